"""A recording in virtual time: which reading a sample is, before, between and after them, and what is said of it."""

from __future__ import annotations

import numpy as np
import pytest

from hiltest.world.recorded_motion import Playback, Resampling, Sensed, Track

TIMES_S = (2.0, 2.5, 4.0)
READINGS = ((10.0, 0.0, -1.0), (20.0, 1.0, -1.0), (-10.0, 4.0, 0.1))


def playback(resampling: Resampling = Resampling.NEAREST, length: int = 3) -> Playback:
    track = Track(np.array(TIMES_S[:length]), np.array(READINGS[:length]))
    return Playback("field.csv", {Sensed.MAGNETOMETER: track}, resampling)


@pytest.mark.parametrize("resampling", Resampling)
def test_at_its_own_times_a_sample_is_the_reading_to_the_last_bit_and_outside_the_first_or_last(
    resampling: Resampling,
) -> None:
    played = playback(resampling)
    at = [played.reading(Sensed.MAGNETOMETER, time_s) for time_s in (0.0, *TIMES_S, 99.0)]
    assert at == [READINGS[0], *READINGS, READINGS[2]]


@pytest.mark.parametrize(
    ("time_s", "nearest", "linear"),
    [
        (2.2, READINGS[0], (14.0, 0.4, -1.0)),
        (2.25, READINGS[0], (15.0, 0.5, -1.0)),  # halfway: the earlier one
        (2.26, READINGS[1], (15.2, 0.52, -1.0)),
        (3.0, READINGS[1], (10.0, 2.0, -1.0 + 1.1 / 3.0)),
    ],
)
def test_between_readings_it_is_the_nearest_or_on_the_line(
    time_s: float, nearest: tuple[float, ...], linear: tuple[float, ...]
) -> None:
    assert playback().reading(Sensed.MAGNETOMETER, time_s) == nearest
    assert playback(Resampling.LINEAR).reading(Sensed.MAGNETOMETER, time_s) == pytest.approx(linear, rel=1e-12)


@pytest.mark.parametrize("resampling", Resampling)
def test_a_single_reading_is_held_all_the_time(resampling: Resampling) -> None:
    played = playback(resampling, length=1)
    assert {played.reading(Sensed.MAGNETOMETER, time_s) for time_s in (0.0, 2.0, 5.0)} == {READINGS[0]}


def test_what_was_not_recorded_is_none_and_said() -> None:
    played = playback()
    assert played.reading(Sensed.GYROSCOPE, 2.0) is None
    assert played.remarks() == ["field.csv: no accelerometer and no gyroscope in it: simulated, at rest"]


def test_samples_beyond_the_part_are_counted_once_each_and_the_end_is_said() -> None:
    played = playback()
    for time_s in (2.0, 2.5, 2.5, 3.0):  # a part may convert the same sample again
        reading = played.reading(Sensed.MAGNETOMETER, time_s)
        assert reading is not None
        played.taken("MAG3110", reading, time_s, limit=15.0, limit_words="15 uT")
    assert played.remarks()[1:] == ["field.csv: 2 samples of the MAG3110 were beyond 15 uT and are cut there"]
    played.taken("MAG3110", READINGS[2], 4.25, limit=15.0, limit_words="15 uT")
    (remark,) = played.remarks()[2:]
    assert "over at 4.000 s of virtual time; its last readings are held since, 0.250 s so far" in remark
