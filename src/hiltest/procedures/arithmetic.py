"""What the board's float32 makes of a heading, beside float64 on the same numbers."""

from __future__ import annotations

import numpy as np

from hiltest.angles import heading_error_deg
from hiltest.calibration import REFERENCES
from hiltest.orientation import tilt_heading
from hiltest.procedures.calibrate import CalibratorRun
from hiltest.procedures.known_angles import KnownAngles
from hiltest.procedures.tumble import Tumble


def float32_error_deg(known: KnownAngles, run: CalibratorRun, tumble: Tumble) -> float | None:
    """Return the largest difference between a heading of the board and the same one in float64 [deg].

    Parameters
    ----------
    known : KnownAngles
        Headings as the board answered them, and the means it took them from.
    run : CalibratorRun
        One of the calibrations that they are under.
    tumble : Tumble
        The counts that were fitted.

    Returns
    -------
    float or None
        None for a calibrator that has no float64 reference, or whose reference finds no fit.

    Notes
    -----
    Neither sensor nor table enters: the reference calibrator fits the same counts, and its heading is
    computed from the same means. What differs is the firmware's arithmetic, in the fit and after it.
    """
    reference = REFERENCES.get(run.calibrator)
    fit = reference(tumble.points[: run.n]) if reference else None
    if fit is None or not fit.has_fit:
        return None
    corrected = fit.corrected(known.magnetometer)
    headings = [
        tilt_heading(gravity, field).heading_deg for gravity, field in zip(known.accelerometer, corrected, strict=True)
    ]
    answered = known.heading_deg[run.name].tolist()
    return float(np.abs([heading_error_deg(*pair) for pair in zip(answered, headings, strict=True)]).max())
