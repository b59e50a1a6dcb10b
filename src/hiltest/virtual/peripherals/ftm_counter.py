"""The counter of an FTM: up, or up and down, in rounds of prescaled ticks."""

from __future__ import annotations

from dataclasses import dataclass

_ALL = 0xFFFF


@dataclass(slots=True)
class FlexCounter:
    """Where a counter is; phases are prescaled ticks since it was at its initial value, counting up.

    Attributes
    ----------
    initial, modulo : int
        CNTIN and MOD.
    up_down : bool
        Whether it counts down again from MOD.
    began : int
        Tick at which this round began.
    """

    initial: int = 0
    modulo: int = 0
    up_down: bool = False
    began: int = 0

    @property
    def top(self) -> int:
        """Steps from the initial value to the last one."""
        modulo = _ALL if self.modulo == self.initial == 0 else self.modulo
        return (modulo - self.initial) & _ALL

    @property
    def period(self) -> int:
        """Ticks of a round."""
        return max(2 * self.top, 1) if self.up_down else self.top + 1

    @property
    def overflow(self) -> int:
        """Phase at which TOF is set and buffered values are taken over: behind MOD."""
        return (self.top + 1) % self.period

    def value(self, phase: int) -> int:
        """What CNT shows at a phase."""
        return (self.initial + self.height(phase)) & _ALL

    def height(self, phase: int) -> int:
        """Steps above the initial value at a phase."""
        return phase if phase <= self.top else 2 * self.top - phase

    def matches(self, value: int) -> tuple[int, ...]:
        """Phases at which it has a value."""
        height = (value - self.initial) & _ALL
        if height > self.top:
            return ()
        down = self.period - height
        return (height, down) if self.up_down and height < down < self.period else (height,)

    def next_tick(self, phase: int, after: int) -> int:
        """First tick behind another at which it is at a phase."""
        return after + (phase - (after - self.began) - 1) % self.period + 1

    def times(self, phase: int, after: int, until: int) -> int:
        """How often it was at a phase behind one tick and up to another."""
        first = self.next_tick(phase, after)
        return 0 if first > until else 1 + (until - first) // self.period
