"""Heading errors that the noise of a run makes unavoidable, per source, and the refusal of smaller ones."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from hiltest.calibration.direct import fit_direct
from hiltest.calibration.fit import FitStatus, MagnetometerFit
from hiltest.calibration.heading_bound import LEAST_CHANCE, HeadingBound, heading_bound
from hiltest.errors import FirmwareContradictionError
from hiltest.procedures.calibrate import UNCALIBRATED, CalibratorRun
from hiltest.procedures.known_angles import KnownAngles
from hiltest.procedures.reported_headings import FIRMWARE, ReportedAngles
from hiltest.procedures.requested_headings import RequestedAngles
from hiltest.procedures.tumble import Tumble
from hiltest.rig import COUNTS_PER_UT, Rig

_FASTEST_HZ = 800.0  # output rate of an FXOS8700CQ, the highest of the known magnetometers
# Below half a count rms, rounding to whole counts is no longer noise.
_LEAST_NOISE_COUNTS = 0.5


def expected_errors(
    known_angles: KnownAngles,
    rig: Rig,
    *,
    field_ned_ut: Sequence[float],
    tumble: Tumble | None = None,
    calibrations: Mapping[str, CalibratorRun] | None = None,
) -> dict[str, HeadingBound]:
    """Return the bounds of the heading errors, by source.

    A source that is not among the calibrations is held against the noise of its readings alone. Sources without noise
    have none.

    Parameters
    ----------
    field_ned_ut
        The earth's field.
    tumble
        Points of the calibrations.
    calibrations
        Calibrations from the first points of the tumble.
    """
    noise_counts, readings = _readings_of(known_angles, rig)
    if noise_counts < _LEAST_NOISE_COUNTS:
        return {}
    field, gravity = known_angles.rotate_to_body(field_ned_ut), known_angles.rotate_to_body((0.0, 0.0, 1.0))
    # Readings scale with the field's strength; the soft iron, a few per cent, changes their noise as little.
    nominal = MagnetometerFit(
        FitStatus.ELLIPSOID, False, 0, np.eye(3) / (COUNTS_PER_UT * rig.field.strength_ut), np.zeros(3)
    )

    def bound(n: int) -> HeadingBound | None:
        points = tumble.points[:n] if tumble is not None and n else None
        fit = nominal if points is None else fit_direct(points)
        if fit.status is not FitStatus.ELLIPSOID:
            return None
        return heading_bound(fit, points, field=field, gravity=gravity, noise=noise_counts, readings=readings)

    sources = [FIRMWARE] if isinstance(known_angles, ReportedAngles) else [*known_angles.heading_deg]
    used = {
        source: calibrations[source].n if calibrations and source in calibrations else 0
        for source in sources
        if source != UNCALIBRATED
    }
    by_n = {n: bound(n) for n in set(used.values())}
    return {source: by_n_bound for source, n in used.items() if (by_n_bound := by_n[n]) is not None}


def _readings_of(known_angles: KnownAngles, rig: Rig) -> tuple[float, Sequence[float]]:
    """Return the noise of one axis of a reading [count], and the number of readings at each pose at most."""
    declared_counts = COUNTS_PER_UT * rig.sensors.magnetometer_noise_ut
    if isinstance(known_angles, ReportedAngles):
        return declared_counts, [
            pose.settled.samples or max(1.0, _FASTEST_HZ * pose.settled.took_s) for pose in known_angles.held
        ]
    if not isinstance(known_angles, RequestedAngles):
        return 0.0, []
    # A part may have less noise than its data sheet declares.
    noise_counts = min(declared_counts, known_angles.magnetometer_sigma_counts or math.inf)
    rounding = 1.0 / math.sqrt(12.0)
    noise_counts = math.hypot(noise_counts, rounding) if noise_counts >= _LEAST_NOISE_COUNTS else 0.0
    return noise_counts, [known_angles.readings] * len(known_angles.poses)


def refuse_impossible_errors(known_angles: KnownAngles, bounds: Mapping[str, HeadingBound]) -> None:
    """Refuse heading errors that are smaller than noise allows.

    Raises
    ------
    FirmwareContradictionError
        When fewer than `LEAST_CHANCE` of honest runs have so small a largest error.
    """
    for source, bound in bounds.items():
        largest_deg = known_angles.summary(source).max_deg
        if len(known_angles.poses) > 1 and bound.chance(largest_deg) < LEAST_CHANCE:
            raise FirmwareContradictionError(
                f"the headings of {source} are better than the magnetometer's noise allows: their largest error over "
                f"{len(known_angles.poses)} poses is {largest_deg:.2g} deg, and of a million honest runs fewer than "
                f"one stays below {bound.least_deg:.2f} deg; the firmware does not compute them from its samples"
            )
