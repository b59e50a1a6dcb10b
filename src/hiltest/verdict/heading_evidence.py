"""Evidence for the cause of a wrong heading: sensor readings at the known angles, beside the true values."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hiltest.calibration import REFERENCES, FitStatus, MagnetometerFit
from hiltest.calibration.accelerometer import AccelerometerFit
from hiltest.calibration.error_sources import ErrorSource, Source, error_sources
from hiltest.calibration.sensor_axes import SensorAxes, sensor_axes
from hiltest.orientation import DegenerateFieldError, tilt_heading
from hiltest.orientation.angles import heading_error_deg
from hiltest.run_record.run import Table

Reals = NDArray[np.float64]

# A source is the cause only if it explains at least half of the squared error.
_EXPLAINS_ENOUGH = 0.5
_UNCALIBRATED = "uncalibrated"
CALIBRATION_FILE = "calibration"
"""Name of a calibration from a file: the only one that was not fitted to points of this run."""


@dataclass(frozen=True, slots=True, eq=False)
class Held:
    """Calibrations in one slot of the board."""

    magnetometer: MagnetometerFit
    accelerometer: AccelerometerFit


@dataclass(frozen=True, slots=True, eq=False)
class HeadingEvidence:
    """Known field and gravity along the board's axes, and the readings there."""

    field: Reals
    gravity: Reals
    """Known field [uT] and gravity [g]; shape (n, 3)."""
    magnetometer: Reals
    accelerometer: Reals
    """Means [counts]; shape (n, 3)."""
    held: Mapping[str, Held]
    """Calibrations by name."""
    points: Reals
    """Points of the tumble [counts], shape (m, 3); empty if the record has none."""
    fitted: Mapping[str, int]
    """Number of these points that each calibrator received."""

    @property
    def strength_ut(self) -> float:
        """Declared strength of the field."""
        return float(np.linalg.norm(self.field[0]))

    def turned(self, degrees: float) -> HeadingEvidence:
        """Return the same evidence for a board that is turned about the vertical by some more degrees."""
        return replace(self, field=turn_field(self.field, self.gravity, degrees))

    def axes(self) -> SensorAxes:
        """Estimate the axes of both sensors."""
        calibrated = [calibrations.magnetometer for name, calibrations in self.held.items() if name != _UNCALIBRATED]
        return sensor_axes(
            self.field,
            self.gravity,
            self.magnetometer,
            self.accelerometer,
            hard_iron=calibrated[0].hard_iron if calibrated else None,
        )

    def axes_under(self, name: str) -> SensorAxes:
        """Estimate the axes of both sensors after a calibration."""
        return sensor_axes(self.field, self.gravity, *self._apply_calibration(name), hard_iron=np.zeros(3))

    def accelerometer_source(self, name: str) -> tuple[bool, ErrorSource] | None:
        """Return whether the accelerometer adds more to the heading error than the magnetometer, and its source."""
        fit = self.held[name].accelerometer
        field, gravity = self._apply_calibration(name)
        errors = self._errors_deg(gravity, field)
        with_gravity, with_field = self._errors_deg(self.gravity, field), self._errors_deg(gravity, self.field)
        if errors is None or with_gravity is None or with_field is None:
            return None
        sources = error_sources(self.gravity, fit.gravity_g(self.accelerometer))
        return _explained_fraction(errors, with_gravity) > _explained_fraction(errors, with_field), sources[0]

    def field_source(self, name: str) -> ErrorSource | None:
        """Return the source of the difference between calibrated and known field; None if none explains enough."""
        field, gravity = self._apply_calibration(name)
        best = error_sources(self.field, field, down=self.gravity)[0]
        errors, remaining = self._errors_deg(gravity, field), self._errors_deg(gravity, best.undone)
        if errors is None or remaining is None or _explained_fraction(errors, remaining) < _EXPLAINS_ENOUGH:
            return None
        return best

    def arithmetic_source(self, name: str) -> ErrorSource | None:
        """Return how a calibration differs from the float64 fit of the same points; None without such a fit."""
        calibrator, n = name.partition("@")[0], self.fitted.get(name, 0)
        if calibrator not in REFERENCES or name not in self.held or not 0 < n <= len(self.points):
            return None
        reference = REFERENCES[calibrator](self.points[:n])
        if not reference.has_fit:
            return None
        points = self.points[:n]
        return error_sources(reference.corrected(points), self.held[name].magnetometer.corrected(points))[0]

    def errors_by(self, source: ErrorSource, *, of_gravity: bool = False) -> list[float]:
        """Return the heading errors [deg] that a source alone makes at the known angles; empty if none is defined."""
        vectors = self.gravity if of_gravity else self.field
        if source.source is Source.CONSTANT_TURN:
            wrong = self.turned(float(source.size[2])).field
        else:
            length = math.sqrt(float((vectors**2).sum(axis=1).mean()))
            wrong = (vectors / length + source.shift) @ np.linalg.pinv(source.gain).T * length
        errors = self._errors_deg(wrong, self.field) if of_gravity else self._errors_deg(self.gravity, wrong)
        return [] if errors is None else [float(error) for error in errors]

    def same_as(self, name: str) -> str:
        """Return the name of another calibrator whose calibration is stored in place of this one's; may be empty."""
        own = self.held.get(name)
        of_fits = [calibrator for calibrator in self.fitted if calibrator in self.held and calibrator != name]
        if own is None or name not in self.fitted:
            return ""
        return next((of_fit for of_fit in of_fits if _equal(self.held[of_fit].magnetometer, own.magnetometer)), "")

    def is_stale(self, name: str, source: ErrorSource, most_percent: float) -> bool:
        """Return whether the iron at the known angles differs from the calibration's.

        A calibration of this run's points fits them with a residual of at most `most_percent`, and no longer does after
        the source is undone: the iron has changed since. A calibration from a file does not fit them until the source
        is undone: the iron had changed before.
        """
        n = self.fitted.get(name) or max(self.fitted.values(), default=0)
        if source.source is Source.CONSTANT_TURN or not 0 < n <= len(self.points):
            return False
        vectors = self.held[name].magnetometer.corrected(self.points[:n])
        undone = vectors @ source.gain.T - source.shift
        fits, fits_undone = _norm_rms_percent(vectors) <= most_percent, _norm_rms_percent(undone) <= most_percent
        return fits != fits_undone and fits == (name != CALIBRATION_FILE)

    def _apply_calibration(self, name: str) -> tuple[Reals, Reals]:
        held = self.held[name]
        return held.magnetometer.corrected(self.magnetometer), held.accelerometer.gravity_g(self.accelerometer)

    def _errors_deg(self, gravity: Reals, field: Reals) -> Reals | None:
        try:
            return np.array(
                [
                    heading_error_deg(tilt_heading(*measured).heading_deg, tilt_heading(*true).heading_deg)
                    for measured, true in zip(
                        zip(gravity, field, strict=True), zip(self.gravity, self.field, strict=True), strict=True
                    )
                ]
            )
        except DegenerateFieldError:
            return None


def turn_field(field: Reals, gravity: Reals, degrees: Reals | float) -> Reals:
    """Return the field, shape (n, 3), of boards that are turned about the vertical; `degrees` may have shape (n, 1)."""
    down, angle = (field * gravity).sum(axis=1, keepdims=True) * gravity, np.radians(degrees)
    north = field - down
    return np.asarray(down + np.cos(angle) * north - np.sin(angle) * np.cross(gravity, north))


def read_heading_evidence(tables: Mapping[str, Table]) -> HeadingEvidence | None:
    """Return the evidence in the tables of a run; None if they are incomplete."""
    needed = [tables.get(f"heading.{name}") for name in ("known", "means", "calibrations")]
    true_vectors, means, calibrations = needed
    if (
        true_vectors is None
        or means is None
        or calibrations is None
        or len(true_vectors.rows) != len(means.rows)
        or not true_vectors.rows
    ):
        return None
    points, results = tables.get("tumble.points"), tables.get("calibration.results")
    point_counts = (
        {} if results is None else dict(zip(results.column("calibrator"), results.column_if_any("points"), strict=True))
    )
    return HeadingEvidence(
        field=read_vectors(true_vectors, "field"),
        gravity=read_vectors(true_vectors, "gravity"),
        magnetometer=read_vectors(means, "magnetometer"),
        accelerometer=read_vectors(means, "accelerometer"),
        held={
            str(name): _read_calibrations(row)
            for name, row in zip(
                calibrations.column("calibration"), _numbers(calibrations, _calibration_columns()), strict=True
            )
        },
        points=np.zeros((0, 3)) if points is None else _numbers(points, list("xyz")),
        fitted={str(name): int(n) for name, n in point_counts.items() if isinstance(n, int | float)},
    )


def _calibration_columns() -> list[str]:
    pairs = [f"{row}{column}" for row in "xyz" for column in "xyz"]
    return [
        *(f"soft_iron_{pair}" for pair in pairs),
        *(f"hard_iron_{axis}" for axis in "xyz"),
        *(f"gain_{pair}" for pair in pairs),
        *(f"offset_{axis}" for axis in "xyz"),
    ]


def _read_calibrations(row: Reals) -> Held:
    soft_iron, hard_iron, gain, offset = np.split(row, [9, 12, 21])
    return Held(
        MagnetometerFit(FitStatus.ELLIPSOID, False, 0, soft_iron.reshape(3, 3), hard_iron),
        AccelerometerFit(gain.reshape(3, 3), offset),
    )


def read_vectors(table: Table, name: str) -> Reals:
    """Return a table's columns ``NAME_x``, ``NAME_y`` and ``NAME_z``, shape (n, 3)."""
    return _numbers(table, [f"{name}_{axis}" for axis in "xyz"])


def _numbers(table: Table, columns: list[str]) -> Reals:
    return np.array([table.column(name) for name in columns], dtype=np.float64).T


def _explained_fraction(errors: Reals, remaining: Reals) -> float:
    """Return the fraction of the squared errors that is gone."""
    before = float((errors**2).sum())
    return 1.0 - float((remaining**2).sum()) / before if before else 0.0


def _equal(one: MagnetometerFit, other: MagnetometerFit) -> bool:
    return bool((one.soft_iron == other.soft_iron).all() and (one.hard_iron == other.hard_iron).all())


def _norm_rms_percent(vectors: Reals) -> float:
    """Return the rms deviation of the lengths of vectors from their mean [%]; a common factor turns no heading."""
    lengths = np.linalg.norm(vectors, axis=1)
    mean = float(lengths.mean())
    return 100.0 * float(lengths.std()) / mean if mean else math.inf
