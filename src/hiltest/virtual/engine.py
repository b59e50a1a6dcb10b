"""The emulator, entered and hooked directly through its C interface.

The binding's own `emu_start` costs as much again as the emulator's, and its wrapper of a hook
doubles the cost of each call.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from typing import Any

import unicorn
from unicorn import arm_const as arm
from unicorn import unicorn_py3
from unicorn.unicorn_py3.unicorn import uclib

_EMU_START = ctypes.CFUNCTYPE(
    ctypes.c_int, ctypes.c_void_p, ctypes.c_uint64, ctypes.c_uint64, ctypes.c_uint64, ctypes.c_size_t
)(("uc_emu_start", uclib))
TRANSLATED_CALLBACK = ctypes.CFUNCTYPE(
    None, ctypes.c_void_p, ctypes.POINTER(unicorn_py3.unicorn.uc_tb), ctypes.c_void_p, ctypes.c_void_p
)

_EVERYWHERE = (1, 0)  # in the form of the C interface


def cortex_m4() -> Any:
    """Make an emulator of the core, without any memory."""
    engine: Any = unicorn_py3.Uc(unicorn.UC_ARCH_ARM, unicorn.UC_MODE_THUMB | unicorn.UC_MODE_MCLASS)
    engine.ctl_set_cpu_model(arm.UC_CPU_ARM_CORTEX_M4)
    return engine


def entrance(engine: Any, until: int) -> Callable[[int], int]:
    """Return what runs code from an address on, until the address `until` or a stop, and answers a `UC_ERR`."""
    handle = engine._uch.value
    return lambda begin: _EMU_START(handle, begin, until, 0, 0)


def add_hook(engine: Any, kind: int, function: Any, data: Any = None, within: tuple[int, int] = _EVERYWHERE) -> int:
    """Have a C function called; the emulator keeps only the pointers to it and to its data.

    Parameters
    ----------
    engine : Uc
        The emulator.
    kind : int
        One of unicorn's `UC_HOOK_*`.
    function, data : object
        What is called, as ctypes knows it, and what it is given.
    within : tuple of int, optional
        First and last address that it is called for.

    Returns
    -------
    int
        What `remove_hook` knows it by.
    """
    first, last = (ctypes.c_uint64(address) for address in within)
    hook = ctypes.c_size_t()
    uclib.uc_hook_add(engine._uch, ctypes.byref(hook), kind, function, data, first, last)
    return hook.value


def remove_hook(engine: Any, hook: int) -> None:
    """Have a hook called no more; code that was translated with it must be translated anew."""
    uclib.uc_hook_del(engine._uch, ctypes.c_size_t(hook))
