"""Every peripheral goes back to a snapshot: the same accesses to its registers get the same answers again."""

from __future__ import annotations

import random
from typing import Any

import pytest

from hiltest.boards import default_firmware
from hiltest.errors import HiltestError
from hiltest.virtual.chip import mk64f12
from hiltest.virtual.k64f import VirtualK64F
from hiltest.virtual.peripherals.reset_control import ResetRequested

GATES = range(0x40048028, 0x40048044, 4)  # SCGC1 to 7
SYSTEM_CONTROL, SYSTICK, DWT = 0xE000E000, 0xE000E010, 0xE0001000
PRIVATE = [*range(SYSTICK, SYSTICK + 12, 4), *range(SYSTEM_CONTROL + 0x100, SYSTEM_CONTROL + 0x120, 4),
           SYSTEM_CONTROL + 0xD14, SYSTEM_CONTROL + 0xDFC, DWT, DWT + 4]  # fmt: skip
REGISTERS = [(register.address, register.size) for module in mk64f12().peripherals for register in module.registers]
ACCESSES, ROUNDS = 300, 5


def opened_board(seed: int) -> VirtualK64F:
    """Return a board that has booted, all of whose modules have clocks, after many accesses to its registers."""
    board = VirtualK64F(default_firmware())
    board.run_until(0.02)
    for gate in GATES:
        board.bus.write(gate, 4, 0xFFFFFFFF)
    outcome_of(board, random.Random(seed))
    return board


def access(board: VirtualK64F, choice: random.Random) -> object:
    """Read or write a register, seldom in another than its own size."""
    address, size = choice.choice(REGISTERS) if choice.random() < 0.9 else (choice.choice(PRIVATE), 4)
    value = choice.choice((0, 0xFFFFFFFF, 1 << choice.randrange(32), choice.getrandbits(32))) & (1 << 8 * size) - 1
    try:
        if choice.random() < 0.5:
            return board.bus.read(address, size) & (1 << 8 * size) - 1
        return board.bus.write(address, size, value)
    except (HiltestError, ResetRequested) as error:
        return str(error)


def outcome_of(board: VirtualK64F, choice: random.Random) -> list[Any]:
    """Access registers, pins and serial lines at random, let time pass in between; return all that can be seen."""
    outcome: list[Any] = []
    with board.unnoticed():
        for _ in range(ROUNDS):
            outcome += [access(board, choice) for _ in range(ACCESSES)]
            board.drive(choice.choice(("PTC5", "PTA19", "PTC6", "PTB9")), choice.random() < 0.5)
            try:
                board.run_until(board.time_s + choice.choice((1e-6, 1e-4, 2e-3)))
            except HiltestError as error:
                outcome.append(str(error))
            outcome += [(uart.name, uart.host_read(100), uart.baud) for uart in board.uarts]
    core = board.processor.core
    return [*outcome, core.cycles, core.instructions, tuple(core.r), board.level("PTC5"), len(board.faults)]


@pytest.mark.parametrize("seed", range(12))
def test_random_accesses_get_the_same_answers_behind_a_restore(seed: int) -> None:
    board = opened_board(seed)
    snapshot = board.snapshot()
    once = outcome_of(board, random.Random(-seed))
    outcome_of(board, random.Random(seed + 1000))
    board.restore(snapshot)
    again = outcome_of(board, random.Random(-seed))
    assert [pair for pair in zip(once, again, strict=True) if pair[0] != pair[1]] == []
