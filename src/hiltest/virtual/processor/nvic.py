"""Exceptions of the core: pending, enabled and active ones, and their priorities.

Numbers are the architecture's exception numbers: 3 is HardFault, 11 SVCall, 14 PendSV, 15 SysTick and 16 + n external
interrupt n.
"""

from __future__ import annotations

from collections.abc import Iterator

from hiltest.virtual.core.library import lib
from hiltest.virtual.core.machine import Machine

NMI, HARD_FAULT, MEM_MANAGE, BUS_FAULT, USAGE_FAULT = 2, 3, 4, 5, 6
SVCALL, PENDSV, SYSTICK, FIRST_INTERRUPT = 11, 14, 15, 16
INTERRUPTS = 86  # MK64F12
IDLE = 256  # priority below that of any exception
_WORD_BITS = 32
_SYSTEM_NAMES = {
    NMI: "NMI",
    HARD_FAULT: "HardFault",
    MEM_MANAGE: "MemManage",
    BUS_FAULT: "BusFault",
    USAGE_FAULT: "UsageFault",
    SVCALL: "SVCall",
    PENDSV: "PendSV",
    SYSTICK: "SysTick",
}


def exception_name(exception: int) -> str:
    """Return the architecture's name of an exception."""
    if exception >= FIRST_INTERRUPT:
        return f"interrupt {exception - FIRST_INTERRUPT}"
    return _SYSTEM_NAMES.get(exception, f"exception {exception}")


class Nvic:
    """Pending and active exceptions of the processor."""

    def __init__(self, machine: Machine) -> None:
        self._core, self._handle = machine.core, machine.handle
        self._core.interrupts = INTERRUPTS

    @staticmethod
    def _members(words: list[int]) -> Iterator[int]:
        """Yield the numbers of the bits that are set."""
        for index in range(len(words)):
            word = words[index]
            while word:
                yield index * _WORD_BITS + (word & -word).bit_length() - 1
                word &= word - 1

    def _has(self, words: list[int], exception: int) -> bool:
        return bool(words[exception // _WORD_BITS] >> exception % _WORD_BITS & 1)

    @property
    def pending(self) -> set[int]:
        return set(self._members(self._core.pending))

    @property
    def taken(self) -> set[int]:
        """Exceptions that have been taken since power-on."""
        return set(self._members(self._core.taken))

    def is_driven(self, interrupt: int) -> bool:
        """Return whether a peripheral drives the line of an external interrupt."""
        return self._has(self._core.lines, FIRST_INTERRUPT + interrupt)

    def is_enabled(self, interrupt: int) -> bool:
        return self._has(self._core.enabled, FIRST_INTERRUPT + interrupt)

    def set_line(self, interrupt: int, level: bool) -> None:
        if level is not self.is_driven(interrupt):
            lib.machine_set_line(self._handle, interrupt, level)

    def pend(self, exception: int) -> None:
        lib.machine_pend(self._handle, exception)

    def unpend(self, exception: int) -> None:
        lib.machine_unpend(self._handle, exception)

    def preemption_priority(self, exception: int) -> int:
        """Return the priority that decides about preemption, without the sub-priority."""
        priority: int = lib.machine_preemption_priority(self._handle, exception)
        return priority

    def ceiling(self, *, without_primask: bool = False) -> int:
        """Return the execution priority due to PRIMASK, FAULTMASK and BASEPRI."""
        ceiling: int = lib.machine_ceiling(self._handle, without_primask)
        return ceiling

    def preempts(self, exception: int, ceiling: int = IDLE) -> bool:
        """Return whether the priority of an exception allows it to be taken now."""
        running: int = lib.machine_execution_priority(self._handle, ceiling)
        return self.preemption_priority(exception) < running

    def can_ever_wake(self, ceiling: int = IDLE) -> bool:
        """Return whether any enabled interrupt would preempt the running code."""
        enabled = set(self._members(self._core.enabled))
        ready = {exception for exception in self.pending if exception < FIRST_INTERRUPT or exception in enabled}
        return any(self.preempts(exception, ceiling) for exception in enabled | ready)

    def priority_groups(self) -> list[set[int]]:
        """Return the taken or enabled exceptions in sets of equal priority, of which one at a time can be active."""
        by_priority: dict[int, set[int]] = {}
        for exception in self.taken | set(self._members(self._core.enabled)):
            by_priority.setdefault(self.preemption_priority(exception), set()).add(exception)
        return list(by_priority.values())
