"""INT1 and INT2: enabled sources, led to a pin, until what raised them is read."""

import math

import pytest

from hiltest.world.distortion import MagneticDistortion
from hiltest.world.earth_field import EarthField
from hiltest.world.sensors.fxas21002c import Fxas21002c
from hiltest.world.sensors.fxos8700cq import Fxos8700cq
from hiltest.world.sensors.mag3110 import Mag3110
from hiltest.world.world import World

from .bus_master import read, write

WORLD = World(EarthField(48.5, 62.0))
HIGH, LOW = True, False


def mag3110():
    part = Mag3110(WORLD, MagneticDistortion(), seed=1)
    write(part, 0.06, 0x10, 0x01)
    return part


def fxos8700cq(*, polarity, enable, to_int1, f_setup=0):
    part = Fxos8700cq(WORLD, MagneticDistortion(), seed=1)
    write(part, 0.06, 0x09, f_setup)
    write(part, 0.06, 0x2C, polarity, enable, to_int1)
    write(part, 0.06, 0x5B, 0x1F)
    write(part, 0.06, 0x2A, 0x0D)  # samples at 0.075, 0.08, ...
    return part


def fxas21002c(control2, f_setup=0):
    part = Fxas21002c(WORLD, seed=1)
    write(part, 0.06, 0x09, f_setup)
    write(part, 0.06, 0x14, control2, 0x08)
    write(part, 0.06, 0x13, 0x0A)  # samples at 0.125, 0.13, ...
    return part


def test_mag3110_int1_is_high_from_new_data_until_x_is_read():
    part = mag3110()
    assert part.interrupt_levels(0.07) == (LOW, LOW)
    assert part.next_interrupt_s(0.07) == 0.075
    assert part.interrupt_levels(0.075) == (HIGH, LOW)
    assert part.next_interrupt_s(0.076) == math.inf
    read(part, 0.08, 0x03, 4)
    assert part.interrupt_levels(0.08) == (HIGH, LOW)
    read(part, 0.08, 0x01, 1)
    assert part.interrupt_levels(0.08) == (LOW, LOW)
    assert part.next_interrupt_s(0.08) == 0.0875


@pytest.mark.parametrize(("polarity", "active"), [(0x00, LOW), (0x02, HIGH)])
def test_fxos8700cq_data_ready_goes_where_it_is_led_with_the_polarity_that_is_set(polarity, active):
    for to_int1, pin in ((0x01, 0), (0x00, 1)):
        part = fxos8700cq(polarity=polarity, enable=0x01, to_int1=to_int1)
        idle = (not active, not active)
        assert part.interrupt_levels(0.074) == idle
        assert part.next_interrupt_s(0.074) == 0.075
        assert part.interrupt_levels(0.075)[pin] is active
        assert part.interrupt_levels(0.075)[1 - pin] is not active
        read(part, 0.076, 0x01, 6)
        assert part.interrupt_levels(0.076)[pin] is active, "the field is still unread"
        read(part, 0.076, 0x33, 6)
        assert part.interrupt_levels(0.076) == idle
        assert part.next_interrupt_s(0.076) == 0.08


def test_fxos8700cq_fifo_watermark_is_a_source_of_its_own():
    part = fxos8700cq(polarity=0x02, enable=0x41, to_int1=0x40, f_setup=0x43)
    assert part.interrupt_levels(0.0751) == (LOW, HIGH)  # data ready of the magnetometer, on INT2
    assert part.next_interrupt_s(0.0751) == 0.08
    assert part.interrupt_levels(0.0849) == (LOW, HIGH)
    assert part.interrupt_levels(0.0851) == (HIGH, HIGH)
    read(part, 0.0852, 0x00, 1)
    assert part.interrupt_levels(0.0852) == (LOW, HIGH)


@pytest.mark.parametrize(("control2", "pin"), [(0x0E, 0), (0x06, 1)])
def test_fxas21002c_data_ready_goes_where_it_is_led(control2, pin):
    part = fxas21002c(control2)
    assert part.interrupt_levels(0.124) == (LOW, LOW)
    assert part.next_interrupt_s(0.124) == 0.125
    assert part.interrupt_levels(0.125) == ((HIGH, LOW), (LOW, HIGH))[pin]
    read(part, 0.126, 0x01, 6)
    assert part.interrupt_levels(0.126) == (LOW, LOW)


def test_fxas21002c_fifo_watermark_falls_when_the_fifo_is_drained():
    part = fxas21002c(0xC0, f_setup=0x44)  # active low, on INT1
    assert part.interrupt_levels(0.1399) == (HIGH, HIGH)
    assert part.interrupt_levels(0.1401) == (LOW, HIGH)
    read(part, 0.141, 0x01, 6)
    assert part.interrupt_levels(0.141) == (HIGH, HIGH)


def test_what_is_not_enabled_never_asks_to_be_looked_at():
    for part in (fxos8700cq(polarity=0, enable=0, to_int1=0), fxas21002c(0x00)):
        assert part.next_interrupt_s(0.3) == math.inf
        assert part.interrupt_levels(0.3) == (HIGH, HIGH)


def test_in_standby_nothing_comes():
    part = mag3110()
    read(part, 0.2001, 0x01, 6)
    write(part, 0.2001, 0x10, 0x00)
    read(part, 0.3, 0x01, 6)
    assert part.next_interrupt_s(0.3) == math.inf
