"""A client that floods the turntable's port costs the board's clients little: its work in each step is bounded."""

from __future__ import annotations

import sys
from collections.abc import Callable
from types import FrameType

import pytest

from hiltest.boards import VirtualBench
from hiltest.boards.simulated_grbl import STEP_BYTES, GrblTable
from hiltest.boards.table_axes import TableAxes
from hiltest.rig import Rig

STEPS = 500
# Calls of functions, Python's and built-in ones, that a step of 2 ms may make for a flood; a call takes 0.1 to 0.3 us,
# so that these take at most a tenth of the step.
MOST_CALLS = 700


def calls_of(work: Callable[[], object]) -> int:
    """Count the calls of functions that some work makes."""
    count = 0

    def on_event(_frame: FrameType, event: str, _argument: object) -> None:
        nonlocal count
        count += event in ("call", "c_call")

    sys.setprofile(on_event)
    try:
        work()
    finally:
        sys.setprofile(None)
    return count


@pytest.mark.parametrize(
    "flood", [b"?", b"\n", b"$$\n", b"$I\n", b"G0X1\n", b"G1X1F1Y2Z3\n", b"!~?", b"\x18", b"$H\n", b"(\n"]
)
def test_a_flood_of_the_turntable_takes_at_most_a_tenth_of_each_step(rig: Rig, flood: bytes) -> None:
    bench = VirtualBench(rig)
    bench.power_on()
    table = GrblTable(TableAxes(bench), about="", reset=lambda: None)
    waiting = flood * STEP_BYTES * STEPS
    taken, calls = 0, 0

    def step() -> None:
        nonlocal taken
        size = table.room()
        table.hear(waiting[taken : taken + size])
        taken += size
        table.say()

    for _ in range(STEPS):
        calls += calls_of(step)
        bench.machine.run_until(bench.time_s + 0.002)
    assert 0 < taken <= STEP_BYTES * STEPS
    assert calls / STEPS <= MOST_CALLS, calls / STEPS


def test_requests_for_status_that_come_together_have_one_report(rig: Rig) -> None:
    bench = VirtualBench(rig)
    bench.power_on()
    table = GrblTable(TableAxes(bench), about="", reset=lambda: None)
    table.say()
    table.hear(b"?" * STEP_BYTES)
    assert table.say().count(b"<Idle|") == 1
