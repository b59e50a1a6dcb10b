"""Calibrators over recorded samples: the calibration of each, and whether it may be used."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from hiltest.boards.board import Board
from hiltest.calibration import FASTER, REFERENCES, UNBIASED, reference
from hiltest.calibration.acceptance import LARGEST_AXIS_RATIO, Acceptance, FitFigures, Reason, rate
from hiltest.calibration.conditioning import ellipsoid_condition
from hiltest.calibration.direct import fit_direct
from hiltest.calibration.direction_error import predicted_direction_error
from hiltest.calibration.fit import FitStatus, MagnetometerFit
from hiltest.calibration.quality import direction_difference_rms_deg, residual_percent
from hiltest.calibration.robust import FURTHEST, MANY_LEFT_OUT
from hiltest.calibration.solid_angle import solid_angle_covered
from hiltest.errors import ConfigError
from hiltest.logs.asked_units import asked_of_field
from hiltest.logs.counts import CountScale, evenly_on_sphere
from hiltest.logs.left_out import LeftOut, left_out
from hiltest.logs.samples import Samples
from hiltest.logs.span import FieldChange, field_change
from hiltest.measurement import CycleRange
from hiltest.procedures.calibrate import calibrate_once
from hiltest.procedures.cycles import upload_points
from hiltest.recordings.columns import MICROTESLA, Unit

Array: TypeAlias = NDArray[np.float64]
Triple: TypeAlias = tuple[float, float, float]
Matrix: TypeAlias = tuple[Triple, Triple, Triple]

ALL = "all"
# Runs of left out readings that a sentence names.
_NAMED_RUNS = 8


@dataclass(frozen=True, slots=True)
class CalibratorFit:
    """Result of one calibrator; lengths are in the unit of the samples.

    Attributes
    ----------
    name : str
    status : str
        How the fit ended, in words.
    verdict : Acceptance
    reasons : tuple of Reason
        Why it is not good.
    n_used : int
        Points that the calibrator got. The figures are over all samples.
    hard_iron : (3,) or None
        None without a calibration, as everything behind it.
    soft_iron : 3 rows of 3 or None
        Symmetric, determinant 1: ``corrected = soft_iron @ (reading - hard_iron)``, in the unit of the samples.
    radius : float or None
        Length of the corrected readings.
    residual_percent : float or None
        rms of the corrected lengths about the radius.
    coverage : float or None
        Part of the sphere that the corrected points cover, 0 to 1.
    axis_ratio : float or None
        Longest over shortest axis of the ellipsoid.
    direction_error_deg, direction_spread_deg, direction_bias_deg : float or None
        Predicted from the points' own noise, rms over the sphere; the first is both others together.
    host_difference_deg : float or None
        Angle, rms over the sphere, between a board's calibration and that of the float64 reference from all samples.
    iterations : int
        Sweeps of the firmware's solver, 0 for a closed form.
    cycles : int or None
        Core cycles of the run; None where they are not counted.
    cycle_band : CycleRange or None
        Uncertainty range of the cycles; None where it is unknown.
    """

    name: str
    status: str
    verdict: Acceptance
    reasons: tuple[Reason, ...]
    n_used: int
    hard_iron: Triple | None = None
    soft_iron: Matrix | None = None
    radius: float | None = None
    residual_percent: float | None = None
    coverage: float | None = None
    axis_ratio: float | None = None
    direction_error_deg: float | None = None
    direction_spread_deg: float | None = None
    direction_bias_deg: float | None = None
    host_difference_deg: float | None = None
    iterations: int = 0
    cycles: int | None = None
    cycle_band: CycleRange | None = None


@dataclass(frozen=True, slots=True)
class FirmwareUsed:
    """Firmware that ran, and the scale of the samples that it was given.

    Attributes
    ----------
    name, version, build_id : str
    sha256 : str or None
        Digest of the ELF file.
    cycle_model : str
        What the cycles mean.
    count_step : float
        What one count stands for, in the unit of the samples.
    count_origin : (3,)
        The reading that is sent as zero counts.
    rounding_rms : float
        What rounding to whole counts moved a reading by, per axis, in the unit of the samples.
    """

    name: str
    version: str
    build_id: str
    sha256: str | None
    cycle_model: str
    count_step: float
    count_origin: Triple
    rounding_rms: float


@dataclass(frozen=True, slots=True)
class SampleFit:
    """Result of every calibrator on the same samples.

    Attributes
    ----------
    file : str
    columns : tuple of str
    unit : str
    unit_from : str
        ``option``, ``header`` or ``assumed``.
    n_in, n_skipped, n_repeated : int
        Readings; rows without three finite numbers; readings equal to the one before and not dropped.
    robust : str
        ``tukey``: what repeats the reading before it, and what is no part of the ellipsoid, was left out. ``none``:
        nothing was.
    n_dropped : int
        Readings that are no part of the ellipsoid.
    dropped : tuple of pairs of int
        First and last line of each run of them; numbers from 1 of readings that are from no file.
    change : FieldChange or None
        Where the hard iron changed by a step.
    condition : float
        Condition of the samples, whatever the calibrator.
    on : str
        ``virtual`` or ``host``.
    firmware : FirmwareUsed or None
    calibrators : tuple of CalibratorFit
    notes : tuple of str
        What a reader should know, a sentence each.
    """

    file: str
    columns: tuple[str, str, str]
    unit: str
    unit_from: str
    n_in: int
    n_skipped: int
    n_repeated: int
    robust: str
    n_dropped: int
    dropped: tuple[tuple[int, int], ...]
    change: FieldChange | None
    condition: float
    on: str
    firmware: FirmwareUsed | None
    calibrators: tuple[CalibratorFit, ...]
    notes: tuple[str, ...]

    @property
    def n_left(self) -> int:
        """Readings that are not left out."""
        return self.n_in - self.n_dropped - (self.n_repeated if self.robust != "none" else 0)

    @property
    def best(self) -> CalibratorFit:
        """The calibrator with the best verdict; of equal ones that with the smallest predicted direction error."""
        order = list(Acceptance)
        return min(
            self.calibrators,
            key=lambda each: (
                order.index(each.verdict), math.inf if each.direction_error_deg is None else each.direction_error_deg
            ),
        )


def fit_on_host(samples: Samples, calibrator: str = ALL, *, robust: bool = True) -> SampleFit:
    """Run the float64 references over all samples.

    Parameters
    ----------
    samples : Samples
    calibrator : str
    robust : bool
        Leave out what `hiltest.logs.left_out.left_out` finds.

    Raises
    ------
    ConfigError
        When a calibrator has no reference.
    """
    names = sorted(REFERENCES.keys() - FASTER) if calibrator == ALL else [calibrator]
    gone = left_out(samples, robust=robust)
    kept = gone.rest
    change = field_change(samples)
    scale, rating = CountScale.of(kept), _Rating(kept, change)
    counts = scale.unrounded(kept.points)
    fits = [rating.result(name, scale.in_unit(reference(name)(counts)), kept.points) for name in names]
    return _sample_fit(samples, gone, change, rating.condition, "host", None, fits)


def fit_on_board(board: Board, samples: Samples, calibrator: str = ALL, *, robust: bool = True) -> SampleFit:
    """Run a board's calibrators over samples, as many as it takes, chosen evenly on the sphere.

    Parameters
    ----------
    board : Board
        Its point buffer is replaced.
    samples : Samples
    calibrator : str
        A name as in the board's identity, or `ALL`.
    robust : bool
        As for `fit_on_host`.

    Returns
    -------
    SampleFit
        Its figures are over all samples that are not left out, so that a verdict is that of the whole file; only the
        predicted direction error is that of the points which the calibrator got.

    Raises
    ------
    ConfigError
        When the firmware has no such calibrator.
    """
    known = board.identity.calibrators
    if calibrator not in (ALL, *known):
        raise ConfigError(f"the firmware has no calibrator {calibrator!r}; it has {', '.join(known)}")
    gone = left_out(samples, robust=robust)
    kept = gone.rest
    change = field_change(samples)
    scale, rating = CountScale.of(kept), _Rating(kept, change)
    counts = scale.unrounded(kept.points)
    about = fit_direct(counts)
    centre = scale.in_unit(about).hard_iron if about.has_fit else kept.points.mean(axis=0)
    used = kept.points[evenly_on_sphere(kept.points, board.identity.max_points, centre)]
    upload_points(board, scale.counts(used))
    fits = []
    for name in known if calibrator == ALL else [calibrator]:
        fit, cost = calibrate_once(board, name, len(used))
        result = rating.result(name, scale.in_unit(fit), used)
        whole = REFERENCES[name](counts) if name in REFERENCES else None
        band = board.cycle_range(cost, name)
        fits.append(replace(result, cycles=cost.cycles if cost else None, cycle_band=band,
                            host_difference_deg=_difference_deg(fit, whole)))
    rounding = scale.counts(used) / scale.per_unit + scale.origin - used
    firmware = FirmwareUsed(
        name=board.identity.name, version=board.identity.version, build_id=board.identity.build_id,
        sha256=board.firmware_sha256, cycle_model=board.cycle_model, count_step=scale.step,
        count_origin=_triple(scale.origin), rounding_rms=float(np.sqrt((rounding * rounding).mean())),
    )
    return _sample_fit(samples, gone, change, rating.condition, str(board.kind), firmware, fits)


def _difference_deg(fit: MagnetometerFit, whole: MagnetometerFit | None) -> float | None:
    """Return the angle between a board's calibration and that of all samples; None where one is no ellipsoid's."""
    if whole is None or {fit.status, whole.status} != {FitStatus.ELLIPSOID}:
        return None
    return direction_difference_rms_deg(fit, whole)


class _Rating:
    """Rates calibrations of the same samples."""

    def __init__(self, samples: Samples, change: FieldChange | None) -> None:
        self._samples, self._change = samples, change
        self.condition = ellipsoid_condition(samples.points)

    def result(self, name: str, fit: MagnetometerFit, used: Array) -> CalibratorFit:
        """Return what a calibrator made of the points it used; `fit` is in the unit of the samples."""
        if not fit.has_fit:
            verdict, reasons = rate(FitFigures(fit.status, self.condition, n=len(used)))
            return CalibratorFit(name, _words(fit.status), verdict, reasons, len(used), iterations=fit.iterations)
        radius = float(np.linalg.det(fit.soft_iron)) ** (-1.0 / 3.0)
        microtesla = self._samples.microtesla
        # With no step in it the fit of a calibrator that takes the bias out is another's.
        predicted = predicted_direction_error(used, fit, unbiased=name in UNBIASED and fit.iterations > 0)
        figures = FitFigures(
            fit.status, self.condition, n=len(used),
            residual_percent=residual_percent(self._samples.points, fit),
            axis_ratio=float(np.linalg.cond(fit.soft_iron)),
            radius_ut=None if microtesla is None else microtesla * radius,
            direction_error_deg=None if predicted is None else predicted.rms_deg,
            change_percent=None if self._change is None else self._change.percent,
        )
        verdict, reasons = rate(figures)
        x, y, z = fit.soft_iron * radius
        return CalibratorFit(
            name, _words(fit.status), verdict, reasons, len(used),
            hard_iron=_triple(fit.hard_iron), soft_iron=(_triple(x), _triple(y), _triple(z)), radius=radius,
            residual_percent=figures.residual_percent,
            coverage=solid_angle_covered(fit.corrected(self._samples.points)), axis_ratio=figures.axis_ratio,
            direction_error_deg=figures.direction_error_deg,
            direction_spread_deg=None if predicted is None else predicted.spread_deg,
            direction_bias_deg=None if predicted is None else predicted.bias_deg, iterations=fit.iterations,
        )


def _sample_fit(
    samples: Samples, gone: LeftOut, change: FieldChange | None, condition: float, on: str,
    firmware: FirmwareUsed | None, fits: Sequence[CalibratorFit],
) -> SampleFit:  # fmt: skip
    fit = SampleFit(
        file=str(samples.path), columns=samples.columns, unit=str(samples.unit), unit_from=samples.unit_from,
        n_in=len(samples.points), n_skipped=samples.skipped, n_repeated=int(gone.repeated.sum()),
        robust="tukey" if gone.robust else "none", n_dropped=int(gone.dropped.sum()), dropped=gone.dropped_lines,
        change=change, condition=condition, on=on, firmware=firmware, calibrators=tuple(fits), notes=(),
    )  # fmt: skip
    return replace(fit, notes=(*samples.notes, *notes(fit)))


def notes(fit: SampleFit) -> Iterator[str]:
    """Yield what a reader of a fit should know, a sentence each."""
    if MICROTESLA[Unit(fit.unit)] is None:
        why = "The header names no unit that is known: taken as counts" if fit.unit_from == "assumed" else "Counts"
        yield f"{why} of unknown scale, so the field strength is not checked; --unit uT or gauss says what they are."
    undetermined = any(each.figure == "condition" and each.verdict is Acceptance.REFUSED for each in fit.best.reasons)
    if fit.best.radius is not None and not undetermined:
        yield from asked_of_field(fit.best.radius, Unit(fit.unit), fit.unit_from)
    if fit.n_skipped:
        yield f"{fit.n_skipped} rows without three finite numbers were skipped."
    if fit.change is not None:
        at = f"{fit.change.at:.4g}"
        yield (
            f"The field changed {fit.change.when}: the hard iron steps by {fit.change.percent:.1f} % of the radius. "
            f"--to {at} or --from {at} takes one part of the log, --steady the longest without a change."
        )
    yield from _left_out_notes(fit)
    ratio = fit.best.axis_ratio
    if ratio is not None and ratio > LARGEST_AXIS_RATIO:
        yield (
            f"The ellipsoid is {ratio:.1f} times as long as wide, more than a board's iron makes it: are these the "
            "columns of one magnetometer, each with the same scale?"
        )
    used, left = fit.calibrators[0].n_used, fit.n_left
    if used != left:
        yield f"The board got {used} of {left} points, as many as it takes, chosen evenly on the sphere."
    if fit.firmware is not None:
        shifted = " from the middle of their range" if any(fit.firmware.count_origin) else ""
        yield (
            f"The firmware got int16 numbers, 1 for {fit.firmware.count_step:.4g} {fit.unit}{shifted}; rounding moved "
            f"a reading by {fit.firmware.rounding_rms:.2g} {fit.unit} rms."
        )


def _left_out_notes(fit: SampleFit) -> Iterator[str]:
    if fit.n_repeated >= MANY_LEFT_OUT * fit.n_in:
        done = "were left out" if fit.robust != "none" else "count as independent"
        yield (
            f"{fit.n_repeated} of {fit.n_in} readings repeat the one before and {done}: the log is faster than the "
            "sensor, or it lay still."
        )
    if not fit.n_dropped:
        return
    runs = [f"{first}" if first == last else f"{first} to {last}" for first, last in fit.dropped]
    more = f" and {len(runs) - _NAMED_RUNS} more places (--json has all)" if len(runs) > _NAMED_RUNS else ""
    kind = "line" if fit.n_dropped == 1 else "lines"
    yield (
        f"{fit.n_dropped} of {fit.n_in} readings were left out, further than {FURTHEST:g} times the scatter from the "
        f"ellipsoid of the others: {kind} {', '.join(runs[:_NAMED_RUNS])}{more}."
    )
    if fit.n_dropped > MANY_LEFT_OUT * fit.n_in:
        yield "So many may have misled the fit: look at --html, and keep the part of the log that is in order."


def _triple(values: Array) -> Triple:
    x, y, z = (float(value) for value in values)
    return x, y, z


def _words(status: FitStatus) -> str:
    return status.name.lower().replace("_", " ")
