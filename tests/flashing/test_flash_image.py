"""An image is written as it is, and one for another chip, or that would lock this one, is refused with its reason."""

from __future__ import annotations

import struct
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.flashing.drive import memory_of

from hiltest.boards import default_firmware
from hiltest.boards.flashing.flash_image import FlashImage, load_flash_image
from hiltest.errors import ConfigError
from hiltest.virtual.program.elf import FirmwareImage, load_image
from hiltest.virtual.program.image_formats import convert_to_elf

PROGRAMS = Path(__file__).parents[1] / "virtual" / "programs"
CODE, STACK, FSEC = 0x410, 0x20030000, 0x40C


def binary(stack: int = STACK, entry: int = CODE + 1, fsec: int = 0xFE, size: int = 0x800) -> bytes:
    """Return a raw binary: vectors, flash configuration field, and code that is none."""
    content = bytearray(b"\xff" * size)
    content[0:8] = struct.pack("<2I", stack, entry)
    if size > FSEC:
        content[FSEC] = fsec
    return bytes(content)


def as_hex(address: int, content: bytes) -> bytes:
    return FlashImage(load_image(default_firmware()), ((address, content),)).intel_hex()


def refused(path: Path, content: bytes) -> str:
    path.write_bytes(content)
    with pytest.raises(ConfigError) as caught:
        load_flash_image(path)
    assert str(path) in str(caught.value)
    return str(caught.value)


def test_an_elf_is_written_where_its_segments_are_loaded() -> None:
    flashed = memory_of(load_flash_image(default_firmware()).intel_hex())
    segments = load_image(default_firmware()).segments
    assert len(flashed) == sum(len(segment.data) for segment in segments)
    assert all(flashed[segment.address + at] == byte for segment in segments for at, byte in enumerate(segment.data))


def test_hex_and_binary_are_taken_as_well(tmp_path: Path) -> None:
    whole = dict(enumerate(binary()))
    for name, content in (("app.bin", binary()), ("app.hex", as_hex(0, binary()))):
        (tmp_path / name).write_bytes(content)
        assert memory_of(load_flash_image(tmp_path / name).intel_hex()) == whole


@given(st.dictionaries(st.integers(0, 0x3FFF).map(lambda at: at << 6), st.binary(min_size=1, max_size=48), min_size=1))
def test_intel_hex_has_every_byte_in_its_place(content: dict[int, bytes]) -> None:
    chunks = tuple(sorted(content.items()))
    text = FlashImage(load_image(default_firmware()), chunks).intel_hex()
    read = FirmwareImage(convert_to_elf("any.hex", text, None))  # hiltest's reader, and DAPLink's stand-in
    assert tuple((segment.address, segment.data) for segment in read.segments) == chunks
    assert memory_of(text) == {base + at: byte for base, data in chunks for at, byte in enumerate(data)}


@pytest.mark.parametrize(
    ("fsec", "said"),
    [
        (0xFF, "secures the chip against all debuggers (FSEC 0xFF)"),
        (0xFC, "secures the chip"),
        (0xFD, "secures the chip"),
        (0xEF, "secures the chip against all debuggers, and forbids the mass erase"),
        (0xEE, "forbids the mass erase that would open a secured chip again (FSEC 0xEE)"),
    ],
)
def test_an_image_that_locks_the_chip_is_refused(fsec: int, said: str, tmp_path: Path) -> None:
    message = refused(tmp_path / "app.bin", binary(fsec=fsec))
    assert said in message
    assert "FSEC (0x40c) = 0xFE" in message


@pytest.mark.parametrize("fsec", [0xFE, 0xBE, 0xF2, 0xCE, 0xDE])  # what else the byte says locks nothing
def test_an_image_that_leaves_the_chip_open_is_taken(fsec: int, tmp_path: Path) -> None:
    (tmp_path / "app.bin").write_bytes(binary(fsec=fsec))
    assert load_flash_image(tmp_path / "app.bin").size == 0x800


@pytest.mark.parametrize("size", [0x100, 0x40F])
def test_an_image_without_a_whole_configuration_field_is_refused(size: int, tmp_path: Path) -> None:
    message = refused(tmp_path / "app.bin", binary(entry=0x81, size=size))
    assert "is incomplete in the file: erased bytes would secure the chip" in message


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (as_hex(0x08000000, binary()), "built for another chip, or for RAM: 2048 bytes load at 0x08000000"),  # STM32
        (as_hex(0xFFC00, binary()), "load at 0x000ffc00, and the MK64FN1M0 has 1024 KiB of flash"),
        (as_hex(0x1FFF0000, binary()), "built for another chip, or for RAM"),
        (as_hex(0, binary(stack=0x20040000)), "(stack 0x20040000"),  # nRF52840: 256 KiB from 0x20000000
        (as_hex(0x8000, binary()), "(stack 0x00000000"),  # behind a boot loader that would be erased
        (as_hex(0, binary(entry=CODE)), "no valid vector table"),
        (as_hex(0, binary(entry=0x9001)), "no valid vector table"),
    ],
)
def test_an_image_with_other_memories_is_refused(content: bytes, message: str, tmp_path: Path) -> None:
    assert message in refused(tmp_path / "app.hex", content)


def test_a_program_of_this_computer_is_refused(tmp_path: Path) -> None:
    assert "Arm Cortex-M4F" in refused(tmp_path / "app.elf", Path(sys.executable).read_bytes())


@pytest.mark.parametrize(("part", "selected"), [("MK22F51212", False), ("MKL25Z4", False), ("MK64F12", True)])
def test_start_up_code_of_another_kinetis_is_refused(
    part: str, selected: bool, tmp_path: Path, require_tool: Callable[[str], str]
) -> None:
    source, elf = tmp_path / f"system_{part}.c", tmp_path / "app.elf"
    source.write_text("int main(void) { for (;;) { } }\n", encoding="utf-8")
    command = [
        require_tool("arm-none-eabi-gcc"),
        "-mcpu=cortex-m4",
        "-mthumb",
        "-nostdlib",
        "-ffreestanding",
        f"-Wl,-T,{PROGRAMS / 'flash.ld'}",
        str(PROGRAMS / "start.S"),
        str(source),
        "-o",
        str(elf),
    ]
    subprocess.run(command, check=True, timeout=60.0)
    if selected:
        load_flash_image(elf)
    else:
        with pytest.raises(ConfigError, match=rf"this is an {part.upper()} image \(it names"):
            load_flash_image(elf)
