"""Headings computed on the host, in float64, from the means that the board took at known angles.

The board's own answers decide a run. These headings check its arithmetic, and test calibrations that are in none
of its slots: those of the points so far, and those that a budget of cycles allows.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hiltest.angles import heading_error_deg
from hiltest.calibration import REFERENCES
from hiltest.calibration.accelerometer import NOMINAL, AccelerometerFit
from hiltest.calibration.fit import MagnetometerFit
from hiltest.orientation import DegenerateFieldError
from hiltest.procedures.calibrate import CalibratorRun
from hiltest.procedures.known_angles import KnownAngles, headings_deg
from hiltest.procedures.tumble import Tumble

Reals = NDArray[np.float64]


def heading_errors_deg(
    known: KnownAngles, fit: MagnetometerFit, accelerometer: AccelerometerFit = NOMINAL
) -> Reals | None:
    """Return the heading errors under two calibrations at all known angles, in (-180, 180], shape (n,) [deg].

    None when the magnetometer's is none, or leaves no horizontal field at one of the poses.
    """
    headings = _headings_deg(known, fit, accelerometer)
    return None if headings is None else _differences_deg(headings, known.reference_deg)


def float32_error_deg(known: KnownAngles, run: CalibratorRun, tumble: Tumble) -> float | None:
    """Return the largest difference between a heading of the board and the same one in float64 [deg].

    Parameters
    ----------
    known
        Headings as the board answered them, and the means it took them from.
    run
        One of the calibrations that they are under.
    tumble
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
    if reference is None:
        return None
    headings = _headings_deg(known, reference(tumble.points[: run.n]), known.accelerometer_fits[run.name])
    return None if headings is None else float(np.abs(_differences_deg(known.heading_deg[run.name], headings)).max())


def _headings_deg(known: KnownAngles, fit: MagnetometerFit, accelerometer: AccelerometerFit) -> Reals | None:
    if not fit.has_fit:
        return None
    try:
        return headings_deg(known.magnetometer, known.accelerometer, fit.soft_iron, fit.hard_iron, accelerometer)
    except DegenerateFieldError:
        return None


def _differences_deg(headings_deg: Reals, others_deg: Reals) -> Reals:
    pairs = zip(headings_deg.tolist(), others_deg.tolist(), strict=True)
    return np.array([heading_error_deg(heading, other) for heading, other in pairs])
