"""The sensor models against bus transcripts written by hand from the data sheets."""

import json
import math
from pathlib import Path

import pytest

from hiltest.orientation.angles import Pose
from hiltest.world.distortion import MagneticDistortion
from hiltest.world.earth_field import EarthField
from hiltest.world.sensors.fxas21002c import Fxas21002c
from hiltest.world.sensors.fxos8700cq import Fxos8700cq, Fxos8700cqNoise
from hiltest.world.sensors.mag3110 import Mag3110
from hiltest.world.world import World

FOLDER = Path(__file__).parents[2] / "fixtures" / "bus"
# North 20, down 40 uT: what the transcripts' words were worked out with.
FIELD = EarthField(strength_ut=math.sqrt(2000.0), dip_deg=math.degrees(math.atan2(40.0, 20.0)))

PARTS = {
    "mag3110": lambda world: Mag3110(world, MagneticDistortion(), seed=1, noise_ut=(0.0,) * 4),
    "fxos8700cq": lambda world: Fxos8700cq(world, MagneticDistortion(), seed=1, noise=Fxos8700cqNoise(0.0, (0.0, 0.0))),
    "fxas21002c": lambda world: Fxas21002c(world, seed=1, bias_dps=(1.5, -2.0, 3.0), noise_density=0.0),
}


def cases():
    for path in sorted(FOLDER.glob("*.json")):
        transcript = json.loads(path.read_text())
        for case in transcript["cases"]:
            yield pytest.param(transcript["part"], case, id=f"{transcript['part']}: {case['name']}")


def transfer(part, step):
    """Carry out one transaction the way a master does; return what it saw."""
    at_s = step["at_s"]
    if step.get("absent"):
        return {"address": part.start(False, at_s)}
    sent = bytes.fromhex(step.get("write", "") or step["read"][0])
    acknowledged = [part.start(False, at_s), *(part.write(byte, at_s) for byte in sent)]
    received = []
    if "read" in step:
        acknowledged.append(part.start(True, at_s))
        received = [part.read(at_s) for _ in bytes.fromhex(step["read"][1])]
    part.stop(at_s)
    return {"acknowledged": acknowledged, "received": bytes(received).hex(" ")}


def expected(step):
    if step.get("absent"):
        return {"address": False}
    if "read" in step:
        return {"acknowledged": [True] * 3, "received": step["read"][1]}
    bytes_sent = len(bytes.fromhex(step["write"]))
    return {"acknowledged": [True] * bytes_sent + [not step.get("nack", False)], "received": ""}


@pytest.mark.parametrize(("part_name", "case"), list(cases()))
def test_the_part_answers_as_its_data_sheet_says(part_name, case):
    world = World(FIELD, pose=Pose(*case.get("pose", (0.0, 0.0, 0.0))))
    part = PARTS[part_name](world)
    for step in case["steps"]:
        assert transfer(part, step) == expected(step), step


def test_there_are_transcripts_for_every_part():
    assert {path.stem for path in FOLDER.glob("*.json")} == set(PARTS)
