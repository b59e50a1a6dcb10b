"""The core's library and its binding: built from the sources that are there, and loaded.

`ffi` has the types of machine.h, `lib` its functions. Both come from cffi; the build has generated the module
`_machine`, so that nothing is parsed here.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

from hiltest.c_library import CORE, build_core, core_is_missing_because
from hiltest.errors import ConfigError

_CHECKOUT = Path(__file__).parents[4]


def _load() -> tuple[Any, Any]:
    """Return `ffi` and `lib`; an editable install builds them anew if its sources have changed."""
    is_editable = (_CHECKOUT / "hatch_build.py").is_file()
    reason = core_is_missing_because()
    if reason and is_editable:
        reason = build_core()
    if reason:
        remedy = f"`pip install -e {_CHECKOUT}` builds it" if is_editable else "Install hiltest again"
        raise ConfigError(f"no core for the virtual board: {reason}. {remedy}")
    try:
        ffi = import_module("hiltest.virtual.core._machine").ffi
        # It stays until the process ends: machines are destroyed late, when Python has let go of everything else.
        return ffi, ffi.dlopen(str(CORE), ffi.RTLD_NOW | ffi.RTLD_NODELETE)
    except (ImportError, OSError) as error:
        raise ConfigError(f"the virtual board's core cannot be loaded: {error}. Install hiltest again") from error


ffi, lib = _load()
