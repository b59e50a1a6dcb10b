"""A program on two boards: one that passes over loops that only wait, and one that executes every turn."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from hiltest.errors import BoardFault
from hiltest.virtual.k64f import VirtualK64F
from hiltest.virtual.native import by_block, every_turn
from hiltest.virtual.profile_file import DEFAULT_PROFILE

from .test_peripherals import Part

Sending = tuple[float, bytes]  # when [s], and what


@dataclass(frozen=True)
class Outcome:
    """All that may not depend on how the board came there.

    Attributes
    ----------
    sent : list of (int, bytes)
        Bytes on UART0, with the cycle at which the board's event had put them there.
    executed : dict
        How often each block went on behind its end, and jumped away.
    """

    cycles: int
    instructions: int
    idle_cycles: int
    sent: list[tuple[int, bytes]]
    events: list[str]
    on_i2c: list[tuple[str, int, float]]
    executed: dict[tuple[object, ...], tuple[int, int]]
    registers: dict[str, int]
    memory: str
    position: str
    unmodelled: list[str]
    told: list[str]
    ended: str


def outcome(
    elf: Path, until_s: float, *, passes_waits: bool, sendings: Sequence[Sending] = (), profile: str = DEFAULT_PROFILE
) -> Outcome:
    """Run a program until a virtual time; SW2 is pressed for the third quarter of it.

    The board has its FXOS8700CQ, or what answers at its address.
    """
    part = Part(0x1D)
    board = VirtualK64F(elf, i2c0=[part], accounting=by_block if passes_waits else every_turn, profile=profile)
    sent: list[tuple[int, bytes]] = []
    told: list[str] = []
    board.tell(told.append)

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
    processor = board.processor
    snapshot = processor.executed()
    assert snapshot is not None
    executed: dict[tuple[object, ...], tuple[int, int]] = {}
    for entered, on, away in zip(snapshot.entered, snapshot.runs[::2], snapshot.runs[1::2], strict=True):
        key = entered.block.address, entered.block.end, entered.block.entry, entered.block.priced
        before = executed.get(key, (0, 0))
        executed[key] = before[0] + on, before[1] + away
    return Outcome(
        board.cycles, board.instructions, processor.idle_cycles, sent, [str(event) for event in board.events],
        part.seen, executed,
        processor.registers.snapshot(), hashlib.sha256(processor.memory.sram.view).hexdigest(), board.position(),
        [f"{access}, {access.accesses} times" for access in board.unmodelled], told, ended,
    )  # fmt: skip


def assert_same_both_ways(
    elf: Path, until_s: float, sendings: Sequence[Sending] = (), profile: str = DEFAULT_PROFILE
) -> Outcome:
    """Run both ways, compare, and return the outcome."""
    passed, executed = (
        outcome(elf, until_s, passes_waits=passes, sendings=sendings, profile=profile) for passes in (True, False)
    )
    assert passed == executed
    return passed
