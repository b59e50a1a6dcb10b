"""Evidence of why a heading is wrong: what the sensors read at the known angles, beside what there was to read."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hiltest.angles import heading_error_deg
from hiltest.calibration import REFERENCES, FitStatus, MagnetometerFit
from hiltest.calibration.accelerometer import AccelerometerFit
from hiltest.calibration.error_sources import ErrorSource, Source, error_sources
from hiltest.calibration.sensor_axes import SensorAxes, sensor_axes
from hiltest.orientation import DegenerateFieldError, tilt_heading
from hiltest.record.run import Table

Reals = NDArray[np.float64]

# A source that explains less than half of the squared error is not its cause.
_EXPLAINS_ENOUGH = 0.5
_UNCALIBRATED = "uncalibrated"
CALIBRATION_FILE = "calibration"
"""Name of the calibration that a file brought: the only one that is not of this run's points."""


@dataclass(frozen=True, slots=True, eq=False)
class Held:
    """Calibrations in one slot of the board."""

    magnetometer: MagnetometerFit
    accelerometer: AccelerometerFit


@dataclass(frozen=True, slots=True, eq=False)
class HeadingEvidence:
    """Known field and gravity along the board's axes, and what was read and answered there."""

    field: Reals
    gravity: Reals
    """Shape (n, 3). Known [uT], [g]."""
    magnetometer: Reals
    accelerometer: Reals
    """Shape (n, 3). Means [counts]."""
    held: Mapping[str, Held]
    """Calibrations by name."""
    points: Reals
    """Shape (m, 3). Of the tumble [counts]; empty where the record has none."""
    fitted: Mapping[str, int]
    """How many of these each calibrator was given."""

    @property
    def strength_ut(self) -> float:
        """Declared strength of the field."""
        return float(np.linalg.norm(self.field[0]))

    def turned(self, degrees: float) -> HeadingEvidence:
        """Return the same evidence of a board that is turned about the vertical by some degrees more."""
        along = (self.field * self.gravity).sum(axis=1, keepdims=True) * self.gravity
        flat, angle = self.field - along, math.radians(degrees)
        field = along + math.cos(angle) * flat - math.sin(angle) * np.cross(self.gravity, flat)
        return replace(self, field=field)

    def axes(self) -> SensorAxes:
        """Estimate the axes of both sensors."""
        calibrated = [each.magnetometer for name, each in self.held.items() if name != _UNCALIBRATED]
        return sensor_axes(
            self.field, self.gravity, self.magnetometer, self.accelerometer,
            hard_iron=calibrated[0].hard_iron if calibrated else None,
        )

    def axes_under(self, name: str) -> SensorAxes:
        """Estimate the axes of what a calibration makes of both sensors."""
        return sensor_axes(self.field, self.gravity, *self._calibrated(name), hard_iron=np.zeros(3))

    def accelerometer_source(self, name: str) -> tuple[bool, ErrorSource] | None:
        """Return whether the accelerometer makes more of the heading error than the magnetometer, and its source."""
        fit = self.held[name].accelerometer
        field, gravity = self._calibrated(name)
        errors = self._errors_deg(gravity, field)
        with_gravity, with_field = self._errors_deg(self.gravity, field), self._errors_deg(gravity, self.field)
        if errors is None or with_gravity is None or with_field is None:
            return None
        sources = error_sources(self.gravity, fit.gravity_g(self.accelerometer))
        return _explained(errors, with_gravity) > _explained(errors, with_field), sources[0]

    def field_source(self, name: str) -> ErrorSource | None:
        """Return what makes the calibrated field another than the known one; None where no source explains enough."""
        field, gravity = self._calibrated(name)
        best = error_sources(self.field, field, down=self.gravity)[0]
        errors, left = self._errors_deg(gravity, field), self._errors_deg(gravity, best.undone)
        if errors is None or left is None or _explained(errors, left) < _EXPLAINS_ENOUGH:
            return None
        return best

    def arithmetic_source(self, name: str) -> ErrorSource | None:
        """Return how a calibration differs from the float64 fit of the same points; None where there is none."""
        calibrator, n = name.partition("@")[0], self.fitted.get(name, 0)
        if calibrator not in REFERENCES or name not in self.held or not 0 < n <= len(self.points):
            return None
        reference = REFERENCES[calibrator](self.points[:n])
        if not reference.has_fit:
            return None
        points = self.points[:n]
        return error_sources(reference.corrected(points), self.held[name].magnetometer.corrected(points))[0]

    def same_as(self, name: str) -> str:
        """Return the name of another calibrator whose calibration is held in place of its own; empty where none is."""
        own = self.held.get(name)
        of_fits = [each for each in self.fitted if each in self.held and each != name]
        if own is None or name not in self.fitted:
            return ""
        return next((of_fit for of_fit in of_fits if _equal(self.held[of_fit].magnetometer, own.magnetometer)), "")

    def is_stale(self, name: str, source: ErrorSource, most_percent: float) -> bool:
        """Say whether the iron of the known angles is another than the calibration's.

        A calibration of this run's points fits them, with a residual of `most_percent` at most, and does no more once
        the source is undone: the iron has changed since. A calibration of a file does not fit them, and does once it
        is undone: the iron had changed before.
        """
        n = self.fitted.get(name) or max(self.fitted.values(), default=0)
        if source.source is Source.CONSTANT_TURN or not 0 < n <= len(self.points):
            return False
        vectors = self.held[name].magnetometer.corrected(self.points[:n])
        undone = vectors @ source.gain.T - source.shift
        fits, fits_undone = _norm_rms_percent(vectors) <= most_percent, _norm_rms_percent(undone) <= most_percent
        return fits != fits_undone and fits == (name != CALIBRATION_FILE)

    def _calibrated(self, name: str) -> tuple[Reals, Reals]:
        held = self.held[name]
        return held.magnetometer.corrected(self.magnetometer), held.accelerometer.gravity_g(self.accelerometer)

    def _errors_deg(self, gravity: Reals, field: Reals) -> Reals | None:
        try:
            return np.array([
                heading_error_deg(tilt_heading(*given).heading_deg, tilt_heading(*known).heading_deg)
                for given, known in zip(
                    zip(gravity, field, strict=True), zip(self.gravity, self.field, strict=True), strict=True
                )
            ])
        except DegenerateFieldError:
            return None


def read_heading_evidence(tables: Mapping[str, Table]) -> HeadingEvidence | None:
    """Return the evidence that the tables of a run hold, None where they do not."""
    needed = [tables.get(f"heading.{name}") for name in ("known", "means", "calibrations")]
    known, means, calibrations = needed
    if known is None or means is None or calibrations is None or len(known.rows) != len(means.rows) or not known.rows:
        return None
    points, results = tables.get("tumble.points"), tables.get("calibration.results")
    given = {} if results is None else dict(
        zip(results.column("calibrator"), results.column_if_any("points"), strict=True)
    )
    return HeadingEvidence(
        field=_vectors(known, "field"), gravity=_vectors(known, "gravity"),
        magnetometer=_vectors(means, "magnetometer"), accelerometer=_vectors(means, "accelerometer"),
        held={
            str(name): _held(row) for name, row in
            zip(calibrations.column("calibration"), _numbers(calibrations, _columns_held()), strict=True)
        },
        points=np.zeros((0, 3)) if points is None else _numbers(points, list("xyz")),
        fitted={str(name): int(n) for name, n in given.items() if isinstance(n, int | float)},
    )  # fmt: skip


def _columns_held() -> list[str]:
    pairs = [f"{row}{column}" for row in "xyz" for column in "xyz"]
    return [
        *(f"soft_iron_{pair}" for pair in pairs), *(f"hard_iron_{each}" for each in "xyz"),
        *(f"gain_{pair}" for pair in pairs), *(f"offset_{each}" for each in "xyz"),
    ]


def _held(row: Reals) -> Held:
    soft_iron, hard_iron, gain, offset = np.split(row, [9, 12, 21])
    return Held(
        MagnetometerFit(FitStatus.ELLIPSOID, False, 0, soft_iron.reshape(3, 3), hard_iron),
        AccelerometerFit(gain.reshape(3, 3), offset),
    )


def _vectors(table: Table, name: str) -> Reals:
    return _numbers(table, [f"{name}_{axis}" for axis in "xyz"])


def _numbers(table: Table, columns: list[str]) -> Reals:
    return np.array([table.column(name) for name in columns], dtype=np.float64).T


def _explained(errors: Reals, left: Reals) -> float:
    """Return the part of the squared errors that is gone."""
    before = float((errors**2).sum())
    return 1.0 - float((left**2).sum()) / before if before else 0.0


def _equal(one: MagnetometerFit, other: MagnetometerFit) -> bool:
    return bool((one.soft_iron == other.soft_iron).all() and (one.hard_iron == other.hard_iron).all())


def _norm_rms_percent(vectors: Reals) -> float:
    """Return how far the lengths of vectors are from their mean [%], rms: a common factor turns no heading."""
    lengths = np.linalg.norm(vectors, axis=1)
    mean = float(lengths.mean())
    return 100.0 * float(lengths.std()) / mean if mean else math.inf
