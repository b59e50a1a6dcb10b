"""A part goes back to a state: whatever a master asks of it then, it answers as it did before."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hiltest.orientation.angles import Pose
from hiltest.world.distortion import MagneticDistortion
from hiltest.world.earth_field import EarthField
from hiltest.world.sensors.faulty_part import FaultyPart
from hiltest.world.sensors.fxas21002c import Fxas21002c
from hiltest.world.sensors.fxos8700cq import Fxos8700cq
from hiltest.world.sensors.mag3110 import Mag3110
from hiltest.world.sensors.register_device import RegisterDevice
from hiltest.world.world import World

from .bus_master import read, write


def moving_world() -> World:
    world = World(EarthField(48.5, 62.0))
    world.turn_to(Pose(90.0, 20.0), time_s=0.25)
    world.turn_to(Pose(200.0, -20.0), time_s=1.0, known_angle=3)
    return world


def mag3110(world: World) -> Mag3110:
    return Mag3110(world, MagneticDistortion(), seed=3)


def fxos8700cq(world: World) -> Fxos8700cq:
    return Fxos8700cq(world, MagneticDistortion(), seed=3)


def fxas21002c(world: World) -> Fxas21002c:
    return Fxas21002c(world, seed=3)


def faulty_mag3110(world: World) -> FaultyPart:
    return FaultyPart(lambda: mag3110(world), 0.6, 0.9)


def replaced_gyroscope(world: World) -> FaultyPart:
    return FaultyPart(lambda: fxas21002c(world), 0.6, 0.9, Fxas21002c(world, seed=4))


# Registers that set a part up and those that show its samples, and values that make it active or stop it.
MAG, FXOS, FXAS = (
    (0x00, 0x01, 0x09, 0x10, 0x11),
    (0x00, 0x01, 0x09, 0x2A, 0x2B, 0x2D, 0x33, 0x39, 0x5B, 0x5C),
    (0x00, 0x01, 0x08, 0x09, 0x0A, 0x0D, 0x13, 0x14, 0x15),
)
VALUES = (0x00, 0x01, 0x02, 0x0D, 0x19, 0x1F, 0x40, 0x42, 0x60, 0x85, 0xC0, 0xFF)
Make = Callable[[World], RegisterDevice | FaultyPart]


def transactions(registers: tuple[int, ...]) -> st.SearchStrategy[list[tuple[str, int, int, float]]]:
    """Lists of accesses: kind, register, value or number of bytes, and the time since the one before."""
    one = st.tuples(
        st.sampled_from(("read", "read", "write", "set up", "levels")),
        st.sampled_from(registers),
        st.sampled_from(VALUES),
        st.sampled_from((0.0001, 0.004, 0.03, 0.2)),
    )
    return st.lists(one, max_size=20)


@pytest.mark.parametrize(
    ("make", "registers", "active"),
    [
        (mag3110, MAG, [(0x10, 0x01)]),
        (fxos8700cq, FXOS, [(0x09, 0x42), (0x5B, 0x1F), (0x2D, 0x41), (0x2A, 0x0D)]),
        (fxas21002c, FXAS, [(0x09, 0x42), (0x14, 0x44), (0x13, 0x0A)]),
        (faulty_mag3110, MAG, [(0x10, 0x01)]),
        (replaced_gyroscope, FXAS, [(0x13, 0x0A)]),
    ],
    ids=lambda value: getattr(value, "__name__", ""),
)
@given(data=st.data())
@settings(max_examples=50)
def test_a_part_answers_again_what_it_answered(
    make: Make, registers: tuple[int, ...], active: list[tuple[int, int]], data: st.DataObject
) -> None:
    part = make(moving_world())

    def answers(accesses: list[tuple[str, int, int, float]], time_s: float) -> list[object]:
        observations: list[object] = []
        for kind, register, value, later_s in accesses:
            time_s += later_s
            if kind in ("write", "set up"):  # in standby, where all set-up is taken
                standby, running = ((active[-1][0], 0), active[-1]) if kind == "set up" else (None, None)
                for place, byte in filter(None, (standby, (register, value), running)):
                    observations.append(
                        (part.start(False, time_s), part.write(place, time_s), part.write(byte, time_s))
                    )
                    part.stop(time_s)
            elif kind == "read":
                observations.append(read(part, time_s, register, 6))
            else:
                observations.append((part.interrupt_levels(time_s), part.next_interrupt_s(time_s)))
        return observations

    time_s = 0.1
    for register, value in active:
        write(part, time_s, register, value)
    before, behind, elsewhere = (data.draw(transactions(registers)) for _ in range(3))
    answers(before, time_s)
    time_s += sum(access[3] for access in before)
    state = part.state()
    once = answers(behind, time_s)
    answers(elsewhere, time_s + 0.5)
    part.restore(state)
    assert answers(behind, time_s) == once


def test_a_gyroscope_has_the_noise_of_its_bandwidth_again() -> None:
    part = fxas21002c(moving_world())
    assert write(part, 0.1, 0x13, 0x0A)
    state = part.state()
    once = read(part, 0.3, 0x01, 6)
    for register, value in ((0x13, 0x00), (0x0D, 0xC0), (0x13, 0x0A)):
        assert write(part, 0.4, register, value)
    assert read(part, 0.6, 0x01, 6) != once
    part.restore(state)
    assert read(part, 0.3, 0x01, 6) == once
