"""The sequences that the shipped firmware times, exceptions among them: each way of counting gives the same clocks."""

from __future__ import annotations

import struct

import pytest

from hiltest.link.sequences import SEQUENCES, SequencePlace, TimeSequence
from hiltest.virtual.accounting import AccountingFactory, BlockAccounting, InstructionAccounting
from hiltest.virtual.k64f import VirtualK64F

from .conftest import SHIPPED
from .test_peripherals import _framed as framed

ANSWER_BYTES = 19  # frame and all, where nothing needs an escape


def clocks(accounting: AccountingFactory) -> tuple[object, ...]:
    """The answers for every sequence, and all that was counted on the way there."""
    board = VirtualK64F(SHIPPED, accounting=accounting)
    at_s = 0.2
    board.run_until(at_s)
    answers = []
    for number, name in enumerate(SEQUENCES):
        # Supervisor calls are made from code in flash too; of the others one memory shows as much as three.
        for place in SequencePlace if name.startswith("exception") else (SequencePlace.SRAM,):
            board.uart0.host_write(framed(struct.pack("<BBHBB", TimeSequence.code, number, 2, number, place)))
            at_s += 0.008  # not with the answer's last byte: whoever stops more often sees that earlier
            board.run_until(at_s)
            answers.append(board.uart0.host_read(100))
    return answers, board.cycles, board.instructions


@pytest.mark.slow  # by instruction, in Python
def test_every_way_of_counting_answers_alike(native_hook: AccountingFactory) -> None:
    counted = [clocks(each) for each in (BlockAccounting, native_hook, InstructionAccounting)]
    assert counted[0] == counted[1] == counted[2]
    answers = counted[0][0]
    assert isinstance(answers, list)
    assert all(len(answer) >= ANSWER_BYTES for answer in answers)
