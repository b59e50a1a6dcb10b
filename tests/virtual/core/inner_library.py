"""The core's inner functions, compiled for tests: everything that its headers declare, sanitized if asked."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from functools import cache
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import cffi
import pytest

SOURCES = Path(__file__).parents[3] / "src" / "hiltest" / "virtual" / "core"
_HEADERS = ("instruction.h", "prices.h", "float.h", "waits.h", "decode.h")
_COMPILER = os.environ.get("CC", "cc")


@cache
def inner_library() -> tuple[Any, Any]:
    """Compile the core and return cffi's `ffi` and library.

    If no C compiler is installed, the calling module or test is skipped.
    """
    if shutil.which(_COMPILER) is None:
        reason = f"{_COMPILER} is not installed"
        if os.environ.get("HILTEST_REQUIRE_TOOLS"):
            pytest.fail(reason, pytrace=False)
        pytest.skip(reason, allow_module_level=True)
    folder = Path(mkdtemp(prefix="hiltest-core-"))
    library = folder / "core.so"
    flags = ["-std=c11", "-O2", "-ffp-contract=off", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC"]
    sources = sorted(SOURCES.glob("*.c"))
    subprocess.run([_COMPILER, *flags, "-o", library, *sources, "-lm"], check=True)
    ffi = cffi.FFI()
    ffi.cdef(_declarations(folder))
    return ffi, ffi.dlopen(str(library))


def _declarations(folder: Path) -> str:
    """Return the declarations of all headers without directives: macros expanded, inline functions left out."""
    text = "".join((SOURCES / name).read_text() for name in _HEADERS)
    source = folder / "headers.h"
    source.write_text(re.sub(r"^#include .*$", "", text, flags=re.MULTILINE))
    command = [_COMPILER, "-E", "-P", str(source)]
    expanded = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    plain = re.sub(r"static inline [^{]*\{[^}]*\}", "", expanded)
    plain = re.sub(r"inline ([^{]*)\{[^}]*\}", r"\1;", plain)  # these have a symbol too
    return plain + (SOURCES / "machine.h").read_text()
