"""Causes of a failed heading."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from hiltest.calibration.error_sources import Source
from hiltest.calibration.fit import FitStatus

# A residual up to this many times the one that noise alone leaves counts as a good fit: for n = 100 the
# rms of a residual scatters by 1/sqrt(2 * 91) = 7 %, so 1.5 is far outside of chance.
GOOD_FIT_FACTOR = 1.5

# Below this coverage nothing holds the ellipsoid; the pivots of `direct` reach their own bound about there.
# A calibrator without such a bound fits its few points well, and is wrong elsewhere.
POOR_COVERAGE_PERCENT = 50.0


class Cause(StrEnum):
    """Cause of a failed heading."""

    NONE = "none"
    NOT_SET = "the board was not at the angle of the scale"
    AXES = "axes"
    ACCELEROMETER = "accelerometer"
    CONSTANT_OFFSET = "constant offset"
    POOR_COVERAGE = "poor coverage"
    STALE = "stale calibration"
    HARD_IRON = "hard-iron error"
    SCALE = "wrong scale"
    SOFT_IRON = "soft-iron error"
    ROTATION = "rotation"
    GOOD_FIT_BAD_HEADING = "good fit, bad heading"
    BAD_FIT = "bad fit"
    # The remaining causes belong to firmware that reports by itself.
    SAMPLES = "samples"
    FRAME = "another frame than the declared one"
    NOT_TOGETHER = "its field, its calibration and its heading do not belong together"
    STILL = "a heading that does not follow the board"
    NOT_SETTLED = "filter not settled"
    FILTER = "its filter"
    ISOLATED = "single corrupt headings"
    OWN_CALIBRATION = "its own calibration"
    KNOWN_BUG = "known bug"


ADVICE = {
    Cause.NOT_SET: "Measure these poses again, and turn the board to each. If it was turned, its magnetometer stands "
    "still or the scale slips.",
    Cause.AXES: "Compare the driver's axes with the data sheet, and the board's position with [mounting] in the rig.",
    Cause.ACCELEROMETER: "Calibrate the accelerometer first: its error tilts every heading.",
    Cause.CONSTANT_OFFSET: "Check the mounting yaw in the rig, a declination, and the firmware's axes.",
    Cause.POOR_COVERAGE: "Collect points in all directions: the points cover too little of the sphere for an "
    "ellipsoid.",
    Cause.STALE: "Calibrate again: the calibration does not match the present iron, or these points.",
    Cause.HARD_IRON: "Compare the hard iron with the float64 fit of the same points.",
    Cause.SCALE: "Compare the gain of each axis with the float64 fit of the same points.",
    Cause.SOFT_IRON: "Compare the soft iron with the float64 fit of the same points.",
    Cause.ROTATION: "Compare the rows and columns of the soft iron with the float64 fit of the same points.",
    Cause.GOOD_FIT_BAD_HEADING: "Calibrate against gravity (joint): a fit of norms cannot detect a rotated soft iron.",
    Cause.BAD_FIT: "Check the calibrated samples in the report: the model does not fit them.",
    Cause.FRAME: "Correct frame or heading under [device] in the rig, or the firmware's convention.",
    Cause.NOT_TOGETHER: "Compare unit, order and axes of the firmware's vectors and calibration with the rig.",
    Cause.STILL: "Turn the board while hiltest listen runs: check that this is the heading, its unit and its scale.",
    Cause.NOT_SETTLED: "Let the filter converge: increase converge_s or settle_s under [device], or make the filter "
    "faster.",
    Cause.ISOLATED: "Look for headings far from those beside them, with hiltest listen: a torn copy of the result, or "
    "another task that writes it.",
    Cause.FILTER: "Compare the heading with that of the calibrated vectors: the difference comes from the filter.",
    Cause.OWN_CALIBRATION: "Turn the board through more directions (tumbles, tumble_s), or check its fit.",
}
"""The next step for each cause; that of a known bug depends on the bug."""

OF_SOURCE = {
    Source.CONSTANT_TURN: Cause.CONSTANT_OFFSET,
    Source.OFFSET: Cause.HARD_IRON,
    Source.SCALE: Cause.SCALE,
    Source.SOFT_IRON: Cause.SOFT_IRON,
    Source.ROTATION: Cause.ROTATION,
}


@dataclass(frozen=True, slots=True, kw_only=True)
class HeadingSymptoms:
    """Symptoms of one calibrator's heading in a run. A limit of None is never exceeded."""

    max_deg: float
    max_limit_deg: float | None
    """Largest heading error and its limit."""
    bias_deg: float | None
    bias_limit_deg: float | None
    """Circular mean of the errors and the limit of its magnitude; None if the errors cancel all round."""
    max_centred_deg: float | None
    """Largest error after subtracting the bias; its limit is `max_limit_deg`."""
    residual_percent: float
    residual_predicted_percent: float
    """Residual of the fit, and the residual that sensor noise alone would cause."""
    accelerometer_norm_rms_mg: float
    accelerometer_limit_mg: float | None
    """Deviation of the measured gravity from 1 g over the known angles, and its limit."""
    tilt_error_deg: float = 0.0
    tilt_limit_deg: float | None = None
    """Largest difference between the answered pitch or roll and the turntable's, and its limit."""
    fit: FitStatus = FitStatus.ELLIPSOID
    """Status of the fit; any status but `ELLIPSOID` means that the headings are those of the sphere fit."""
    coverage_percent: float = 100.0
    """Coverage of the fitted points, from `sphere_coverage`."""
    wrong_axes: bool = False
    """True if the readings at the known angles belong to other axes than the board's."""
    accelerometer_makes_more: bool | None = None
    """True if the accelerometer contributes more to the error than the magnetometer; None if unknown."""
    source: Source | None = None
    """Source of most of the magnetometer's contribution; None if no source is known."""
    is_arithmetic: bool = False
    """True if the source is the firmware's own arithmetic: the float64 fit of the same points is free of it."""
    is_stale: bool = False
    """True if the calibration belongs to other iron, or to other points."""

    @property
    def fails(self) -> bool:
        """True if the error or its mean exceeds its limit."""
        return _exceeds(self.max_deg, self.max_limit_deg) or self.bias_over

    @property
    def bias_over(self) -> bool:
        """True if the mean error exceeds its limit."""
        return self.bias_deg is not None and _exceeds(abs(self.bias_deg), self.bias_limit_deg)

    @property
    def centred_over(self) -> bool:
        """True if the largest error exceeds its limit without the mean, or with it if there is no mean."""
        return _exceeds(self.max_deg if self.max_centred_deg is None else self.max_centred_deg, self.max_limit_deg)

    @property
    def accelerometer_is_wrong(self) -> bool:
        """True if gravity causes most of the error; if that is unknown, whether it is out of its own limits."""
        if self.accelerometer_makes_more is not None:
            return self.accelerometer_makes_more
        return _exceeds(self.accelerometer_norm_rms_mg, self.accelerometer_limit_mg) or _exceeds(
            self.tilt_error_deg, self.tilt_limit_deg
        )

    @property
    def fits_well(self) -> bool:
        """True if the residual is no larger than noise explains."""
        return self.residual_percent <= GOOD_FIT_FACTOR * self.residual_predicted_percent


def name_cause(symptoms: HeadingSymptoms) -> Cause:
    """Return the likely cause of a failed heading.

    Returns
    -------
    Cause
        `Cause.NONE` if neither the error nor the bias exceeds its limit.

    Notes
    -----
    The order matters. Wrong axes explain every other symptom. A wrong accelerometer spoils every
    heading, whatever the fit; its contribution to the error is compared with the magnetometer's
    if the record has the true field and gravity. Otherwise its limits decide. Its norm
    alone does not show it: an offset of e g at a right angle to gravity changes the norm by
    e^2 / 2 and tilts the horizon by e radians, so pitch and roll are compared with the known ones.

    An offset that is the same at every pose is the mounting, or the firmware. A rotation of the
    soft iron about the body's z axis has the same effect *while the board is level*: z is then the vertical.
    On a tilted board the same rotation mixes the vertical field into the horizontal and the error
    changes with the heading: poses of both kinds identify it as a rotation, which no fit
    of norms can see. A source that is known to cause most of the error is named; a rotation that
    leaves the fit good is reported as a good fit with a bad heading. So is an unexplained error after a perfect
    fit, if the points covered the sphere and the calibrator did not fall back to a sphere:
    otherwise the fit is not good, however small the residual.
    """
    if not symptoms.fails:
        return Cause.NONE
    if symptoms.wrong_axes:
        return Cause.AXES
    if symptoms.accelerometer_is_wrong:
        return Cause.ACCELEROMETER
    if symptoms.bias_over and not symptoms.centred_over:
        return Cause.CONSTANT_OFFSET
    if symptoms.fit is FitStatus.POOR_COVERAGE or symptoms.coverage_percent < POOR_COVERAGE_PERCENT:
        return Cause.POOR_COVERAGE
    if symptoms.is_stale:
        return Cause.STALE
    is_ellipsoid = symptoms.fit is FitStatus.ELLIPSOID
    looks_like_a_good_fit = symptoms.source is Source.ROTATION and symptoms.fits_well and not symptoms.is_arithmetic
    if is_ellipsoid and symptoms.source is not None and not looks_like_a_good_fit:
        return OF_SOURCE[symptoms.source]
    looks_good = is_ellipsoid and symptoms.centred_over and symptoms.fits_well
    return Cause.GOOD_FIT_BAD_HEADING if looks_good else Cause.BAD_FIT


def _exceeds(value: float, limit: float | None) -> bool:
    return limit is not None and value > limit
