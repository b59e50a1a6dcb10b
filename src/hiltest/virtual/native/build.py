"""Builds the hooks in C, where there is a compiler.

Only the standard library, and no import from the package: the build hook runs
this file before the package is installed.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import shlex
import shutil
import subprocess
from pathlib import Path

SOURCES = tuple(Path(__file__).with_name(name) for name in ("block_hook.c", "running_calls.c"))
LIBRARY = Path(__file__).with_name("block_hook.so")
_FLAGS = ("-std=c11", "-O2", "-shared", "-fPIC")
_TIMEOUT_S = 120.0


def source_sha256() -> str:
    """Return the hash of the C sources, which is compiled into the library."""
    return hashlib.sha256(b"".join(source.read_bytes() for source in SOURCES)).hexdigest()


def compile_library(*flags: str) -> str:
    """Compile the library beside its sources.

    Parameters
    ----------
    *flags : str
        For the compiler, beside its usual ones.

    Returns
    -------
    str
        Why there is none now; empty when there is.
    """
    reason = _compile(flags)
    if reason:
        with contextlib.suppress(OSError):  # where nothing can be written, nothing was
            LIBRARY.unlink(missing_ok=True)  # an older one is of another source
    return reason


def _compile(flags: tuple[str, ...]) -> str:
    compiler = shlex.split(os.environ.get("CC", "cc"))
    if not compiler or shutil.which(compiler[0]) is None:
        return f"there is no C compiler ({' '.join(compiler) or 'CC is empty'})"
    fresh = LIBRARY.with_name(f".{LIBRARY.name}.{os.getpid()}")
    macro = f'-DHILTEST_SOURCE_SHA256="{source_sha256()}"'
    command = [*compiler, *_FLAGS, *flags, macro, *map(str, SOURCES), "-o", str(fresh)]
    try:
        result = subprocess.run(command, capture_output=True, text=True, errors="replace", timeout=_TIMEOUT_S)
        if result.returncode:
            return f"the C compiler failed: {(result.stderr or result.stdout).strip()}"
        fresh.replace(LIBRARY)  # at once: other processes may be loading it
    except (OSError, subprocess.TimeoutExpired) as error:
        return f"the C compiler could not be run: {error}"
    finally:
        fresh.unlink(missing_ok=True)
    return ""
