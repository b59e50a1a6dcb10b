"""Firmware with tasks, interrupts and the FPU in all of them runs as on the part, however it is optimised."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hiltest.virtual.board.k64f import VirtualK64F

from .conftest import PROGRAMS, Build, word

TICK_S = 0.001
BuildTasks = Callable[..., Path]


@pytest.fixture
def build_tasks(build: Build) -> BuildTasks:
    """Return a function that builds the program at a level of optimisation."""

    def compile_program(level: str, *flags: str, tick_priority: int = 0x40, timer_priority: int = 0x80) -> Path:
        priorities = (f"-DTICK_PRIORITY={tick_priority}u", f"-DTIMER_PRIORITY={timer_priority}u")
        # A fused multiply-add would give other bits at some levels.
        return build(PROGRAMS / "tasks.c", level, "-ffp-contract=off", *priorities, *flags)

    return compile_program


def run(elf: Path) -> tuple[VirtualK64F, tuple[int, ...], tuple[int, ...]]:
    """Run for 43 ticks; return the board, the tasks' results, and how many of them were disturbed."""
    board = VirtualK64F(elf, strict=True)
    board.run_until(43.5 * TICK_S)
    memory, symbols = board.processor.memory, board.image.symbols
    assert board.faults == ()
    assert min(memory.read_words(symbols["rounds"].address, 2)) > 3
    assert word(board, "timer_rounds") > 200
    results, disturbed = (memory.read_words(symbols[name].address, 2) for name in ("first_result", "disturbed"))
    return board, results, disturbed


def series(factor: float) -> int:
    """Compute what a task computes, in float32; the bits of the result."""
    total, term, alternating = np.float32(0), np.float32(1), np.float32(0)
    for _ in range(400):
        total, alternating, term = np.float32(total + term), np.float32(term - alternating), term * np.float32(factor)
    (bits,) = struct.unpack("<I", np.float32(total + alternating).tobytes())
    return int(bits)


@pytest.mark.parametrize("level", ["-O0", "-Os", "-O3"])
def test_the_program_does_the_same_at_every_level_of_optimisation(build_tasks: BuildTasks, level: str) -> None:
    board, results, disturbed = run(build_tasks(level))
    assert results == (series(0.999), series(0.75))
    assert disturbed == (0, 0)
    assert word(board, "preempted_timer") > 0


def test_a_kernel_that_forgets_the_floating_point_registers_is_caught(build_tasks: BuildTasks) -> None:
    _, _, disturbed = run(build_tasks("-O2", "-DWITHOUT_FLOATING_POINT_CONTEXT"))
    assert sum(disturbed) > 0


def test_a_less_urgent_tick_waits_for_the_timers_handler(build_tasks: BuildTasks) -> None:
    board, _, disturbed = run(build_tasks("-O2", tick_priority=0x80, timer_priority=0x40))
    assert disturbed == (0, 0)
    assert word(board, "preempted_timer") == 0
