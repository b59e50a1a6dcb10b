"""Motions with a true attitude, in which filters are judged: a simulated one, and recordings."""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from hiltest.calibration.fit import Array
from hiltest.judge.worlds import default_poses, default_rig, draw_noise, earth_field_ut
from hiltest.orientation.motion_recording import STANDARD_GRAVITY_M_S2, MotionRecording

SIMULATED = "rig"
"""Name of the simulated motion: the poses of the default rig, one after another."""
_RATE_HZ = 100.0
_REST_S, _HOLD_S, _TURN_DPS = 6.0, 2.0, 90.0
_ACCELEROMETER_NOISE_G = 0.002


def simulated_motion(number: int = 1) -> MotionRecording:
    """Return a motion through the poses of the default rig, with its field, noise and gyroscope bias.

    The body rests at the first pose, turns to each pose at 90 deg/s about one axis, and is held there for 2 s. Sensors
    are calibrated; only the gyroscope has a bias, which is to be taken from the rest.

    Parameters
    ----------
    number
        Seed of the noise.
    """
    poses, rig = default_poses(), default_rig()
    assert rig.world is not None
    attitudes = Rotation.concatenate(
        [_attitude(poses.field_ut[k], poses.gravity[k]) for k in range(len(poses.gravity))]
    )
    times, places = [0.0], [0]
    time_s = _REST_S
    for place in range(1, len(attitudes)):
        angle = (attitudes[place - 1].inv() * attitudes[place]).magnitude()
        for end_s, at in ((time_s, place - 1), (time_s + math.degrees(angle) / _TURN_DPS, place)):
            times.append(end_s)
            places.append(at)
        time_s = times[-1] + _HOLD_S
    times.append(time_s)
    places.append(len(attitudes) - 1)
    count = int(time_s * _RATE_HZ)
    instants = np.arange(count + 1) / _RATE_HZ
    truth = Slerp(times, attitudes[places])(np.minimum(instants, times[-1]))
    rates = (truth[:-1].inv() * truth[1:]).as_rotvec() * _RATE_HZ
    truth = truth[1:]  # the rate of a sample is the mean up to it
    moves = np.linalg.norm(rates, axis=1) > math.radians(1.0)
    to_body = truth.inv()
    field = to_body.apply(earth_field_ut())
    gravity = to_body.apply([0.0, 0.0, 1.0])
    density = math.radians(rig.sensors.gyroscope_noise_mdps_per_rthz / 1000.0)
    gyroscope = (
        rates
        + np.radians(rig.world.gyroscope_bias_dps)
        + density * math.sqrt(_RATE_HZ / 2.0) * draw_noise(number, "motion gyroscope", count)
    )
    return MotionRecording(
        SIMULATED if number == 1 else f"{SIMULATED}/{number}",
        _RATE_HZ,
        gyroscope,
        -STANDARD_GRAVITY_M_S2 * (gravity + _ACCELEROMETER_NOISE_G * draw_noise(number, "motion accelerometer", count)),
        field + rig.sensors.magnetometer_noise_ut * draw_noise(number, "motion magnetometer", count),
        truth.as_quat(),
        moves,
    )


def _attitude(field_ut: Array, gravity: Array) -> Rotation:
    """Return the rotation from the body frame to NED that has these vectors."""
    east = np.cross(gravity, field_ut)
    east /= np.linalg.norm(east)
    return Rotation.from_matrix(np.stack([np.cross(east, gravity), east, gravity]))
