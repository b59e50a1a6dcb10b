"""Hooks at the instructions of IT blocks that matter when they are skipped."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import unicorn

from hiltest.virtual.code_hook import CodeHook
from hiltest.virtual.engine import add_hook

_LONGEST = 4  # bytes of an instruction


class Watched:
    """Has the emulator tell which of the watched instructions are executed: for one that is skipped it calls no hook.

    Parameters
    ----------
    engine : Uc
        The emulator.
    hook : CodeHook or None
        What is told; None: nothing wants to know.
    """

    def __init__(self, engine: Any, hook: CodeHook | None) -> None:
        self._engine = engine
        self._hook = hook
        self._addresses: set[int] = set()

    def knows(self, addresses: frozenset[int]) -> bool:
        """Whether all of some instructions are watched."""
        return self._hook is None or self._addresses.issuperset(addresses)

    def watch(self, addresses: frozenset[int], first: int, end: int) -> None:
        """Watch instructions of the code from `first` to `end`, which must be translated anew to know of that."""
        if self._hook is None or self.knows(addresses):
            return
        for begin, last in _together(sorted(addresses - self._addresses)):
            add_hook(self._engine, unicorn.UC_HOOK_CODE, *self._hook, within=(begin, last))
            self._addresses.update(range(begin, last + 1, 2))
        self._engine.ctl_remove_cache(first, end)


def _together(addresses: list[int]) -> Iterator[tuple[int, int]]:
    """Yield first and last of those that follow on one another; each hook more makes the call of any take longer."""
    begin = last = addresses[0]
    for address in addresses[1:]:
        if address - last > _LONGEST:
            yield begin, last
            begin = address
        last = address
    yield begin, last
