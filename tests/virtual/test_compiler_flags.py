"""The firmware file tells the flags that it was compiled with, as long as it has its debugging information."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from hiltest.boards import default_firmware
from hiltest.virtual.program.elf import FirmwareImage

FindTool = Callable[[str], str]
Build = Callable[..., str]


@pytest.fixture
def flags_of(require_tool: FindTool, tmp_path: Path) -> Build:
    """Return a function that compiles two units with flags of their own, and returns what the file says of them."""
    gcc = require_tool("arm-none-eabi-gcc")
    target = ["-mcpu=cortex-m4", "-mthumb"]

    def build(*units: str) -> str:
        objects = []
        for number, flags in enumerate(units):
            source = tmp_path / f"unit{number}.c"
            source.write_text(f"int answer{number}(int x) {{ return x * {number + 6}; }}\n", encoding="utf-8")
            objects.append(str(source.with_suffix(".o")))
            subprocess.run([gcc, *target, *flags.split(), "-c", str(source), "-o", objects[-1]], check=True, timeout=60)
        elf = tmp_path / "units.elf"
        entry = "-Wl,--entry=answer0"
        subprocess.run([gcc, *target, "-nostdlib", entry, *objects, "-o", str(elf)], check=True, timeout=60)
        return FirmwareImage(elf).compiler_flags

    return build


def test_the_shipped_firmware_tells_its_flags() -> None:
    flags = FirmwareImage(default_firmware()).compiler_flags.split()
    assert {"-O2", "-g", "-ffp-contract=off", "-mcpu=cortex-m4"} <= set(flags)
    assert flags == sorted(set(flags))


def test_a_flag_of_one_unit_alone_is_seen(flags_of: Build) -> None:
    plain = flags_of("-g -O2", "-g -O2")
    assert set(flags_of("-g -O2", "-g -O2 -funroll-loops").split()) - set(plain.split()) == {"-funroll-loops"}
    assert set(flags_of("-g -O2", "-g -O3").split()) - set(plain.split()) == {"-O3"}


def test_without_debugging_information_nothing_is_told(flags_of: Build, require_tool: FindTool, tmp_path: Path) -> None:
    assert flags_of("-O2") == ""
    bare = tmp_path / "bare.elf"
    strip = require_tool("arm-none-eabi-strip")
    subprocess.run([strip, "-o", str(bare), str(default_firmware())], check=True, timeout=60)
    assert FirmwareImage(bare).compiler_flags == ""
