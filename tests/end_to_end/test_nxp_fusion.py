"""NXP's Sensor Fusion as it is: judged by its packets, its calibration apart from its filter, its functions counted."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

from ..finished_run import without_volatile
from ..foreign_elf import foreign_elf

RIG = Path(__file__).parents[2] / "hil" / "rigs" / "nxp-fusion-agm01.toml"
WALL_LIMIT_S = 900  # a minute and a half on two idle cores
# Four headings, and hardly a rest: the calibration needs none, and the filter has not converged then.
SHORT = (
    (r"^headings_deg = .*$", "headings_deg = [0, 90, 180, 270]"),
    (r"^tilts_deg = .*$", "tilts_deg = [[0, 0]]"),
    (r"^converge_s = .*$", "converge_s = 1.0"),
    (r"^settle_s = .*$", "settle_s = 3.0"),
)


def test_its_calibration_is_right_and_its_slices_are_counted(tmp_path: Path) -> None:
    elf = foreign_elf("nxp_sensor_fusion.elf")
    text = RIG.read_text(encoding="utf-8")
    for pattern, instead in SHORT:
        text, result = re.subn(pattern, instead, text, flags=re.M)
        assert result == 1, pattern
    (tmp_path / "short.toml").write_text(text, encoding="utf-8")
    command = [sys.executable, "-m", "hiltest", "run", "--rig", "short.toml"]
    recorded = [*command, "--firmware", str(elf), "--record", "run.jsonl.gz"]
    done = subprocess.run(recorded, capture_output=True, text=True, timeout=WALL_LIMIT_S, cwd=tmp_path)
    assert done.returncode in (0, 1), done.stdout + done.stderr
    record = json.loads((tmp_path / "hil-out" / "run.json").read_text(encoding="utf-8"))
    values = {measurement["name"]: measurement["value"] for measurement in record["measurements"]}
    # Packets, variables, what its functions cost and the samples that ours got come from the recording as they were.
    replay = [*command[:4], "--replay", "run.jsonl.gz", "--out", "again"]
    replayed = subprocess.run(replay, capture_output=True, text=True, timeout=WALL_LIMIT_S, cwd=tmp_path)
    assert replayed.returncode == done.returncode, replayed.stdout + replayed.stderr
    again = json.loads((tmp_path / "again" / "run.json").read_text(encoding="utf-8"))
    volatile = sorted({*record["volatile"], *again["volatile"]})
    assert without_volatile(again | {"volatile": volatile}) == without_volatile(record | {"volatile": volatile})
    assert values["heading.uncalibrated.max_level"] > 20.0, "its magnetometer reads 19 uT too much, level, of 23"
    assert values["heading.calibrated.max"] < 1.0
    assert values["fit.firmware.offset_error"] < 1.0
    assert values["device.not_understood"] == 0
    assert values["cycles.fit-4.slices"] == 17, "as its source has it, with 14 rows of its buffer"
    # Of its last solution; were it computed from another memory, or by other arguments, it would not be offered.
    assert 1.05 < values["cycles.calibrated.from_flash"] / values["cycles.calibrated.total"] < 1.5
    assert re.search(
        r"Its fit takes \d+ \d+ cycles without memory waits, .* \(fit-10 in \d+ slices\); direct \d",
        record["verdict"]["sentence"],
    ), record["verdict"]["sentence"]
    # Ours got what was in its buffer when that solution began: with three axes in a row or another index none fits.
    assert values["heading.direct.max"] < 1.5
    assert values["cycles.kalman.calls"] > 40 * 60, "40 a second"
    # What its own clock says of a step of its filter, in ticks of the core: it counts with interrupts, and in twenties.
    assert values["cycles.kalman.median"] > 10_000
