"""Checks of the earth's field at the bench: the rig's and the board's values against the World Magnetic Model."""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import date

import numpy as np
from numpy.typing import NDArray

from hiltest.boards import Board
from hiltest.doctor.board_checks import READINGS
from hiltest.doctor.check import Check, not_looked_at, ok, warning
from hiltest.errors import DeviceError
from hiltest.link.messages import Average, GetCalibration
from hiltest.link.replies import MICROTESLA_PER_COUNT, AverageReply, CalibrationReply, SensorKind, Status
from hiltest.rig import Rig

# The model's standard uncertainty is 0.14 uT and 0.2 deg, of declination 0.4, mostly from the rock below (WMM2025,
# technical report, table of the error model); rigs are written to half a microtesla. Steel in a room adds several uT.
_DECLARED_OFF_UT, _DECLARED_OFF_DEG = 1.0, 1.0
# A calibration gives the field in the part's own microtesla. The gain of a part is trimmed to some percent, and cannot
# be distinguished from the mean gain of the board's soft iron.
_MEASURED_OFF = 0.1
# Axes of magnetometer and accelerometer differ by 1 to 2 deg; an accelerometer error of 20 mg adds 1.1 deg.
_MEASURED_OFF_DEG = 3.0


@dataclass(frozen=True, slots=True)
class ModelField:
    """Field at a place: total intensity [uT], dip and declination [deg], and the model's name."""

    strength_ut: float
    dip_deg: float
    declination_deg: float
    model: str


def model_field(rig: Rig, today: date) -> ModelField | str:
    """Return the World Magnetic Model's field at the rig's place, or the reason why it is unknown."""
    place = rig.field
    if place.latitude_deg is None or place.longitude_deg is None:
        return "the rig has no place: write latitude_deg and longitude_deg under [field]"
    return field_at(place.latitude_deg, place.longitude_deg, place.altitude_m, today)


def field_at(latitude_deg: float, longitude_deg: float, altitude_m: float, day: date) -> ModelField | str:
    """Return the World Magnetic Model's field at a place on a day, or the reason why it is unknown."""
    from pygeomag import GeoMag, calculate_decimal_year

    model = GeoMag()
    try:
        result = model.calculate(
            glat=latitude_deg, glon=longitude_deg, alt=1e-3 * altitude_m, time=calculate_decimal_year(day)
        )
    except ValueError:
        begin, end = model.life_span
        return f"{model.model} is valid from {begin:.0f} to {end:.0f}, and the day is {day}: install a newer pygeomag"
    return ModelField(1e-3 * result.f, result.i, result.d, model.model)


def see_declared_field(rig: Rig, model: ModelField | str) -> Check:
    """Compare the rig's declared field with the model."""
    name, declared = "declared field", rig.field
    written = _field_in_words(declared.strength_ut, declared.dip_deg, declared.declination_deg)
    if isinstance(model, str):
        return not_looked_at(name, model)
    place = f"{model.model} {_field_in_words(model.strength_ut, model.dip_deg, model.declination_deg)}"
    finding = f"the rig has {written}; {place}"
    turned_deg = (declared.declination_deg - model.declination_deg + 180.0) % 360.0 - 180.0
    off_deg = max(abs(declared.dip_deg - model.dip_deg), abs(turned_deg))
    if abs(declared.strength_ut - model.strength_ut) <= _DECLARED_OFF_UT and off_deg <= _DECLARED_OFF_DEG:
        return ok(name, finding)
    return warning(
        name,
        finding,
        "if the field of the rig was not measured, write the model's under [field]; otherwise iron is nearby: keep "
        "steel, magnets and loudspeakers a metre away",
    )


def see_measured_field(board: Board, rig: Rig, model: ModelField | str) -> Check:
    """Compare the field that the board measures under a stored calibration with the model, or else with the rig.

    Raw readings are not compared: the hard iron in them is as large as the field.
    """
    name = "measured field"
    held = _calibration(board)
    if held is None:
        return not_looked_at(
            name,
            "the board has no calibration, and its own iron is as strong as the field: repeat this check after "
            "`hiltest calibrate` or a run, without switching the board off",
        )
    board.sensor(SensorKind.MAGNETOMETER)
    board.sensor(SensorKind.ACCELEROMETER)
    slot, calibration = held
    strength_ut, dip_deg = field_under(calibration, board.session.request(Average(READINGS)))
    if isinstance(model, str):
        expected_ut, expected_deg, whose = rig.field.strength_ut, rig.field.dip_deg, "the rig declares"
    else:
        expected_ut, expected_deg, whose = model.strength_ut, model.dip_deg, model.model
    finding = (
        f"{strength_ut:.1f} uT, dip {dip_deg:.1f} deg under the calibration in slot {slot}; {whose} "
        f"{expected_ut:.1f} uT, dip {expected_deg:.1f} deg"
    )
    near = abs(strength_ut / expected_ut - 1.0) <= _MEASURED_OFF and abs(dip_deg - expected_deg) <= _MEASURED_OFF_DEG
    return (
        ok(name, finding)
        if near
        else warning(
            name, finding, "iron is nearby: keep steel, magnets and loudspeakers a metre away, and calibrate again here"
        )
    )


def field_under(calibration: CalibrationReply, average: AverageReply) -> tuple[float, float]:
    """Return strength [uT] and dip [deg] of the field that a still board measures.

    A calibration turns the field at its place into a unit vector. The strength of that field is the mean gain of its
    matrix, the cube root of its determinant: soft iron that preserves volumes does not change it.
    """
    unit: NDArray[np.float64] = calibration.soft_iron @ (average.magnetometer.mean - calibration.hard_iron)
    gravity = average.accelerometer.mean
    length = float(np.linalg.norm(unit))
    strength_ut = MICROTESLA_PER_COUNT * length / float(np.cbrt(abs(np.linalg.det(calibration.soft_iron))))
    sine = float(unit @ gravity) / (length * float(np.linalg.norm(gravity)))
    return strength_ut, math.degrees(math.asin(min(max(sine, -1.0), 1.0)))


def _calibration(board: Board) -> tuple[int, CalibrationReply] | None:
    """Return the first calibration that the board holds; one without hard iron does not count."""
    for slot in range(board.identity.slots):
        try:
            held = board.session.request(GetCalibration(slot))
        except DeviceError as error:
            if error.status != Status.NO_CALIBRATION.name:
                raise
            continue
        if held.hard_iron.any():
            return slot, held
    return None


def _field_in_words(strength_ut: float, dip_deg: float, declination_deg: float) -> str:
    return f"{strength_ut:.1f} uT, dip {dip_deg:.1f}, declination {declination_deg:.1f} deg"
