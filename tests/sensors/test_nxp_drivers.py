"""The shield's FXOS8700CQ and FXAS21002C by Adafruit's drivers, unmodified; the parts are aligned as on the shield."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hiltest.orientation.angles import Pose
from hiltest.world import MagneticDistortion, World
from hiltest.world.sensors import AccelerometerErrors
from hiltest.world.sensors.fxas21002c import Fxas21002c
from hiltest.world.sensors.fxos8700cq import Fxos8700cq

from .driver_bus import FIELD, TILTED, DriverClock, DriverI2c, ImportDriver, statistics

METRES_PER_S2 = 9.80665
OFFSET_G = (0.02, -0.01, 0.015)  # the data sheet gives +-20 mg
HARD_IRON_UT = (10.0, -5.0, 7.0)
BIAS_DPS = (1.0, -2.0, 0.5)


def accelerometer_g(reading: np.ndarray) -> np.ndarray:
    """The driver's reading along the body."""
    x, y, z = reading / METRES_PER_S2
    return np.array([y, x, z])


@pytest.mark.parametrize("pose", [Pose(0.0), TILTED])
@pytest.mark.parametrize("full_scale_g", [2, 4])
def test_fxos8700cq_by_adafruit_s_driver(
    clock: DriverClock, driver: ImportDriver, pose: Pose, full_scale_g: int
) -> None:
    adafruit, world = driver("adafruit_fxos8700"), World(FIELD, pose=pose)
    part = Fxos8700cq(
        world,
        MagneticDistortion(hard_iron_ut=HARD_IRON_UT),
        seed=3,
        address=0x1F,
        errors=AccelerometerErrors(offset_g=OFFSET_G),
    )
    range_code = {2: adafruit.ACCEL_RANGE_2G, 4: adafruit.ACCEL_RANGE_4G}[full_scale_g]
    sensor = adafruit.FXOS8700(DriverI2c([part], clock), accel_range=range_code)
    clock.sleep(0.1)
    mean, noise = statistics(lambda: sensor.accelerometer, clock, 0.01)
    truth_g = np.add(world.state_at(0.0).gravity_body_g, OFFSET_G)
    # The driver rounds 1/4096 g to 0.000244 g, and cuts the two lowest bits off: half a count on average.
    step_g = full_scale_g / 8192
    assert accelerometer_g(mean) == pytest.approx(truth_g, abs=1e-3)
    noise_g = math.hypot(126e-6 * math.sqrt(50.0), step_g / 12**0.5)  # density and bandwidth, data sheet
    assert noise / METRES_PER_S2 == pytest.approx([noise_g] * 3, rel=0.15)
    (x, y, z), noise_ut = statistics(lambda: sensor.magnetometer, clock, 0.01)
    assert [-y, -x, -z] == pytest.approx(np.add(world.state_at(0.0).field_body_ut, HARD_IRON_UT), abs=0.1)
    assert (noise_ut > 0.3).all()  # data sheet: 0.3 uT at an oversampling of 32, 1.5 uT at 2; here it is 16
    assert (noise_ut < 0.6).all()


@pytest.mark.parametrize("full_scale_dps", [250, 500, 1000, 2000])
def test_fxas21002c_by_adafruit_s_driver_in_a_turn(
    clock: DriverClock, driver: ImportDriver, full_scale_dps: int
) -> None:
    adafruit, world = driver("adafruit_fxas21002c"), World(FIELD, pose=TILTED)
    part = Fxas21002c(world, seed=3, address=0x21, bias_dps=BIAS_DPS)
    sensor = adafruit.FXAS21002C(DriverI2c([part], clock), gyro_range=full_scale_dps)

    def rate_dps() -> np.ndarray:
        x, y, z = np.degrees(sensor.gyroscope)
        return np.array([-y, -x, -z])

    mean_dps, noise_dps = statistics(rate_dps, clock, 0.01)
    assert mean_dps == pytest.approx(BIAS_DPS, abs=0.05)
    # The data sheet gives 25 mdps/sqrt(Hz); the bandwidth is 0.32 of 100 Hz. The rest is the rounding to a count.
    step_dps = full_scale_dps / 32_000
    assert noise_dps == pytest.approx([math.hypot(0.025 * math.sqrt(32.0), step_dps / 12**0.5)] * 3, rel=0.15)
    world.turn_round(360.0, rate_dps=60.0, time_s=clock.now_s)
    clock.sleep(1.0)
    errors_dps = []
    for _ in range(300):
        clock.sleep(0.01)
        errors_dps.append(rate_dps() - BIAS_DPS - world.state_at(clock.now_s).rate_body_dps)
    assert np.linalg.norm(world.state_at(clock.now_s).rate_body_dps) == pytest.approx(60.0)
    assert np.mean(errors_dps, axis=0) == pytest.approx([0.0] * 3, abs=0.05)
