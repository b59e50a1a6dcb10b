"""The project's own firmware with an edit, built with the cross compiler."""

from __future__ import annotations

import hashlib
import math
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from hiltest.link.messages import PROTOCOL_VERSION

FIRMWARE = Path(__file__).parents[2] / "firmware_stub"
BUILD_LIMIT_S = 120  # a build takes a few seconds; nothing may wait for ever


@dataclass(frozen=True)
class Edit:
    """One place of one source file, and what stands there instead."""

    file: str
    old: str
    new: str

    @contextmanager
    def made(self, sources: Path) -> Iterator[None]:
        """Edit the file, and put it back."""
        source = sources / self.file
        text = source.read_text()
        assert text.count(self.old) == 1, f"{self.file}: the line to edit is there {text.count(self.old)} times"
        source.write_text(text.replace(self.old, self.new))
        try:
            yield
        finally:
            source.write_text(text)


NEXT_PROTOCOL = Edit(
    "protocol/message.h", f"PROTOCOL_VERSION {PROTOCOL_VERSION}u", f"PROTOCOL_VERSION {PROTOCOL_VERSION + 1}u"
)


def calibrations_turned(degrees: float, *, about: str) -> Edit:
    """Turn every calibration as it is stored, about the body's x or z: all that is answered agrees, and is wrong."""
    first, second = {"x": (3, 6), "z": (3, 0)}[about]
    sine, cosine = math.sin(math.radians(degrees)), math.cos(math.radians(degrees))
    stored = "    slots[slot].calibration = *calibration;\n"
    turn = f"""    float *const rows = slots[slot].calibration.soft_iron;
    for (int column = 0; column < 3; column++) {{
        const float one = rows[{first} + column], other = rows[{second} + column];
        rows[{first} + column] = {cosine:.8f}f * one - {sine:.8f}f * other;
        rows[{second} + column] = {sine:.8f}f * one + {cosine:.8f}f * other;
    }}
"""
    return Edit("app/calibration_slots.c", stored, stored + turn)


class FirmwareCopy:
    """A copy of the sources, and its build folder: for each edit only what includes the edited file is compiled."""

    def __init__(self, folder: Path) -> None:
        self._sources, self._build = folder / "firmware_stub", folder / "build"
        shutil.copytree(FIRMWARE, self._sources, ignore=shutil.ignore_patterns("__pycache__"))
        _run(sys.executable, self._sources / "build.py", "--build", self._build, "--out", folder / "elf")

    def build(self, edit: Edit, elf: Path) -> Path:
        """Build the firmware with an edit, into a file."""
        with edit.made(self._sources):
            build_id = hashlib.sha256(f"{edit}".encode()).hexdigest()[:16]
            _run("cmake", f"-DHILTEST_BUILD_ID={build_id}", "-S", self._sources, "-B", self._build)
            _run("cmake", "--build", self._build)
            return Path(shutil.copyfile(self._build / "hiltest-frdm-k64f.elf", elf))

    def build_compass(self, edit: Edit, elf: Path) -> Path:
        """Build the sample compass that prints lines with an edit, into a file."""
        with edit.made(self._sources):
            _run("cmake", "--build", self._build / "compass")
            return Path(shutil.copyfile(self._build / "compass" / "compass-lines.elf", elf))


def _run(*command: str | Path) -> None:
    subprocess.run([str(item) for item in command], check=True, capture_output=True, timeout=BUILD_LIMIT_S)
