"""A fit in one sentence: the verdict, and the heading error before and after."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hiltest.calibration.acceptance import Acceptance
from hiltest.log_fitting.fit_result import CalibratorFit, SampleFit

Reals = NDArray[np.float64]

# Dip for the heading error if gravity did not show it: that of central Europe and of most of the United States.
_ASSUMED_DIP_DEG = 60.0
HEADINGS_DEG: Reals = np.arange(0.0, 361.0, 5.0)


def dip_deg(fit: SampleFit) -> float:
    """Return the dip that headings are computed for: that of the best calibration against gravity, or 60 degrees."""
    gravity = fit.best.gravity
    return _ASSUMED_DIP_DEG if gravity is None or gravity.dip_deg is None else gravity.dip_deg


def heading_errors_deg(best: CalibratorFit, dip: float, calibration: CalibratorFit | None = None) -> Reals | None:
    """Return the errors of headings at `HEADINGS_DEG`, level with z vertical; None without a calibration.

    The true reading at a heading is the one that `best` maps to the field; headings are of readings as read, or after
    another calibration.
    """
    if best.hard_iron is None or best.soft_iron is None or best.radius is None or best.turn is not None:
        return None
    heading, down = np.radians(HEADINGS_DEG), math.radians(dip)
    level = best.radius * math.cos(down) * np.column_stack([np.cos(heading), -np.sin(heading)])
    field = np.column_stack([level, np.full(len(heading), best.radius * math.sin(down))])
    readings = np.linalg.solve(np.array(best.soft_iron), field.T).T + best.hard_iron
    if calibration is not None and calibration.hard_iron is not None:
        readings = (readings - calibration.hard_iron) @ np.array(calibration.soft_iron).T
    errors = np.degrees(np.arctan2(-readings[:, 1], readings[:, 0])) - HEADINGS_DEG
    wrapped: Reals = (errors + 180.0) % 360.0 - 180.0
    return wrapped


def calibrated_heading_error_deg(fit: SampleFit) -> float | None:
    """Return the rms error of level calibrated headings: predicted, or measured against the ellipsoid of the samples.

    Half of the variance of a predicted direction error is horizontal, across the field. A measured one adds the
    headings' difference from those after the ellipsoid. A rotation of the sensor is in neither.
    """
    truth = _truth(fit)
    error_deg = truth.direction_error_deg
    if error_deg is None or truth.turn is not None:
        return error_deg
    predicted_deg = error_deg / math.sqrt(2.0) / max(math.cos(math.radians(dip_deg(fit))), 0.01)
    off_deg = None if truth is fit.best else heading_errors_deg(truth, dip_deg(fit), fit.best)
    return predicted_deg if off_deg is None else math.hypot(predicted_deg, float(np.sqrt((off_deg[1:] ** 2).mean())))


def heading_errors_as_read_deg(fit: SampleFit) -> Reals | None:
    """Return the errors of headings as read; see `heading_errors_deg`."""
    return None if fit.best.turn is not None else heading_errors_deg(_truth(fit), dip_deg(fit))


def error_words(fit: SampleFit) -> str:
    """Return whether the error with the calibration is a measurement or a prediction."""
    return "predicted" if _truth(fit) is fit.best else "measured against the ellipsoid of the same samples"


def _truth(fit: SampleFit) -> CalibratorFit:
    """Return the calibration that stands for the truth: the best one, or the ellipsoid if that differs clearly."""
    return fit.ellipsoid if fit.best.error_is_measured and fit.ellipsoid is not None else fit.best


def headline(fit: SampleFit) -> str:
    """Return the result of a fit in one sentence."""
    name, best = Path(fit.file).name, fit.best
    if best.verdict is Acceptance.REFUSED or best.hard_iron is None:
        reasons = {reason.figure: reason.meaning for reason in best.reasons if reason.verdict is Acceptance.REFUSED}
        why = next(iter(reasons.values()), "there is no calibration")
        if fit.at_rest:
            why = "the sensor was at rest"
        elif fit.change is not None and "halves_difference" in reasons:
            why = f"the field changed {fit.change.when}"
        return f"{name}: refused, use no calibration from this log: {why}."
    before, after_deg = heading_errors_as_read_deg(fit), calibrated_heading_error_deg(fit)
    after = "an unknown angle" if after_deg is None else f"{after_deg:.2g} deg"
    iron = f"{float(np.linalg.norm(best.hard_iron)):.3g} {fit.unit} of hard iron"
    if before is None:
        return (
            f"{name}: {best.verdict}, for headings in the plane of the turn, which err by {after} rms with {best.name}."
        )
    stretch = f"soft iron that stretches by {100.0 * ((_truth(fit).axis_ratio or 1.0) - 1.0):.0f} %"
    return (
        f"{name}: {best.verdict}, with {iron} and {stretch}; at a dip of {dip_deg(fit):.0f} deg a level compass errs "
        f"by up to {np.abs(before).max():.3g} deg as read, and with {best.name} by {after} rms "
        f"({error_words(fit)}, plus any rotation)."
    )
