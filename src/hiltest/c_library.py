"""Shared libraries in C: built where there is a compiler, checked against their sources, and never required.

Only the standard library, and no import from the package: the build hook runs
this file before the package is installed.
"""

from __future__ import annotations

import contextlib
import ctypes
import hashlib
import os
import shlex
import shutil
import struct
import subprocess
from collections.abc import Sequence
from pathlib import Path

_PACKAGE = Path(__file__).parent
_FLAGS = ("-std=c11", "-O2", "-shared", "-fPIC")  # c11: sums are never contracted to an fma, on any processor
_TIMEOUT_S = 120.0

BLOCK_HOOK = _PACKAGE / "virtual" / "native" / "block_hook.so"
INSTANCES_KERNEL = _PACKAGE / "studies" / "instances_kernel.so"
SOURCES = {
    BLOCK_HOOK: tuple(BLOCK_HOOK.with_name(name) for name in ("block_hook.c", "running_calls.c")),
    INSTANCES_KERNEL: (INSTANCES_KERNEL.with_suffix(".c"),),
}
"""C sources of every library of the package."""


def sha256_of(sources: Sequence[Path]) -> str:
    """Return the hash of C sources, which is compiled into their library."""
    return hashlib.sha256(b"".join(source.read_bytes() for source in sources)).hexdigest()


def compiled(library: Path, sources: Sequence[Path], flags: Sequence[str] = ()) -> str:
    """Compile a library.

    Parameters
    ----------
    library : Path
        What is made, of the sources alone; an older one goes if that fails.
    sources : sequence of Path
    flags : sequence of str
        For the compiler, beside its usual ones.

    Returns
    -------
    str
        Why there is none now; empty when there is.
    """
    reason = _compile(library, sources, flags)
    if reason:
        with contextlib.suppress(OSError):  # where nothing can be written, nothing was
            library.unlink(missing_ok=True)  # an older one is of another source
    return reason


def _compile(library: Path, sources: Sequence[Path], flags: Sequence[str]) -> str:
    compiler = shlex.split(os.environ.get("CC", "cc"))
    if not compiler or shutil.which(compiler[0]) is None:
        return f"there is no C compiler ({' '.join(compiler) or 'CC is empty'})"
    fresh = library.with_name(f".{library.name}.{os.getpid()}")
    macro = f'-DHILTEST_SOURCE_SHA256="{sha256_of(sources)}"'
    command = [*compiler, *_FLAGS, *flags, macro, *map(str, sources), "-o", str(fresh), "-lm"]
    try:
        result = subprocess.run(command, capture_output=True, text=True, errors="replace", timeout=_TIMEOUT_S)
        if result.returncode:
            return f"the C compiler failed: {(result.stderr or result.stdout).strip()}"
        fresh.replace(library)  # at once: other processes may be loading it
    except (OSError, subprocess.TimeoutExpired) as error:
        return f"the C compiler could not be run: {error}"
    finally:
        fresh.unlink(missing_ok=True)
    return ""


def loaded(
    library: Path, sources: Sequence[Path], kind: type[ctypes.CDLL] = ctypes.CDLL
) -> tuple[ctypes.CDLL | None, str]:
    """Load a library, or say why it is not used.

    Parameters
    ----------
    library : Path
    sources : sequence of Path
        What it must have been built from.
    kind : type, optional
        Class of ctypes: whether a call lets other threads of Python run.

    Returns
    -------
    library : ctypes.CDLL or None
    reason : str
        Empty where there is one.
    """
    try:
        content = library.read_bytes()
        if _is_cut_off(content):
            return None, f"{library} is cut off"
        # Before it is loaded: what a process has loaded from a place it does not load again when it is built anew.
        if sha256_of(sources).encode() not in content:
            return None, f"{library} was built from another {sources[0].name}"
        return kind(str(library)), ""
    except FileNotFoundError:
        return None, f"{library} was not built"
    except OSError as error:
        return None, f"{library} cannot be loaded ({error})"


def _is_cut_off(content: bytes) -> bool:
    """Whether the end of an ELF file is missing: to load such a one can kill the process, not only fail."""
    if len(content) < 64 or content[:4] != b"\x7fELF":
        return False  # what is no ELF file at all the loader refuses
    wide = content[4] == 2
    (sections,) = struct.unpack_from("=Q" if wide else "=I", content, 0x28 if wide else 0x20)
    size, count = struct.unpack_from("=HH", content, 0x3A if wide else 0x2E)
    return bool(sections + size * count > len(content))  # the table of sections ends the file
