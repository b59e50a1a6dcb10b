"""A program on two boards: one that passes the turns of loops which wait, and one that executes each turn."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from hiltest.errors import BoardFault
from hiltest.virtual.board.k64f import VirtualK64F
from hiltest.virtual.model.profile_file import DEFAULT_PROFILE
from hiltest.virtual.processor.executed_code import ExecutionWatch

from .test_peripherals import Part

Sending = tuple[float, bytes]  # when [s], and what


@dataclass(frozen=True)
class Outcome:
    """All that may not depend on how the board came there.

    Attributes
    ----------
    cycles : tuple of int
        All of them, those asleep, and those in which instructions waited for memories.
    sent : list of (int, bytes)
        Bytes on UART0, with the cycle at which the board's event had put them there.
    executed, jumped : Counter
        How often each instruction was executed, and how often it jumped.
    answers : list of int or None
        What devices have answered to the latest loads.
    """

    cycles: tuple[int, int, int]
    instructions: int
    device_loads: int
    answers: list[int] | None
    sent: list[tuple[int, bytes]]
    events: list[str]
    on_i2c: list[tuple[str, int, float]]
    executed: Counter[int]
    jumped: Counter[int]
    registers: dict[str, int]
    memory: str
    position: str
    unmodelled: list[str]
    told: list[str]
    ended: str


def outcome(
    elf: Path, until_s: float, *, executes_all: bool, sendings: Sequence[Sending] = (), profile: str = DEFAULT_PROFILE
) -> Outcome:
    """Run a program until a virtual time; SW2 is pressed for the third quarter of it.

    The board has its FXOS8700CQ, or what answers at its address.
    """
    part = Part(0x1D)
    board = VirtualK64F(elf, i2c0=[part], profile=profile)
    processor, core = board.processor, board.processor.core
    core.executes_all = executes_all
    watch = ExecutionWatch(processor)
    sent: list[tuple[int, bytes]] = []
    messages: list[str] = []
    board.report_waits(messages.append)

    def look() -> bool:
        if board.uart0.host_waiting:
            sent.append((board.cycles, board.uart0.host_read(10_000)))
        return False

    actions = [(at_s, lambda data=data: board.uart0.host_write(data)) for at_s, data in sendings]
    actions += [(until_s / 2, lambda: board.press("SW2")), (3 * until_s / 4, lambda: board.release("SW2"))]
    ended = ""
    try:
        for at_s, act in sorted(actions, key=lambda action: action[0]):
            board.run_until(at_s, wake=look)
            act()
        board.run_until(until_s, wake=look)
    except BoardFault as fault:
        ended = str(fault)
    code = watch.code()
    answers = processor.machine.answers(max(core.device_loads - 1000, 0))
    return Outcome(
        (board.cycles, processor.idle_cycles, core.memory_cycles),
        board.instructions,
        core.device_loads,
        None if answers is None else list(answers),
        sent,
        [str(event) for event in board.events],
        part.seen,
        code.executed,
        code.jumped,
        processor.registers.snapshot(),
        hashlib.sha256(processor.memory.sram.view).hexdigest(),
        board.position(),
        [f"{access}, {access.accesses} times" for access in board.unmodelled],
        messages,
        ended,
    )


def assert_same_both_ways(
    elf: Path, until_s: float, sendings: Sequence[Sending] = (), profile: str = DEFAULT_PROFILE
) -> Outcome:
    """Run both ways, compare, and return the outcome."""
    knowing, asking = (
        outcome(elf, until_s, executes_all=asks, sendings=sendings, profile=profile) for asks in (False, True)
    )
    assert knowing == asking
    return knowing
