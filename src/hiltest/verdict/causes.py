"""Causes of a failed heading."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from hiltest.calibration.error_sources import Source
from hiltest.calibration.fit import FitStatus

# A residual up to this many times the one that noise alone leaves counts as a good fit: for n = 100 the
# rms of a residual scatters by 1/sqrt(2 * 91) = 7 %, so 1.5 is far outside of chance.
GOOD_FIT_FACTOR = 1.5

# Below this nothing holds the ellipsoid: about where the pivots of `direct` reach their own bound. A
# calibrator that has no such bound fits the few points it has as well as any, and is wrong elsewhere.
POOR_COVERAGE_PERCENT = 50.0


class Cause(StrEnum):
    """Cause of a failed heading."""

    NONE = "none"
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
    # Of firmware that speaks its own language.
    FRAME = "another frame than the declared one"
    NOT_TOGETHER = "its field, its calibration and its heading do not belong together"
    STILL = "a heading that does not follow the board"
    NOT_SETTLED = "filter not settled"
    FILTER = "its filter"
    OWN_CALIBRATION = "its own calibration"


ADVICE = {
    Cause.AXES: "Compare the driver's axes with the data sheet's, and how the board lies with the rig's [mounting].",
    Cause.ACCELEROMETER: "Calibrate the accelerometer first: a wrong one tilts every heading.",
    Cause.CONSTANT_OFFSET: "Check the mounting yaw that the rig declares, a declination, and the firmware's axes.",
    Cause.POOR_COVERAGE: "Collect points all round: what was seen of the sphere does not hold an ellipsoid.",
    Cause.STALE: "Calibrate again: the calibration is not of the iron that is there now, or not of these points.",
    Cause.HARD_IRON: "Compare the hard iron with the one that the same points give in float64.",
    Cause.SCALE: "Compare the gain of each axis with the one that the same points give in float64.",
    Cause.SOFT_IRON: "Compare the soft iron with the one that the same points give in float64.",
    Cause.ROTATION: "Compare the rows and columns of the soft iron with those that the same points give in float64.",
    Cause.GOOD_FIT_BAD_HEADING: "A fit of norms cannot see a rotated soft iron: calibrate against gravity (dpi).",
    Cause.BAD_FIT: "Look at the calibrated samples in the report: the model does not fit them.",
    Cause.FRAME: "Correct frame or heading under [device] in the rig, or the firmware's convention.",
    Cause.NOT_TOGETHER: "Compare unit, order and axes of its vectors and its calibration with those in the rig.",
    Cause.STILL: "Turn the board under hiltest device try: is it the heading, and its unit and scale right?",
    Cause.NOT_SETTLED: "Let its filter converge: a longer converge_s or settle_s under [device], or a faster filter.",
    Cause.FILTER: "Compare its heading with the one of its calibrated vectors: what differs is made by its filter.",
    Cause.OWN_CALIBRATION: "Turn the board through more directions (tumbles, tumble_s), or look at its fit.",
}
"""The next step for each cause."""

OF_SOURCE = {
    Source.CONSTANT_TURN: Cause.CONSTANT_OFFSET, Source.OFFSET: Cause.HARD_IRON, Source.SCALE: Cause.SCALE,
    Source.SOFT_IRON: Cause.SOFT_IRON, Source.ROTATION: Cause.ROTATION,
}  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class HeadingSymptoms:
    """Symptoms of one calibrator's heading in a run. A limit that is None is not exceeded."""

    max_deg: float
    max_limit_deg: float | None
    """Largest heading error and its limit."""
    bias_deg: float | None
    bias_limit_deg: float | None
    """Circular mean of the errors and the limit of its magnitude; None of errors that cancel all round."""
    max_centred_deg: float | None
    """Largest error with the bias taken off; it has the limit `max_limit_deg`."""
    residual_percent: float
    residual_predicted_percent: float
    """Residual of the fit, and the one that sensor noise alone would leave."""
    accelerometer_norm_rms_mg: float
    accelerometer_limit_mg: float | None
    """How far the measured gravity is from 1 g over the known angles."""
    tilt_error_deg: float = 0.0
    tilt_limit_deg: float | None = None
    """Largest difference between pitch or roll as answered and as the turntable knows them."""
    fit: FitStatus = FitStatus.ELLIPSOID
    """With any other than `ELLIPSOID` the headings are those of the sphere fit."""
    coverage_percent: float = 100.0
    """Coverage of the points that were fitted: `sphere_coverage`."""
    wrong_axes: bool = False
    """The readings at the known angles are those of other axes than the board's."""
    accelerometer_makes_more: bool | None = None
    """Whether the accelerometer makes more of the error than the magnetometer; None where that is unknown."""
    source: Source | None = None
    """What makes most of the magnetometer's part; None where nothing is known to."""
    is_arithmetic: bool = False
    """The source is the firmware's own arithmetic: the float64 fit of the same points is without it."""
    is_stale: bool = False
    """The calibration is of other iron, or of other points."""

    @property
    def fails(self) -> bool:
        """Whether the error or its mean exceeds its limit."""
        return _over(self.max_deg, self.max_limit_deg) or self.bias_over

    @property
    def bias_over(self) -> bool:
        """Whether the mean error exceeds its limit."""
        return self.bias_deg is not None and _over(abs(self.bias_deg), self.bias_limit_deg)

    @property
    def centred_over(self) -> bool:
        """Whether the largest error does without its mean; as it is where there is no mean."""
        return _over(self.max_deg if self.max_centred_deg is None else self.max_centred_deg, self.max_limit_deg)

    @property
    def accelerometer_is_wrong(self) -> bool:
        """Whether gravity makes most of the error; where that is unknown, whether it is out of its own limits."""
        if self.accelerometer_makes_more is not None:
            return self.accelerometer_makes_more
        return (
            _over(self.accelerometer_norm_rms_mg, self.accelerometer_limit_mg)
            or _over(self.tilt_error_deg, self.tilt_limit_deg)
        )

    @property
    def fits_well(self) -> bool:
        """Whether the residual is no larger than noise may leave."""
        return self.residual_percent <= GOOD_FIT_FACTOR * self.residual_predicted_percent


def name_cause(seen: HeadingSymptoms) -> Cause:
    """Return the likely cause of a failed heading.

    Returns
    -------
    Cause
        `Cause.NONE` when neither the error nor the bias exceeds its limit.

    Notes
    -----
    The order matters. Wrong axes explain every other symptom. A wrong accelerometer spoils every
    heading, whatever the fit; what it makes of the error is compared with what the magnetometer
    makes, where the record has the field and gravity that there were to read. Otherwise its limits decide. Its norm
    alone does not show it: an offset of e g at a right angle to gravity changes the norm by
    e^2 / 2 and tilts the horizon by e radians, so pitch and roll are compared with the known ones.

    An offset that is the same at every pose is the mounting, or the firmware. A rotation of the
    soft iron about the body's z axis is one too *while the board is level*: z is then the vertical.
    On a tilted board the same rotation mixes the vertical field into the horizontal and the error
    changes with the heading: over poses of both kinds it is what it is, a rotation that no fit
    of norms can see. A source that is known to make most of the error is named; a rotation that
    leaves the fit good is called what it looks like. That is also what is left with a perfect
    fit, once the points covered the sphere and the calibrator did not fall back to a sphere:
    neither is a good fit, however small the residual.
    """
    if not seen.fails:
        return Cause.NONE
    if seen.wrong_axes:
        return Cause.AXES
    if seen.accelerometer_is_wrong:
        return Cause.ACCELEROMETER
    if seen.bias_over and not seen.centred_over:
        return Cause.CONSTANT_OFFSET
    if seen.fit is FitStatus.POOR_COVERAGE or seen.coverage_percent < POOR_COVERAGE_PERCENT:
        return Cause.POOR_COVERAGE
    if seen.is_stale:
        return Cause.STALE
    is_ellipsoid = seen.fit is FitStatus.ELLIPSOID
    looks_like_a_good_fit = seen.source is Source.ROTATION and seen.fits_well and not seen.is_arithmetic
    if is_ellipsoid and seen.source is not None and not looks_like_a_good_fit:
        return OF_SOURCE[seen.source]
    return Cause.GOOD_FIT_BAD_HEADING if is_ellipsoid and seen.centred_over and seen.fits_well else Cause.BAD_FIT


def _over(value: float, limit: float | None) -> bool:
    return limit is not None and value > limit
