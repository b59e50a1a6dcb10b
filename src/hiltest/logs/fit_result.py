"""Result of a fit of recorded samples: every calibrator's, and what was fitted to."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

from hiltest.calibration.acceptance import Acceptance, Reason
from hiltest.calibration.shapes import Shape
from hiltest.calibration.solid_angle import Hole
from hiltest.logs.span import FieldChange
from hiltest.measurement import CycleRange

Triple: TypeAlias = tuple[float, float, float]
Matrix: TypeAlias = tuple[Triple, Triple, Triple]

_ORDER = list(Acceptance)


@dataclass(frozen=True, slots=True)
class Turn:
    """A turn in a plane."""

    axis: str
    """Axis of the sensor that it turned about, ``x``, ``y`` or ``z``."""
    tilt_deg: float
    """Angle between that axis and the one that it turned about."""
    arc_deg: float
    """A full turn less the largest gap."""


@dataclass(frozen=True, slots=True)
class GravityFigures:
    """What gravity says of one calibration, and the accelerometer's calibration that belongs to it."""

    held_out_dip_deg: float | None = None
    """How far the dip of pairs that the fit has not seen is from that of those it has, rms; None where parts of the
    log determine no calibration."""
    dip_deg: float | None = None
    """Angle of the field to the plane across gravity, 0 to 90; None without a calibration, as everything behind it."""
    rotation_deg: float | None = None
    """Angle of the rotation in soft_iron."""
    accelerometer_offset: Triple | None = None
    """In the unit of the accelerometer's readings."""
    accelerometer_gain: Matrix | None = None
    """Symmetric: ``gravity = gain @ (reading - offset)`` has length 1, in the sign of the readings."""


@dataclass(frozen=True, slots=True)
class AgainstGravity:
    """Whether the accelerometer of a log shows how the magnetometer's axes lie."""

    n_pairs: int
    """Rows with readings of both that are fitted."""
    unit: str
    """Of the accelerometer's readings."""
    gravity_spread_percent: float | None = None
    """Standard deviation of the length of its calibrated readings; None where they make no ellipsoid."""
    dip_spread_deg: float | None = None
    largest_dip_spread_deg: float | None = None
    """Standard deviation of the dip in these pairs, and what is allowed of it."""
    norms_held_out_dip_deg: float | None = None
    """As `GravityFigures.held_out_dip_deg`, of ellipsoids that each sensor got for itself."""
    axes: str = ""
    """What seems wrong with the magnetometer's axes; empty where nothing is."""
    unused: str = ""
    """Why nothing was calibrated against gravity; empty where something was."""

    @property
    def gain_unit(self) -> str:
        """Unit of the accelerometer's gain."""
        return f"1/({self.unit})" if "/" in self.unit else f"1/{self.unit}"


@dataclass(frozen=True, slots=True)
class CalibratorFit:
    """Result of one calibrator, or shape; lengths are in the unit of the samples."""

    name: str
    status: str
    """How the fit ended, in words."""
    verdict: Acceptance
    reasons: tuple[Reason, ...]
    """Why it is not good."""
    n_used: int
    """Points that the calibrator got. The figures are over all samples."""
    hard_iron: Triple | None = None
    """None without a calibration, as everything behind it."""
    soft_iron: Matrix | None = None
    """Determinant 1: ``corrected = soft_iron @ (reading - hard_iron)``, in the unit of the samples. Symmetric,
    unless `gravity` is there: then it takes readings to the axes of the accelerometer."""
    radius: float | None = None
    """Length of the corrected readings."""
    residual_percent: float | None = None
    """rms of the corrected lengths about the radius."""
    coverage: float | None = None
    """Part of the sphere that the corrected points cover, 0 to 1; None for a turn."""
    axis_ratio: float | None = None
    """Longest over shortest axis of the ellipsoid."""
    direction_error_deg: float | None = None
    direction_spread_deg: float | None = None
    direction_bias_deg: float | None = None
    """Predicted from the points' own noise, rms over the sphere, or over a turn; the first is both others together."""
    shape: Shape | None = None
    """None for a calibrator's."""
    turn: Turn | None = None
    """What samples in a plane show; None for an ellipsoid and what is part of a sphere."""
    host_difference_deg: float | None = None
    """Angle, rms over the sphere, between a board's calibration and that of the float64 reference from all samples."""
    iterations: int = 0
    """Sweeps of the firmware's solver, 0 for a closed form."""
    cycles: int | None = None
    """Core cycles of the run; None where they are not counted."""
    cycle_band: CycleRange | None = None
    """Uncertainty range of the cycles; None where it is unknown."""
    gravity: GravityFigures | None = None
    """Of a calibration against gravity, on the host."""


@dataclass(frozen=True, slots=True)
class FirmwareUsed:
    """Firmware that ran, and the scale of the samples that it was given."""

    name: str
    version: str
    build_id: str
    sha256: str | None
    """Digest of the ELF file."""
    cycle_model: str
    """What the cycles mean."""
    count_step: float
    """What one count stands for, in the unit of the samples."""
    count_origin: Triple
    """The reading that is sent as zero counts."""
    rounding_rms: float
    """What rounding to whole counts moved a reading by, per axis, in the unit of the samples."""


@dataclass(frozen=True, slots=True)
class SampleFit:
    """Result of every calibrator on the same samples."""

    file: str
    columns: tuple[str, str, str]
    unit: str
    unit_from: str
    """``option``, ``header`` or ``assumed``."""
    n_in: int
    n_skipped: int
    n_repeated: int
    """Readings; rows without three finite numbers; readings equal to the one before and not dropped."""
    robust: str
    """``tukey``: what repeats the reading before it, and what is no part of the ellipsoid, was left out. ``none``:
    nothing was."""
    n_dropped: int
    """Readings that are no part of the ellipsoid."""
    dropped: tuple[tuple[int, int], ...]
    """First and last line of each run of them; numbers from 1 of readings that are from no file."""
    in_order: bool
    """False where a reading is as far from the next one as from any other: the order of the rows carries no time."""
    change: FieldChange | None
    """Where the hard iron changed by a step."""
    condition: float
    """Condition of the samples, whatever the calibrator."""
    hole: Hole | None
    """Largest cap of the sphere without a sample, seen from the best calibration's centre; None without one, and
    for a turn."""
    field_ut: float | None
    """Strength of the field, where it was given."""
    on: str
    """``virtual`` or ``host``."""
    firmware: FirmwareUsed | None
    calibrators: tuple[CalibratorFit, ...]
    notes: tuple[str, ...]
    """What a reader should know, a sentence each."""
    gravity: AgainstGravity | None = None
    """None where the samples have no accelerometer, one calibrator or shape was asked for, or all are refused."""

    @property
    def n_left(self) -> int:
        """Readings that are not left out."""
        return self.n_in - self.n_dropped - (self.n_repeated if self.robust != "none" else 0)

    @property
    def best(self) -> CalibratorFit:
        """The calibrator that `best_of` finds, or one against gravity with as good a verdict.

        It has the smallest dip held out, if that is smaller than with norms alone.
        """
        alone = best_of([calibrator for calibrator in self.calibrators if calibrator.gravity is None])
        norms = None if self.gravity is None else self.gravity.norms_held_out_dip_deg
        dips = {
            calibrator.gravity.held_out_dip_deg: calibrator for calibrator in self.calibrators
            if calibrator.gravity is not None and calibrator.gravity.held_out_dip_deg is not None
            and _ORDER.index(calibrator.verdict) <= _ORDER.index(alone.verdict)
        }  # fmt: skip
        least = min(dips, default=math.inf)
        return dips[least] if least < (math.inf if norms is None else norms) else alone


def best_of(fits: Sequence[CalibratorFit]) -> CalibratorFit:
    """Return the fit with the best verdict; of equal ones that with the smallest predicted direction error."""
    return min(
        fits,
        key=lambda fit: (
            _ORDER.index(fit.verdict), math.inf if fit.direction_error_deg is None else fit.direction_error_deg
        ),
    )
