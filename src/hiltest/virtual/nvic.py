"""Exceptions: which are pending, enabled and active, and which may be taken.

Numbers are exception numbers as the architecture counts them: 3 is HardFault, 11
SVCall, 14 PendSV, 15 SysTick, 16 + n external interrupt n.
"""

from __future__ import annotations

from collections.abc import Callable

NMI, HARD_FAULT, MEM_MANAGE, BUS_FAULT, USAGE_FAULT = 2, 3, 4, 5, 6
SVCALL, PENDSV, SYSTICK, FIRST_INTERRUPT = 11, 14, 15, 16
INTERRUPTS = 86  # MK64F12
IDLE = 256  # a priority that everything beats
_PRIORITY_MASK = 0xF0  # the K64F implements four bits
_FIXED_PRIORITIES = {NMI: -2, HARD_FAULT: -1}
_SYSTEM_NAMES = {
    NMI: "NMI", HARD_FAULT: "HardFault", MEM_MANAGE: "MemManage", BUS_FAULT: "BusFault", USAGE_FAULT: "UsageFault",
    SVCALL: "SVCall", PENDSV: "PendSV", SYSTICK: "SysTick",
}  # fmt: skip


def exception_name(exception: int) -> str:
    """Name an exception as the architecture does."""
    if exception >= FIRST_INTERRUPT:
        return f"interrupt {exception - FIRST_INTERRUPT}"
    return _SYSTEM_NAMES.get(exception, f"exception {exception}")


class Nvic:
    """Pending and active exceptions of the processor.

    Attributes
    ----------
    enabled, lines : list of bool
        For each external interrupt: whether it is enabled, and what its peripheral drives.
    priority : dict of int to int
        Priority bytes by exception; lower is more urgent.
    pending : set of int
        Exceptions that wait.
    active : list of int
        Exceptions being handled, the one that runs last.
    taken : set of int
        Exceptions that have been taken since power-on.
    changed : bool
        Set when something may have become deliverable; the processor clears it.
    on_line : callable
        Told an external interrupt whose line goes high.
    newly_pending : bool
        Set when an exception becomes pending; whom that wakes clears it.
    """

    def __init__(self) -> None:
        self.on_line: Callable[[int], None] = lambda _interrupt: None
        self.taken: set[int] = set()
        self.reset()

    def reset(self) -> None:
        """Return to the state after reset: nothing enabled, pending or active."""
        self.enabled = [False] * INTERRUPTS
        self.lines = [False] * INTERRUPTS
        self.priority: dict[int, int] = {}
        self.pending: set[int] = set()
        self.active: list[int] = []
        self.changed = False
        self.newly_pending = False
        self.priority_grouping = 0

    @property
    def priority_grouping(self) -> int:
        """AIRCR.PRIGROUP: bits up to this one order pending exceptions and do not pre-empt."""
        return self._grouping

    @priority_grouping.setter
    def priority_grouping(self, value: int) -> None:
        self._grouping = value
        self._group_mask = 0xFF << (value + 1) & _PRIORITY_MASK
        self._preemption: dict[int, int] = {}
        self.changed = True

    def set_line(self, interrupt: int, level: bool) -> None:
        """Set the level of a peripheral's interrupt line."""
        if level != self.lines[interrupt]:
            self.lines[interrupt] = level
            if level:
                self.pend(FIRST_INTERRUPT + interrupt)
                self.on_line(interrupt)

    def pend(self, exception: int) -> None:
        """Make an exception pending."""
        self.newly_pending |= exception not in self.pending
        self.pending.add(exception)
        self.changed = True

    def clear_pending(self, interrupt: int) -> None:
        """Forget that an external interrupt is pending; a line that is still high pends again, now or at the return."""
        exception = FIRST_INTERRUPT + interrupt
        if not self.lines[interrupt] or exception in self.active:
            self.pending.discard(exception)

    def set_enabled(self, interrupt: int, enabled: bool) -> None:
        """Enable or disable an external interrupt."""
        self.enabled[interrupt] = enabled
        self.changed = True

    def set_priority(self, exception: int, value: int) -> None:
        """Set the priority byte of an exception; lower is more urgent."""
        if exception >= MEM_MANAGE:
            self.priority[exception] = value & _PRIORITY_MASK
            self._preemption.clear()
            self.changed = True

    def _order(self, exception: int) -> int:
        """Priority among pending exceptions, sub-priority included."""
        fixed = _FIXED_PRIORITIES.get(exception)
        return self.priority.get(exception, 0) if fixed is None else fixed

    def preemption_priority(self, exception: int) -> int:
        """Priority of an exception against what runs: without its sub-priority."""
        priority = self._preemption.get(exception)
        if priority is None:
            order = self._order(exception)
            priority = self._preemption[exception] = order if order < 0 else order & self._group_mask
        return priority

    def ceiling(self, primask: int, faultmask: int, basepri: int) -> int:
        """Translate the mask registers: only what is more urgent than the answer may be taken."""
        if faultmask & 1:
            return _FIXED_PRIORITIES[HARD_FAULT]
        if primask & 1:
            return 0
        basepri &= _PRIORITY_MASK
        return basepri & self._group_mask if basepri else IDLE

    def execution_priority(self, ceiling: int = IDLE) -> int:
        """Priority of what runs, raised by the masks."""
        priority = ceiling
        for exception in self.active:
            priority = min(priority, self.preemption_priority(exception))
        return priority

    def _ready(self) -> list[int]:
        return [e for e in self.pending if e < FIRST_INTERRUPT or self.enabled[e - FIRST_INTERRUPT]]

    def next_exception(self, *, ceiling: int = IDLE) -> int | None:
        """Choose the pending exception that pre-empts what runs, if any.

        Parameters
        ----------
        ceiling : int
            Only exceptions more urgent than this priority, see `ceiling`.
        """
        best = self.most_urgent()
        return best if best is not None and self.preempts(best, ceiling) else None

    def most_urgent(self, ceiling: int = IDLE) -> int | None:
        """Choose the pending exception that comes first, if it passes the masks; whatever is active."""
        ready = self._ready()
        if not ready:
            return None
        best = ready[0]
        if len(ready) > 1:
            best = min(ready, key=lambda exception: (self._order(exception), exception))
        return best if self.preemption_priority(best) < ceiling else None

    def preempts(self, exception: int, ceiling: int = IDLE) -> bool:
        """Whether an exception is urgent enough to be taken now."""
        return self.preemption_priority(exception) < self.execution_priority(ceiling)

    def can_ever_wake(self, ceiling: int = IDLE) -> bool:
        """Whether any interrupt that is enabled, should it come, would be taken over what runs."""
        enabled = [FIRST_INTERRUPT + number for number, enabled in enumerate(self.enabled) if enabled]
        return any(self.preempts(exception, ceiling) for exception in (*enabled, *self._ready()))

    def enter(self, exception: int) -> None:
        """Make an exception active."""
        self.pending.discard(exception)
        self.active.append(exception)
        self.taken.add(exception)

    def together(self) -> list[set[int]]:
        """Return the exceptions that were taken or are enabled, by priority: one of each set is active at a time."""
        enabled = {FIRST_INTERRUPT + number for number, enabled in enumerate(self.enabled) if enabled}
        found: dict[int, set[int]] = {}
        for exception in self.taken | enabled:
            found.setdefault(self.preemption_priority(exception), set()).add(exception)
        return list(found.values())

    def leave(self) -> None:
        """End the most recent exception; a line that is still high pends again."""
        if not self.active:
            return
        exception = self.active.pop()
        self.changed = True
        if exception >= FIRST_INTERRUPT and self.lines[exception - FIRST_INTERRUPT]:
            self.pending.add(exception)


class EventRegister:
    """Set by SEV and by every entry to and return from an exception.

    Parameters
    ----------
    nvic : Nvic
        Its newly pending exceptions are events too, where firmware has set SEVONPEND.

    Attributes
    ----------
    on_pend : bool
        SCR.SEVONPEND: an exception that becomes pending is an event, enabled or not.
    """

    def __init__(self, nvic: Nvic) -> None:
        self._nvic = nvic
        self.reset()

    def reset(self) -> None:
        """State after a processor reset."""
        self.on_pend = False
        self._set = False
        self._nvic.newly_pending = False

    def send(self) -> None:
        """Set it."""
        self._set = True

    def take(self) -> bool:
        """Clear it; return whether it was set."""
        was_set = self._set or (self.on_pend and self._nvic.newly_pending)
        self._set = self._nvic.newly_pending = False
        return was_set
