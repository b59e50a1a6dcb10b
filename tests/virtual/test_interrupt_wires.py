"""Wires follow a part's interrupt pins, and nothing is looked at while nothing can happen."""

from __future__ import annotations

import math
from fractions import Fraction

from hiltest.virtual.board.interrupt_wires import InterruptWires, Wire
from hiltest.virtual.processor.clock import PICOSECONDS, Clock
from hiltest.virtual.processor.schedule import Schedule


class Part:
    """INT1 rises every 10 ms and stays until `read`; INT2 is its opposite."""

    def __init__(self) -> None:
        self.enabled = True
        self.read_until = -1
        self.looks = 0

    def read(self, time_s: float) -> None:
        self.read_until = math.floor(time_s / 0.01 + 1e-9)

    def interrupt_levels(self, time_s: float) -> tuple[bool, bool]:
        self.looks += 1
        raised = self.enabled and math.floor(time_s / 0.01 + 1e-9) > self.read_until
        return (raised, not raised)

    def next_interrupt_s(self, time_s: float) -> float:
        raised = math.floor(time_s / 0.01 + 1e-9) > self.read_until
        return (self.read_until + 1) * 0.01 if self.enabled and not raised else math.inf


class Millisecond:
    """A calendar with a cycle a millisecond, and the clock that keeps virtual time."""

    def __init__(self) -> None:
        self.now = 0
        self.schedule = Schedule()
        self.time = Clock(self.schedule, lambda: self.now)
        self.time.run_at(Fraction(PICOSECONDS), Fraction(1000), 0)

    def pass_to(self, cycle: int) -> None:
        self.now = cycle
        self.schedule.run_due(cycle)


def test_each_edge_is_told_once_at_its_cycle_and_an_access_at_its_end() -> None:
    board, part = Millisecond(), Part()
    part.read(0.0)
    told: list[tuple[float, str, bool]] = []

    def tell(pin: str) -> Wire:
        return lambda level: told.append((board.schedule.time, pin, level))

    wires = InterruptWires(part, (tell("INT1"), tell("INT2")), board.time)
    wires.look()
    assert told == [(0.0, "INT1", False), (0.0, "INT2", True)]
    told.clear()
    board.pass_to(35)
    assert told == [(10.0, "INT1", True), (10.0, "INT2", False)]
    part.read(0.035)
    wires.look()
    assert told[2:] == [(10.0, "INT1", False), (10.0, "INT2", True)]
    board.pass_to(39)
    assert len(told) == 4
    board.pass_to(40)
    assert told[4:] == [(40.0, "INT1", True), (40.0, "INT2", False)]


def test_a_part_that_cannot_raise_anything_is_left_alone() -> None:
    board, part = Millisecond(), Part()
    part.enabled = False
    wires = InterruptWires(part, (None, None), board.time)
    wires.look()
    board.pass_to(10**9)
    assert part.looks == 1
    assert board.schedule.next_cycle == math.inf


def test_looking_twice_leaves_one_appointment() -> None:
    board, part = Millisecond(), Part()
    part.read(0.0)
    wires = InterruptWires(part, (None, None), board.time)
    for cycle in (0, 1, 2):
        board.pass_to(cycle)
        wires.look()
    looks = part.looks
    board.pass_to(12)
    assert part.looks == looks + 1
