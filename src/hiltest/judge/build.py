"""Builds of a source file: an image for the Cortex-M4 and a library for the host, by the compilers that are there."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from importlib.util import find_spec
from pathlib import Path

from hiltest.errors import ConfigError
from hiltest.virtual.core.c_library import ZIG_REQUIREMENT
from hiltest.virtual.part.part_file import load_part

HEADER = "hiltest_judge.h"
"""Header with the contracts."""
C_SUFFIXES = (".c",)
CPP_SUFFIXES = (".cc", ".cpp", ".cxx")
FLAGS = "-O2"
_CORTEX_M4 = "cortex-m4"
_FPU_FLAGS = dict.fromkeys((_CORTEX_M4, "cortex-m33"), ("-mfpu=fpv4-sp-d16", "-mfloat-abi=hard"))
_SPLIT_FLAGS = ("-ffunction-sections", "-fdata-sections")
_CPP_FLAGS = ("-fno-exceptions", "-fno-rtti", "-fno-threadsafe-statics")
_ZIG_TARGET = (
    "-target",
    "thumb-linux-musleabihf",
    "-mcpu=cortex_m4+vfp4d16sp",
)  # with the C library musl, which zig brings along
_TIMEOUT_S = 600.0  # zig compiles its C library at first use, which takes a minute or two
_LONGEST_MESSAGE = 2000
_CPP_LIBRARY_ADVICE = (
    "\nThis compiler lacks the standard library of C++: if the source needs it, install it (Debian: "
    "libstdc++-arm-none-eabi-newlib)."
)
# Code in SRAM_L and data in SRAM_U of the MK64FN1M0, where nothing waits: without a part with memories.
_CODE, _DATA = (0x1FFF0000, 0x10000), (0x20000000, 0x20000)
_LINKER_SCRIPT = """\
ENTRY({function})
MEMORY
{{
    code (rx) : ORIGIN = {code[0]}, LENGTH = {code[1]}
    data (rw) : ORIGIN = {data[0]}, LENGTH = {data[1]}
}}
SECTIONS
{{
    .text : {{ *(.text .text.*) *(.rodata .rodata.*) }} > code
    .ARM.extab : {{ *(.ARM.extab*) }} > code
    .ARM.exidx : {{ *(.ARM.exidx*) }} > code
    .init_array : {{ *(.init_array .init_array.*) }} > code
    .data : {{ *(.data .data.*) }} > data
    .bss : {{ *(.bss .bss.*) *(COMMON) }} > data
    end = .;
}}
"""


@dataclass(frozen=True, slots=True)
class Build:
    """A file that a compiler wrote."""

    file: Path
    built_by: str
    """Compiler with its version, and flags."""


def is_source(file: Path) -> bool:
    """Return whether a file is a source in C or C++."""
    return file.suffix in (*C_SUFFIXES, *CPP_SUFFIXES)


def header_folder() -> Path:
    """Return the folder of `HEADER` and of the template."""
    return Path(str(resources.files("hiltest.judge")))


def build_image(source: Path, functions: Sequence[str], folder: Path, *, part: str | None = None) -> Build:
    """Compile a source for a part, by default for the Cortex-M4 of the MK64FN1M0.

    Parameters
    ----------
    functions
        Functions that must be in the image, if the source has them.
    folder
        Folder of the image.
    part
        Part whose core and whose first flash and RAM are used.

    Raises
    ------
    ConfigError
        If there is no such part or no compiler for it, or the source cannot be compiled; with the compiler's first
        messages.
    """
    script, image, start = folder / "judged.ld", folder / f"{source.stem}.elf", folder / "start.c"
    chip = None if part is None else load_part(part)
    core, memories = (_CORTEX_M4, None) if chip is None else (chip.core, chip.memory_map)
    code, data = (_CODE, _DATA) if memories is None else (memories.flash[0], memories.ram[0])
    script.write_text(_LINKER_SCRIPT.format(function=functions[0], code=code, data=data), encoding="utf-8")
    is_cpp = source.suffix in CPP_SUFFIXES
    language = _CPP_FLAGS if is_cpp else ()
    common = [FLAGS, "-gdwarf-4", *_SPLIT_FLAGS, *language, "-I", str(header_folder()), "-T", str(script)]
    common += ["-Wl,--gc-sections", *(f"-Wl,-u,{function}" for function in functions), "-o", str(image), str(source)]
    if command := shutil.which("arm-none-eabi-g++" if is_cpp else "arm-none-eabi-gcc"):
        cpu = [f"-mcpu={core}", "-mthumb", *_FPU_FLAGS.get(core, ())]
        options = [*cpu, "-nostartfiles", "--specs=nosys.specs", "-Wl,--no-warnings", *common, "-lm"]
        c_driver = shutil.which("arm-none-eabi-gcc")
        if is_cpp and c_driver and not _has_cpp_library(command):
            _run([c_driver, *options], source, advice=_CPP_LIBRARY_ADVICE)
        else:
            _run([command, *options], source)
        return Build(image, f"{_version([command])} {FLAGS}")
    if core != _CORTEX_M4:
        raise ConfigError(f"{source}: install arm-none-eabi-gcc, because zig compiles sources for a Cortex-M4 only")
    zig = _zig(is_cpp=is_cpp)
    start.write_text("int main(void) { return 0; }\n", encoding="utf-8")  # its C library wants one
    _run([*zig, *_ZIG_TARGET, "-static", *common, str(start), "-lm"], source)
    return Build(image, f"{_version(zig)} {FLAGS}")


def build_library(source: Path, folder: Path) -> Build:
    """Compile a source for this machine, as a shared library.

    Raises
    ------
    ConfigError
        As `build_image` does.
    """
    library = folder / f"{source.stem}.so"
    is_cpp = source.suffix in CPP_SUFFIXES
    names = ("c++", "g++", "clang++") if is_cpp else ("cc", "gcc", "clang")
    command = next(([path] for name in names if (path := shutil.which(name))), None) or _zig(is_cpp=is_cpp)
    options = [FLAGS, "-fPIC", "-shared", "-I", str(header_folder()), "-o", str(library), str(source), "-lm"]
    _run([*command, *options], source)
    return Build(library, f"{_version(command)} {FLAGS}")


def _zig(*, is_cpp: bool) -> list[str]:
    if find_spec("ziglang") is None:
        raise ConfigError(
            "there is no compiler for the Cortex-M4: install arm-none-eabi-gcc (Debian: gcc-arm-none-eabi, "
            f"libnewlib-arm-none-eabi), or the Python package {ZIG_REQUIREMENT!r} (pip install 'hiltest[judge]')"
        )
    return [sys.executable, "-m", "ziglang", "c++" if is_cpp else "cc"]


def _has_cpp_library(command: str) -> bool:
    """Return whether a compiler has the standard library of C++, which Debian packages apart from the compiler."""
    name = "libstdc++.a"
    done = subprocess.run([command, f"-print-file-name={name}"], capture_output=True, text=True, timeout=_TIMEOUT_S)
    return done.stdout.strip() != name


def _run(command: Sequence[str], source: Path, *, advice: str = "") -> None:
    try:
        done = subprocess.run(command, capture_output=True, text=True, errors="replace", timeout=_TIMEOUT_S)
    except subprocess.TimeoutExpired as error:
        raise ConfigError(f"{source}: the compiler did not end within {_TIMEOUT_S:.0f} s") from error
    if done.returncode:
        message = (done.stderr or done.stdout).strip()[:_LONGEST_MESSAGE]
        raise ConfigError(f"{source}: {_compiler_name(command)} cannot compile it:\n{message}{advice}")


def _compiler_name(command: Sequence[str]) -> str:
    return "zig" if "ziglang" in command else Path(command[0]).name


def _version(command: Sequence[str]) -> str:
    """Return the name and the version of a compiler."""
    done = subprocess.run([*command, "--version"], capture_output=True, text=True, errors="replace", timeout=_TIMEOUT_S)
    name = _compiler_name(command)
    versions = sorted(re.findall(r"\d+(?:\.\d+)+", done.stdout.partition("\n")[0]), key=lambda text: text.count("."))
    return f"{name} {versions[-1]}" if versions else name
