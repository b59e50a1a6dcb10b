"""The sequences that the shipped firmware times, exceptions among them, take the cycles of the model in Python."""

from __future__ import annotations

import struct

import pytest

from hiltest.link.sequences import SEQUENCES, SequencePlace, TimeSequence
from hiltest.virtual.board.k64f import VirtualK64F

from .conftest import SHIPPED
from .oracle import acted
from .test_peripherals import _framed as framed

ANSWER_BYTES = 19  # frame and all, where nothing needs an escape


def answers(board: VirtualK64F) -> list[bytes]:
    """Ask for every sequence, and return what is answered."""
    at_s = 0.2
    board.run_until(at_s)
    answered = []
    for number, name in enumerate(SEQUENCES):
        # Supervisor calls are made from code in flash too; of the others one memory shows as much as three.
        for place in SequencePlace if name.startswith("exception") else (SequencePlace.SRAM,):
            board.uart0.host_write(framed(struct.pack("<BBHBB", TimeSequence.code, number, 2, number, place)))
            at_s += 0.008
            board.run_until(at_s)
            answered.append(board.uart0.host_read(100))
    return answered


@pytest.mark.slow  # step by step, in Python
def test_every_sequence_takes_the_cycles_of_the_model() -> None:
    _, answered = acted(SHIPPED, answers)
    assert all(len(answer) >= ANSWER_BYTES for answer in answered)
