"""Calibrations of recorded samples, each with its figures and a verdict."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from hiltest.calibration import is_unbiased
from hiltest.calibration.acceptance import Acceptance, FitFigures, rate, status_words
from hiltest.calibration.corrected import fit_corrected
from hiltest.calibration.direction_error import LARGEST_PREDICTED_DEG, DirectionError, ErrorPrediction
from hiltest.calibration.fit import FitStatus, MagnetometerFit
from hiltest.calibration.quality import direction_difference_rms_deg, residual_of_corrected_percent
from hiltest.calibration.shapes import Shape, fit_shape
from hiltest.calibration.solid_angle import solid_angle_covered
from hiltest.log_fitting.counts import CountScale
from hiltest.log_fitting.fit_result import AS_READ, CalibratorFit, Triple, Turn
from hiltest.log_fitting.samples import Samples
from hiltest.log_fitting.span import FieldChange

Array: TypeAlias = NDArray[np.float64]

# Largest mean of raw norms to which their spread is relative, in radii: raw counts may be about any number.
_FARTHEST_ZERO = 3.0
_MISFIT = "its directions differ by this from those of the ellipsoid of the same samples; use another calibrator"
# Multiple of the predicted error above which a correction is no accident, as for the halves.
_CLEARLY = 3.0


class Rating:
    """Rater of calibrations of the same samples.

    Parameters
    ----------
    samples
        Samples without omitted ones.
    change
        Step of the hard iron in the complete log.
    growth_percent
        Growth of the field's strength over the complete log.

    Attributes
    ----------
    condition : float
        Condition of the samples, for any calibrator.
    """

    def __init__(self, samples: Samples, change: FieldChange | None, growth_percent: float | None = None) -> None:
        self._samples, self._change, self._growth_percent = samples, change, growth_percent
        self._predicted = samples.points, ErrorPrediction(samples.points)
        self.condition = self._predicted[1].condition
        self._halves_difference = self._predicted[1].halves_difference
        scale = CountScale.choose(samples)
        self._ellipsoid = scale.convert_fit(fit_corrected(scale.unrounded(samples.points)))

    @property
    def ellipsoid(self) -> CalibratorFit:
        """The unbiased ellipsoid of all samples, which errors of calibrators are measured against."""
        return self.calibrator("corrected", self._ellipsoid, self._samples.points)

    def calibrator(
        self, name: str, fit: MagnetometerFit, used: Array, *, against_gravity: bool = False
    ) -> CalibratorFit:
        """Rate a calibrator's result on the points it used; `fit` is in the unit of the samples.

        The axes of a fit against gravity are others than those of the ellipsoid.
        """
        predicted = self._predictions(used).predict(fit, unbiased=is_unbiased(name, fit.iterations))
        figures = FitFigures(
            fit.status, condition=self.condition, n=len(used), halves_difference=self._halves_difference
        )
        difference_deg = None if against_gravity else self._difference_deg(fit)
        is_measured = predicted is not None and difference_deg is not None and difference_deg > predicted.rms_deg
        own = self._predictions(self._samples.points).predict(self._ellipsoid, unbiased=True) if is_measured else None
        if own is not None:
            predicted = replace(own, bias_deg=math.hypot(own.bias_deg, difference_deg or 0.0))
        rated = self._rate_fit(name, fit, figures, predicted, self._samples.points)
        reasons = (
            replace(reason, meaning=_MISFIT) if is_measured and reason.figure == "direction_error_deg" else reason
            for reason in rated.reasons
        )
        rated = replace(
            rated, reasons=tuple(reasons), direction_difference_deg=difference_deg, error_is_measured=is_measured
        )
        return rated if own is not None and own.rms_deg <= LARGEST_PREDICTED_DEG else _bound_prediction(rated)

    def _difference_deg(self, fit: MagnetometerFit) -> float | None:
        if not fit.has_fit or self._ellipsoid.status is not FitStatus.ELLIPSOID:
            return None
        return direction_difference_rms_deg(fit, self._ellipsoid)

    def _predictions(self, used: Array) -> ErrorPrediction:
        """Return the prediction for the calibrators' points, which are the same for one board or for the host."""
        if self._predicted[0] is not used:
            self._predicted = used, ErrorPrediction(used)
        return self._predicted[1]

    def as_read(self, best: CalibratorFit) -> CalibratorFit:
        """Rate the readings without calibration, their error being the rms angle to the best calibration's directions.

        The error is None if that calibration is refused, or does not apply to all directions.
        """
        length = float(np.linalg.norm(self._samples.points, axis=1).mean()) or 1.0
        raw, error = MagnetometerFit(FitStatus.ELLIPSOID, False, 0, np.eye(3) / length, np.zeros(3)), None
        if best.hard_iron and best.radius and best.verdict is not Acceptance.REFUSED and best.turn is None:
            soft_iron, hard_iron = np.array(best.soft_iron) / best.radius, np.array(best.hard_iron)
            calibrated = replace(raw, soft_iron=soft_iron, hard_iron=hard_iron)
            error = DirectionError(spread_deg=0.0, bias_deg=direction_difference_rms_deg(raw, calibrated))
        figures = FitFigures(FitStatus.ELLIPSOID)
        return replace(self._rate_fit("as read", raw, figures, error), status=AS_READ, n_used=len(self._samples.points))

    def shape(self, shape: Shape, field: float | None, left_out_percent: float) -> CalibratorFit:
        """Fit and rate a shape, with the field's strength in the samples' unit if it is known."""
        shape_fit = fit_shape(self._samples.points, shape, field=field)
        strong = shape_fit.error_strong_iron
        figures = FitFigures(
            shape_fit.fit.status,
            n=len(self._samples.points),
            shape=shape,
            left_out_percent=left_out_percent,
            strong_iron_deg=None if strong is None else strong.rms_deg,
        )
        points, plane = self._samples.points, shape_fit.plane
        in_plane = points if plane is None else points @ plane.axes[:2].T
        rated = _bound_prediction(self._rate_fit(str(shape), shape_fit.fit, figures, shape_fit.error, in_plane))
        if shape_fit.plane is None or shape_fit.arc_deg is None:
            return replace(rated, shape=shape)
        # A turn does not cover an area of the sphere.
        turn = Turn(shape_fit.plane.axis, shape_fit.plane.tilt_deg, shape_fit.arc_deg)
        return replace(rated, shape=shape, coverage=None, turn=turn)

    def _rate_fit(
        self,
        name: str,
        fit: MagnetometerFit,
        figures: FitFigures,
        predicted: DirectionError | None,
        raw: Array | None = None,
    ) -> CalibratorFit:
        """Return a rated calibration, with further figures besides `figures`.

        Its residual is compared with the spread of the norms of `raw`, if readings are given, in space or in a plane.
        """
        n_used = figures.n or 0
        if not fit.has_fit:
            verdict, reasons = rate(figures)
            return CalibratorFit(name, status_words(fit.status), verdict, reasons, n_used, iterations=fit.iterations)
        corrected = fit.corrected(self._samples.points)
        microtesla = self._samples.microtesla
        whole = figures.shape is None or figures.shape.axes == 3
        figures = replace(
            figures,
            residual_percent=residual_of_corrected_percent(corrected),
            axis_ratio=float(np.linalg.cond(fit.soft_iron)),
            # The radius of a turn is the field's component in its plane, which may have any size.
            radius_ut=microtesla * fit.radius if whole and microtesla is not None else None,
            direction_error_deg=None if predicted is None else predicted.rms_deg,
            change_percent=None if self._change is None else self._change.percent,
            growth_percent=None if self._growth_percent is None else abs(self._growth_percent),
        )
        verdict, reasons = rate(figures)
        if raw is not None and (figures.shape is not None or not self._is_clear(fit, verdict, predicted)):
            norms = np.linalg.norm(raw, axis=1)
            spread_percent = 100.0 * float(norms.std()) / min(float(norms.mean()), _FARTHEST_ZERO * fit.radius)
            residual_percent = residual_of_corrected_percent(corrected)
            figures = replace(figures, residual_of_spread=residual_percent / spread_percent if spread_percent else None)
            verdict, reasons = rate(figures)
        x, y, z = fit.soft_iron * fit.radius
        return CalibratorFit(
            name,
            figures.shape or status_words(fit.status),
            verdict,
            reasons,
            n_used,
            hard_iron=triple(fit.hard_iron),
            soft_iron=(triple(x), triple(y), triple(z)),
            radius=fit.radius,
            residual_percent=figures.residual_percent,
            coverage=solid_angle_covered(corrected),
            axis_ratio=figures.axis_ratio,
            direction_error_deg=figures.direction_error_deg,
            direction_spread_deg=None if predicted is None else predicted.spread_deg,
            direction_bias_deg=None if predicted is None else predicted.bias_deg,
            iterations=fit.iterations,
        )

    @staticmethod
    def _is_clear(fit: MagnetometerFit, verdict: Acceptance, predicted: DirectionError | None) -> bool:
        """Return whether a calibration is otherwise good or fair, and corrects clearly more than its stated error."""
        if verdict not in (Acceptance.GOOD, Acceptance.FAIR) or predicted is None:
            return False
        raw = replace(fit, soft_iron=np.eye(3) / fit.radius, hard_iron=np.zeros(3))
        return direction_difference_rms_deg(raw, fit) > _CLEARLY * predicted.rms_deg


def _bound_prediction(fit: CalibratorFit) -> CalibratorFit:
    """Return a fit whose predicted angles above `LARGEST_PREDICTED_DEG` are None, and that limit in its reasons."""
    reasons = tuple(
        replace(reason, value=min(float(reason.value), LARGEST_PREDICTED_DEG))
        if reason.figure in ("direction_error_deg", "strong_iron_deg")
        else reason
        for reason in fit.reasons
    )
    if (fit.direction_error_deg or 0.0) <= LARGEST_PREDICTED_DEG:
        return replace(fit, reasons=reasons)
    return replace(
        fit,
        reasons=reasons,
        direction_error_deg=None,
        direction_spread_deg=None,
        direction_bias_deg=None,
        error_is_measured=False,
    )


def triple(values: Array) -> Triple:
    """Return three numbers as a tuple."""
    x, y, z = (float(value) for value in values)
    return x, y, z
