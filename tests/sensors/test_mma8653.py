"""The MMA8653FC, by its registers."""

from __future__ import annotations

import math

import pytest

from hiltest.orientation.angles import Pose
from hiltest.world.sensors.mma8653 import Mma8653

from .bus_master import read, write
from .driver_bus import setup

ACTIVE = {0x2B: 0x10, 0x2D: 0x01, 0x2E: 0x01, 0x2A: 0x21}  # as the micro:bit's firmware sets it up: 50 Hz


def active(part: Mma8653) -> Mma8653:
    for register, value in ACTIVE.items():
        write(part, 0.1, register, value)
    return part


def words_g(part: Mma8653, time_s: float, full_scale_g: float = 2.0) -> list[float]:
    data = bytes(read(part, time_s, 0x01, 6))
    words = [int.from_bytes(data[place : place + 2], "big", signed=True) for place in (0, 2, 4)]
    assert all(word % 64 == 0 for word in words), "ten bits, left-justified"
    return [word / 32768 * full_scale_g for word in words]


@pytest.mark.parametrize(
    ("pose", "expected_g"),
    [(Pose(0.0), (0.0, 0.0, -1.0)), (Pose(0.0, 0.0, 90.0), (0.0, -1.0, 0.0)), (Pose(0.0, 30.0), (0.5, 0.0, -0.866))],
)
def test_it_feels_the_force_that_holds_it(pose: Pose, expected_g: tuple[float, float, float]) -> None:
    part = active(Mma8653(setup(pose)))
    assert words_g(part, 1.0) == pytest.approx(expected_g, abs=0.006)  # steps of 3.9 mg, and noise


def test_the_full_scale_changes_the_words_and_only_in_standby() -> None:
    part = active(Mma8653(setup(Pose(0.0))))
    write(part, 1.0, 0x0E, 0x02)
    assert words_g(part, 1.1)[2] == pytest.approx(-1.0, abs=0.006)
    write(part, 1.2, 0x2A, 0x20)
    write(part, 1.3, 0x0E, 0x02)
    write(part, 1.4, 0x2A, 0x21)
    assert words_g(part, 2.0, 8.0)[2] == pytest.approx(-1.0, abs=0.02)


def test_a_user_offset_is_added_in_steps_of_2_mg() -> None:
    part = Mma8653(setup(Pose(0.0)))
    write(part, 0.05, 0x2F, 0x7F)
    assert words_g(active(part), 1.0)[0] == pytest.approx(127 * 0.00196, abs=0.006)


def test_int1_is_low_from_new_data_until_it_is_read() -> None:
    part = active(Mma8653(setup(Pose(0.0))))
    first_s = part.next_interrupt_s(0.1)
    assert 0.141 <= first_s <= 0.161, "two periods and a millisecond, on the grid of 20 ms"
    assert part.interrupt_levels(first_s - 0.001) == (True, True)
    assert part.interrupt_levels(first_s) == (False, True)
    read(part, first_s + 0.001, 0x01, 6)
    assert part.interrupt_levels(first_s + 0.002) == (True, True)
    assert math.isclose(part.next_interrupt_s(first_s + 0.002), first_s + 0.02)


def test_fast_read_skips_the_low_bytes() -> None:
    part = active(Mma8653(setup(Pose(0.0))))
    write(part, 1.0, 0x2A, 0x20)
    write(part, 1.1, 0x2A, 0x23)
    x, y, z = read(part, 2.0, 0x01, 3)
    assert z == 0xC0, "-64, high byte of -1 g"
    assert {x, y} <= {0x00, 0xFF}
