"""The earth's field at the bench: what the rig declares and the board measures beside the World Magnetic Model."""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import date

import numpy as np
from numpy.typing import NDArray

from hiltest.boards import Board
from hiltest.doctor.board import READINGS
from hiltest.doctor.check import Check, not_looked_at, ok, warning
from hiltest.errors import DeviceError
from hiltest.link.messages import Average, GetCalibration
from hiltest.link.replies import MICROTESLA_PER_COUNT, AverageReply, CalibrationReply, SensorKind, Status
from hiltest.rig import Rig

# The model's standard uncertainty is 0.14 uT and 0.2 deg, of declination 0.4, most of it the rock below (WMM2025,
# technical report, table of the error model); rigs are written to half a microtesla. Steel in a room makes several.
_DECLARED_OFF_UT, _DECLARED_OFF_DEG = 1.0, 1.0
# A calibration knows the field in the part's own microtesla. The gain of a part is trimmed to some percent, and what
# the board's soft iron adds to it all round cannot be told apart from it.
_MEASURED_OFF = 0.1
# Between axes of magnetometer and accelerometer 1 to 2, and 20 mg that the latter may be off 1.1.
_MEASURED_OFF_DEG = 3.0


@dataclass(frozen=True, slots=True)
class ModelField:
    """Field at a place: total intensity [uT], dip and declination [deg], and the model's name."""

    strength_ut: float
    dip_deg: float
    declination_deg: float
    model: str


def model_field(rig: Rig, today: date) -> ModelField | str:
    """Return the World Magnetic Model's field at the rig's place, or why it is unknown."""
    from pygeomag import GeoMag, calculate_decimal_year

    place = rig.field
    if place.latitude_deg is None or place.longitude_deg is None:
        return "the rig does not say where it is: write latitude_deg and longitude_deg under [field]"
    model = GeoMag()
    try:
        found = model.calculate(
            glat=place.latitude_deg, glon=place.longitude_deg, alt=1e-3 * place.altitude_m,
            time=calculate_decimal_year(today),
        )
    except ValueError:
        begin, end = model.life_span
        return f"{model.model} is of {begin:.0f} to {end:.0f}, and today is {today}: a later pygeomag has the next"
    return ModelField(1e-3 * found.f, found.i, found.d, model.model)


def see_declared_field(rig: Rig, model: ModelField | str) -> Check:
    """Compare what the rig declares with the model."""
    name, declared = "declared field", rig.field
    written = _written(declared.strength_ut, declared.dip_deg, declared.declination_deg)
    if isinstance(model, str):
        return not_looked_at(name, model)
    place = f"{model.model} {_written(model.strength_ut, model.dip_deg, model.declination_deg)}"
    found = f"the rig has {written}; {place}"
    turned_deg = (declared.declination_deg - model.declination_deg + 180.0) % 360.0 - 180.0
    off_deg = max(abs(declared.dip_deg - model.dip_deg), abs(turned_deg))
    if abs(declared.strength_ut - model.strength_ut) <= _DECLARED_OFF_UT and off_deg <= _DECLARED_OFF_DEG:
        return ok(name, found)
    return warning(
        name, found, "if it was not measured there, write the model's under [field]; if it was, iron is nearby: keep "
        "steel, magnets and loudspeakers a metre away",
    )


def see_measured_field(board: Board, rig: Rig, model: ModelField | str) -> Check:
    """Compare what the board measures under a calibration that it holds with the model, or with what the rig declares.

    Raw readings are not compared: the hard iron in them is as large as the field.
    """
    name = "measured field"
    held = _calibration(board)
    if held is None:
        return not_looked_at(
            name, "the board holds no calibration, and its own iron is as strong as the field: after `hiltest "
            "calibrate` or a run, while it stays on, this can be told",
        )
    board.sensor(SensorKind.MAGNETOMETER)
    board.sensor(SensorKind.ACCELEROMETER)
    slot, calibration = held
    strength_ut, dip_deg = field_under(calibration, board.session.request(Average(READINGS)))
    if isinstance(model, str):
        expected_ut, expected_deg, whose = rig.field.strength_ut, rig.field.dip_deg, "the rig declares"
    else:
        expected_ut, expected_deg, whose = model.strength_ut, model.dip_deg, model.model
    found = (
        f"{strength_ut:.1f} uT, dip {dip_deg:.1f} deg under the calibration in slot {slot}; {whose} "
        f"{expected_ut:.1f} uT, dip {expected_deg:.1f} deg"
    )
    near = abs(strength_ut / expected_ut - 1.0) <= _MEASURED_OFF and abs(dip_deg - expected_deg) <= _MEASURED_OFF_DEG
    return ok(name, found) if near else warning(
        name, found, "iron is nearby: keep steel, magnets and loudspeakers a metre away, and calibrate again here"
    )


def field_under(calibration: CalibrationReply, average: AverageReply) -> tuple[float, float]:
    """Return strength [uT] and dip [deg] of the field that a still board measures.

    A calibration makes the field where it was made a unit vector. How strong that was is the mean gain of its matrix,
    the cube root of its determinant: soft iron that leaves volumes alone does not change it.
    """
    unit: NDArray[np.float64] = calibration.soft_iron @ (average.magnetometer.mean - calibration.hard_iron)
    gravity = average.accelerometer.mean
    length = float(np.linalg.norm(unit))
    strength_ut = MICROTESLA_PER_COUNT * length / float(np.cbrt(abs(np.linalg.det(calibration.soft_iron))))
    sine = float(unit @ gravity) / (length * float(np.linalg.norm(gravity)))
    return strength_ut, math.degrees(math.asin(min(max(sine, -1.0), 1.0)))


def _calibration(board: Board) -> tuple[int, CalibrationReply] | None:
    """Return the first calibration that the board holds; one without hard iron is none."""
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


def _written(strength_ut: float, dip_deg: float, declination_deg: float) -> str:
    return f"{strength_ut:.1f} uT, dip {dip_deg:.1f}, declination {declination_deg:.1f} deg"
