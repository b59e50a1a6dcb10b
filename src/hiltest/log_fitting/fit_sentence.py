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


def heading_errors_deg(best: CalibratorFit, dip: float) -> Reals | None:
    """Return the errors of uncalibrated headings at `HEADINGS_DEG`, level with z vertical; None without a calibration.

    The true reading at a heading is the one that the calibration maps to the field.
    """
    if best.hard_iron is None or best.soft_iron is None or best.radius is None or best.turn is not None:
        return None
    heading, down = np.radians(HEADINGS_DEG), math.radians(dip)
    level = best.radius * math.cos(down) * np.column_stack([np.cos(heading), -np.sin(heading)])
    field = np.column_stack([level, np.full(len(heading), best.radius * math.sin(down))])
    readings = np.linalg.solve(np.array(best.soft_iron), field.T).T + best.hard_iron
    errors = np.degrees(np.arctan2(-readings[:, 1], readings[:, 0])) - HEADINGS_DEG
    wrapped: Reals = (errors + 180.0) % 360.0 - 180.0
    return wrapped


def calibrated_heading_error_deg(fit: SampleFit) -> float | None:
    """Return the predicted standard deviation of level calibrated headings.

    Half of the variance of a direction is horizontal, across the field. A rotation of the sensor is not predicted.
    """
    error_deg = fit.best.direction_error_deg
    if error_deg is None or fit.best.turn is not None:
        return error_deg
    return error_deg / math.sqrt(2.0) / max(math.cos(math.radians(dip_deg(fit))), 0.01)


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
    before, after_deg = heading_errors_deg(best, dip_deg(fit)), calibrated_heading_error_deg(fit)
    after = "an unknown angle" if after_deg is None else f"{after_deg:.2g} deg"
    iron = f"{float(np.linalg.norm(best.hard_iron)):.3g} {fit.unit} of hard iron"
    if before is None:
        return (
            f"{name}: {best.verdict}, for headings in the plane of the turn, which err by {after} rms with {best.name}."
        )
    stretch = f"soft iron that stretches by {100.0 * ((best.axis_ratio or 1.0) - 1.0):.0f} %"
    return (
        f"{name}: {best.verdict}, with {iron} and {stretch}; at a dip of {dip_deg(fit):.0f} deg a level compass errs "
        f"by up to {np.abs(before).max():.3g} deg as read, and with {best.name} by {after} rms (predicted, plus any "
        "rotation)."
    )
