"""Firmware with one thing wrong: the real command must end red, by the right name, within its deadline.

Each case is the project's own firmware with one edit, built with the cross compiler and run on the virtual board.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from hiltest.link.messages import PROTOCOL_VERSION

from .firmware_edits import NEXT_PROTOCOL, Edit, FirmwareCopy, calibrations_turned

WALL_LIMIT_S = 120  # a run takes a few seconds; nothing may wait for ever
# What these causes show in, and the gyroscope, which is measured before the headings are.
SUITES = ("--", "-k", "identity or accelerometer or test_gyroscope or heading or dpi")


@dataclass(frozen=True)
class Ended:
    """What a run of the command told, and what it kept."""

    output: str
    record: dict[str, Any]

    @property
    def values(self) -> dict[str, float | None]:
        """What was measured, by name; None where there was nothing to give."""
        return {measurement["name"]: measurement["value"] for measurement in self.record["measurements"]}


RunEdited = Callable[..., Ended]


@pytest.fixture
def run_edited(tmp_path: Path, copy_of_the_firmware: FirmwareCopy) -> RunEdited:
    """Return a function that edits the firmware, builds it, and runs ``hiltest run`` to the end it must have."""

    def run(edit: Edit, *, exit_code: int = 1, rig: str = "virtual-k64f", suite: str = "gate") -> Ended:
        elf, out = copy_of_the_firmware.build(edit, tmp_path / "edited.elf"), tmp_path / "out"
        command = [sys.executable, "-m", "hiltest", "run", "--poses", "level", "--out", str(out)]
        command += ["--rig", rig, "--suite", suite, "--firmware", str(elf), *SUITES]
        done = subprocess.run(command, capture_output=True, text=True, timeout=WALL_LIMIT_S, cwd=tmp_path)
        assert done.returncode == exit_code, done.stdout + done.stderr
        return Ended(" ".join((done.stdout + done.stderr).split()), json.loads((out / "run.json").read_text()))

    return run


OF_THE_ACCELEROMETER = (
    "    body[0] = limited(sensor[1]);\n    body[1] = limited(sensor[0]);\n    body[2] = limited(sensor[2]);\n"
)


@pytest.mark.parametrize(
    ("axes", "message"),
    [
        ((1, 0, "negated", 2), "(x, y, -z)"),
        ((0, 1, "limited", 2), "(y, x, z)"),
        ((0, 2, "limited", 1), "(y, z, x)"),
    ],
)
def test_wrong_axes_of_the_accelerometer_are_named_beside_the_delivered_samples(
    run_edited: RunEdited, axes: tuple[int, int, str, int], message: str
) -> None:
    x, y, sign, z = axes
    read = (f"limited(sensor[{x}])", f"limited(sensor[{y}])", f"{sign}(sensor[{z}])")
    result = "".join(f"    body[{axis}] = {value};\n" for axis, value in enumerate(read))
    ended = run_edited(Edit("sensors/axes.c", OF_THE_ACCELEROMETER, result))
    assert f"accelerometer samples has {message} in place of (x, y, z)" in ended.output


DPI_SUMS = "calibration/dpi_sums.c"
GRAVITY = "row[0] * a[0] + row[1] * a[1] + row[2] * a[2] + at_zero"


def test_a_mistake_in_a_calibration_is_named_with_its_size(run_edited: RunEdited) -> None:
    ended = run_edited(calibrations_turned(3.0, about="x"))
    assert "Likely cause: rotation (rotated by 3 deg about x, beside its fit in float64)" in ended.output


def test_gravity_in_another_unit_is_red(run_edited: RunEdited) -> None:
    edit = Edit("calibration/gravity_row.h", f"return {GRAVITY};", f"return 9.80665f * ({GRAVITY});")
    # The heading does not depend on it. But 9.8 times the sine of 62 degrees is no sine.
    ended = run_edited(edit, suite="full")
    assert ended.values["fit.dpi.dip"] == pytest.approx(90.0)
    assert "fit.dpi.dip" in ended.output


def test_axes_of_gravity_in_a_circle_make_every_heading_wrong(run_edited: RunEdited) -> None:
    axes = ".a = {{(float)a[{}], (float)a[{}], (float)a[{}]}},"
    ended = run_edited(Edit(DPI_SUMS, axes.format(0, 1, 2), axes.format(1, 2, 0)), suite="full")
    assert ended.values["fit.dpi.rotation_left"] == pytest.approx(120.0, abs=1.0)
    assert ended.values["heading.dpi.max"] > 45


CORRECTED = "const float x = counts[0] {} calibration->offset[{}];"
STORED = "    slot_set_accelerometer(slot, &calibration);"
IN_MG = """    for (int i = 0; i < 3; i++) {
        calibration.offset[i] *= 1000.0f * ACCELEROMETER_G_PER_COUNT;
    }
"""


@pytest.mark.parametrize(
    "edit",
    [
        Edit("calibration/accelerometer_calibration.c", CORRECTED.format("-", 0), CORRECTED.format("+", 0)),
        Edit("calibration/accelerometer_calibration.c", CORRECTED.format("-", 0), CORRECTED.format("-", 1)),
    ],
    ids=["sign", "axis"],
)
def test_an_accelerometer_calibration_that_is_not_applied_as_it_is_answered_is_a_contradiction(
    run_edited: RunEdited, edit: Edit
) -> None:
    ended = run_edited(edit, rig="virtual-k64f-untrimmed")
    assert "the firmware contradicts itself: it answers a residual of" in ended.output
    assert "heading.direct.max" not in ended.values


def test_an_accelerometer_calibration_in_another_unit_is_red(run_edited: RunEdited) -> None:
    edit = Edit("app/accelerometer_commands.c", STORED, IN_MG + STORED)
    result = run_edited(edit, rig="virtual-k64f-untrimmed").values
    # 20 mg that stay, or come twice, on one axis alone: 1.1 degrees of tilt at least, times tan(62).
    assert result["heading.direct.max"] > 2.0
    assert result["accelerometer.tilt_error"] > 0.3
    assert result["accelerometer.six_position.offset_error"] < 0.7  # the fit itself is right


def in_tilt_heading(statement: str) -> Edit:
    return Edit("orientation/tilt_heading.c", "    float g[3], b[3];", f"    float g[3], b[3];\n    {statement}")


PDB0_BY_ITS_STATUS = """*(volatile unsigned *)0x4004803C |= 1u << 22;
    while (!(*(volatile unsigned *)0x40036000 & 0x40u)) {
    }"""


@pytest.mark.parametrize(
    ("edit", "answer"),
    [
        (in_tilt_heading("for (;;) {\n    }"), ("the firmware is hung", "in tilt_heading (tilt_heading.c:")),
        (
            in_tilt_heading("*(volatile int *)0x30000000 = 1;"),
            ("write to unmapped address 0x30000000", "tilt_heading.c:"),
        ),
        (
            in_tilt_heading(PDB0_BY_ITS_STATUS),
            (
                "no answer to AVERAGE within",
                "executing tilt_heading (tilt_heading.c:",
                ", polling PDB0_SC at 0x40036000, which is not modelled",
            ),
        ),
    ],
    ids=["hangs", "faults", "waits for what is not modelled"],
)
def test_firmware_that_stops_is_a_lost_bench_that_says_where_and_keeps_what_was_measured(
    run_edited: RunEdited, edit: Edit, answer: tuple[str, ...]
) -> None:
    ended = run_edited(edit, exit_code=20)
    assert [words for words in answer if words not in ended.output] == [], ended.output
    assert ended.values.get("heading.direct.max") is None
    assert ended.values["gyroscope.bias_error"] < 0.1


@pytest.mark.parametrize(
    ("edit", "exit_code", "answer"),
    [
        (
            Edit("boards/frdm_k64f/uart.c", "#define BAUD_DIVISOR 65u", "#define BAUD_DIVISOR 60u"),
            20,
            ("synchronisation",),
        ),
        # Bytes arrive at the right pace, and none of their check sums holds.
        (
            Edit("protocol/message.c", "write_u32(&trailer, crc32(", "write_u32(&trailer, ~crc32("),
            20,
            ("synchronisation",),
        ),
        (
            Edit("boards/frdm_k64f/board.c", '.name = "hiltest-frdm-k64f"', '.name = "blinky"'),
            23,
            ("blinky", "hiltest-frdm-k64f"),
        ),
        (NEXT_PROTOCOL, 23, (f"speaks protocol version {PROTOCOL_VERSION + 1}",)),
    ],
    ids=["another baud rate", "wrong check sums", "another name", "another protocol version"],
)
def test_firmware_that_is_not_understood_is_named_and_nothing_is_measured(
    run_edited: RunEdited, edit: Edit, exit_code: int, answer: tuple[str, ...]
) -> None:
    ended = run_edited(edit, exit_code=exit_code)
    assert [words for words in answer if words not in ended.output] == [], ended.output
    assert ended.values.get("heading.direct.max") is None
