"""Acceptance of a calibration: good, fair, poor or refused, and why."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

from hiltest.calibration.conditioning import LARGEST_CONDITION, WELL_CONDITIONED
from hiltest.calibration.fit import FitStatus
from hiltest.calibration.robust import MANY_LEFT_OUT
from hiltest.calibration.shapes import Shape


class Acceptance(StrEnum):
    """Verdict on a calibration, the best first."""

    GOOD = "good"
    FAIR = "fair"
    POOR = "poor"
    REFUSED = "refused"


@dataclass(frozen=True, slots=True)
class FitFigures:
    """Figures for the rating of a calibration; None is not rated.

    Attributes
    ----------
    residual_percent, axis_ratio, direction_error_deg : float or None
    """

    status: FitStatus
    condition: float | None = None
    """`hiltest.calibration.conditioning.ellipsoid_condition` of the points."""
    n: int | None = None
    """Number of points of the calibrator."""
    residual_percent: float | None = None
    axis_ratio: float | None = None
    radius_ut: float | None = None
    """None if the unit of the points is not known."""
    direction_error_deg: float | None = None
    residual_of_spread: float | None = None
    """Residual relative to the spread of the raw norms, both in parts of the length; None if iron is certain."""
    halves_difference: float | None = None
    """Angle between the calibrations of two halves, in predicted ones; None if a half determines none."""
    change_percent: float | None = None
    """Step of the hard iron within the points, relative to the radius; None without one."""
    growth_percent: float | None = None
    """Size of the growth of the field's strength over the points; None without one."""
    shape: Shape | None = None
    """None for an ellipsoid."""
    strong_iron_deg: float | None = None
    """Direction error of a shape if soft iron stretches the field by a fifth."""
    left_out_percent: float | None = None
    """Readings that were omitted from a shape's fit because they are too far from it."""


@dataclass(frozen=True, slots=True)
class Reason:
    """Reason why a calibration is not good."""

    figure: str
    """Name of the figure that is out of bounds."""
    value: float | str
    """Value of the figure; the status of a fit, and a shape, are words."""
    threshold: float | str
    """Violated limit."""
    unit: str
    verdict: Acceptance
    """Verdict that this reason alone causes."""
    meaning: str
    """Meaning, as a sentence."""


_UNITS = {"percent": "%", "deg": "deg", "ut": "uT", "n": "points"}


@dataclass(frozen=True, slots=True)
class Bound:
    """A threshold of one figure: if it is violated, a calibration has this verdict for this reason."""

    figure: str
    limit: float
    verdict: Acceptance
    meaning: str
    below: bool = False

    @property
    def unit(self) -> str:
        """Unit of the figure, by the end of its name."""
        return _UNITS.get(self.figure.rpartition("_")[2], "")

    def broken_by(self, value: float) -> bool:
        """Return whether a value is on the wrong side; the limit itself is not."""
        # NaN violates every bound.
        return not (value >= self.limit if self.below else value <= self.limit)


#: Boards and cases stretch the field by tenths. A factor of two means that this is not a sensor in the earth's field,
#: unless the points show the whole ellipsoid: then the part is unusual, not the fit.
LARGEST_AXIS_RATIO = 2.0

#: The order is that of the reasons: for each figure the severest first, and only the first violated one is reported.
BOUNDS = (
    # Nine points always lie on a quadric, so there is no residual to judge it by.
    Bound(
        "n",
        10.0,
        Acceptance.REFUSED,
        "a quadric through so few points is exact, without an estimate of its error; take more points",
        below=True,
    ),
    # Two for each unknown: with nine degrees of freedom the residual, and so the prediction, is known to 24 %.
    Bound(
        "n",
        18.0,
        Acceptance.POOR,
        "too few points remain to estimate the residual; take more points",
        below=True,
    ),
    # Simulated over 100 points: 300 is where a third of the sphere is covered (see `ellipsoid_condition`). Any
    # calibrator also returns an ellipsoid for less, of a wrong radius.
    Bound(
        "condition",
        LARGEST_CONDITION,
        Acceptance.REFUSED,
        "the points cover too little of the sphere to determine an ellipsoid, or nearly all lie in one place, or one "
        "is far from all others; turn the sensor in all directions",
    ),
    # 60 % of the sphere has 57 in the median: at 0.4 uT and 100 points `direct` is off by 0.32 deg there, by 0.21 on
    # three quarters, 0.53 on a half and 1.05 on 30 %.
    Bound(
        "condition",
        WELL_CONDITIONED,
        Acceptance.FAIR,
        "a large part of the sphere is missing, and directions in it are extrapolated; turn the sensor in all "
        "directions",
    ),
    # A sensor at rest is a ball of noise: about 40 %. At 20 % a reading's own direction is off by some 11 deg.
    Bound(
        "residual_percent",
        20.0,
        Acceptance.REFUSED,
        "the points do not lie on an ellipsoid: sensor at rest, wrong columns, or the field changed",
    ),
    # A reading that is off in length is as far off across: 3.5 % are the 2 deg that the thesis allows.
    Bound(
        "residual_percent",
        3.5,
        Acceptance.POOR,
        "a single reading's direction is off by 2 deg or more: iron that moved, a current, or turning too fast for "
        "the sensor",
    ),
    # Noise of 0.4 uT in 48 uT leaves 0.8 %, of 1 uT 2 %. An intact part does not have more.
    Bound(
        "residual_percent",
        2.0,
        Acceptance.FAIR,
        "the points scatter about the ellipsoid by more than a sensor's noise: iron that moved, a current, or "
        "turning too fast for the sensor",
    ),
    Bound(
        "axis_ratio",
        LARGEST_AXIS_RATIO,
        Acceptance.REFUSED,
        "the ellipsoid is longer than any board's iron makes it, and the points cover only part of it; check that "
        "these are the columns of one magnetometer",
    ),
    # The earth's field is 22 to 67 uT at the surface (World Magnetic Model).
    Bound(
        "radius_ut",
        20.0,
        Acceptance.REFUSED,
        "the field is weaker than the earth's anywhere; wrong unit, shielding, or a fit that went astray",
        below=True,
    ),
    Bound(
        "radius_ut",
        70.0,
        Acceptance.REFUSED,
        "the field is stronger than the earth's anywhere; wrong unit, or a fit that went astray",
    ),
    # A field that varies and a sensor without iron have about 1, the iron of a board less, unless it is as small as the
    # noise.
    Bound(
        "residual_of_spread",
        0.5,
        Acceptance.REFUSED,
        "the calibration hardly makes the norms more equal: no iron to correct, or a field that varies; turn the "
        "sensor in one place",
    ),
    # A calibration is made for headings within 2 deg, and boards without any err by 5 to 10.
    Bound(
        "direction_error_deg",
        5.0,
        Acceptance.REFUSED,
        "the points determine directions hardly better than without calibration; take more points, in all directions",
    ),
    Bound(
        "halves_difference",
        3.0,
        Acceptance.REFUSED,
        "the calibrations of the log's halves contradict each other: the field, the iron or the sensor changed; fit a "
        "part of the log",
    ),
    Bound(
        "direction_error_deg",
        2.0,
        Acceptance.POOR,
        "more than the thesis allows any calibrator; take more points, in all directions",
    ),
    # Half of the 2 deg that the thesis allows a calibrator, to leave the other half for soft iron and tilt.
    Bound(
        "direction_error_deg",
        1.0,
        Acceptance.FAIR,
        "corrected directions have this rms error; take more points, in all directions",
    ),
    # Like no calibration at all. With so much iron a tenth of the sphere, or a flat ring, determines nothing else.
    Bound(
        "strong_iron_deg",
        10.0,
        Acceptance.REFUSED,
        "if iron stretches the field by a fifth, directions have this error; turn the sensor further",
    ),
    # A whole ellipsoid identifies outliers; in a patch with so many of them the rest may not be a sphere either.
    Bound(
        "left_out_percent",
        100.0 * MANY_LEFT_OUT,
        Acceptance.REFUSED,
        "so many samples are outliers that the others may not lie on a sphere either; use samples of a steady field, "
        "and turn the sensor in all directions",
    ),
    # Any detectable step is as large: 1.7 deg across, on one side of the step or the other.
    Bound(
        "change_percent",
        0.0,
        Acceptance.POOR,
        "the hard iron differs before and after; fit one part, or move the sensor away from moving iron",
    ),
    # Any detectable growth: its middle is fitted, and 3 % of the strength are 0.9 % of residual.
    Bound(
        "growth_percent",
        0.0,
        Acceptance.FAIR,
        "the field's strength or the sensor's scale changes over the log; let the sensor warm up and stay in one place",
    ),
)

_NO_ELLIPSOID = {
    FitStatus.REFUSED: "the calibrator refused the points",
    FitStatus.NOT_AN_ELLIPSOID: "the best surface is not an ellipsoid",
    FitStatus.POOR_COVERAGE: "the calibrator rejected the points as too unevenly spread for an ellipsoid",
    FitStatus.TOO_FEW_POINTS: "an ellipsoid needs at least 9 points, a ridge 10, a sphere or ellipse 6, a circle 4",
    FitStatus.SINGULAR: "no finite solution: the points lie in a plane, on a line or in one place, or the calibrator "
    "returned numbers that are not finite, or a matrix without an inverse",
    FitStatus.NOT_CONVERGED: "the calibrator's iteration did not end",
    FitStatus.HORIZONTAL_FIELD: "the dip of the field is too small to find its direction from gravity",
    FitStatus.MIRRORED: "the calibration is a reflection; an axis, or the sign of an axis or of gravity, is wrong",
}

_IN_SPACE = "soft iron is assumed to be small in directions without samples; turn the sensor in all directions"
_IN_PLANE = "it corrects headings only in this attitude of the sensor; turn it about a second axis as well"


def rate(figures: FitFigures) -> tuple[Acceptance, tuple[Reason, ...]]:
    """Rate a calibration: return its verdict, and every reason why it is not good."""
    reasons = tuple(_reasons(figures))
    return worst([reason.verdict for reason in reasons]), reasons


def rate_by(bounds: Sequence[Bound], figures: Mapping[str, float | None]) -> tuple[Acceptance, tuple[Reason, ...]]:
    """Rate figures by their names: return the verdict, and every reason why it is not good; None is not rated."""
    reasons = tuple(_broken(bounds, figures))
    return worst([reason.verdict for reason in reasons]), reasons


def worst(verdicts: Sequence[Acceptance]) -> Acceptance:
    """Return the worst of some verdicts, good when there is none."""
    return max(verdicts, key=list(Acceptance).index, default=Acceptance.GOOD)


def _reasons(figures: FitFigures) -> Iterator[Reason]:
    if figures.status is not FitStatus.ELLIPSOID:
        yield Reason(
            "status",
            status_words(figures.status),
            status_words(FitStatus.ELLIPSOID),
            "",
            Acceptance.REFUSED,
            _NO_ELLIPSOID[figures.status],
        )
    if figures.shape is not None:
        yield Reason(
            "shape",
            figures.shape,
            status_words(FitStatus.ELLIPSOID),
            "",
            Acceptance.FAIR,
            _IN_PLANE if figures.shape.axes == 2 else _IN_SPACE,
        )
    whole = figures.condition is not None and figures.condition <= WELL_CONDITIONED
    yield from _broken(
        BOUNDS,
        {
            bound.figure: None if whole and bound.figure == "axis_ratio" else getattr(figures, bound.figure)
            for bound in BOUNDS
        },
    )


def _broken(bounds: Sequence[Bound], figures: Mapping[str, float | None]) -> Iterator[Reason]:
    reported = set()
    for bound in bounds:
        value = figures.get(bound.figure)
        if value is not None and bound.figure not in reported and bound.broken_by(value):
            reported.add(bound.figure)
            yield Reason(bound.figure, value, bound.limit, bound.unit, bound.verdict, bound.meaning)


def status_words(status: FitStatus) -> str:
    """Return a status in words."""
    return status.name.lower().replace("_", " ")
