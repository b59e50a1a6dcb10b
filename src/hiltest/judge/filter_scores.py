"""Errors of judged filters, by motion and by phase."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hiltest.calibration.fit import Array
from hiltest.errors import ConfigError
from hiltest.judge.filters import FilterAnswers, JudgedFilter, median_cycles
from hiltest.orientation.attitude_errors import attitude_errors, phases
from hiltest.orientation.motion_recording import MotionRecording

MOTION = "motion"
"""Phase that the benchmark's score is of."""
_DIGITS = 6
_LEAST_HORIZONTAL = math.sin(math.radians(10.0))  # of the body's x axis, without which it has no heading


@dataclass(frozen=True, slots=True)
class PhaseScore:
    """Root-mean-square errors in one phase of a motion [deg]."""

    motion: str
    phase: str
    total_deg: float | None
    heading_deg: float
    inclination_deg: float | None
    """None if the filter returns headings only."""
    answers: int


@dataclass(frozen=True, slots=True)
class FilterResult:
    """Result of one filter."""

    name: str
    role: str
    """``judged``, ``against`` or ``hiltest``."""
    built_by: str
    cycle_model: str
    cycles: int | None
    low: int | None
    high: int | None
    """Median of the cycles of an update in the first motion, and its uncertainty range."""
    most_cycles: int | None
    """Most cycles of an update in any motion."""
    host_us: float | None
    """Time of an update on the host; it depends on the host [us]."""
    scores: tuple[PhaseScore, ...]

    def mean_deg(self, error: str) -> float | None:
        """Return the mean of an error over the motions, in the phase of the benchmark: ``total``, ``heading`` or
        ``inclination``."""
        values = [getattr(score, f"{error}_deg") for score in self.scores if score.phase == MOTION]
        return None if not values or None in values else round(sum(values) / len(values), _DIGITS)


def judge_filter(
    filter_: JudgedFilter,
    role: str,
    motions: Sequence[MotionRecording],
    tell: Callable[[MotionRecording], None] = lambda _motion: None,
) -> FilterResult:
    """Judge a filter in all motions.

    Parameters
    ----------
    motions
        At least one.
    tell
        Is called before each motion.

    Raises
    ------
    ConfigError
        If an answer is no attitude.
    """
    scores: list[PhaseScore] = []
    cycles: list[Array] = []
    bands, times_us = [], []
    for motion in motions:
        tell(motion)
        answers = filter_.follow(motion)
        cycles.append(answers.cycles)
        bands.append(answers.band)
        times_us.append(answers.host_us)
        scores += _scores(filter_.name, motion, answers)
    first = cycles[0]
    return FilterResult(
        filter_.name,
        role,
        filter_.built_by,
        filter_.cycle_model,
        median_cycles(first) if len(first) else None,
        bands[0].low if bands[0] else None,
        bands[0].high if bands[0] else None,
        max(int(counts.max()) for counts in cycles) if len(first) else None,
        times_us[0],
        tuple(scores),
    )


def _scores(name: str, motion: MotionRecording, answers: FilterAnswers) -> list[PhaseScore]:
    truth = motion.truth[answers.places]
    masks = {phase: mask[answers.places] for phase, mask in phases(motion).items()}
    if answers.quaternions is None:
        assert answers.headings_deg is not None
        return _heading_scores(name, motion.name, answers.headings_deg, truth, masks)
    try:
        errors = attitude_errors(answers.quaternions, truth)
    except ConfigError as error:
        raise ConfigError(f"{name} in the motion {motion.name}: {error}") from error
    scored = [(phase, errors.score(mask)) for phase, mask in masks.items()]
    return [
        PhaseScore(
            motion.name,
            phase,
            round(score.total_deg, _DIGITS),
            round(score.heading_deg, _DIGITS),
            round(score.inclination_deg, _DIGITS),
            score.samples,
        )
        for phase, score in scored
        if score is not None
    ]


def _heading_scores(
    name: str, motion: str, headings_deg: Array, truth: Array, masks: Mapping[str, NDArray[np.bool_]]
) -> list[PhaseScore]:
    """Return errors of headings: angles of the x axis clockwise from north, where it is not near the vertical."""
    if not np.isfinite(headings_deg).all():
        raise ConfigError(f"{name} in the motion {motion}: a heading is not finite")
    x, y, z, w = truth.T
    north, east = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z)
    has_heading = np.hypot(north, east) > _LEAST_HORIZONTAL  # False for NaN
    errors = (headings_deg - np.degrees(np.arctan2(east, north)) + 180.0) % 360.0 - 180.0
    scores = []
    for phase, mask in masks.items():
        counted = mask & has_heading
        if counted.any():
            rms_deg = round(math.sqrt(float(np.mean(errors[counted] ** 2))), _DIGITS)
            scores.append(PhaseScore(motion, phase, None, rms_deg, None, int(counted.sum())))
    return scores
