"""Whole programs, interrupts among them, take the cycles of the model in Python."""

from __future__ import annotations

from hiltest.virtual.board.k64f import VirtualK64F

from .conftest import PROGRAMS, SHIPPED, Build
from .oracle import acted, ran
from .test_peripherals import Part
from .test_peripherals import _framed as framed


def test_interrupts_that_use_the_fpu_take_the_cycles_of_the_model(build: Build) -> None:
    board = ran(build(PROGRAMS / "exceptions.c"), 0.004)
    assert board.cycles > 80_000


def test_a_session_with_serial_port_and_sensors_takes_the_cycles_of_the_model() -> None:
    answers = []

    def converse(board: VirtualK64F) -> None:
        board.run_until(0.2)
        board.uart0.host_write(framed(bytes.fromhex("01 01 0400 efbeadde")))
        board.run_until(board.time_s + 0.02)
        answers.append(board.uart0.host_read(1000))

    acted(SHIPPED, converse, i2c1=[Part(0x0E), Part(0x1E)])
    assert answers[0] == answers[1]
    assert answers[0]
