"""A short run of the main job on the virtual board, and how it ended."""

from __future__ import annotations

import json
import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.finished_run import run_module

from hiltest.boards.bench import START_UP_S
from hiltest.link.messages import Collect
from hiltest.link.session import ATTEMPTS, REPLY_DEADLINE_S
from hiltest.rig.bench_files import shipped
from hiltest.world.sensors import Fxos8700cqNoise

WALL_LIMIT_S = 120.0  # for what takes some 3 s on a machine of its own
READINGS = 16
# 100 points at 80 Hz; of the requests of this run the one that the board may spend most on.
LONGEST_DEADLINE_S = REPLY_DEADLINE_S + Collect(100, timeout_us=3_500_000).board_time_s
# Every attempt of one request has its deadline; the rest is what the reads before and the end of the run take.
DEADLINE_S = ATTEMPTS * LONGEST_DEADLINE_S + 1.0

# How long a run took, what the line made of it, and the most stack of all that ran: of a run that ended early, of less.
OF_THE_COURSE = ("board.", "link.retried", "firmware.stack_most")

SHORT = {
    "[358.3, 58.3, 118.3, 178.3, 238.3, 298.3, 328.3, 268.3, 208.3, 148.3, 88.3, 28.3]": "[0, 90, 180, 270]",
    "tumble_points = 300": 'tumble_points = 100\ndpi = "none"',
    "temperature_end_degc = 41.0\ntemperature_ramp_s = 150.0\n": "",
}
# A world without noise, but of the accelerometer, in which a time later by a second changes no number.
QUIET = SHORT | {"mag3110_noise_ut = [0.4, 0.35, 0.3, 0.25]": "mag3110_noise_ut = [0.0, 0.0, 0.0, 0.0]"}
TESTS = '''\
"""The main job in short: who answers, points of a tumble, a calibration, its cycles, headings."""

from hiltest.procedures import collect_tumble, measure_cycles, measure_known_angles, run_calibrators


def test_who_answers(board, measure):
    measure("identity.calibrators", len(board.identity.calibrators))


def test_headings(board, turntable, rig, measure):
    tumble = collect_tumble(board, turntable, points=100)
    measure("tumble.coverage", 100.0 * tumble.coverage, "%")
    run = run_calibrators(board, tumble, calibrators=["direct"], n=100)["direct"]
    measure("fit.direct.residual", run.residual_percent, "%")
    measure("fit.direct.offset_error", run.offset_error_ut, "uT")
    angles = measure_known_angles(
        board, turntable, poses=rig.procedure.known_angle_poses("level"),
        slots={"uncalibrated": 0, "direct": run.slot}, mounting_yaw_deg=rig.mounting.yaw_deg,
    )
    for name in ("direct", "uncalibrated"):
        measure(f"heading.{name}.max", angles.summary(name).max_deg, "deg")


def test_cycles(board, measure):
    cost = measure_cycles(board, ["direct"], point_sets=1, sizes=(20, 100))["direct"]
    measure("cycles.direct.total", cost.total, "cycle", cycle_model=cost.model, band=cost.band)
    measure("cycles.direct.instructions", cost.instructions)


def test_line(board, measure):
    measure("link.retried", board.session.retried)
'''


@dataclass(frozen=True)
class Ended:
    """How a run ended."""

    code: int
    output: str
    record: dict[str, Any]

    @property
    def numbers(self) -> dict[str, float | None]:
        """What was measured and does not depend on how long it took, by name."""
        measured = {measurement["name"]: measurement["value"] for measurement in self.record["measurements"]}
        return {name: value for name, value in measured.items() if not name.startswith(OF_THE_COURSE)}

    @property
    def retried(self) -> int:
        """How many requests were sent again, in a run that came to its end."""
        return self._value("link.retried")

    @property
    def virtual_s(self) -> float:
        """When it ended, from the opening of the port on, by the board's clock."""
        return self._value("board.virtual_seconds") - START_UP_S

    @property
    def sentence(self) -> str:
        """What a user reads of it in the end."""
        sentence: str = self.record["verdict"]["sentence"]
        return sentence

    def _value(self, name: str) -> Any:
        (value,) = (measurement["value"] for measurement in self.record["measurements"] if measurement["name"] == name)
        return value


def run_short(folder: Path, faults: str = "", *, noisy: bool = False, firmware: bytes | None = None) -> Ended:
    """Run the tests above on a virtual board with faults, or with other firmware."""
    text = (shipped() / "rigs" / "virtual-k64f.toml").read_text(encoding="utf-8").partition("[limits]")[0]
    for old, new in (SHORT if noisy else QUIET).items():
        assert text.count(old) == 1
        text = text.replace(old, new)
    folder.mkdir()
    (folder / "rig.toml").write_text(f"{text}\n[faults]\n{faults}\n" if faults else text, encoding="utf-8")
    (folder / "test_short.py").write_text(TESTS, encoding="utf-8")
    if firmware is not None:
        (folder / "other.elf").write_bytes(firmware)
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("HIL_", "PYTEST_"))}
    done = run_module(
        "pytest",
        "-q",
        "-p",
        "no:cacheprovider",
        "--hil-rig",
        "rig.toml",
        *(["--hil-firmware", "other.elf"] if firmware else []),
        "test_short.py",
        folder=folder,
        environment=environment,
    )
    (file,) = folder.glob("**/run.json")
    return Ended(done.returncode, done.stdout, json.loads(file.read_text(encoding="utf-8")))


def heading_tolerance_deg(dip_deg: float = 62.0) -> float:
    """Return by how much the noise of the accelerometer's readings, others where time has passed, may move a heading.

    An error of e radians turns it by up to e tan(dip); readings of 16 each on two axes, on either side of a
    difference, and five sigma.
    """
    sigma_g = Fxos8700cqNoise().accelerometer_g(100.0)
    return 5.0 * math.degrees(2.0 * sigma_g / math.sqrt(READINGS) * math.tan(math.radians(dip_deg)))


def wrong_numbers(ended: Ended, clean: Ended) -> list[str]:
    """Return the names of numbers that are there and are not those of the run without faults."""
    allowed = heading_tolerance_deg()
    return [
        name
        for name, value in ended.numbers.items()
        if value != clean.numbers[name]
        and not (
            name.startswith("heading.")
            and value is not None
            and clean.numbers[name] is not None
            and abs(value - clean.numbers[name]) <= allowed
        )
    ]
