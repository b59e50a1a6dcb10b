"""Calibrators over a recorded cloud: what each makes of it, and whether that may be used."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from hiltest.boards.board import Board
from hiltest.calibration import FASTER, REFERENCES, UNBIASED, reference
from hiltest.calibration.acceptance import Acceptance, FitFigures, Reason, judge
from hiltest.calibration.conditioning import ellipsoid_condition
from hiltest.calibration.direction_error import predicted_direction_error
from hiltest.calibration.fit import FitStatus, MagnetometerFit
from hiltest.calibration.quality import residual_percent
from hiltest.calibration.solid_angle import solid_angle_covered
from hiltest.errors import ConfigError
from hiltest.logs.counts import CountScale, thinned
from hiltest.logs.samples import Cloud
from hiltest.measurement import CycleBand
from hiltest.procedures.calibrate import calibrate_once
from hiltest.procedures.cycles import upload_cloud

Array: TypeAlias = NDArray[np.float64]
Triple: TypeAlias = tuple[float, float, float]
Matrix: TypeAlias = tuple[Triple, Triple, Triple]

ALL = "all"
#: Fixed, so that a file gives one answer whatever a firmware's buffer holds; beyond it a fit's spread falls only with
#: the root of n, by 1.2 to the 512 points of the packaged firmware.
MOST_POINTS = 360
# Of the readings: from here on the log is faster than the sensor, and its points are fewer than they seem.
_MANY_REPEATED = 0.2


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
        Points that the calibrator got. The figures are over all of them in the cloud.
    hard_iron : (3,) or None
        None without a calibration, as everything behind it.
    soft_iron : 3 rows of 3 or None
        Symmetric, determinant 1: ``corrected = soft_iron @ (reading - hard_iron)``, in the unit of the cloud.
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
    iterations : int
        Sweeps of the firmware's solver, 0 for a closed form.
    cycles : int or None
        Core cycles of the run; None where they are not counted.
    cycle_band : CycleBand or None
        Within what they lie by the cycle model's own uncertainty; None where that is unknown.
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
    iterations: int = 0
    cycles: int | None = None
    cycle_band: CycleBand | None = None


@dataclass(frozen=True, slots=True)
class FirmwareUsed:
    """The firmware that ran, and how it got the cloud.

    Attributes
    ----------
    name, version, build_id : str
    sha256 : str or None
        Digest of the ELF file.
    cycle_model : str
        What the cycles mean.
    count_step : float
        What one count stands for, in the unit of the cloud.
    count_origin : (3,)
        The reading that is sent as zero counts.
    rounding_rms : float
        What rounding to whole counts moved a reading by, per axis, in the unit of the cloud.
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
class CloudFit:
    """Calibrators over one cloud.

    Attributes
    ----------
    file : str
    columns : tuple of str
    unit : str
    unit_from : str
        ``option``, ``header`` or ``assumed``.
    n_in, n_skipped, n_repeated : int
        Readings; rows without three finite numbers; readings equal to the one before.
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
    condition: float
    on: str
    firmware: FirmwareUsed | None
    calibrators: tuple[CalibratorFit, ...]
    notes: tuple[str, ...]

    @property
    def best(self) -> CalibratorFit:
        """The calibrator with the best verdict; of equal ones that with the smallest residual."""
        order = list(Acceptance)
        return min(
            self.calibrators,
            key=lambda each: (
                order.index(each.verdict), float("inf") if each.residual_percent is None else each.residual_percent
            ),
        )


def fit_on_host(cloud: Cloud, calibrator: str = ALL) -> CloudFit:
    """Run the float64 references over every point of a cloud.

    Raises
    ------
    ConfigError
        When a calibrator has no reference.
    """
    names = sorted(REFERENCES.keys() - FASTER) if calibrator == ALL else [calibrator]
    scale, judged = CountScale.of(cloud), _Judge(cloud)
    counts = scale.unrounded(cloud.points)
    fits = [judged.result(name, scale.in_unit(reference(name)(counts)), cloud.points) for name in names]
    return _cloud_fit(cloud, judged.condition, "host", None, fits)


def fit_on_board(board: Board, cloud: Cloud, calibrator: str = ALL) -> CloudFit:
    """Run a board's calibrators over a cloud, thinned to `MOST_POINTS`.

    Parameters
    ----------
    board : Board
        Its point buffer is replaced.
    cloud : Cloud
    calibrator : str
        A name as in the board's identity, or `ALL`.

    Returns
    -------
    CloudFit
        Its figures are over all points of the cloud, so that a verdict is that of the whole file; only the
        predicted direction error is that of the points which the calibrator got.

    Raises
    ------
    ConfigError
        When the firmware has no such calibrator.
    """
    known = board.identity.calibrators
    if calibrator not in (ALL, *known):
        raise ConfigError(f"the firmware has no calibrator {calibrator!r}; it has {', '.join(known)}")
    scale, judged = CountScale.of(cloud), _Judge(cloud)
    used = thinned(cloud.points, min(MOST_POINTS, board.identity.max_points))
    upload_cloud(board, scale.counts(used))
    fits = []
    for name in known if calibrator == ALL else [calibrator]:
        fit, cost = calibrate_once(board, name, len(used))
        result = judged.result(name, scale.in_unit(fit), used)
        band = board.cycle_band(cost)
        fits.append(replace(result, cycles=cost.cycles if cost else None, cycle_band=band))
    rounding = scale.counts(used) / scale.per_unit + scale.origin - used
    firmware = FirmwareUsed(
        name=board.identity.name, version=board.identity.version, build_id=board.identity.build_id,
        sha256=board.firmware_sha256, cycle_model=board.cycle_model, count_step=scale.step,
        count_origin=_triple(scale.origin), rounding_rms=float(np.sqrt((rounding * rounding).mean())),
    )
    return _cloud_fit(cloud, judged.condition, str(board.kind), firmware, fits)


class _Judge:
    """Judges calibrations by one cloud."""

    def __init__(self, cloud: Cloud) -> None:
        self._cloud = cloud
        self.condition = ellipsoid_condition(cloud.points)

    def result(self, name: str, fit: MagnetometerFit, used: Array) -> CalibratorFit:
        """Return what a calibrator made of the points it used; `fit` is in the unit of the cloud."""
        if not fit.has_fit:
            verdict, reasons = judge(FitFigures(fit.status, self.condition, n=len(used)))
            return CalibratorFit(name, _words(fit.status), verdict, reasons, len(used), iterations=fit.iterations)
        radius = float(np.linalg.det(fit.soft_iron)) ** (-1.0 / 3.0)
        microtesla = self._cloud.microtesla
        # With no step in it the fit of a calibrator that takes the bias out is another's.
        predicted = predicted_direction_error(used, fit, unbiased=name in UNBIASED and fit.iterations > 0)
        figures = FitFigures(
            fit.status, self.condition, n=len(used),
            residual_percent=residual_percent(self._cloud.points, fit),
            axis_ratio=float(np.linalg.cond(fit.soft_iron)),
            radius_ut=None if microtesla is None else microtesla * radius,
            direction_error_deg=None if predicted is None else predicted.rms_deg,
        )
        verdict, reasons = judge(figures)
        x, y, z = fit.soft_iron * radius
        return CalibratorFit(
            name, _words(fit.status), verdict, reasons, len(used),
            hard_iron=_triple(fit.hard_iron), soft_iron=(_triple(x), _triple(y), _triple(z)), radius=radius,
            residual_percent=figures.residual_percent,
            coverage=solid_angle_covered(fit.corrected(self._cloud.points)), axis_ratio=figures.axis_ratio,
            direction_error_deg=figures.direction_error_deg,
            direction_spread_deg=None if predicted is None else predicted.spread_deg,
            direction_bias_deg=None if predicted is None else predicted.bias_deg, iterations=fit.iterations,
        )


def _cloud_fit(
    cloud: Cloud, condition: float, on: str, firmware: FirmwareUsed | None, fits: Sequence[CalibratorFit]
) -> CloudFit:
    return CloudFit(
        file=str(cloud.path), columns=cloud.columns, unit=str(cloud.unit), unit_from=cloud.unit_from,
        n_in=len(cloud.points), n_skipped=cloud.skipped, n_repeated=cloud.repeated, condition=condition, on=on,
        firmware=firmware, calibrators=tuple(fits),
        notes=tuple(text for said in _NOTES if (text := said(cloud, firmware, fits))),
    )


def _unit_note(cloud: Cloud, _firmware: FirmwareUsed | None, _fits: Sequence[CalibratorFit]) -> str:
    if cloud.microtesla is not None:
        return ""
    why = "The header names no unit that is known: taken as counts" if cloud.unit_from == "assumed" else "Counts"
    return f"{why} of unknown scale, so the field strength is not checked; --unit uT or gauss says what they are."


def _skipped_note(cloud: Cloud, _firmware: FirmwareUsed | None, _fits: Sequence[CalibratorFit]) -> str:
    return f"{cloud.skipped} rows without three finite numbers were skipped." if cloud.skipped else ""


def _repeated_note(cloud: Cloud, _firmware: FirmwareUsed | None, _fits: Sequence[CalibratorFit]) -> str:
    if cloud.repeated < _MANY_REPEATED * len(cloud.points):
        return ""
    return (
        f"{cloud.repeated} of {len(cloud.points)} readings repeat the one before: the log is faster than the sensor, "
        "or it lay still. The predicted direction error counts them as independent, and is too small."
    )


def _thinned_note(cloud: Cloud, _firmware: FirmwareUsed | None, fits: Sequence[CalibratorFit]) -> str:
    used = fits[0].n_used
    if used == len(cloud.points):
        return ""
    return f"The board got {used} points, taken at a uniform stride over all {len(cloud.points)}."


def _counts_note(cloud: Cloud, firmware: FirmwareUsed | None, _fits: Sequence[CalibratorFit]) -> str:
    if firmware is None:
        return ""
    shifted = " from the middle of their range" if any(firmware.count_origin) else ""
    return (
        f"The firmware got int16 numbers, 1 for {firmware.count_step:.4g} {cloud.unit}{shifted}; rounding moved a "
        f"reading by {firmware.rounding_rms:.2g} {cloud.unit} rms."
    )


_Note: TypeAlias = Callable[[Cloud, FirmwareUsed | None, Sequence[CalibratorFit]], str]
_NOTES: tuple[_Note, ...] = (_unit_note, _skipped_note, _repeated_note, _thinned_note, _counts_note)


def _triple(values: Array) -> Triple:
    x, y, z = (float(value) for value in values)
    return x, y, z


def _words(status: FitStatus) -> str:
    return status.name.lower().replace("_", " ")
