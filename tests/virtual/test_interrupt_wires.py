"""Wires follow a part's interrupt pins, and nothing is looked at while nothing can happen."""

from __future__ import annotations

import math

from hiltest.virtual.interrupt_wires import InterruptWires, Wire
from hiltest.virtual.schedule import Schedule

CORE_HZ = 1000.0


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


def test_each_edge_is_told_once_at_its_cycle_and_an_access_at_its_end() -> None:
    schedule, part = Schedule(), Part()
    part.read(0.0)
    told: list[tuple[float, str, bool]] = []

    def tell(pin: str) -> Wire:
        return lambda level: told.append((schedule.time, pin, level))

    wires = InterruptWires(part, (tell("INT1"), tell("INT2")), schedule, core_hz=CORE_HZ)
    wires.look(0.0)
    assert told == [(0.0, "INT1", False), (0.0, "INT2", True)]
    told.clear()
    schedule.run_due(35.0)
    assert told == [(10.0, "INT1", True), (10.0, "INT2", False)]
    part.read(0.035)
    wires.look(35.0)
    assert told[2:] == [(10.0, "INT1", False), (10.0, "INT2", True)]
    schedule.run_due(39.0)
    assert len(told) == 4
    schedule.run_due(40.0)
    assert told[4:] == [(40.0, "INT1", True), (40.0, "INT2", False)]


def test_a_part_that_cannot_raise_anything_is_left_alone() -> None:
    schedule, part = Schedule(), Part()
    part.enabled = False
    wires = InterruptWires(part, (None, None), schedule, core_hz=CORE_HZ)
    wires.look(0.0)
    schedule.run_due(1e9)
    assert part.looks == 1
    assert schedule.next_cycle == math.inf


def test_looking_twice_leaves_one_appointment() -> None:
    schedule, part = Schedule(), Part()
    part.read(0.0)
    wires = InterruptWires(part, (None, None), schedule, core_hz=CORE_HZ)
    for cycle in (0.0, 1.0, 2.0):
        wires.look(cycle)
    looks = part.looks
    schedule.run_due(12.0)
    assert part.looks == looks + 1
