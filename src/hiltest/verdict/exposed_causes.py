"""Known bugs that wrong headings at the poses of a run can show, and those that look alike there."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from hiltest.measurement import Limit
from hiltest.orientation.angles import Pose, rotation_body_from_ned
from hiltest.orientation.heading_models import MODELS, Array, Model, Poses, Stage, noisy_answers
from hiltest.run_record.run import Run
from hiltest.text import join_words
from hiltest.verdict.heading_evidence import read_vectors
from hiltest.verdict.reported_headings import noise_of_limit

LEAST_SIGMAS = 5.0
"""Distance of two causes that a run tells apart, in standard deviations of the noise."""
_NAMED_AT_MOST = 5
_SAME_DEG = 1e-6
_ATTITUDES, _GOLDEN, _LARGEST_TILT_DEG = 200, (5.0**0.5 - 1.0) / 2.0, 60.0


@dataclass(frozen=True, slots=True)
class CausePair:
    """Two causes, and how far apart their headings are."""

    one: str
    other: str
    sigmas: float
    """Root of the summed squares of the differences at all poses, in standard deviations of the noise."""


@dataclass(frozen=True, slots=True, eq=False)
class _Row:
    model: Model
    words: str
    headings: NDArray[np.complex128]
    """Shape (n,). Mean headings as points of the unit circle."""

    def differences_deg(self, other: _Row) -> Array:
        return np.asarray(np.degrees(np.angle(self.headings * other.headings.conj())))


def cause_pairs(poses: Poses) -> list[CausePair]:
    """Return the pairs of causes without a fitted size, the weakest first; a right compass is a cause as well.

    Causes whose headings are equal in every attitude are no pair, nor are two sizes of one cause.
    """
    rows = zip(_rows(poses), _rows(_everywhere(poses)), strict=True)
    pairs = [
        CausePair(one.words, other.words, float(np.linalg.norm(one.differences_deg(other))) / poses.noise_deg)
        for (one, one_everywhere), (other, other_everywhere) in combinations(rows, 2)
        if not (one.model is other.model and one.model.size)
        and np.abs(one_everywhere.differences_deg(other_everywhere)).max() > _SAME_DEG
    ]
    return sorted(pairs, key=lambda pair: pair.sigmas)


def poses_in(attitudes: Sequence[Pose], field_ned_ut: Sequence[float], noise_deg: float) -> Poses:
    """Return the answers of a right compass in some attitudes of the board."""
    turns = np.array([rotation_body_from_ned(attitude) for attitude in attitudes])
    headings_deg = np.array([attitude.heading_deg for attitude in attitudes])
    return Poses(turns @ np.array(field_ned_ut), turns @ np.array([0.0, 0.0, 1.0]), headings_deg, noise_deg)


def noise_of_limits(limits: Mapping[str, Limit | None]) -> float:
    """Return the noise of headings [deg] that the smallest limit of a largest error allows for."""
    largest_deg = [
        limit.max
        for name, limit in limits.items()
        if limit is not None and limit.max is not None and name.startswith("heading.") and name.endswith(".max")
    ]
    return noise_of_limit(min(largest_deg, default=None))


def hidden_causes(run: Run) -> str:
    """Return the bugs that no heading of a run can show, in words; empty without any, and without true vectors."""
    vectors = run.table("heading.known")
    if vectors is None or not vectors.rows:
        return ""
    noise_deg = noise_of_limits({measurement.name: measurement.limit for measurement in run.measurements})
    field, gravity = (read_vectors(vectors, name) for name in ("field", "gravity"))
    right, *rows = _rows(Poses(field, gravity, np.zeros(len(field)), noise_deg))
    hidden = [row.words for row in rows if np.linalg.norm(row.differences_deg(right)) < LEAST_SIGMAS * noise_deg]
    return join_words(hidden, _NAMED_AT_MOST)


def _rows(poses: Poses) -> Iterator[_Row]:
    """Yield a right compass and each model without fitted parameters, with headings that are means over the noise.

    A jump at a pose counts with its share of the noise.
    """
    right = Model("no bug", Stage.HEADING, "", lambda heading_deg, _: heading_deg)
    for model in (right, *(model for model in MODELS if not model.limits)):
        for choice in np.zeros((1, 0)) if model.choices is None else model.choices:
            angles = np.radians(noisy_answers(poses, (model,), choice))
            yield _Row(model, model.words(choice), np.exp(1j * angles).mean(axis=0))


def _everywhere(poses: Poses) -> Poses:
    """Return poses in the same field that cover headings and tilts evenly."""
    down_ut = float(poses.field_ut[0] @ poses.gravity_g[0])
    north_ut = float(np.linalg.norm(poses.field_ut[0] - down_ut * poses.gravity_g[0]))
    shares = np.outer(np.arange(_ATTITUDES), _GOLDEN ** np.arange(1.0, 4.0)) % 1.0
    angles_deg = np.array([360.0, *2 * [2.0 * _LARGEST_TILT_DEG]]) * (shares - [0.0, 0.5, 0.5])
    return poses_in([Pose(*angles) for angles in angles_deg.tolist()], (north_ut, 0.0, down_ut), poses.noise_deg)
