"""Intel HEX and raw binaries run as the ELF does that they were made from; what is damaged is named with its line."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hiltest.boards import default_firmware
from hiltest.errors import BoardFault, ConfigError
from hiltest.virtual.board.k64f import VirtualK64F
from hiltest.virtual.program.elf import load_image

COUNT_AND_WAIT = """
volatile unsigned steps, *const pit = (volatile unsigned *)0x40037000;
int main(void) { for (;;) { if (++steps == 1000) *(volatile unsigned *)0x60000000 = 1; } }
"""


def converted(elf: Path, kind: str, suffix: str) -> Path:
    result = elf.with_suffix(suffix)
    subprocess.run(["arm-none-eabi-objcopy", "-O", kind, str(elf), str(result)], check=True, timeout=60)
    return result


def outcome(board: VirtualK64F) -> tuple[str, int, int]:
    with pytest.raises(BoardFault) as fault:
        board.run_until(0.1)
    return fault.value.cause, fault.value.pc, board.cycles


@pytest.mark.parametrize(("kind", "suffix"), [("ihex", ".hex"), ("binary", ".bin")])
def test_firmware_runs_as_its_elf_and_a_fault_names_the_address_without_a_function(build_c, kind, suffix):
    elf = build_c(COUNT_AND_WAIT)
    plain = VirtualK64F(converted(elf, kind, suffix))
    named = VirtualK64F(elf)
    assert outcome(plain) == outcome(named)
    assert plain.cycles > 5000  # and not at the first instruction
    pc = plain.faults[0].fault.pc
    assert named.image.function_at(pc) is not None
    assert plain.image.function_at(pc) is None
    assert plain.image.location_at(pc) == ""


def test_a_raw_binary_starts_from_the_vector_table_at_its_base(build, tmp_path):
    program = """
    .section .vectors, "a"
    .word 0x20030000
    .word start + 1
    .text
    start: adr r0, start
    ldr r1, =0xE000ED08
    ldr r2, [r1]
    b .
    """
    elf = build(program, "-Wl,-Ttext=0x8410", "-Wl,--section-start=.vectors=0x8000", with_start=False)
    raw = converted(elf, "binary", ".img")
    board = VirtualK64F(load_image(raw, base=0x8000))
    board.may_rest = False
    with pytest.raises(BoardFault, match="branch to itself"):
        board.run_until(0.1)
    start, _, vector_table = board.processor.registers.general.read()[:3]
    assert (start, vector_table) == (0x8410, 0x8000)
    with pytest.raises(ConfigError, match="no valid vector table at address 0x0"):
        VirtualK64F(load_image(raw, base=0)).boot()


def record(kind: int, offset: int, data: bytes = b"") -> str:
    raw = bytes([len(data), offset >> 8, offset & 0xFF, kind]) + data
    return f":{raw.hex()}{-sum(raw) & 0xFF:02X}\n"


END = record(1, 0)


@pytest.mark.parametrize(
    ("text", "line", "message"),
    [
        (record(0, 0, b"abcd")[:-3] + "00\n" + END, 1, "invalid checksum"),
        (record(0, 0, b"abcd"), 1, "without an end record"),
        (record(0, 0, b"abcd") + record(0, 4, b"efgh")[:-5] + "\n" + END, 2, "invalid length"),
        (record(0, 0, b"abcd") + END + record(0, 4, b"efgh"), 3, "follows the end record"),
        (record(0, 0, b"abcd") + "\n" + record(0, 3, b"e") + END, 3, "data overlap at address 0x3"),
        (record(6, 0) + END, 1, "invalid record type"),
        (record(4, 0, b"\0") + END, 1, "Invalid Extended Linear Address Record"),
        ("hello\n" + END, 1, "invalid record"),
    ],
)
def test_a_damaged_hex_file_is_refused_with_its_line(tmp_path, text, line, message):
    path = tmp_path / "damaged.hex"
    path.write_text(text)
    with pytest.raises(ConfigError, match=f"damaged.hex, line {line}: .*{message}"):
        load_image(path)


def test_hex_of_both_kinds_of_address_is_placed_and_joined(tmp_path):
    path = tmp_path / "parts.txt"  # known by its colon
    path.write_text(
        record(4, 0, b"\x1f\xff")
        + record(0, 0x10, b"cd")
        + record(2, 0, b"\x10\0")
        + record(0, 2, b"g")
        + record(4, 0, b"\x1f\xff")
        + record(0, 0xE, b"ab")
        + record(5, 0, b"\0\0\4\1")
        + END
    )
    segments = [(segment.address, segment.data) for segment in load_image(path).segments]
    assert segments == [(0x10002, b"g"), (0x1FFF000E, b"abcd")]


@given(st.binary(max_size=200))
def test_any_bytes_called_hex_are_an_image_or_a_config_error(content):
    for source in (b":" + content, b"::" + content, END.encode() + content):
        with pytest.raises(ConfigError, match=r"line|no data to load"):
            load_image(source)


@pytest.mark.parametrize(
    ("name", "content", "base", "message"),
    [
        ("empty.bin", b"", None, "empty.bin: the file is empty"),
        ("any.img", b"\0" * 8, 0xFFFFFFFC, "beyond the last address"),
        ("text.img", b"no firmware", None, "not a complete ELF file"),
        ("far.hex", (record(4, 0, b"\xff\xff") + record(0, 0xFFFE, b"abcd") + END).encode(), None, "beyond the last"),
        ("a.hex", END.encode(), 0x100, "Intel HEX contains its own addresses"),
    ],
)
def test_what_cannot_be_placed_is_refused(tmp_path, name, content, base, message):
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(ConfigError, match=message):
        load_image(path, base=base)


@pytest.mark.parametrize(("kind", "suffix"), [("ihex", ".hex"), ("binary", ".bin")])
def test_a_build_is_known_by_its_note_in_every_format(tmp_path, require_tool, kind, suffix):
    require_tool("arm-none-eabi-objcopy")
    elf = tmp_path / "shipped.elf"
    elf.write_bytes(default_firmware().read_bytes())
    assert load_image(converted(elf, kind, suffix)).build_id == load_image(elf).build_id != ""


def test_an_elf_takes_no_base():
    with pytest.raises(ConfigError, match="an ELF contains its own addresses"):
        load_image(default_firmware(), base=0)
