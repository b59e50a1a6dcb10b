"""Known bugs that wrong headings at the poses of a run can show, and those that look alike there."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from hiltest.measurement import Limit
from hiltest.orientation.angles import Pose, rotation_body_from_ned
from hiltest.run_record.run import Run
from hiltest.text import join_words
from hiltest.verdict.heading_evidence import read_vectors
from hiltest.verdict.heading_models import MODELS, Array, Model, Poses, answered_headings
from hiltest.verdict.heading_models import _wrap as wrap

LEAST_SIGMAS = 5.0
"""Distance of two causes that a run tells apart, in standard deviations of the noise."""
_NO_BUG = "no bug"
_NAMED_AT_MOST = 5
# A limit is far enough from the errors of right firmware: their rms is at most about a quarter of it.
_NOISE_OF_LIMIT, _USUAL_LIMIT_DEG = 0.25, 2.0
_SAME_DEG = 1e-3
_TURNS = 8
_ATTITUDES, _GOLDEN, _LARGEST_TILT_DEG = 200, (5.0**0.5 - 1.0) / 2.0, 60.0


@dataclass(frozen=True, slots=True)
class CausePair:
    """Two causes, and how far apart their headings are."""

    one: str
    other: str
    sigmas: float
    """Root of the summed squares of the differences at all poses, in standard deviations of the noise."""


def cause_pairs(poses: Poses) -> list[CausePair]:
    """Return the pairs of causes without a fitted size, the weakest first; a right compass is a cause as well.

    Causes whose headings are equal in every attitude are no pair, nor are two sizes of one cause.
    """
    rows = list(zip(_rows(poses), _rows(_everywhere(poses)), strict=True))
    pairs = [
        CausePair(one[1], other[1], float(np.linalg.norm(wrap(one[2] - other[2]) / poses.noise_deg)))
        for (one, one_everywhere), (other, other_everywhere) in combinations(rows, 2)
        if not (one[0] is other[0] and one[0].size)
        and np.abs(wrap(one_everywhere[2] - other_everywhere[2])).max() > _SAME_DEG
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
    return _NOISE_OF_LIMIT * min(largest_deg, default=_USUAL_LIMIT_DEG)


def hidden_causes(run: Run) -> str:
    """Return the bugs that no heading of a run can show, in words; empty without any, and without true vectors."""
    vectors = run.table("heading.known")
    if vectors is None or not vectors.rows:
        return ""
    noise_deg = noise_of_limits({measurement.name: measurement.limit for measurement in run.measurements})
    field, gravity = (read_vectors(vectors, name) for name in ("field", "gravity"))
    _, *rows = _rows(Poses(field, gravity, np.zeros(len(field)), noise_deg))
    hidden = [words for _, words, errors in rows if np.linalg.norm(errors) < LEAST_SIGMAS * noise_deg]
    return join_words(hidden, _NAMED_AT_MOST)


_NONE = Model(_NO_BUG, MODELS[0].stage, "", lambda heading_deg, _: heading_deg)


def _rows(poses: Poses) -> Iterator[tuple[Model, str, Array]]:
    """Yield each model with a cause in words and its mean errors, shape (n,).

    The headings scatter evenly, with the noise's standard deviation, so that a jump at a pose becomes a ramp.
    """
    shares = np.repeat((np.arange(_TURNS) + 0.5) / _TURNS - 0.5, len(poses.field_ut))[:, None]
    field, gravity = (np.tile(vectors, (_TURNS, 1)) for vectors in (poses.field_ut, poses.gravity_g))
    down, angle = (field * gravity).sum(axis=1, keepdims=True) * gravity, np.radians(np.sqrt(12.0) * poses.noise_deg)
    cos, sin = np.cos(angle * shares), np.sin(angle * shares)
    turned = Poses(
        down + cos * (field - down) - sin * np.cross(gravity, field), gravity, np.zeros(len(field)), poses.noise_deg
    )
    true_deg = np.tile(poses.headings_deg(), _TURNS)
    for model in (_NONE, *(model for model in MODELS if not model.limits)):
        choices = np.zeros((1, 0)) if model.choices is None else model.choices
        errors = answered_headings(turned, (model,), choices.T) - true_deg
        means = np.exp(1j * np.radians(errors)).reshape(len(choices), _TURNS, -1).mean(axis=1)
        for choice, mean in zip(choices, means, strict=True):
            yield model, model.words(choice), np.degrees(np.angle(mean))


def _everywhere(poses: Poses) -> Poses:
    """Return poses in the same field that cover headings and tilts evenly."""
    down_ut = float(poses.field_ut[0] @ poses.gravity_g[0])
    north_ut = float(np.linalg.norm(poses.field_ut[0] - down_ut * poses.gravity_g[0]))
    shares = np.outer(np.arange(_ATTITUDES), _GOLDEN ** np.arange(1.0, 4.0)) % 1.0
    angles_deg = np.array([360.0, *2 * [2.0 * _LARGEST_TILT_DEG]]) * (shares - [0.0, 0.5, 0.5])
    return poses_in([Pose(*angles) for angles in angles_deg.tolist()], (north_ut, 0.0, down_ut), 1.0)
