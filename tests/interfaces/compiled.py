"""C programs compiled for the chip, and their memory as it is when they begin."""

from __future__ import annotations

import subprocess
from dataclasses import dataclass
from pathlib import Path

from hiltest.virtual.program.elf import FirmwareImage

from ..virtual.conftest import FLAGS, PROGRAMS


def compile_c(compiler: str, folder: Path, source: str | dict[str, str], *flags: str) -> Path:
    """Compile a program, of one file or of several by name, and return its ELF."""
    sources = {"program.c": source} if isinstance(source, str) else source
    for name, text in sources.items():
        (folder / name).write_text(text)
    elf = folder / "program.elf"
    command = [compiler, *FLAGS, *flags, str(PROGRAMS / "start.S"), *(str(folder / source) for source in sources)]
    subprocess.run([*command, "-o", str(elf)], check=True, timeout=60, cwd=folder)
    return elf


@dataclass(frozen=True)
class InitialMemory:
    """Memory of a program behind its start-up code."""

    image: FirmwareImage

    def __call__(self, address: int, size: int) -> bytes:
        for segment in self.image.segments:
            at = address - segment.run_address
            if at >= 0 and at + size <= max(segment.run_size, len(segment.data)):
                return segment.data[at : at + size].ljust(size, b"\0")
        raise AssertionError(f"0x{address:08x} is not in the program")
