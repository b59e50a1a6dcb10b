"""Checks of a board that answers: firmware, sensors on its buses, clock, cycle counter, noise at rest."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from hiltest.boards import Board
from hiltest.boards.bench import packaged_build_id
from hiltest.boards.real import is_silicon
from hiltest.doctor.check import Check, failed, not_looked_at, ok, warning
from hiltest.link.messages import ClearPoints, Read, TimeRange
from hiltest.link.replies import (
    DPS_PER_COUNT,
    G_PER_COUNT,
    MICROTESLA_PER_COUNT,
    SAMPLE_RATE_HZ,
    CycleSource,
    SensorKind,
)
from hiltest.procedures.cycles import upload_points
from hiltest.procedures.golden_points import golden_points
from hiltest.procedures.rest import BoardMovedError, noise_counts, rest_gyroscope
from hiltest.rig import Rig
from hiltest.rig.rig import MOST_NOISE_RATIO
from hiltest.world.sensors.fxos8700cq import Fxos8700cqNoise

# Number of samples for a noise: its deviation is known to 5 % over three axes; the largest allowed ratio is 2.
READINGS = 64
_REST_S = 2.0
_CLOCK_S = 2.0
# An untrimmed oscillator on the chip is off by some percent, a crystal by 0.01. The time of a request is measured, and
# does not count.
_CLOCK_OFF_MOST = 0.01
_TIMED_POINTS = 100
# Standard deviation of rounding to whole counts; the accelerometer's 14 bits come in steps of four.
_ROUNDING_COUNTS, _ACCELEROMETER_STEP = math.sqrt(1.0 / 12.0), 4.0

_SHIELD = "attach the shield FRDM-FXS-MULTI-B, with its jumpers as shipped"


def see_identity(board: Board, _rig: Rig, flash: str = "hiltest flash") -> Check:
    """Check which firmware answers; `flash` is the command that flashes hiltest's firmware."""
    identity = board.identity
    is_chip = is_silicon(identity.unique_id)
    chip = identity.unique_id.hex() if is_chip else "a virtual board"
    finding = f"{board.firmware_line} on {chip}"
    shipped = packaged_build_id()
    if identity.build_id != shipped:
        return warning(
            "identity",
            f"{finding}; the firmware of this hiltest is build {shipped}",
            f"{flash if is_chip else 'end that hiltest serve, and start it from this hiltest'}, unless the firmware "
            "is yours",
        )
    return ok("identity", finding)


def see_protocol(board: Board, _rig: Rig) -> Check:
    """Report the protocol's version; a version other than hiltest's ends the session earlier."""
    return ok("protocol", f"version {board.session.protocol_version}")


def see_sensors(board: Board, rig: Rig) -> Check:
    """Check that the sensors that the rig names answer on their buses."""
    present, absent = [], []
    for kind, name in board.declared.sensor_names.items():
        sensor = next(sensor for sensor in board.sensors if sensor.kind is kind and sensor.name == name)
        place = f"{name} (I2C{sensor.bus} 0x{sensor.address:02X})"
        if sensor.present:
            present.append(place)
        else:
            mismatch = f"WHO_AM_I 0x{sensor.seen_who_am_i:02X}, not 0x{sensor.expected_who_am_i:02X}"
            absent.append(f"{place}: {mismatch if sensor.seen_who_am_i else 'no answer'}")
    if absent:
        others = [sensor.name for sensor in board.sensors if sensor.present]
        instead = f"; or name the sensors that answer under [sensors] in the rig: {', '.join(others)}" if others else ""
        return failed("sensors", "; ".join(absent), _SHIELD + instead)
    if not present:
        present = [sensor.name for sensor in board.sensors if sensor.present]
    return (
        ok("sensors", ", ".join(present)) if present else failed("sensors", "no sensor answers on either bus", _SHIELD)
    )


def see_clock(board: Board, _rig: Rig) -> Check:
    """Compare the board's clock with the host's, or a virtual board's with that of its world."""
    core = f"core at {board.core_clock_hz / 1e6:g} MHz"
    sensor = next((sensor for sensor in board.sensors if sensor.present), None)
    if sensor is None:
        return not_looked_at("clock", f"{core} by its own statement; without a sensor its clock cannot be checked")

    def read() -> tuple[float, float, float]:
        """Return the host's time of a request, the board's time of its sample, and the host's time of the reply [s]."""
        asked_s = board.now_s()
        time_us = int(board.session.request(Read(sensor.sensor_id, 1)).time_us[0])
        return asked_s, 1e-6 * time_us, board.now_s()

    for _ in range(2):  # a served board catches up once after a delay; an oscillator is off each time
        first = read()
        board.sleep(_CLOCK_S)
        last = read()
        board_s = last[1] - first[1]
        least_s, most_s = last[0] - first[2], last[2] - first[0]
        host_s = min(max(board_s, least_s), most_s)
        is_off = abs(board_s - host_s) > _CLOCK_OFF_MOST * host_s
        if not is_off:
            break
    finding = f"{core}; {board_s:.3f} s of board time in {least_s:.3f} to {most_s:.3f} s of the host's"
    if is_off:
        remedy = (
            "let the firmware run from the crystal: times and gyroscope angles have the same relative error"
            if is_silicon(board.identity.unique_id)
            else "end other programs on the machine that serves the board, which is too busy"
        )
        return warning("clock", finding, remedy)
    return ok("clock", finding)


def see_cycle_counter(board: Board, _rig: Rig) -> Check:
    """Let the board count the same work twice; its stored points are replaced and lost."""
    name = "cycle counter"
    remedy = "remove limits on cycles from the rig: this board can measure everything but cycles"
    if board.identity.cycle_source is CycleSource.NONE:
        return warning(name, "the core has no cycle counter, as in some emulators", remedy)
    board.session.request(ClearPoints())
    upload_points(board, golden_points(_TIMED_POINTS))
    costs = [board.session.request(TimeRange(_TIMED_POINTS)) for _ in range(2)]
    board.session.request(ClearPoints())
    counted = [cost.cycles if cost else 0 for cost in costs]
    if not all(counted):
        return warning(name, "the counter does not move", remedy)
    if counted[0] != counted[1]:
        return warning(
            name,
            f"the same work takes {counted[0]} cycles, then {counted[1]}",
            "detach the debugger and press the reset button: debuggers disturb the count",
        )
    return ok(name, f"{board.cycle_model}: {counted[0]} cycles for the same work, twice")


def see_magnetometer_noise(board: Board, rig: Rig) -> Check:
    """Compare the magnetometer's noise at rest with the data sheet's value in the rig."""
    spread = _spread(board, SensorKind.MAGNETOMETER)
    return _judge_noise(
        "magnetometer",
        spread,
        MICROTESLA_PER_COUNT,
        rig.sensors.magnetometer_noise_ut,
        "uT",
        key="magnetometer_noise_ut",
    )


def see_accelerometer_noise(board: Board, _rig: Rig) -> Check:
    """Compare the accelerometer's noise at rest with the data sheet of FXOS8700CQ, which every board has."""
    spread = _spread(board, SensorKind.ACCELEROMETER)
    declared_mg = 1e3 * Fxos8700cqNoise().accelerometer_g(SAMPLE_RATE_HZ)
    return _judge_noise("accelerometer", spread, 1e3 * G_PER_COUNT, declared_mg, "mg", step=_ACCELEROMETER_STEP)


def see_gyroscope_noise(board: Board, _rig: Rig) -> Check:
    """Compare the gyroscope's noise at rest with the data sheet's value in the rig."""
    board.sensor(SensorKind.GYROSCOPE)
    declared_dps = noise_counts(board) * DPS_PER_COUNT
    try:
        rest = rest_gyroscope(board, seconds=_REST_S)
    except BoardMovedError as error:
        finding, _, remedy = str(error).partition(". ")
        return warning("gyroscope noise", finding, remedy)
    return _judge_noise(
        "gyroscope", rest.rate.spread, DPS_PER_COUNT, declared_dps, "deg/s", key="gyroscope_noise_mdps_per_rthz"
    )


def _spread(board: Board, kind: SensorKind) -> NDArray[np.float64]:
    """Return the deviation of each axis [counts] of this sensor alone, since another one may be faulty."""
    counts = board.session.request(Read(board.sensor(kind).sensor_id, READINGS)).counts
    board.protocol.sample_checks.samples(kind, counts)
    return np.asarray(counts.std(axis=0, ddof=1), dtype=np.float64)


def _judge_noise(
    sensor: str,
    spread: NDArray[np.float64] | None,
    scale: float,
    declared: float,
    unit: str,
    *,
    step: float = 1.0,
    key: str = "",
) -> Check:
    """Judge the spread of each axis [counts] by its rms, and by an axis that does not change at all.

    `key` of the rig's [sensors] declares the noise; empty if only the data sheet does.
    """
    name = f"{sensor} noise"
    assert spread is not None  # more than one reading
    still = [axis for axis, value in zip("xyz", spread, strict=True) if value == 0.0]
    measured = scale * float(np.sqrt((spread**2).mean()))
    expected = math.hypot(declared, scale * step * _ROUNDING_COUNTS)
    finding = f"{measured:.3g} {unit} rms at rest; data sheet {expected:.3g}"
    if still and expected > scale * step:
        return failed(
            name,
            f"axis {' and '.join(still)} gives the same reading at least {READINGS} times",
            "switch the board off and on: a sensor that hangs repeats its last reading",
        )
    if measured > MOST_NOISE_RATIO * expected:
        still_noisy = f"; if that is the noise of the part, correct {key} under [sensors] in the rig" if key else ""
        return warning(
            name, finding, f"keep the board still, away from motors, mains leads and power supplies{still_noisy}"
        )
    if measured < expected / MOST_NOISE_RATIO:
        return warning(
            name,
            finding,
            f"correct {key} under [sensors] in the rig: this part has less noise"
            if key
            else "remove filters of readings from the firmware: the noise is below that of the part",
        )
    return ok(name, finding)


BOARD_CHECKS: dict[str, Callable[[Board, Rig], Check]] = {
    "protocol": see_protocol,
    "identity": see_identity,
    "sensors": see_sensors,
    "clock": see_clock,
    "cycle counter": see_cycle_counter,
    "magnetometer noise": see_magnetometer_noise,
    "accelerometer noise": see_accelerometer_noise,
    "gyroscope noise": see_gyroscope_noise,
}
