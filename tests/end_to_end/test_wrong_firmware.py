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

from .firmware_edits import NEXT_PROTOCOL, Edit, FirmwareCopy

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

    def run(edit: Edit, *, exit_code: int = 1, rig: str = "virtual-k64f") -> Ended:
        elf, out = copy_of_the_firmware.build(edit, tmp_path / "edited.elf"), tmp_path / "out"
        command = [sys.executable, "-m", "hiltest", "run", "--poses", "level", "--out", str(out)]
        command += ["--rig", rig, "--firmware", str(elf), *SUITES]
        done = subprocess.run(command, capture_output=True, text=True, timeout=WALL_LIMIT_S, cwd=tmp_path)
        assert done.returncode == exit_code, done.stdout + done.stderr
        return Ended(" ".join((done.stdout + done.stderr).split()), json.loads((out / "run.json").read_text()))

    return run


def test_a_dip_of_the_opposite_sign_is_the_firmwares_where_the_known_angles_show_it_right(
    run_edited: RunEdited,
) -> None:
    ended = run_edited(Edit("app/dpi_commands.c", "sinf(dip_deg /", "-sinf(dip_deg /"))
    assert "dpi of 300 rows: MIRRORED" in ended.output
    assert "likely cause: dpi refuses points as MIRRORED although the known angles confirm their axes" in ended.output


CORRECTED = "const float x = counts[0] {} calibration->offset[{}];"


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
