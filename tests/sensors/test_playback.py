"""Parts that measure a recording: along their own axes, without noise, in their own counts, cut where they stop."""

from __future__ import annotations

import numpy as np
import pytest

from hiltest.world.earth_field import EarthField
from hiltest.world.recorded_motion import Playback, Sensed, Track
from hiltest.world.sensors import SensorSetup
from hiltest.world.sensors.lis3mdl import Lis3mdl
from hiltest.world.sensors.lsm303agr_a import Lsm303agrA
from hiltest.world.sensors.register_device import RegisterDevice
from hiltest.world.world import World

from .bus_master import read, write
from .test_sampling import active_fxas21002c, active_fxos8700cq, active_mag3110


def playing(**readings: tuple[float, float, float]) -> World:
    """Return a world in which a recording shows one reading of each sensor that is named."""
    world = World(EarthField(48.5, 62.0))
    times_s = np.array([0.0, 9.0])
    tracks = {Sensed[name.upper()]: Track(times_s, np.array([reading, reading])) for name, reading in readings.items()}
    world.playback = Playback("field.csv", tracks)
    return world


def words(part: RegisterDevice, register: int = 0x01) -> list[int]:
    return np.frombuffer(read(part, 1.0, register, 6), ">i2").tolist()


def test_each_part_turns_the_bodys_axes_into_its_own_counts_without_noise() -> None:
    world = playing(magnetometer=(12.34, -20.0, 30.0), accelerometer=(0.1, -0.2, 0.97), gyroscope=(1.0, -2.0, 300.0))
    assert words(active_mag3110(world)) == [200, -123, 300]  # body = (-y, -x, z), 0.1 uT
    both = active_fxos8700cq(world)
    assert words(both, 0x33) == [200, -123, -300]  # body = (-y, -x, -z)
    assert [word >> 2 for word in words(both)] == [round(2048 * item) for item in (-0.2, 0.1, 0.97)]  # 4 g full scale
    assert words(active_fxas21002c(world)) == [32, -16, -4800]  # body = (-y, -x, -z), 1/16 deg/s
    assert world.playback is not None
    assert world.playback.remarks() == []


def test_a_part_stops_where_it_stops_and_that_is_said() -> None:
    world = playing(magnetometer=(0.0, 4000.0, 1100.0), accelerometer=(0.0, 5.0, -4.5), gyroscope=(0.0, 0.0, 2100.0))
    assert words(active_mag3110(world)) == [-20_000, 0, 11_000]
    both = active_fxos8700cq(world)
    assert words(both, 0x33) == [-12_000, 0, -11_000]
    assert [word >> 2 for word in words(both)] == [8191, 0, -8192]
    assert words(active_fxas21002c(world)) == [0, 0, -32_768]
    assert world.playback is not None
    answer = "; ".join(world.playback.remarks())
    assert "1 samples of the MAG3110 were beyond 2000 uT" in answer
    assert "FXOS8700CQ accelerometer were beyond 4 g and are cut there" in answer
    assert "FXAS21002C were beyond 2048 dps" in answer


def test_offset_registers_act_on_a_recording_as_on_the_world() -> None:
    part = active_fxos8700cq(playing(accelerometer=(0.0, 0.0, 1.0)))
    write(part, 0.02, 0x2A, 0x0C)
    write(part, 0.02, 0x31, 0x10)  # 16 steps of 2 mg on the part's z
    write(part, 0.02, 0x2A, 0x0D)
    assert words(part)[2] >> 2 == round(2048 * 1.032)


@pytest.mark.parametrize("make", [active_mag3110, active_fxas21002c])
def test_what_is_not_recorded_is_simulated_as_before(make) -> None:
    simulated = words(make(World(EarthField(48.5, 62.0))))
    assert words(make(playing(accelerometer=(0.0, 0.0, 1.0)))) == simulated


def test_a_part_of_a_table_measures_a_recording_along_its_place() -> None:
    world = playing(magnetometer=(12.34, -20.0, 30.0), accelerometer=(0.1, -0.2, 0.97))
    magnetometer = Lis3mdl(SensorSetup(world, axes=("y", "-x", "z")))  # body x is the part's y
    write(magnetometer, 0.02, 0x22, 0x00)
    field = np.frombuffer(read(magnetometer, 1.0, 0x28, 6), "<i2")
    assert field.tolist() == [round(68.42 * item) for item in (20.0, 12.34, 30.0)]
    accelerometer = Lsm303agrA(SensorSetup(world, axes=("x", "-y", "-z")))
    write(accelerometer, 0.02, 0x23, 0x08)  # high resolution, 0.98 mg in the upper 12 bits
    write(accelerometer, 0.02, 0x20, 0x57)  # 100 Hz
    force = np.frombuffer(read(accelerometer, 1.0, 0xA8, 6), "<i2") >> 4
    assert force.tolist() == [
        round(item / 0.98e-3) for item in (-0.1, -0.2, 0.97)
    ]  # the axis that points up reads +1 g
    beyond = Lis3mdl(SensorSetup(playing(magnetometer=(2000.0, 0.0, 0.0))))
    write(beyond, 0.02, 0x22, 0x00)
    assert np.frombuffer(read(beyond, 1.0, 0x28, 6), "<i2").tolist() == [32_767, 0, 0]
    assert beyond.setup.world.playback is not None
    assert "1 samples of the LIS3MDL were beyond 1600 uT" in "; ".join(beyond.setup.world.playback.remarks())
