"""Result of a fit of recorded samples: of every calibrator, with the samples."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

from hiltest.calibration.acceptance import Acceptance, Reason
from hiltest.calibration.shapes import Shape
from hiltest.calibration.solid_angle import Hole
from hiltest.log_fitting.span import FieldChange
from hiltest.measurement import CycleRange

Triple: TypeAlias = tuple[float, float, float]
Matrix: TypeAlias = tuple[Triple, Triple, Triple]

_ORDER = list(Acceptance)
#: Status of the readings without calibration.
AS_READ = "none"


@dataclass(frozen=True, slots=True)
class Turn:
    """A turn in a plane."""

    axis: str
    """Axis of the sensor nearest to the axis of the turn, ``x``, ``y`` or ``z``."""
    tilt_deg: float
    """Angle between that axis and the axis of the turn."""
    arc_deg: float
    """A full turn minus the largest gap."""


@dataclass(frozen=True, slots=True)
class GravityFigures:
    """Figures of one calibration against gravity, and the accelerometer calibration that belongs to it."""

    held_out_dip_deg: float | None = None
    """Difference in dip between held-out pairs and the fitted ones, rms; None if parts of the log determine no
    calibration."""
    dip_deg: float | None = None
    """Angle between the field and the horizontal plane, 0 to 90; None without a calibration, like all fields below."""
    rotation_deg: float | None = None
    """Angle of the rotation in soft_iron."""
    accelerometer_offset: Triple | None = None
    """Offset in the unit of the accelerometer's readings."""
    accelerometer_gain: Matrix | None = None
    """Symmetric: ``gravity = gain @ (reading - offset)`` has length 1, in the sign of the readings."""


@dataclass(frozen=True, slots=True)
class AgainstGravity:
    """Use of a log's accelerometer as a reference for the magnetometer's axes."""

    n_pairs: int
    """Number of fitted rows with readings of both sensors."""
    unit: str
    """Unit of the accelerometer's readings."""
    gravity_spread_percent: float | None = None
    """Standard deviation of the length of its calibrated readings; None if they make no ellipsoid."""
    dip_spread_deg: float | None = None
    largest_dip_spread_deg: float | None = None
    """Standard deviation of the dip in these pairs, and its limit."""
    norms_held_out_dip_deg: float | None = None
    """`GravityFigures.held_out_dip_deg` for separate ellipsoids of the two sensors."""
    axes: str = ""
    """Likely mistake in the magnetometer's axes; empty without one."""
    unused: str = ""
    """Reason why gravity was not used; empty if it was."""

    @property
    def gain_unit(self) -> str:
        """Unit of the accelerometer's gain."""
        return f"1/({self.unit})" if "/" in self.unit else f"1/{self.unit}"


@dataclass(frozen=True, slots=True)
class FollowedColumn:
    """A column of the log that the hard iron follows."""

    name: str
    unit: str
    """Its header, and its unit; empty if unknown."""
    vector: Triple
    """Hard iron per unit of the column, in the unit of the samples."""
    error: float
    """Standard deviation of the vector: the root of the sum over its components."""
    reference: float
    """Value at which `CalibratorFit.hard_iron` is stated."""


@dataclass(frozen=True, slots=True)
class Following:
    """Iron that follows columns of the log; the calibrators get readings without it."""

    columns: tuple[FollowedColumn, ...]
    before_percent: float
    after_percent: float
    """Residual without and with it."""
    explained_percent: float
    """Part of the squared residual that it explains."""


@dataclass(frozen=True, slots=True)
class CalibratorFit:
    """Result of one calibrator, or shape; lengths are in the unit of the samples."""

    name: str
    status: str
    """Result of the fit, in words."""
    verdict: Acceptance
    reasons: tuple[Reason, ...]
    """Reasons why it is not good."""
    n_used: int
    """Number of points of the calibrator. The figures are over all samples."""
    hard_iron: Triple | None = None
    """Hard iron; None without a calibration, like all fields below."""
    soft_iron: Matrix | None = None
    """Determinant 1: ``corrected = soft_iron @ (reading - hard_iron)``, in the unit of the samples. Symmetric, unless
    `gravity` is present: then it converts readings to the axes of the accelerometer."""
    radius: float | None = None
    """Length of the corrected readings."""
    residual_percent: float | None = None
    """rms deviation of the corrected lengths from the radius."""
    coverage: float | None = None
    """Part of the sphere that the corrected points cover, 0 to 1; None for a turn."""
    axis_ratio: float | None = None
    """Longest over shortest axis of the ellipsoid."""
    direction_error_deg: float | None = None
    direction_spread_deg: float | None = None
    direction_bias_deg: float | None = None
    """Direction errors predicted from the points' noise, rms over the sphere, or over a turn; the first combines the
    others. They are None above 30 deg, where the prediction is not valid. If `error_is_measured`, the prediction for
    the ellipsoid of the samples, with the difference as a bias."""
    direction_difference_deg: float | None = None
    """Measured rms angle over the sphere to the directions of the unbiased ellipsoid (`corrected`, in float64) of all
    samples; None without one."""
    error_is_measured: bool = False
    """True if that difference is larger than the predicted error."""
    shape: Shape | None = None
    """Fitted shape; None for a calibrator."""
    turn: Turn | None = None
    """Turn in a plane; None for an ellipsoid or a part of a sphere."""
    host_difference_deg: float | None = None
    """rms angle over the sphere between a board's calibration and the float64 reference's from all samples."""
    iterations: int = 0
    """Sweeps of the firmware's solver; 0 for a closed form."""
    cycles: int | None = None
    """Core cycles of the run; None if they are not counted."""
    cycle_band: CycleRange | None = None
    """Uncertainty range of the cycles; None if unknown."""
    gravity: GravityFigures | None = None
    """Figures of a calibration against gravity, on the host."""

    @property
    def verdict_text(self) -> str:
        """Verdict, or a dash for readings as read that no calibration shows the error of."""
        return "-" if self.status == AS_READ and self.direction_error_deg is None else self.verdict


@dataclass(frozen=True, slots=True)
class FirmwareUsed:
    """Firmware that ran, and the scale of its samples."""

    name: str
    version: str
    build_id: str
    sha256: str | None
    """Digest of the ELF file."""
    cycle_model: str
    """Cycle model."""
    count_step: float
    """Size of one count, in the unit of the samples."""
    count_origin: Triple
    """Reading that is sent as zero counts."""
    rounding_rms: float
    """rms rounding error per axis, in the unit of the samples."""


@dataclass(frozen=True, slots=True)
class SampleFit:
    """Result of every calibrator on the same samples."""

    file: str
    columns: tuple[str, ...]
    unit: str
    unit_from: str
    """``option``, ``header`` or ``assumed``."""
    n_in: int
    n_skipped: int
    n_repeated: int
    """Readings; rows without three finite numbers; readings equal to the one before."""
    robust: str
    """``tukey``: repetitions of the previous reading and outliers of the ellipsoid were omitted. ``none``: no readings
    were."""
    n_dropped: int
    """Number of outliers of the ellipsoid among the readings that repeat none."""
    dropped: tuple[tuple[int, int], ...]
    """First and last line of each run of them and their repetitions; without a file, numbers of readings from 1."""
    in_order: bool
    """True if the rows are in the order of time: false if a reading is as far from the next one as from any other."""
    at_rest: bool
    """True if the readings are a small ball of noise."""
    change: FieldChange | None
    """Step of the hard iron."""
    growth_percent: float | None
    """Growth of the field's strength from the first to the last reading; None if it is not significant."""
    condition: float
    """Condition of the samples, for any calibrator."""
    hole: Hole | None
    """Largest cap of the sphere without a sample, seen from the best calibration's centre; None without one, and
    for a turn."""
    field_ut: float | None
    """Declared strength of the field."""
    on: str
    """``virtual`` or ``host``."""
    firmware: FirmwareUsed | None
    calibrators: tuple[CalibratorFit, ...]
    notes: tuple[str, ...]
    """Notes, one sentence each."""
    as_read: CalibratorFit
    """Readings without calibration. Their direction error is the rms angle to those of the best calibration by norms
    alone; None if that is refused, or fits a turn."""
    gravity: AgainstGravity | None = None
    """None if the samples have no accelerometer, a shape is the best fit, or all are refused."""
    following: Following | None = None
    """Iron that follows columns; None if no column was named."""
    ellipsoid: CalibratorFit | None = None
    """The unbiased ellipsoid of the samples, against which errors are measured; None if all are predicted."""

    @property
    def n_left(self) -> int:
        """Number of readings that are not omitted."""
        return self.n_in - self.n_dropped - (self.n_repeated if self.robust != "none" else 0)

    @property
    def worse_than_none(self) -> list[str]:
        """Calibrators with a larger direction error than that of the readings without calibration."""
        as_read_deg = self.as_read.direction_error_deg
        if as_read_deg is None:
            return []
        return [fit.name for fit in self.calibrators if (fit.direction_error_deg or 0.0) > as_read_deg]

    @property
    def best(self) -> CalibratorFit:
        """The calibrator that `best_of` finds, or one against gravity with as good a verdict.

        It has the smallest held-out dip error, if that is smaller than with norms alone.
        """
        alone = best_of([calibrator for calibrator in self.calibrators if calibrator.gravity is None])
        norms = None if self.gravity is None else self.gravity.norms_held_out_dip_deg
        dips = {
            calibrator.gravity.held_out_dip_deg: calibrator
            for calibrator in self.calibrators
            if calibrator.gravity is not None
            and calibrator.gravity.held_out_dip_deg is not None
            and _ORDER.index(calibrator.verdict) <= _ORDER.index(alone.verdict)
        }
        least = min(dips, default=math.inf)
        return dips[least] if least < (math.inf if norms is None else norms) else alone


def best_of(fits: Sequence[CalibratorFit]) -> CalibratorFit:
    """Return the fit with the best verdict; of equal ones that with the smallest predicted direction error."""
    return min(
        fits,
        key=lambda fit: (
            _ORDER.index(fit.verdict),
            math.inf if fit.direction_error_deg is None else fit.direction_error_deg,
        ),
    )
