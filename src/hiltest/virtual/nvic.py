"""Exceptions: which are pending, enabled and active, and which may be taken.

Numbers are exception numbers as the architecture counts them: 11 is SVCall, 14
PendSV, 15 SysTick, 16 + n external interrupt n.
"""

from __future__ import annotations

SVCALL, PENDSV, SYSTICK, FIRST_INTERRUPT = 11, 14, 15, 16
INTERRUPTS = 86  # MK64F12
_IDLE = 256  # a priority that everything beats
_PRIORITY_MASK = 0xF0  # the K64F implements four bits


class Nvic:
    """Pending and active exceptions of the processor."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Nothing enabled, pending or active."""
        self.enabled = [False] * INTERRUPTS
        self.lines = [False] * INTERRUPTS
        self.priority: dict[int, int] = {}
        self.pending: set[int] = set()
        self.active: list[int] = []
        # Set when something may have become deliverable; the processor clears it.
        self.changed = False

    def set_line(self, interrupt: int, level: bool) -> None:
        """A peripheral drives its interrupt line."""
        if level != self.lines[interrupt]:
            self.lines[interrupt] = level
            if level:
                self.pend(FIRST_INTERRUPT + interrupt)

    def pend(self, exception: int) -> None:
        """Make an exception pending."""
        self.pending.add(exception)
        self.changed = True

    def set_enabled(self, interrupt: int, enabled: bool) -> None:
        """Enable or disable an external interrupt."""
        self.enabled[interrupt] = enabled
        self.changed = True

    def set_priority(self, exception: int, value: int) -> None:
        """Set the priority byte of an exception; lower is more urgent."""
        self.priority[exception] = value & _PRIORITY_MASK
        self.changed = True

    def _ready(self) -> list[int]:
        return [e for e in self.pending if e < FIRST_INTERRUPT or self.enabled[e - FIRST_INTERRUPT]]

    def _running_priority(self) -> int:
        return min((self.priority.get(exception, 0) for exception in self.active), default=_IDLE)

    def next_exception(self, *, ceiling: int = _IDLE) -> int | None:
        """Choose the pending exception that pre-empts what runs, if any.

        Parameters
        ----------
        ceiling : int
            Only exceptions more urgent than this priority (BASEPRI, PRIMASK = 0).
        """
        ready = self._ready()
        if not ready:
            return None
        best = min(ready, key=lambda exception: (self.priority.get(exception, 0), exception))
        limit = min(self._running_priority(), ceiling)
        return best if self.priority.get(best, 0) < limit else None

    def wakes(self) -> bool:
        """Whether WFI ends: something pending would be taken if PRIMASK were clear."""
        return self.next_exception() is not None

    @property
    def can_ever_wake(self) -> bool:
        """Whether any interrupt is enabled at all."""
        return any(self.enabled) or bool(self.pending)

    def enter(self, exception: int) -> None:
        """An exception is taken."""
        self.pending.discard(exception)
        self.active.append(exception)

    def leave(self) -> None:
        """The most recent exception returns; a line that is still high pends again."""
        if not self.active:
            return
        exception = self.active.pop()
        self.changed = True
        if exception >= FIRST_INTERRUPT and self.lines[exception - FIRST_INTERRUPT]:
            self.pending.add(exception)
