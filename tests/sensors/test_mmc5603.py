"""The MMC5603 by Adafruit's driver, unmodified."""

from __future__ import annotations

import numpy as np
import pytest

from hiltest.orientation.angles import Pose
from hiltest.world import MagneticDistortion
from hiltest.world.sensors.mmc5603 import Mmc5603

from .bus_master import write
from .driver_bus import TILTED, DriverClock, DriverI2c, ImportDriver, setup, statistics, true_field_ut

ONE_SHOT_S = 6.6e-3
BANDWIDTH = 0x1C  # register
# The driver takes the rounded 0.0625 mG per count of the front page; the table of specifications has 16 384 per gauss.
DRIVER_SCALE = 16_384 / 16_000


@pytest.mark.parametrize("pose", [Pose(0.0), TILTED])
def test_mmc5603_by_adafruit_s_driver_measures_once(clock: DriverClock, driver: ImportDriver, pose: Pose) -> None:
    adafruit, part = driver("adafruit_mmc56x3"), Mmc5603(setup(pose))
    sensor = adafruit.MMC5603(DriverI2c([part], clock))
    began_s, first = clock.now_s, sensor.magnetic
    assert clock.now_s - began_s >= ONE_SHOT_S
    assert first == pytest.approx(DRIVER_SCALE * true_field_ut(part), abs=1.0)  # 5 sigma
    mean_ut, noise_ut = statistics(lambda: sensor.magnetic, clock, 0.0)
    # The mean of 400 readings is good to 0.01 uT; the data sheet gives 2 mG of noise.
    assert mean_ut == pytest.approx(DRIVER_SCALE * true_field_ut(part), abs=0.05)
    assert noise_ut == pytest.approx([0.2 * DRIVER_SCALE] * 3, rel=0.15)  # 4 sigma of a deviation from 400 readings


def test_mmc5603_measures_at_the_rate_of_which_it_has_computed_the_period(
    clock: DriverClock, driver: ImportDriver
) -> None:
    adafruit, part = driver("adafruit_mmc56x3"), Mmc5603(setup())
    sensor = adafruit.MMC5603(DriverI2c([part], clock))
    sensor.continuous_mode = True
    clock.sleep(1.0)
    assert not sensor._meas_m_done  # the data rate is 0
    sensor.continuous_mode = False
    sensor.data_rate = 50
    sensor.continuous_mode = True
    readings = set()
    for _ in range(1000):
        clock.sleep(1e-3)
        readings.add(sensor.magnetic)
    assert len(readings) == pytest.approx(50 * 1.2, abs=8)  # reading takes another 0.3 ms each time
    sensor.data_rate = 10
    assert part.outputs[0].rate_hz == 50.0
    sensor.continuous_mode = True
    assert part.outputs[0].rate_hz == 10.0
    sensor.data_rate = 1000
    sensor.continuous_mode = True
    assert part.outputs[0].rate_hz == 150.0
    write(part, clock.now_s, BANDWIDTH, 3)  # the driver has no bandwidth
    assert part.outputs[0].rate_hz == 1000.0
    mean_ut, noise_ut = statistics(lambda: sensor.magnetic, clock, 1e-3)
    assert mean_ut == pytest.approx(DRIVER_SCALE * true_field_ut(part), abs=0.15)
    assert noise_ut == pytest.approx([0.2 * DRIVER_SCALE * np.sqrt(6.6 / 1.2)] * 3, rel=0.15)


def test_mmc5603_reads_twenty_bits_up_to_the_end_of_its_range(clock: DriverClock, driver: ImportDriver) -> None:
    strong = MagneticDistortion(hard_iron_ut=(2000.0, -5000.0, 5000.0))
    adafruit, part = driver("adafruit_mmc56x3"), Mmc5603(setup(Pose(0.0), distortion=strong))
    sensor = adafruit.MMC5603(DriverI2c([part], clock))
    x_ut, y_ut, z_ut = sensor.magnetic
    assert x_ut == pytest.approx(DRIVER_SCALE * (2000.0 + true_field_ut(part)[0]), abs=1.0)
    assert (y_ut, z_ut) == (-(1 << 19) * 0.00625, ((1 << 19) - 1) * 0.00625)


@pytest.mark.parametrize("degc", [-40.0, 25.0, 85.0])
def test_mmc5603_measures_the_temperature_when_asked(clock: DriverClock, driver: ImportDriver, degc: float) -> None:
    adafruit, part = driver("adafruit_mmc56x3"), Mmc5603(setup(temperature_degc=degc))
    sensor = adafruit.MMC5603(DriverI2c([part], clock))
    assert not sensor._meas_t_done
    assert sensor.temperature == pytest.approx(degc, abs=0.4)  # half a count
    assert not sensor._meas_t_done


def test_mmc5603_answers_nothing_for_20_ms_after_a_reset(clock: DriverClock, driver: ImportDriver) -> None:
    adafruit, part = driver("adafruit_mmc56x3"), Mmc5603(setup())
    sensor = adafruit.MMC5603(DriverI2c([part], clock))
    sensor._ctrl1_reg = 0x80
    clock.sleep(0.019)
    with pytest.raises(OSError, match="0x30"):
        _ = sensor._status_reg
    clock.sleep(0.001)
    assert sensor._status_reg == 0x10
