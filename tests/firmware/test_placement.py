"""Floating-point instructions of the kernels begin at words, where a Cortex-M4 fetches them without waiting."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import hiltest
from hiltest.procedures.golden_points import golden_points
from hiltest.virtual.board.k64f import VirtualK64F
from hiltest.virtual.calls.buffers import Address, Structure
from hiltest.virtual.calls.calling import CallResult
from hiltest.virtual.calls.procedure_call import Argument
from hiltest.virtual.counts.profiling import profile_call

from ..orientation.filters import FilterState, floats
from .dpi_kernel import BoardDpi
from .streams import BoardStream

ELF = Path(hiltest.__file__).parent / "firmware" / "hiltest-frdm-k64f.elf"
MOST = 0.05


class Watched(VirtualK64F):
    """A virtual board that keeps where the floating-point instructions lay that it executed."""

    def __init__(self) -> None:
        super().__init__(ELF)
        self.executed: Counter[str] = Counter()
        self.straddling: Counter[str] = Counter()
        self._watching = True

    def call(self, function: str, *arguments: Argument, **options: float) -> CallResult:
        if not self._watching:
            return super().call(function, *arguments, **options)
        self._watching = False  # profile_call calls it too
        try:
            profile = profile_call(self, function, *arguments)
        finally:
            self._watching = True
        for address in profile.addresses:
            if address.text.startswith("v"):
                self.executed[address.function] += address.executions
                self.straddling[address.function] += address.executions * (address.address % 4 == 2)
        return profile


def calibrator(name: str) -> Callable[[Watched], object]:
    def run(board: Watched) -> object:
        counts = np.ascontiguousarray(golden_points(100), "<i2")
        spread = counts.min(axis=0), counts.max(axis=0)
        points = Structure(Address(counts), np.array([100], "<u2"), *spread, np.array([0], "<u2"))
        return board.call(f"magnetometer_{name}", points, bytearray(64))

    return run


def dpi(board: Watched) -> object:
    points = golden_points(300)
    return BoardDpi(board).pairs(points, np.roll(points, 1, axis=0))


def stream(name: str) -> Callable[[Watched], object]:
    def run(board: Watched) -> object:
        running = BoardStream(name, board)
        running.reset()
        for point in golden_points(160).tolist():
            running.add(point)
        return running.report()

    return run


def attitude_filter(board: Watched) -> object:
    state = bytearray(bytes(FilterState()))
    rates, gravity, field = (bytes(floats(item)) for item in ([0.9, -0.7, 0.8], [0.1, 0.2, 0.97], [20.0, 1.0, 40.0]))
    for _ in range(10):
        board.call("attitude_filter_update", state, rates, gravity, field, 0.5)
    return state


@pytest.mark.parametrize(
    ("kernel", "run"),
    [
        ("direct", calibrator("direct")),
        ("direct-fast", calibrator("direct_fast")),
        ("corrected", calibrator("corrected")),
        ("iterative", calibrator("iterative")),
        ("dpi", dpi),
        ("direct-stream", stream("direct-stream")),
        ("iterative-stream", stream("iterative-stream")),
        ("attitude_filter", attitude_filter),
    ],
)
def test_a_kernels_floating_point_lies_at_words(kernel: str, run: Callable[[Watched], object]) -> None:
    board = Watched()
    run(board)
    executed, straddling = board.executed.total(), board.straddling.total()
    worst = ", ".join(f"{name} {count}" for name, count in board.straddling.most_common(3) if count)
    print(f"{kernel}: {straddling} of {executed} floating-point instructions at half a word. {worst}")
    assert executed > 100
    assert straddling <= MOST * executed
