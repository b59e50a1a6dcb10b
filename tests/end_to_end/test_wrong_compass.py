"""The sample compass with one thing wrong ends red, by the right name; one that averages longer is not wrong."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from hiltest.boards import default_firmware
from hiltest.rig.bench_files import shipped

from .. import in_process
from ..command_files import checked
from ..finished_run import run_hiltest
from .firmware_edits import Edit, FirmwareCopy

WALL_LIMIT_S = 300  # a run takes half a minute
SAID = "    output_state(&state, &background);\n"


POOR = "    if (found.status != FIT_ELLIPSOID"
ROLL_NEGATED = "(const float[3]){state.gravity[0], -state.gravity[1], state.gravity[2]}"
TWICE = [f"state.field[{axis}] - background.iron.hard_iron[{axis}]" for axis in range(3)]
REMOVED_TWICE = f"(const float[3]){{{', '.join(TWICE)}}}"
FITTED = "        background->iron = iron;\n"


@pytest.mark.parametrize(
    ("edit", "poses", "red", "message"),
    [
        (
            Edit("compass/main.c", SAID, f"    state.heading_deg = 360.0f - state.heading_deg;\n{SAID}"),
            "level",
            "heading.firmware.max",
            "headings counted the other way; calibration right",
        ),
        (
            Edit("compass/main.c", "tilt_heading(state.gravity, ", f"tilt_heading({ROLL_NEGATED}, "),
            "all",
            "heading.firmware.max",
            "sign of roll; calibration right",
        ),
        (
            Edit("compass/main.c", "state.gravity, state.field, ", f"state.gravity, {REMOVED_TWICE}, "),
            "all",
            "heading.firmware.max",
            "hard iron subtracted twice",
        ),
        (
            Edit("compass/background.c", FITTED, f"{FITTED}        background->iron.soft_iron[0] *= 1.1f;\n"),
            "level",
            "heading.firmware.max",
            "scale of the x axis of the magnetometer (+",
        ),
        # Of the first points, which are of less than half of the sphere: 0.69, 1.16, 1.92 and 1.21 degrees of the noise
        # of seeds 1 to 4, beside 0.37 to 0.63. One run does not see the first.
        (
            Edit("compass/background.c", POOR, f"    if (background->iron.error_percent < 100.0f || {POOR[8:]}"),
            "all --seed 3",
            "heading.firmware.max",
            "its calibration alone errs by",
        ),
        (
            Edit("compass/main.c", SAID, f"    state.pitch_deg = -state.pitch_deg;\n{SAID}"),
            "all",
            "accelerometer.tilt_error",
            "right within 0.1 deg with pitch negated",
        ),
        (
            Edit("compass/main.c", SAID, f"    state.heading_deg = 12.0f;\n{SAID}"),
            "level",
            "heading.firmware.max",
            "a heading that does not follow the board (they cover 0.0 deg",
        ),
        # Of the noise of its samples the mean is off by a tenth of a degree, either way.
        (
            Edit("compass/main.c", SAID, f"    state.heading_deg += 10.5f;\n{SAID}"),
            "level",
            "heading.firmware.max",
            "constant offset (+10.",
        ),
        (
            Edit("compass/main.c", SAID, f'{SAID}    if (state.time_us > 30000000u) output_error("too warm");\n'),
            "level",
            "device.errors",
            "'too warm'",
        ),
        (
            Edit(
                "compass/output_lines.c",
                'put_vector(" ACC=", state->gravity, 1.0f',
                'put_vector(" ACC=", state->gravity, 0.97f',
            ),
            "level",
            "device.acceleration_error",
            "",
        ),
        (
            Edit(
                "compass/main.c",
                SAID,
                f"    state.heading_deg = 30.0f * (float)((int)((state.heading_deg + 15.0f) / 30.0f) % 12);\n{SAID}",
            ),
            "level",
            "",
            "the headings of firmware are better than the magnetometer's noise allows",
        ),
    ],
    ids=[
        "heading the other way",
        "roll the other way in the heading",
        "hard iron removed twice for the heading",
        "a wrong gain after the fit",
        "a fit that is never renewed",
        "pitch the other way",
        "a heading that is frozen",
        "a heading with an offset",
        "errors on the way",
        "a scale of the shown acceleration",
        "the table's angles",
    ],
)
def test_a_compass_with_a_mistake_is_red_by_its_name(
    copy_of_the_firmware: FirmwareCopy, tmp_path: Path, edit: Edit, poses: str, red: str, message: str
) -> None:
    elf = copy_of_the_firmware.build_compass(edit, tmp_path / "edited.elf")
    command = [sys.executable, "-m", "hiltest", "run", "--rig", "text-compass", "--poses", *poses.split()]
    done = subprocess.run(
        [*command, "--firmware", str(elf)], capture_output=True, text=True, timeout=WALL_LIMIT_S, cwd=tmp_path
    )
    assert done.returncode == 1, done.stdout + done.stderr
    assert message in " ".join(done.stdout.split())
    record = json.loads((tmp_path / "hil-out" / "run.json").read_text(encoding="utf-8"))
    failed = [measurement["name"] for measurement in record["measurements"] if measurement["outcome"] == "fail"]
    assert red in failed or not red


HAS_HEADING = "if (state->has_heading) {"


@pytest.mark.parametrize(
    ("condition", "code"),
    [("state->has_heading && iron->strength > 0.0f", 0), ("state->has_heading && iron->strength < 0.0f", 23)],
    ids=["after its calibration", "never"],
)
def test_a_compass_is_judged_from_its_calibration_on_if_it_gives_no_heading_before(
    copy_of_the_firmware: FirmwareCopy, tmp_path: Path, condition: str, code: int
) -> None:
    edit = Edit("compass/output_lines.c", HAS_HEADING, f"if ({condition}) {{")
    elf = copy_of_the_firmware.build_compass(edit, tmp_path / "edited.elf")
    ended = run_hiltest(tmp_path, "--rig", "text-compass", "--poses", "level", "--firmware", str(elf))
    assert ended.code == code, ended.output + ended.errors
    if code == 0:
        assert ended.measured["heading.uncalibrated.max"]["value"] is None
        assert ended.value("heading.firmware.max") < 1.3


def test_a_compass_that_averages_100_samples_raises_no_alarm(
    copy_of_the_firmware: FirmwareCopy, tmp_path: Path
) -> None:
    edit = Edit("compass/main.c", "#define SAMPLES_A_STATE 8 ", "#define SAMPLES_A_STATE 100 ")
    elf = copy_of_the_firmware.build_compass(edit, tmp_path / "edited.elf")
    text = (shipped() / "rigs" / "text-compass.toml").read_text(encoding="utf-8")
    slower = text.replace('kind = "text"\n', 'kind = "text"\nwindow_s = 2.5\n', 1)  # a line comes every 1.25 s
    (tmp_path / "slower.toml").write_text(slower, encoding="utf-8")
    ended = run_hiltest(tmp_path, "--rig", "slower.toml", "--firmware", str(elf))
    assert ended.code == 0, ended.output + ended.errors
    assert ended.value("heading.firmware.max") < 1.0


TAKE = "void background_take(background_t *background, const int16_t sample[3])\n{\n"
BUSY = f"{TAKE}    for (volatile int turn = 0; turn < 300; turn++) {{ }}\n"


@pytest.mark.parametrize(
    ("counted", "function"), [("", "all code"), ('background = "background_take"', "background_take")]
)
def test_work_that_is_added_to_a_foreign_compass_is_worse_and_explained_by_its_line(
    copy_of_the_firmware: FirmwareCopy, tmp_path: Path, counted: str, function: str
) -> None:
    elf = copy_of_the_firmware.build_compass(Edit("compass/background.c", TAKE, BUSY), tmp_path / "busy.elf")
    base = default_firmware().with_name("compass-lines.elf")
    text = (shipped() / "rigs" / "text-compass.toml").read_text(encoding="utf-8")
    (tmp_path / "rig.toml").write_text(text.replace("[cycles]\n", f"[cycles]\n{counted}\n"), encoding="utf-8")
    options = ["--rig", "rig.toml", "--poses", "level"]
    assert run_hiltest(tmp_path, *options, "--firmware", str(base), "--out", "before").code == 0
    after = run_hiltest(tmp_path, *options, "--firmware", str(elf), "--baseline", "before", "--out", "after")
    assert after.code == 21, after.output + after.errors
    words = ["after", "--firmware", str(elf), "--against", str(base), "--json"]
    explained = checked(in_process.hiltest("explain", *words, folder=tmp_path).stdout, "hiltest.explanation/1")
    worse = [change["name"] for change in explained["changes"] if change["change"] == "worse"]
    assert ("cycles.awake.share" in worse, "cycles.background.median" in worse) == (True, bool(counted))
    changed = explained["functions"][0]
    line = changed["lines"][0]
    assert changed["function"] == function
    assert explained["functions"][-1]["function"] == "all code"
    assert line["location"].startswith("background.c:")
    assert line["base_cycles"] == 0
    if counted:  # a call and what it calls, and nothing else: all code takes 9 120 cycles for each of the 1 600 calls
        assert changed["cycles"] == pytest.approx(5_800, rel=0.05)
    # A turn of the loop takes 10 cycles; a call, or all 1 600 of the tumble.
    assert line["cycles"] == pytest.approx(3_000 if counted else 1_600 * 3_000, rel=0.02)
