"""Builds the hooks in C, where there is a compiler."""

from __future__ import annotations

from hiltest import c_library

LIBRARY = c_library.BLOCK_HOOK
SOURCES = c_library.SOURCES[LIBRARY]


def source_sha256() -> str:
    """Return the hash of the C sources, which is compiled into the library."""
    return c_library.sha256_of(SOURCES)


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
    return c_library.compiled(LIBRARY, SOURCES, flags)
