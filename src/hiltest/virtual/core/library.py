"""The core's library and its binding.

`ffi` has the types of machine.h, `lib` its functions. cffi generates the module `_machine` at build time, so that
machine.h need not be parsed at import.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

from hiltest.errors import ConfigError
from hiltest.virtual.core.c_library import CORE, build_core, core_is_missing_because

_CHECKOUT = Path(__file__).parents[4]


def _load() -> tuple[Any, Any]:
    """Return `ffi` and `lib`; an editable install rebuilds them if their sources have changed."""
    is_editable = (_CHECKOUT / "hatch_build.py").is_file()
    reason = core_is_missing_because()
    if reason and is_editable:
        reason = build_core()
    if reason:
        remedy = f"`pip install -e {_CHECKOUT}` builds it" if is_editable else "Install hiltest again"
        raise ConfigError(f"no core for the virtual board: {reason}. {remedy}")
    try:
        ffi = import_module("hiltest.virtual.core._machine").ffi
        # The library stays loaded until the process ends, because machines are destroyed late.
        return ffi, ffi.dlopen(str(CORE), ffi.RTLD_NOW | ffi.RTLD_NODELETE)
    except (ImportError, OSError) as error:
        raise ConfigError(f"the virtual board's core cannot be loaded: {error}. Install hiltest again") from error


ffi, lib = _load()


def guarded_callback(
    declaration: str, action: Callable[..., int | None], abort: Callable[[BaseException], None]
) -> Any:
    """Return an action as a callback of the library; the caller must keep a reference to it.

    Parameters
    ----------
    declaration : str
        C type of the callback, whose first parameter is a context that the action does not receive.
    action : callable
        Returns an integer, or None if the type is void.
    abort : callable
        Called with any exception of the action, since the library cannot pass it on; the callback then returns 0.
    """
    nothing = None if declaration.startswith("void(") else 0

    @ffi.callback(declaration)  # type: ignore[untyped-decorator]
    def call(_context: Any, *arguments: int) -> int | None:
        try:
            return action(*arguments)
        except BaseException as error:  # Ctrl-C too
            abort(error)
        return nothing

    return call
