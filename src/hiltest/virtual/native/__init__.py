"""The block hook in C: counts as `BlockAccounting` does, at nearly the emulator's own speed.

It is built when the package is, where there is a C compiler, and never required.
`by_block` takes it when it is there and fits, and the hook in Python otherwise.
"""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable
from functools import cache
from typing import Any

from unicorn.unicorn_py3.unicorn import uclib

from hiltest.errors import ConfigError
from hiltest.virtual.accounting import Accounting, BlockAccounting
from hiltest.virtual.blocks import CodeBlock, ReadCode
from hiltest.virtual.native.accounting import NativeBlockAccounting, TellPassed
from hiltest.virtual.native.library import COUNTED, COUNTS, STEADY, Window, library, missing_because
from hiltest.virtual.registers import register_number
from hiltest.virtual.timing import TimingProfile

Offsets = range | frozenset[int]
PAGE_BYTES = 4096
CHOICE = "HILTEST_BLOCK_HOOK"  # in the environment: auto, native, python


def counts_natively() -> bool:
    """Say whether `by_block` counts in C.

    Raises
    ------
    ConfigError
        When the environment asks for what is not there, or for nothing known.
    """
    choice = os.environ.get(CHOICE, "auto")
    if choice not in ("auto", "native", "python"):
        raise ConfigError(f"{CHOICE}={choice}: choose auto, native or python")
    reason = missing_because()
    if choice == "native" and reason:
        raise ConfigError(f"{CHOICE}=native, but {reason}; python -m hiltest.virtual.native --build builds it")
    return choice != "python" and not reason


def by_block(
    profile: TimingProfile, read_code: ReadCode, attend: Callable[[CodeBlock], bool], stop: Callable[[], None]
) -> Accounting:
    """Return the accounting by block: in C where that is built, in Python otherwise."""
    kind = NativeBlockAccounting if counts_natively() else BlockAccounting
    return kind(profile, read_code, attend, stop)


def every_turn(
    profile: TimingProfile, read_code: ReadCode, attend: Callable[[CodeBlock], bool], stop: Callable[[], None]
) -> Accounting:
    """Return the accounting by block that passes over no turn of a loop."""
    accounting = by_block(profile, read_code, attend, stop)
    accounting.passes_waits = False
    return accounting


@cache
def declared_registers(steady: Offsets, counters: Offsets, *, counted: bool) -> ctypes.Array[ctypes.c_uint8]:
    """Return what is declared of each byte of a page, as the hook in C wants it: kept for good, as are its users.

    Parameters
    ----------
    steady, counters : range or frozenset of int
        Bytes of registers that are steady between events, and of those that count with time.
    counted : bool
        Whether the page wants to know of reads that were passed over.
    """
    declared = (ctypes.c_uint8 * PAGE_BYTES)()
    for offset in steady:
        declared[offset] = STEADY | (COUNTED if counted else 0)
    for offset in counters:
        declared[offset] = COUNTS | (COUNTED if counted else 0)
    return declared


def native_permission(
    base: int, opened: Any, ask: Any, steady: Any, accounting: Accounting, tell_passed: TellPassed
) -> tuple[Any, Any] | None:
    """Return a memory hook in C, and its argument, that asks only about pages not known to be open.

    Parameters
    ----------
    base : int
        Where the window begins.
    opened : array of c_uint8
        For each of its pages whether every access is permitted.
    ask : memory hook
        Decides about the others.
    steady : array of c_void_p
        For each page where what is declared of each of its bytes stands, or None: see `declared_registers`.
    accounting : Accounting
        Its watch over loops that only wait, where it has one, takes note of accesses.
    tell_passed : callable
        See `NativeBlockAccounting.permission_counter`.
    """
    if not counts_natively():
        return None
    functions = (ctypes.cast(function, ctypes.c_void_p) for function in (ask, uclib.uc_reg_read, uclib.uc_reg_write))
    counter = accounting.permission_counter(tell_passed) if isinstance(accounting, NativeBlockAccounting) else None
    window = Window(
        base, ctypes.addressof(opened), *functions, register_number("XPSR"), ctypes.addressof(steady), counter
    )
    return library().hiltest_permit, ctypes.pointer(window)
