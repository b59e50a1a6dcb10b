"""Shared libraries in C: built with an installed C compiler or zig's, and checked against their sources.

The virtual board's core is required, with its binding for Python. The others are faster versions of Python functions.

This module imports only the standard library and nothing of the package, because the build hook runs this file before
the package is installed. cffi, which generates the binding, is imported when a binding is generated.
"""

from __future__ import annotations

import contextlib
import ctypes
import hashlib
import io
import os
import shlex
import shutil
import struct
import subprocess
import sys
from collections.abc import Sequence
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory

_PACKAGE = Path(__file__).parents[2]
_FLAGS = (
    "-std=c11",
    "-O2",
    "-fPIC",
    "-shared",
    "-s",
    "-ffp-contract=off",  # clang would contract a product and a sum to one fma on processors with that instruction
    "-fno-semantic-interposition",  # gcc may inline a function although the library could export it
)
_CORE_FLAGS = (
    "-fno-tree-slp-vectorize",  # gcc would keep both counters of the interpreter in one vector: a third slower
    "-falign-functions=64",  # the interpreter's alignment changes its speed by up to a tenth
)
_ZIG_FLAGS = (
    "-mcpu=baseline",  # by default zig compiles for the processor of this machine
    "-fomit-frame-pointer",
)
_TIMEOUT_S = 600.0

ZIG_REQUIREMENT = "ziglang>=0.13,<0.18"
"""PyPI package of the compiler that is used if no other one works."""

RELEASE_ARCHITECTURES = ("x86_64", "aarch64")
RELEASE_GLIBC = (2, 17)
"""Minimum version of glibc for libraries of a release: that of manylinux2014."""

INSTANCES_KERNEL = _PACKAGE / "studies" / "instances_kernel.so"
CORE = _PACKAGE / "virtual" / "core" / "core.so"
CORE_INTERFACE = CORE.with_name("machine.h")
CORE_BINDING = CORE.with_name("_machine.py")
SOURCES = {
    INSTANCES_KERNEL: (INSTANCES_KERNEL.with_suffix(".c"),),
    CORE: tuple(path for suffix in ("c", "h") for path in sorted(CORE.parent.glob(f"*.{suffix}"))),
}
"""C sources of every library of the package, headers included."""

_PROBE = """\
#include <math.h>
#include <stdint.h>
#include <string.h>

float probe(const char *text, float value)
{
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    return fmaf(value, sqrtf(value), (float)(strlen(text) + bits));
}
"""


def release_architecture() -> str:
    """Return the architecture in HILTEST_WHEEL_ARCH; if it is empty, libraries are built for this machine.

    Raises
    ------
    ValueError
        If releases are not built for the architecture.
    """
    name = os.environ.get("HILTEST_WHEEL_ARCH", "")
    if name and name not in RELEASE_ARCHITECTURES:
        raise ValueError(f"HILTEST_WHEEL_ARCH={name}: wheels are built for {' and '.join(RELEASE_ARCHITECTURES)}")
    return name


def build_requirements() -> list[str]:
    """Return the packages that are needed to compile the libraries: zig, or none."""
    if release_architecture():
        return [ZIG_REQUIREMENT]
    compiler, _ = _system_compiler(os.environ.get("CC"), os.environ.get("PATH"))
    return [] if compiler else [ZIG_REQUIREMENT]


@cache
def _system_compiler(cc: str | None, path: str | None) -> tuple[tuple[str, ...], str]:
    """Return the command of the first compiler that works, or the reason why none does.

    Parameters
    ----------
    cc
        Value of the variable CC, which is the only candidate if it is set.
    path
        Search path of commands; as a parameter, it is a part of the cache's key.
    """
    candidates = [("cc",), ("gcc",), ("clang",)] if cc is None else [tuple(shlex.split(cc))]
    present = [command for command in candidates if command and shutil.which(command[0], path=path)]
    if not present:
        names = ", ".join(" ".join(command) for command in candidates)
        return (), f"there is no C compiler ({names or 'CC is empty'})"
    reasons = []
    for command in present:
        reason = _probe(command)
        if not reason:
            return command, ""
        reasons.append(f"{' '.join(command)}: {reason}")
    return (), reasons[0]


def _probe(command: Sequence[str]) -> str:
    """Compile, link and load a few lines; return the reason for a failure, or an empty text.

    The test excludes compilers for other processors and compilers without the headers of a C library.
    """
    with TemporaryDirectory(prefix="hiltest-probe-") as folder:
        source, library = Path(folder, "probe.c"), Path(folder, "probe.so")
        source.write_text(_PROBE, encoding="utf-8")
        if reason := _link(command, library, [source], exports="probe"):
            return reason
        try:
            ctypes.CDLL(str(library))
        except OSError as error:
            return f"Python cannot load the library that the C compiler wrote: {error}"
    return ""


def _compiler() -> tuple[tuple[str, ...], str]:
    """Return the command of the compiler to use, or the reason why none works.

    zig is used if no other compiler works, and for releases, because it can link against any version of glibc.
    """
    zig = (sys.executable, "-m", "ziglang", "cc", *_ZIG_FLAGS)
    if name := release_architecture():
        return (*zig, "-target", f"{name}-linux-gnu.{'.'.join(map(str, RELEASE_GLIBC))}"), ""
    command, reason = _system_compiler(os.environ.get("CC"), os.environ.get("PATH"))
    if command:
        return command, ""
    if find_spec("ziglang") is not None:
        return zig, ""
    advice = f"Install one (Debian: gcc and libc6-dev) or the Python package {ZIG_REQUIREMENT!r}"
    return (), f"{reason}. {advice}"


@cache
def _zig_cache() -> TemporaryDirectory[str]:
    """Return zig's cache folder, which exists until this process ends."""
    return TemporaryDirectory(prefix="hiltest-zig-")


def _run(command: Sequence[str]) -> str:
    """Run a compiler; return the reason for a failure, or an empty text."""
    environment = dict(os.environ)
    if "ziglang" in command:
        for variable in ("ZIG_GLOBAL_CACHE_DIR", "ZIG_LOCAL_CACHE_DIR"):
            environment.setdefault(variable, _zig_cache().name)
    try:
        result = subprocess.run(
            command, env=environment, capture_output=True, text=True, errors="replace", timeout=_TIMEOUT_S
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        return f"the C compiler could not be run: {error}"
    if result.returncode:
        return f"the C compiler failed: {(result.stderr or result.stdout).strip()}"
    return ""


def sha256_of(sources: Sequence[Path]) -> str:
    """Return the hash of C sources, which becomes the build ID of their library."""
    return hashlib.sha256(b"".join(source.read_bytes() for source in sources)).hexdigest()


def compiled(library: Path, sources: Sequence[Path], flags: Sequence[str] = (), *, exports: str = "") -> str:
    """Compile a library.

    Parameters
    ----------
    library
        File of the library; an older one is removed if the compilation fails.
    sources
        C files and the headers that they include.
    flags
        Additional flags of the compiler.
    exports
        Pattern for the names of exported functions; empty to export all.

    Returns
    -------
    str
        Reason for a failure; empty on success.
    """
    reason = _compile(library, sources, flags, exports)
    if reason:
        with contextlib.suppress(OSError):  # if the folder is read-only
            library.unlink(missing_ok=True)  # an older library belongs to other sources
    return reason


def _compile(library: Path, sources: Sequence[Path], flags: Sequence[str], exports: str) -> str:
    compiler, reason = _compiler()
    if not compiler:
        return reason
    fresh = library.with_name(f".{library.name}.{os.getpid()}")
    try:
        if reason := _link(compiler, fresh, sources, flags, exports):
            return reason
        fresh.replace(library)  # atomically, because other processes may be loading the library
    except OSError as error:
        return f"the C compiler could not be run: {error}"
    finally:
        fresh.unlink(missing_ok=True)
    return ""


def _link(
    compiler: Sequence[str], library: Path, sources: Sequence[Path], flags: Sequence[str] = (), exports: str = ""
) -> str:
    """Compile sources and link them; return the reason for a failure, or an empty text."""
    sha256 = sha256_of(sources)
    command = [*compiler, *_FLAGS, *flags, f'-DHILTEST_SOURCE_SHA256="{sha256}"']
    command += [str(source) for source in sources if source.suffix == ".c"]
    command += ["-o", str(library), "-lm", "-Wl,-z,defs", f"-Wl,--build-id=0x{sha256}"]
    if not exports:
        return _run(command)
    with TemporaryDirectory(prefix="hiltest-link-") as folder:
        names = Path(folder, "exports.map")
        names.write_text(f"{{ global: {exports}; local: *; }};\n", encoding="utf-8")
        return _run([*command, f"-Wl,--version-script={names}"])


def build_core() -> str:
    """Compile the core of the virtual board and generate its binding for Python.

    Returns
    -------
    str
        Reason for a failure; empty on success.
    """
    return compiled(CORE, SOURCES[CORE], _CORE_FLAGS, exports="machine_*") or _bind_core()


def _bind_core() -> str:
    """Generate the binding from machine.h, as a module that needs no parser at import."""
    try:
        from cffi import FFI
    except ImportError as error:
        return f"the binding cannot be generated ({error}). Install the Python package cffi"
    ffi = FFI()
    ffi.set_source("hiltest.virtual.core._machine", None, compiler_verbose=0)
    ffi.cdef(CORE_INTERFACE.read_text(encoding="utf-8"))
    code = io.StringIO()
    code.write(f"# Generated from sources with the SHA-256 {sha256_of(SOURCES[CORE])}.\n")
    code.write("# ruff: noqa\n# mypy: ignore-errors\n")
    ffi.emit_python_code(code)
    fresh = CORE_BINDING.with_name(f".{CORE_BINDING.name}.{os.getpid()}")
    try:
        fresh.write_text(code.getvalue(), encoding="utf-8")
        fresh.replace(CORE_BINDING)
    except OSError as error:
        return f"the binding cannot be written: {error}"
    finally:
        fresh.unlink(missing_ok=True)
    return ""


def core_is_missing_because() -> str:
    """Return the reason why core or binding cannot be used, such as newer sources; empty if they can."""
    sources = SOURCES[CORE]
    if reason := _unfit_reason(CORE, sources):
        return reason
    try:
        if sha256_of(sources).encode() not in CORE_BINDING.read_bytes():
            return f"{CORE_BINDING} was generated from another {CORE_INTERFACE.name}"
    except FileNotFoundError:
        return f"{CORE_BINDING} was not built"
    return ""


def loaded(
    library: Path, sources: Sequence[Path], kind: type[ctypes.CDLL] = ctypes.CDLL
) -> tuple[ctypes.CDLL | None, str]:
    """Load a library, or return the reason why it is not used.

    Parameters
    ----------
    sources
        Sources of the library, which are compared with its build ID.
    kind
        Class of ctypes, which decides whether other threads of Python run during a call.

    Returns
    -------
    library : ctypes.CDLL or None
    reason : str
        Reason; empty if the library was loaded.
    """
    # The check precedes loading, because a process never loads a rebuilt library from the same path.
    if reason := _unfit_reason(library, sources):
        return None, reason
    try:
        return kind(str(library)), ""
    except OSError as error:
        return None, f"{library} cannot be loaded ({error})"


def _unfit_reason(library: Path, sources: Sequence[Path]) -> str:
    """Return the reason why a library must not be loaded: it is missing, damaged, or built from other sources."""
    try:
        content = library.read_bytes()
    except FileNotFoundError:
        return f"{library} was not built"
    except OSError as error:
        return f"{library} cannot be loaded ({error})"
    if _is_truncated(content):
        return f"{library} is truncated"
    if bytes.fromhex(sha256_of(sources)) not in content:
        return f"{library} was built from another {sources[0].name}"
    return ""


def _is_truncated(content: bytes) -> bool:
    """Return whether the end of an ELF file is missing, since loading such a file can kill the process."""
    if len(content) < 64 or content[:4] != b"\x7fELF":
        return False  # the loader rejects other files
    wide = content[4] == 2
    (sections,) = struct.unpack_from("=Q" if wide else "=I", content, 0x28 if wide else 0x20)
    size, count = struct.unpack_from("=HH", content, 0x3A if wide else 0x2E)
    return bool(sections + size * count > len(content))  # the section table is the end of the file
