"""The block hook in C: counts as `BlockAccounting` does, at nearly the emulator's own speed.

It is built when the package is, where there is a C compiler, and never required.
`by_block` takes it when it is there and fits, and the hook in Python otherwise.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

from hiltest.errors import ConfigError
from hiltest.virtual.accounting import Accounting, Block, BlockAccounting, ReadCode
from hiltest.virtual.native.accounting import NativeBlockAccounting
from hiltest.virtual.native.library import library, missing_because
from hiltest.virtual.timing import TimingProfile

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
    profile: TimingProfile, read_code: ReadCode, attend: Callable[[Block], bool], stop: Callable[[], None]
) -> Accounting:
    """Make what counts by block: in C where that is there, in Python otherwise."""
    kind = NativeBlockAccounting if counts_natively() else BlockAccounting
    return kind(profile, read_code, attend, stop)


def permit_natively() -> Any | None:
    """Return a memory hook in C that permits every access, if there is one."""
    return library().hiltest_permit if counts_natively() else None
