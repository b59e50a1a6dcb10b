"""A part that loses its supply: silent meanwhile, and as after power-on when it is back."""

from __future__ import annotations

import math
from functools import partial

import pytest

from hiltest.world import EarthField, MagneticDistortion, World
from hiltest.world.sensors import Fxas21002c, Mag3110
from hiltest.world.sensors.faulty_part import FaultyPart

from .bus_master import read, write

WORLD = World(EarthField(48.5, 62.0))
OFF_X_LSB, CTRL_REG1 = 0x0A, 0x10
BEGIN_S, END_S = 1.0, 1.5


def mag3110() -> Mag3110:
    return Mag3110(WORLD, MagneticDistortion(), seed=1)


@pytest.mark.parametrize("end_s", [BEGIN_S, END_S])
def test_it_keeps_its_registers_until_it_loses_its_supply(end_s: float) -> None:
    part = FaultyPart(mag3110, BEGIN_S, end_s)
    write(part, 0.1, OFF_X_LSB, 0x12)
    assert read(part, 0.9, OFF_X_LSB, 1) == b"\x12"
    assert read(part, end_s, OFF_X_LSB, 1) == b"\x00"
    write(part, end_s, OFF_X_LSB, 0x34)
    assert read(part, end_s + 9.0, OFF_X_LSB, 1) == b"\x34"


def test_nothing_acknowledges_while_it_is_away_and_the_line_reads_as_ones() -> None:
    part = FaultyPart(mag3110, BEGIN_S, END_S)
    assert part.start(False, 0.9)
    assert not part.start(False, BEGIN_S)
    assert not part.write(0, BEGIN_S)
    assert part.read(BEGIN_S) == 0xFF
    part.stop(BEGIN_S)
    assert part.start(False, END_S)


def test_another_part_answers_in_its_place() -> None:
    part = FaultyPart(mag3110, BEGIN_S, math.inf, Fxas21002c(WORLD, seed=1))
    assert read(part, 0.9, 0x07, 1) == b"\xc4"
    assert read(part, BEGIN_S, 0x0C, 1) == b"\xd7"


def test_one_that_takes_time_to_boot_takes_it_again() -> None:
    part = FaultyPart(partial(Fxas21002c, WORLD, seed=1), BEGIN_S, END_S)
    assert part.start(False, 0.9)
    assert not part.start(False, END_S + 0.01)
    assert part.start(False, END_S + 0.1)


def test_its_pin_is_looked_at_again_when_it_goes_and_comes() -> None:
    part = FaultyPart(mag3110, BEGIN_S, END_S)
    write(part, 0.1, CTRL_REG1, 0x01)
    read(part, 0.99, 0x01, 6)
    assert part.interrupt_levels(0.99) == (False, False)
    assert part.next_interrupt_s(0.99) == BEGIN_S
    assert part.interrupt_levels(BEGIN_S) == (False, False)
    assert part.next_interrupt_s(BEGIN_S) == END_S
    assert part.next_interrupt_s(END_S) == math.inf  # it stands by
