"""The sample compass with one thing wrong: ``hiltest run --rig text-compass`` must end red, by the right name."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from .firmware_edits import Edit, FirmwareCopy

WALL_LIMIT_S = 300  # a run takes half a minute
SAID = "    output_state(&state, &background);\n"


@pytest.mark.parametrize(
    ("edit", "poses", "red", "told"),
    [
        (Edit("compass/main.c", SAID, f"    state.heading_deg = 360.0f - state.heading_deg;\n{SAID}"), "level",
         "heading.firmware.max", "another frame than the declared one (headings are right"),
        (Edit("compass/background.c", "        field[axis] = row[0] * x + row[1] * y + row[2] * z;",
              "        field[axis] = row[axis] * (axis == 0 ? 1.1f * x : axis == 1 ? y : z);"), "level",
         "heading.firmware.max", "its own calibration"),
        (Edit("compass/main.c", SAID, f"    state.pitch_deg = -state.pitch_deg;\n{SAID}"), "all",
         "accelerometer.tilt_error", "accelerometer.tilt_error 40."),
    ],
    ids=["heading the other way", "a wrong gain after the fit", "pitch the other way"],
)  # fmt: skip
def test_a_compass_with_a_mistake_is_red_by_its_name(
    copy_of_the_firmware: FirmwareCopy, tmp_path: Path, edit: Edit, poses: str, red: str, told: str
) -> None:
    elf = copy_of_the_firmware.build_compass(edit, tmp_path / "edited.elf")
    command = [sys.executable, "-m", "hiltest", "run", "--rig", "text-compass", "--poses", poses]
    done = subprocess.run(
        [*command, "--firmware", str(elf)], capture_output=True, text=True, timeout=WALL_LIMIT_S, cwd=tmp_path
    )
    assert done.returncode == 1, done.stdout + done.stderr
    assert told in " ".join(done.stdout.split())
    record = json.loads((tmp_path / "hil-out" / "run.json").read_text(encoding="utf-8"))
    assert red in [each["name"] for each in record["measurements"] if each["outcome"] == "fail"]
