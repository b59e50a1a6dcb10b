"""What a board that answers is like: firmware, sensors on its buses, clock, cycle counter, noise at rest."""

from __future__ import annotations

import json
import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from hiltest.boards import Board, default_firmware
from hiltest.boards.real import is_silicon
from hiltest.doctor.check import Check, failed, not_looked_at, ok, warning
from hiltest.link.messages import Average, ClearPoints, Read, TimeRange
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
from hiltest.sensors.fxos8700cq import Fxos8700cqNoise

# Samples of a noise: its deviation is then known to 5 % over three axes, and the largest allowed ratio is 2.
READINGS = 64
_REST_S = 2.0
_CLOCK_S = 2.0
# An untrimmed oscillator on the chip is off by some percent, a crystal by 0.01. What asking takes is measured, and does
# not count.
_CLOCK_OFF_MOST = 0.01
_TIMED_POINTS = 100
# Of rounding to whole counts; the accelerometer's 14 bits come in steps of four.
_ROUNDING_COUNTS, _ACCELEROMETER_STEP = math.sqrt(1.0 / 12.0), 4.0


def see_identity(board: Board, _rig: Rig) -> Check:
    """Look which firmware answers."""
    identity = board.identity
    chip = identity.unique_id.hex() if is_silicon(identity.unique_id) else "a virtual board"
    found = f"{board.firmware_line} on {chip}"
    shipped = json.loads(default_firmware().with_name("manifest.json").read_text(encoding="utf-8"))["build_id"]
    if identity.build_id != shipped:
        return warning(
            "identity", f"{found}; this hiltest comes with build {shipped}",
            f"flash {default_firmware()}, unless it is a build of your own",
        )
    return ok("identity", found)


def see_protocol(board: Board, _rig: Rig) -> Check:
    """Say which version of the protocol is spoken; another one than hiltest's ends the session before."""
    return ok("protocol", f"version {board.session.protocol_version}")


def see_sensors(board: Board, rig: Rig) -> Check:
    """Look whether the sensors that the rig names answer on their buses."""
    found, absent = [], []
    for kind, wanted in board.declared.wanted.items():
        each = next(sensor for sensor in board.sensors if sensor.kind is kind and sensor.name == wanted)
        place = f"{wanted} (I2C{each.bus} 0x{each.address:02X})"
        if each.present:
            found.append(place)
        else:
            seen = f"WHO_AM_I 0x{each.seen_who_am_i:02X}, not 0x{each.expected_who_am_i:02X}"
            absent.append(f"{place}: {seen if each.seen_who_am_i else 'no answer'}")
    if absent:
        others = [each.name for each in board.sensors if each.present]
        return failed(
            "sensors", "; ".join(absent), "put the shield FRDM-FXS-MULTI-B on, with its jumpers as shipped; or name "
            f"sensors that answer under [sensors] in the rig: {', '.join(others) or 'none does'}",
        )
    if not found:
        found = [each.name for each in board.sensors if each.present]
    return ok("sensors", ", ".join(found)) if found else failed(
        "sensors", "none answers on either bus", "put the shield FRDM-FXS-MULTI-B on, with its jumpers as shipped"
    )


def see_clock(board: Board, _rig: Rig) -> Check:
    """Compare the board's clock with the host's; a virtual board's with that of its world."""
    core = f"core at {board.core_clock_hz / 1e6:g} MHz"
    sensor = next((each for each in board.sensors if each.present), None)
    if sensor is None:
        return not_looked_at("clock", f"{core}, it says; its time comes with samples, and no sensor answers")

    def read() -> tuple[float, float, float]:
        """Return when a sample was asked for, its time by the board, and when it was there [s]."""
        asked_s = board.now_s()
        time_us = int(board.session.request(Read(sensor.sensor_id, 1)).time_us[0])
        return asked_s, 1e-6 * time_us, board.now_s()

    for _ in range(2):  # a served board that was late catches up, once; an oscillator is off each time
        first = read()
        board.sleep(_CLOCK_S)
        last = read()
        board_s = last[1] - first[1]
        least_s, most_s = last[0] - first[2], last[2] - first[0]
        host_s = min(max(board_s, least_s), most_s)
        is_off = abs(board_s - host_s) > _CLOCK_OFF_MOST * host_s
        if not is_off:
            break
    found = f"{core}; {board_s:.3f} s of its time in {least_s:.3f} to {most_s:.3f} s of the host's"
    if is_off:
        remedy = (
            "times and angles of the gyroscope are off by as much: does the firmware run from the crystal, and the "
            "core at what it says?" if is_silicon(board.identity.unique_id)
            else "the machine that serves it is too busy to keep pace: end what else runs on it"
        )  # fmt: skip
        return warning("clock", found, remedy)
    return ok("clock", found)


def see_cycle_counter(board: Board, _rig: Rig) -> Check:
    """Let the board count the same work twice, over points of the host: those that it held are gone."""
    name = "cycle counter"
    remedy = "cycles are not measured on this board, and limits of cycles end a run as not evaluated; the rest is"
    if board.identity.cycle_source is CycleSource.NONE:
        return warning(name, "the core has none, as under an emulator without it", remedy)
    board.session.request(ClearPoints())
    upload_points(board, golden_points(_TIMED_POINTS))
    costs = [board.session.request(TimeRange(_TIMED_POINTS)) for _ in range(2)]
    board.session.request(ClearPoints())
    counted = [each.cycles if each else 0 for each in costs]
    if not all(counted):
        return warning(name, "it stands still", remedy)
    if counted[0] != counted[1]:
        return warning(
            name, f"the same work takes {counted[0]} cycles, then {counted[1]}",
            "interrupts or a debugger disturb it: detach the debugger, and reset the board",
        )
    return ok(name, f"{board.cycle_model}: {counted[0]} cycles for the same work, twice")


def see_magnetometer_noise(board: Board, rig: Rig) -> Check:
    """Compare the magnetometer's noise at rest with what the rig has from the data sheet."""
    board.sensor(SensorKind.MAGNETOMETER)
    spread = board.session.request(Average(READINGS)).magnetometer.spread
    return _noise("magnetometer", spread, MICROTESLA_PER_COUNT, rig.sensors.magnetometer_noise_ut, "uT")


def see_accelerometer_noise(board: Board, _rig: Rig) -> Check:
    """Compare the accelerometer's noise at rest with the data sheet of FXOS8700CQ, which every board has."""
    board.sensor(SensorKind.ACCELEROMETER)
    spread = board.session.request(Average(READINGS)).accelerometer.spread
    declared_mg = 1e3 * Fxos8700cqNoise().accelerometer_g(SAMPLE_RATE_HZ)
    return _noise("accelerometer", spread, 1e3 * G_PER_COUNT, declared_mg, "mg", step=_ACCELEROMETER_STEP)


def see_gyroscope_noise(board: Board, _rig: Rig) -> Check:
    """Compare the gyroscope's noise at rest with what the rig has from the data sheet."""
    board.sensor(SensorKind.GYROSCOPE)
    declared_dps = noise_counts(board) * DPS_PER_COUNT
    try:
        rest = rest_gyroscope(board, seconds=_REST_S)
    except BoardMovedError as error:
        found, _, remedy = str(error).partition(". ")
        return warning("gyroscope noise", found, remedy)
    return _noise("gyroscope", rest.rate.spread, DPS_PER_COUNT, declared_dps, "deg/s")


def _noise(
    sensor: str, spread: NDArray[np.float64] | None, scale: float, declared: float, unit: str, *, step: float = 1.0
) -> Check:
    """Judge the spread of each axis [counts]: by its rms, and by an axis that does not change at all."""
    name = f"{sensor} noise"
    assert spread is not None  # more than one reading
    still = [axis for axis, value in zip("xyz", spread, strict=True) if value == 0.0]
    measured = scale * float(np.sqrt((spread**2).mean()))
    expected = math.hypot(declared, scale * step * _ROUNDING_COUNTS)
    found = f"{measured:.3g} {unit} rms at rest; data sheet {expected:.3g}"
    if still and expected > scale * step:
        return failed(
            name, f"axis {' and '.join(still)} gives the same reading {READINGS} times and more",
            "switch the board off and on: a sensor that hangs gives its last reading for ever",
        )
    if measured > MOST_NOISE_RATIO * expected:
        return warning(
            name, found, "let the board lie still, away from motors, mains leads and power supplies; or the rig "
            "declares less noise than this part has",
        )
    if measured < expected / MOST_NOISE_RATIO:
        return warning(name, found, "the rig declares more noise than this part has: correct it under [sensors]")
    return ok(name, found)


BOARD_CHECKS: dict[str, Callable[[Board, Rig], Check]] = {
    "protocol": see_protocol, "identity": see_identity, "sensors": see_sensors, "clock": see_clock,
    "cycle counter": see_cycle_counter, "magnetometer noise": see_magnetometer_noise,
    "accelerometer noise": see_accelerometer_noise, "gyroscope noise": see_gyroscope_noise,
}  # fmt: skip
