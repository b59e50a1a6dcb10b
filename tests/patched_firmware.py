"""Firmware with other instructions in place of its own: what a mistake, or a broken flash, makes of it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from elftools.elf.elffile import ELFFile

HANG: Sequence[int] = (0xE7FE,)  # b .
UNDEFINED: Sequence[int] = (0xDE00,)  # udf #0
RETURN_0: Sequence[int] = (0x2000, 0x4770)  # movs r0, #0; bx lr
OVERFLOW: Sequence[int] = (0xB5F0, 0xE7FD)  # push {r4-r7, lr}; b back to it


def patched(elf: Path, functions: Iterable[str], instructions: Sequence[int]) -> bytes:
    """Return an ELF with other first instructions, halfwords of Thumb, in functions."""
    content = bytearray(elf.read_bytes())
    with elf.open("rb") as file:
        image = ELFFile(file)
        for function in functions:
            (symbol,) = image.get_section_by_name(".symtab").get_symbol_by_name(function)
            address = symbol["st_value"] & ~1
            (at,) = (
                segment["p_offset"] + address - segment["p_vaddr"]
                for segment in image.iter_segments("PT_LOAD")
                if segment["p_vaddr"] <= address < segment["p_vaddr"] + segment["p_filesz"]
            )
            code = b"".join(instruction.to_bytes(2, "little") for instruction in instructions)
            content[at : at + len(code)] = code
    return bytes(content)
