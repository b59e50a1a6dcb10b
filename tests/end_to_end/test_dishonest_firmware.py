"""Firmware that reports of itself what the board sees is not so: a failed test that prints both figures."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from hiltest.boards import default_firmware
from hiltest.virtual.program.elf import load_image

from .firmware_edits import Edit, FirmwareCopy

WALL_LIMIT_S = 120  # a run takes a few seconds; nothing may wait for ever

TIMED = "app/timed_run.c"
FIT = "    calibrator(points, fit);\n"
REPORTED = "    cost.cycles = total - cost.overhead_cycles; /*"
TOTAL = "    const uint32_t total = count_cycles(calibrator, points, fit);\n"
COUNTER_CONTROL = "*(volatile uint32_t *)0xE0001000u"
# To remove the section would move others, into segments that overlap.
RENAME_NOTE = ("--rename-section", ".note.gnu.build-id=.note.other")


@dataclass(frozen=True)
class Ended:
    """What a run of the command told, and what it measured."""

    output: str
    measured: dict[str, Any]


def run(elf: Path, folder: Path, suites: str, *, poses: str = "level", code: int = 1) -> Ended:
    command = [sys.executable, "-m", "hiltest", "run", "--poses", poses, "--out", "out", "--firmware", str(elf)]
    done = subprocess.run(
        [*command, "--", "-k", suites], capture_output=True, text=True, timeout=WALL_LIMIT_S, cwd=folder, check=False
    )
    assert done.returncode == code, done.stdout + done.stderr
    record = json.loads((folder / "out" / "run.json").read_text(encoding="utf-8"))
    output = " ".join((done.stdout + done.stderr).split())
    return Ended(output, {measurement["name"]: measurement["value"] for measurement in record["measurements"]})


@pytest.mark.parametrize(
    "answered",
    ["floorf(turned / 30.0f + 0.5f) * 30.0f", "turned < 359.0f ? turned + 0.003f : 0.0f"],
    ids=["rounded to the known angles", "a little more"],
)
def test_headings_that_its_own_calibration_and_means_do_not_give(
    copy_of_the_firmware: FirmwareCopy, tmp_path: Path, answered: str
) -> None:
    edit = Edit("orientation/tilt_heading.c", "turned < 360.0f ? turned : 0.0f;", f"{answered};")
    ended = run(copy_of_the_firmware.build(edit, tmp_path / "edited.elf"), tmp_path, "identity or heading")
    answer = r"the firmware contradicts itself: it answers a heading of \d+\.\d{4} degrees under '[a-z-]+' at heading"
    assert re.search(answer, ended.output), ended.output
    assert "heading.direct.max" not in ended.measured  # no wrong number is recorded


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("atan2f(side, ahead)", "atan2f(-b[1], b[0])", "no tilt compensation"),
        ("ahead) * DEGREES_PER_RADIAN;", "ahead) * DEGREES_PER_RADIAN + 3.5f;", "constant offset (+3.50 deg)"),
        ("atan2f(side, ahead)", "atan2f(-side, ahead)", "headings counted the other way"),
        ("sin_pitch = -g[0]", "sin_pitch = g[0]", "sign of pitch"),
    ],
    ids=["no tilt compensation", "a declination", "the wrong way round", "the sign of pitch"],
)
def test_a_heading_that_another_computation_gives_names_that(
    copy_of_the_firmware: FirmwareCopy, tmp_path: Path, old: str, new: str, message: str
) -> None:
    edit = Edit("orientation/tilt_heading.c", old, new)
    ended = run(copy_of_the_firmware.build(edit, tmp_path / "edited.elf"), tmp_path, "identity or heading", poses="all")
    words = rf"the firmware contradicts itself: .* degrees Likely cause: {re.escape(message)}.* Next: Check "
    assert re.search(words, ended.output), ended.output


@pytest.mark.parametrize(
    "edit",
    [
        Edit(TIMED, REPORTED, "    cost.cycles = (total - 18u) / 2u; /*"),
        Edit(TIMED, REPORTED, "    cost.cycles = (total - 18u) / 5u * 4u; /*"),
        Edit(TIMED, FIT, f"    {COUNTER_CONTROL} = 0u;\n{FIT}    {COUNTER_CONTROL} = 1u;\n"),
        Edit(TIMED, TOTAL, TOTAL.replace("calibrator,", "magnetometer_empty,") + FIT),
        Edit(
            TIMED,
            TOTAL,
            "    magnetometer_points_t half = *points;\n    half.count /= 2u;\n"
            + TOTAL.replace("points,", "&half,")
            + FIT,
        ),
    ],
    ids=["half of it", "20 % less", "the counter is stopped", "other work is timed", "half of the points are timed"],
)
def test_cycles_that_the_board_did_not_count(copy_of_the_firmware: FirmwareCopy, tmp_path: Path, edit: Edit) -> None:
    ended = run(copy_of_the_firmware.build(edit, tmp_path / "edited.elf"), tmp_path, "identity or cycles")
    match = re.search(
        r"the firmware contradicts the board: it reports (\d+) cycles of direct, and the board counted (\d+) in",
        ended.output,
    )
    assert match, ended.output
    assert int(match[2]) > 1.2 * int(match[1])
    assert "cycles.direct.total" not in ended.measured


def test_cycles_of_a_streams_steps_that_the_board_did_not_count(
    copy_of_the_firmware: FirmwareCopy, tmp_path: Path
) -> None:
    step = "count_step_cycles(step, state, point, status);\n    cost.cycles = "
    edit = Edit(TIMED, f"{step}total - cost.overhead_cycles;", f"{step}(total - cost.overhead_cycles) / 2u;")
    ended = run(copy_of_the_firmware.build(edit, tmp_path / "edited.elf"), tmp_path, "test_cost_of_a_new_point")
    match = re.search(r"it reports (\d+) cycles of direct-stream.add, and the board counted (\d+) in", ended.output)
    assert match, ended.output
    assert int(match[2]) > 1.5 * int(match[1])
    assert not any(name.startswith("stream.") for name in ended.measured)


def test_a_build_id_that_is_not_the_elfs(copy_of_the_firmware: FirmwareCopy, tmp_path: Path) -> None:
    edit = Edit("app/link_commands.c", "write_string(reply, build_id);", 'write_string(reply, "a83ff0fdb4eee047");')
    ended = run(copy_of_the_firmware.build(edit, tmp_path / "edited.elf"), tmp_path, "identity", code=23)
    note = load_image(tmp_path / "edited.elf").build_id
    assert f"GNU build-id note has build {note}, and the firmware answers 'a83ff0fdb4eee047'" in ended.output
    assert ended.measured == {}


def test_a_core_clock_that_is_not_the_one_it_set_up(copy_of_the_firmware: FirmwareCopy, tmp_path: Path) -> None:
    edit = Edit("app/link_commands.c", "write_u32(reply, board.core_clock_hz);", "write_u32(reply, 60000000u);")
    ended = run(copy_of_the_firmware.build(edit, tmp_path / "edited.elf"), tmp_path, "identity", code=23)
    assert "answers a core clock of 60 MHz, and the core runs at 120" in ended.output
    assert ended.measured == {}


def test_the_packaged_build_id_of_a_file_without_a_note(
    copy_of_the_firmware: FirmwareCopy, tmp_path: Path, require_tool: Callable[[str], str]
) -> None:
    own, bare = tmp_path / "own.elf", tmp_path / "bare.elf"
    answer = 'write_string(reply, "{}");'
    for answered, code in ((load_image(default_firmware()).build_id, 23), ("my own build", 0)):
        edit = Edit("app/link_commands.c", "write_string(reply, build_id);", answer.format(answered))
        copy_of_the_firmware.build(edit, own)
        objcopy = [require_tool("arm-none-eabi-objcopy"), *RENAME_NOTE, str(own), str(bare)]
        subprocess.run(objcopy, check=True, timeout=WALL_LIMIT_S)
        assert load_image(bare).build_id == ""
        ended = run(bare, tmp_path, "test_every_sensor_that_answers", code=code)
        assert ("that of the packaged firmware, but is another file" in ended.output) == bool(code)


@pytest.mark.parametrize(
    ("function", "code", "message"),
    [
        ("dpi_from_pairs", 1, "it reports the cycles of direct, and its function was not called for this request"),
        ("magnetometer_empty", 1, "the board counted 3 in its call"),
        ("magnetometer_directly", 4, "such function; name one of its symbols"),
    ],
    ids=["not called", "another one", "not there"],
)
def test_the_function_that_the_rig_names_is_the_one_that_is_counted(
    run_in, edited, tmp_path: Path, function: str, code: int, message: str
) -> None:
    rig = edited(("[limits]", f'[cycles]\ndirect = "{function}"\n\n[limits]'))
    ended = run_in(tmp_path, "--rig", rig, "--", "-k", "identity or cycles")
    output = " ".join((ended.output + ended.errors).split())
    assert message in output
    assert ended.code == code, output
