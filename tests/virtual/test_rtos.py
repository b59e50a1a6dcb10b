"""Firmware with tasks, interrupts and the FPU in all of them runs as on the part, however it is optimised."""

from __future__ import annotations

import struct
import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from hiltest.virtual.board.k64f import VirtualK64F

from .both_ways import assert_same_both_ways
from .conftest import FLAGS, PROGRAMS
from .oracle import ran
from .test_exceptions import word
from .test_peripherals import Part

RTOS = PROGRAMS / "rtos"
LEVELS = ("-O0", "-Os", "-O2", "-O3")
TEXT = b"the quick brown fox jumps over the lazy dog 0123456789\n"
TICK_S = 0.001

BuildRtos = Callable[..., Path]


@dataclass(frozen=True)
class Seen:
    """What somebody outside the chip sees, and what the program knows of itself."""

    said: bytes
    blinks: list[tuple[str, bool]]
    who_am_i: int
    results: tuple[int, ...]
    disturbed: tuple[int, ...]


@pytest.fixture
def build_rtos(tmp_path: Path, require_tool: Callable[[str], str]) -> BuildRtos:
    """Return a function that builds the program at a level of optimisation."""
    compiler = require_tool("arm-none-eabi-gcc")

    def compile_program(level: str, *flags: str, tick_priority: int = 0x40, timer_priority: int = 0x80) -> Path:
        elf = tmp_path / f"rtos{level}.elf"
        sources = [PROGRAMS / "start.S", *sorted(RTOS.glob("*.c")), RTOS / "context.S"]
        # A fused multiply-add would give other bits at some levels. The C library has memset and memcpy.
        command = [
            compiler, *(flag for flag in FLAGS if flag not in ("-O1", "-nostdlib")), "-nostartfiles", level,
            "-std=c11", "-ffp-contract=off", "-Wall", "-Wextra", "-Wconversion", "-Werror",
            f"-DTICK_PRIORITY={tick_priority}u", f"-DTIMER_PRIORITY={timer_priority}u", *flags,
            *map(str, sources), "-o", str(elf),
        ]  # fmt: skip
        subprocess.run(command, check=True, timeout=60)
        return elf

    return compile_program


def run(elf: Path) -> tuple[VirtualK64F, Seen]:
    """Run for 43 ticks with bytes coming in from the fifth on."""
    board = VirtualK64F(elf, i2c0=[Part(0x0E)], strict=True)
    board.run_until(5 * TICK_S)
    board.uart0.host_write(TEXT)
    board.run_until(43.5 * TICK_S)
    memory, symbols = board.processor.memory, board.image.symbols
    seen = Seen(
        board.uart0.host_read(1000), [(event.what, event.on) for event in board.events], word(board, "who_am_i"),
        memory.read_words(symbols["first_result"].address, 2), memory.read_words(symbols["disturbed"].address, 2),
    )  # fmt: skip
    return board, seen


@pytest.mark.parametrize("level", LEVELS)
def test_it_runs_the_same_however_often_the_board_stops(build_rtos: BuildRtos, level: str) -> None:
    assert_same_both_ways(build_rtos(level), 0.05, [(5 * TICK_S, TEXT)])


def series(factor: float) -> int:
    """Compute what a task computes, in float32; the bits of the result."""
    total, term, alternating = np.float32(0), np.float32(1), np.float32(0)
    for _ in range(400):
        total, alternating, term = np.float32(total + term), np.float32(term - alternating), term * np.float32(factor)
    (bits,) = struct.unpack("<I", np.float32(total + alternating).tobytes())
    return int(bits)


EXPECTED = Seen(
    said=b"ready\n" + TEXT.upper(),
    blinks=[("LED red", index % 2 == 0) for index in range(8)],  # every fifth tick of 43, noticed within a round
    who_am_i=0xA5,
    results=(series(0.999), series(0.75)),
    disturbed=(0, 0),
)


@pytest.mark.parametrize("level", LEVELS)
def test_the_program_does_the_same_at_every_level_of_optimisation(build_rtos: BuildRtos, level: str) -> None:
    board, seen = run(build_rtos(level))
    assert seen == EXPECTED
    assert board.faults == ()
    rounds = board.processor.memory.read_words(board.image.symbols["rounds"].address, 2)
    # A round is 400 times at least six instructions, 50 us with the interrupts; half of the time each: 35 ms.
    assert min(rounds) > 50
    # 20 timer interrupts a tick, 7 us each of 50: some ticks fall into one, and are more urgent.
    assert word(board, "timer_rounds") > 700
    assert word(board, "preempted_timer") > 0


@pytest.mark.slow  # step by step, in Python
def test_tasks_and_interrupts_take_the_cycles_of_the_model(build_rtos: BuildRtos) -> None:
    board = ran(build_rtos("-O2"), 6.5 * TICK_S, i2c0=[Part(0x0E)], strict=True)
    assert word(board, "timer_rounds") > 100


def test_a_kernel_that_forgets_the_floating_point_registers_is_caught(build_rtos: BuildRtos) -> None:
    _, seen = run(build_rtos("-O2", "-DWITHOUT_FLOATING_POINT_CONTEXT"))
    assert sum(seen.disturbed) > 0


def test_a_less_urgent_tick_waits_for_the_timers_handler(build_rtos: BuildRtos) -> None:
    board, seen = run(build_rtos("-O2", tick_priority=0x80, timer_priority=0x40))
    assert seen == EXPECTED
    assert word(board, "preempted_timer") == 0
