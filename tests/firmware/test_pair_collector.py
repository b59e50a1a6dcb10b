"""Points that the board collects while it tumbles: both sensors' readings are of the same instant."""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

from hiltest.link.messages import Points
from hiltest.link.request import decode_reply
from hiltest.orientation.angles import rotation_rows
from hiltest.world.distortion import MagneticDistortion
from hiltest.world.earth_field import EarthField
from hiltest.world.motion import TumbleMotion
from hiltest.world.sensors.fxos8700cq import Fxos8700cq, Fxos8700cqNoise
from hiltest.world.sensors.mag3110 import Mag3110
from hiltest.world.world import World

from .bench import COLLECT, Bench

Reals = NDArray[np.float64]
FIELD = EarthField(48.5, 62.0)
PERIOD_S = 1.0 / 80.0


def collected(count: int) -> tuple[Reals, Reals, float]:
    """Return field [uT] and gravity [g] without noise, and when the tumble began [s]."""
    world = World(FIELD)
    distortion = MagneticDistortion()
    parts = (
        Mag3110(world, distortion, seed=1, noise_ut=(0.0, 0.0, 0.0, 0.0)),
        Fxos8700cq(world, distortion, seed=1, noise=Fxos8700cqNoise(0.0)),
    )
    bench = Bench(i2c1=parts)
    bench.board.run_until(0.3)
    end_s = world.tumble(time_s=bench.board.time_s, duration_s=4.0)
    bench.board.run_until(world.last_move_start_s + 0.1)
    stored, *_ = struct.unpack("<H6hH", bench.ask(COLLECT, struct.pack("<HI", count, 4_000_000)))
    assert stored == count
    assert bench.board.time_s < end_s
    rows = []
    for first in range(0, count, 50):
        request = Points(first, 50)
        reply = decode_reply(request, bench.request(request.code, request.payload()).payload)
        rows.append(np.column_stack([reply.magnetometer, reply.accelerometer]))
    pairs = np.concatenate(rows)
    return pairs[:, :3] / 10.0, pairs[:, 3:] / 8192.0, world.last_move_start_s


def lags_s(fields_ut: Reals, gravities_g: Reals, began_s: float) -> Reals:
    """Return how much older gravity is than the field beside it, pair by pair."""
    tumble = TumbleMotion(began_s, began_s + 4.0)

    def body_from_ned(time_s: float) -> Reals:
        return np.array(rotation_rows(tumble.angles(time_s)[0]))

    # Sampling instants are multiples of the period since power-on, and the samples follow each other.
    starts_s = PERIOD_S * np.arange(np.ceil(began_s / PERIOD_S), np.ceil(began_s / PERIOD_S) + 60)
    first_s = min(starts_s, key=lambda time_s: np.abs(body_from_ned(time_s) @ FIELD.ned_ut - fields_ut[0]).max())
    times_s = first_s + PERIOD_S * np.arange(len(fields_ut))
    true_ut = np.array([body_from_ned(time_s) @ FIELD.ned_ut for time_s in times_s])
    assert np.abs(true_ut - fields_ut).max() <= 0.051  # half a count, and a float's rounding: the instants are right
    step_s = 1e-4
    down, later = (np.array([body_from_ned(t + dt)[:, 2] for t in times_s]) for dt in (0.0, step_s))
    rates = (later - down) / step_s
    lags: Reals = ((down - gravities_g) * rates).sum(axis=1) / (rates * rates).sum(axis=1)
    return lags


def test_gravity_is_of_the_instant_of_the_field_beside_it() -> None:
    lags = lags_s(*collected(150))
    print(f"mean {1e6 * lags.mean():.0f} us, after ten {1e6 * lags[10:].mean():.0f} +- {1e6 * lags[10:].std():.0f} us")
    # A sample taken as the part's latest is 0 and 2.5 ms old in turn here, 1.3 in the mean, which is 0.7 degrees.
    assert abs(lags.mean()) <= 1e-4
    # Bounds of a 64th of a period: 0.2 ms of the magnetometer, 0.08 of the accelerometer. A count of gravity, at the
    # slowest of the tumble's rates of some 1.5 rad/s, is worth 0.3 ms.
    assert np.median(np.abs(lags[10:])) <= 3e-4
    assert np.abs(lags).max() <= 1.6e-3  # the first look comes an eighth of a period late at most
