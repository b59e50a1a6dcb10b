"""Interrupts disturb nothing that they interrupt."""

from __future__ import annotations

import struct

import numpy as np

from hiltest.virtual.board.k64f import VirtualK64F

from .conftest import PROGRAMS, Build, word


def test_a_computation_survives_interrupts_that_use_the_fpu(build: Build) -> None:
    board = VirtualK64F(build(PROGRAMS / "exceptions.c"))
    board.run_until(0.05)
    total, term = np.float32(0), np.float32(1)
    for _ in range(20000):
        total, term = np.float32(total + term), np.float32(term * np.float32(0.999))
    bits = word(board, "result")
    assert np.float32(struct.unpack("<f", struct.pack("<I", bits))[0]) == total
    # 20 000 rounds of at least 5 cycles, a tick every 1000: many ticks, and as many PendSV.
    assert word(board, "ticks") > 80
    assert word(board, "switches") == word(board, "ticks")
    assert word(board, "calls") == 1
    assert word(board, "number_in_handler") == 11
