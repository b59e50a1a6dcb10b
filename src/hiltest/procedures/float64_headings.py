"""Headings computed on the host, in float64, from the means that the board took at known angles.

The board's answers decide a run. These headings check its arithmetic, and test calibrations that are not in its slots:
from the points so far, and within a budget of cycles.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hiltest.calibration import REFERENCES
from hiltest.calibration.accelerometer import NOMINAL, AccelerometerFit
from hiltest.calibration.fit import MagnetometerFit
from hiltest.orientation import DegenerateFieldError
from hiltest.orientation.angles import heading_error_deg
from hiltest.procedures.calibrate import CalibratorRun
from hiltest.procedures.requested_headings import RequestedAngles, headings_deg
from hiltest.procedures.tumble import Tumble

Reals = NDArray[np.float64]


def heading_errors_deg(
    known_angles: RequestedAngles, fit: MagnetometerFit, accelerometer: AccelerometerFit = NOMINAL
) -> Reals | None:
    """Return the heading errors under two calibrations at all known angles, in (-180, 180], shape (n,) [deg].

    None if the magnetometer has no calibration, or it leaves no horizontal field at one of the poses.
    """
    headings = _headings_deg(known_angles, fit, accelerometer)
    return None if headings is None else _differences_deg(headings, known_angles.reference_deg)


def float32_error_deg(known_angles: RequestedAngles, run: CalibratorRun, tumble: Tumble) -> float | None:
    """Return the largest difference between a heading of the board and the same one in float64 [deg].

    Parameters
    ----------
    known_angles
        Headings of the board, and the means that they are from.
    run
        One of the calibrations of these headings.
    tumble
        The fitted counts.

    Returns
    -------
    float or None
        None for a calibrator that has no float64 reference, or whose reference finds no fit. Rounded to 1e-12 deg:
        below 1e-13 deg it depends on the version of numpy.

    Notes
    -----
    Sensor and table do not contribute: the reference calibrator fits the same counts, and its heading is computed from
    the same means. The difference is the firmware's arithmetic, in the fit and after it.
    """
    reference = REFERENCES.get(run.calibrator)
    if reference is None:
        return None
    headings = _headings_deg(known_angles, reference(tumble.points[: run.n]), known_angles.accelerometer_fits[run.name])
    return (
        None
        if headings is None
        else round(float(np.abs(_differences_deg(known_angles.heading_deg[run.name], headings)).max()), 12)
    )


def _headings_deg(known_angles: RequestedAngles, fit: MagnetometerFit, accelerometer: AccelerometerFit) -> Reals | None:
    if not fit.has_fit:
        return None
    try:
        return headings_deg(
            known_angles.magnetometer, known_angles.accelerometer, fit.soft_iron, fit.hard_iron, accelerometer
        )
    except DegenerateFieldError:
        return None


def _differences_deg(headings_deg: Reals, others_deg: Reals) -> Reals:
    pairs = zip(headings_deg.tolist(), others_deg.tolist(), strict=True)
    return np.array([heading_error_deg(heading, other) for heading, other in pairs])
