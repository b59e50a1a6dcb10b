"""`hiltest profile`: what it prints, writes and refuses."""

from __future__ import annotations

import json
import subprocess
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path

import pytest
from pydantic import TypeAdapter
from tests.patched_firmware import HANG, patched

from hiltest.boards import default_firmware
from hiltest.commands.cli import main
from hiltest.virtual.board.k64f import VirtualK64F
from hiltest.virtual.profiling.document import ProfileDocument

CRC = ("shipped", "crc32", "text:123456789", "9")


def profile(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as ended:
        main(["profile", *arguments])
    output = capsys.readouterr()
    return int(ended.value.code or 0), output.out, output.err


def document(capsys: pytest.CaptureFixture[str], *arguments: str) -> ProfileDocument:
    code, out, _ = profile(capsys, *arguments, "--json")
    assert code == 0
    return TypeAdapter(ProfileDocument).validate_json(out)


def test_the_tables_show_the_answer_the_cost_and_its_model(capsys: pytest.CaptureFixture[str]) -> None:
    cycles = VirtualK64F(default_firmware()).call("crc32", b"123456789", 9).cycles
    code, out, _ = profile(capsys, *CRC, "--instructions", "2")
    assert code == 0
    assert "crc32(text:123456789, 9) = 3421780262 (0xcbf43926)" in out
    assert f"{cycles} cycles," in out
    assert "cycle model cortex-m4-trm/3@flash" in out
    assert "code ran from flash with zero wait states" in out
    assert "crc32.c:" in out
    assert " pop.w " in out
    assert "... " in out.split("instruction ")[-1], "says how many instructions are left out"


def test_json_is_of_the_shipped_schema_and_its_shares_add_up(capsys: pytest.CaptureFixture[str]) -> None:
    found = document(capsys, *CRC)
    assert found.schema == "hiltest.profile/1"
    assert found.returned == 0xCBF43926
    assert sum(share.cycles for share in found.shares) == found.cycles
    assert sum(share.percent for share in found.shares) == pytest.approx(100.0, abs=1e-9)  # float64 sums
    assert found.notes == (
        "code ran from flash with zero wait states, because they are not modelled: silicon takes more cycles; "
        "the profile cortex-m4-k64f/3 counts them",
    )
    assert found.band is None


@pytest.mark.parametrize(
    ("written", "hz", "shown"),
    [
        ("48MHz", 48_000_000, "48 MHz"),
        ("48_000_000", 48_000_000, "48 MHz"),
        ("20.97 mhz", 20_970_000, "20.97 MHz"),
        ("32.768kHz", 32_768, "0.032768 MHz"),
        ("1GHz", 1_000_000_000, "1000 MHz"),
        ("6e7", 60_000_000, "60 MHz"),
    ],
)
def test_microseconds_are_of_the_clock_that_was_named(
    capsys: pytest.CaptureFixture[str], written: str, hz: int, shown: str
) -> None:
    usual, found = document(capsys, *CRC), document(capsys, *CRC, "--clock", written)
    assert (found.cycles, found.core_clock_hz, usual.core_clock_hz) == (usual.cycles, hz, 120_000_000)
    microseconds = f"{found.cycles / hz * 1e6:.2f} us at {shown}"
    assert microseconds in " ".join(profile(capsys, *CRC, "--clock", written)[1].split())


def test_waits_for_flash_are_said_to_be_of_the_timing_profile_at_another_clock(
    capsys: pytest.CaptureFixture[str],
) -> None:
    counted = (*CRC, "--profile", "cortex-m4-k64f/3")
    usual, slower = document(capsys, *counted), document(capsys, *counted, "--clock", "48MHz")
    assert slower.cycles == usual.cycles
    (note,) = set(slower.notes) - set(usual.notes)
    assert "regardless of the core clock" in note


def test_code_in_sram_carries_its_placement_and_no_note(capsys: pytest.CaptureFixture[str]) -> None:
    found = document(capsys, "shipped", "magnetometer_empty", "0", "0")
    assert (found.cycle_model, found.notes, found.returned) == ("cortex-m4-trm/3@sram", (), None)


def test_what_a_function_left_in_a_buffer_is_shown_and_nothing_else(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ("shipped", "memset", "int16:1,2,3,4", "255", "6")
    found = document(capsys, *arguments)
    assert [(each.argument, each.type, each.values) for each in found.buffers] == [(1, "int16", (-1, -1, -1, 4))]
    assert "argument 1 holds int16: -1 -1 -1 4" in profile(capsys, *arguments)[1]
    assert "holds" not in profile(capsys, "shipped", "memset", "int16:0", "0", "2")[1]


def test_folded_stacks_and_the_flame_graph_hold_every_cycle(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    folded, graph = tmp_path / "stacks.folded", tmp_path / "flame.svg"
    points = "ptr:int16:" + ",".join(str(100 * ((k * k) % 7 - 3) + k) for k in range(60))
    arguments = ("shipped", "magnetometer_direct", f"{points}+uint16:20+int16:-300,-300,-300,360,360,360", "zeros:64")
    found = document(capsys, *arguments, "--folded", str(folded), "--flame-graph", str(graph))
    stacks = {stack: int(cycles) for stack, cycles in (line.rsplit(" ", 1) for line in folded.read_text().splitlines())}
    assert sum(stacks.values()) == found.cycles
    assert "magnetometer_direct;moments_sum" in stacks
    titles = [each.text or "" for each in ET.parse(graph).iter("{http://www.w3.org/2000/svg}title")]
    assert f"magnetometer_direct: {found.cycles} cycles, 100.0 %" in titles
    boxes = {
        float(each.attrib["width"])
        for each in ET.parse(graph).iter("{http://www.w3.org/2000/svg}rect")
        if each.attrib["width"] != "100%"
    }
    assert max(boxes) == 1000.0


def test_a_superfluous_argument_is_refused_before_the_calibrator_is_called(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    elf = tmp_path / "hangs.elf"
    elf.write_bytes(patched(default_firmware(), ["magnetometer_direct"], HANG))
    assert profile(capsys, str(elf), "direct", "1")[0] == 4
    assert profile(capsys, str(elf), "direct")[0] == 20, "it hangs if it is called"


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (("shipped", "crc3"), "no function 'crc3'; near: crc32"),
        (("shipped", "direct", "1"), "direct is a calibrator, which is called with 100 points, without arguments"),
        (("shipped", "direct", "--clock", "48MHz"), "or name its function: magnetometer_direct"),
        (("shipped", "direkt"), "no function and no calibrator 'direkt'; did you mean 'direct'?"),
        (("shipped", "crc32", "1"), "crc32 takes 2 arguments, not 1"),
        (("shipped", "crc32", "text:a", "1.5"), "argument 2 of crc32 is unsigned, not float"),
        (("shipped", "crc32", "--jsn", "1"), "'--jsn' is not an argument"),
        (("--jsn", "shipped", "crc32"), "No such option '--jsn'"),
        (("gone.elf", "main"), "gone.elf: No such file or directory; name the firmware's ELF"),
        ((*CRC, "--profile", "cortex-m7"), "no timing profile 'cortex-m7'; known: cortex-m4-k64f/1, cortex-m4-k64f/2"),
        ((*CRC, "--folded", "gone/stacks"), "cannot write gone/stacks: No such file or directory"),
        ((*CRC, "--lines", "-1"), "-1 is not in the range x>=0"),
        ((*CRC, "--clock", "fast"), "--clock: 'fast' is not a core clock from 1 kHz to 1 GHz; write 48MHz"),
        ((*CRC, "--clock", "0"), "'0' is not a core clock"),
        ((*CRC, "--clock", "120"), "'120' is not a core clock"),  # MHz were meant
        ((*CRC, "--clock=-48MHz"), "'-48MHz' is not a core clock"),
        ((*CRC, "--clock", "4_8_MHz"), "'4_8_MHz' is not a core clock"),
        ((*CRC, "--clock", "1e12"), "'1e12' is not a core clock"),
        ((*CRC, "--clock", "nan"), "'nan' is not a core clock"),
        ((*CRC, "--clock", "1000.5"), "'1000.5' is not a core clock"),
    ],
)
def test_a_wrong_command_line_is_a_usage_error(
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    arguments: tuple[str, ...],
    complaint: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    code, out, err = profile(capsys, *arguments)
    assert (code, out) == (4, "")
    assert complaint in err


def test_a_function_that_faults_says_where(capsys: pytest.CaptureFixture[str]) -> None:
    code, _, err = profile(capsys, "shipped", "crc32", "0x10000000", "4")
    assert code == 20
    assert "read of unmapped address" in err
    assert "in crc32" in err


def test_a_function_that_waits_for_a_register_that_is_not_modelled_says_so(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, require_tool: Callable[[str], str]
) -> None:
    source, elf = tmp_path / "waits.c", tmp_path / "waits.elf"
    loop = "for (int turn = 0; turn < 2000 && (*(volatile unsigned *)0x40004010 & 1) == 0; turn++) {}"
    source.write_text(f"void waits(void) {{\n    {loop}\n}}\n")
    options = ["-mcpu=cortex-m4", "-mthumb", "-O1", "-g", "-nostdlib", "-Wl,-e,waits,-Ttext=0x1000"]
    subprocess.run([require_tool("arm-none-eabi-gcc"), *options, str(source), "-o", str(elf)], check=True)
    code, _, err = profile(capsys, str(elf), "waits")
    assert code == 0
    (told,) = err.splitlines()
    assert told.startswith("firmware waits for AXBS_CRS0 at 0x40004010, which is not modelled, at 0x")
    assert told.endswith(" in waits (waits.c:2)")


def test_a_nan_is_null_for_machines_and_nan_for_people(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ("shipped", "memset", "float32:1", "255", "4")
    assert document(capsys, *arguments).buffers[0].values == (None,)
    assert "argument 1 holds float32: nan" in profile(capsys, *arguments)[1]
    assert document(capsys, "shipped", "atanf", "nan").returned is None


def test_a_function_that_resets_the_board_says_so(capsys: pytest.CaptureFixture[str]) -> None:
    code, _, err = profile(capsys, "shipped", "board_reset")
    assert code == 20
    assert "board_reset requested a system reset" in err


def test_a_stripped_file_is_refused_with_the_reason(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, require_tool: Callable[[str], str]
) -> None:
    strip = require_tool("arm-none-eabi-strip")
    subprocess.run([strip, "-o", str(tmp_path / "bare.elf"), str(default_firmware())], check=True, timeout=60)
    code, _, err = profile(capsys, str(tmp_path / "bare.elf"), "crc32")
    assert code == 4
    assert "no function 'crc32', nor any other function: its symbols are stripped" in err


def test_negative_numbers_are_arguments_and_no_options(capsys: pytest.CaptureFixture[str]) -> None:
    found = document(capsys, "shipped", "atanf", "-1")
    assert found.returned == pytest.approx(-0.7853982, abs=1e-7)  # float32 eps of the answer
    assert json.loads(json.dumps(found.arguments)) == ["-1"]
