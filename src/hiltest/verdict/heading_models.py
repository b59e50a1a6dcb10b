"""Models of known bugs in compass firmware, fitted to the headings that it answers at known poses.

A model changes one stage of a right compass: its field, its gravity, the formula for the heading, the heading, or the
sequence of headings. Models of several stages combine. Vectors have the shape (3, k, n) and headings (k, n), for k sets
of parameters and n poses; parameters have the shape (p, k, 1). A parameter of 0 changes nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from functools import partial
from itertools import combinations, permutations, product
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]

MOST_CAUSES = 3
LEAST_GAIN = 10.0
"""Decrease of the criterion that a further cause, or a larger model than another one, must achieve."""
_OUTLIERS = 0.05  # prior share of poses that no model explains
_MOST_ISOLATED = 0.2  # share of poses above which unexplained ones are no exceptions
_LARGEST_NOISE = 1.5  # rms of a remainder that counts as noise, as a multiple of the noise
_FAR = 5.0  # error of an outlier, as a multiple of the noise
_STICKS_OUT = 2.0  # error of an exception, as a multiple of the largest other error
_MOST_REMAINS = 0.5  # largest share of the rms error that a partial explanation leaves
_SAME = 0.5  # largest difference between equal answers, as a multiple of the noise
_WIDE_DEG = 10.0  # noise while a fit approaches: errors are large at first
_APPROACH = ((20.0, 3), (5.0, 3), (1.0, 2), (0.0, 9))  # noise [deg], 0 for that of the poses, and steps
_CONVERGED = 1e-4
_WIDE = (_WIDE_DEG, 3.0)
_SAMPLES, _STARTS = 200, 3
_STEP = 1e-5
_NAMED_AT_MOST = 3


class Stage(IntEnum):
    """Stage of a compass that a bug changes, in the order of computation."""

    FIELD = 0
    GRAVITY = 1
    FORMULA = 2
    HEADING = 3
    SEQUENCE = 4


@dataclass(frozen=True, slots=True, eq=False)
class Poses:
    """True vectors at the poses of a run, in their order, and the headings that the firmware answered."""

    field_ut: Array
    gravity_g: Array
    """Shape (n, 3). Vectors in the body frame."""
    answered_deg: Array
    """Shape (n,)."""
    noise_deg: float
    """Error of a heading of right firmware, rms."""
    stages: Sequence[Stage] = tuple(Stage)
    """Stages whose models are fitted: without the true field only the last ones."""
    hard_iron_ut: Array | None = None
    """Shape (3,). Hard iron that the firmware reports."""

    def headings_deg(self) -> Array:
        """Return the true headings, shape (n,)."""
        return np.asarray(answered_headings(self, (), np.zeros((0, 1)))[0])


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """A known bug."""

    name: str
    """Noun phrase, followed by the size of the bug in a sentence."""
    stage: Stage
    place: str
    """Part of the firmware to check."""
    change: Callable[..., Array]
    """Function of the stage's input and the parameters, which returns its output."""
    limits: tuple[tuple[float, float], ...] = ()
    """Range of each fitted parameter."""
    choices: Array | None = None
    """Shape (k, p). Sets of parameters to choose from, if they are not fitted."""
    size: Callable[[Array], str] = lambda parameters: ""
    """Parameters in words."""

    def words(self, parameters: Array) -> str:
        """Return name and size."""
        size = self.size(parameters)
        return f"{self.name} ({size})" if size else self.name

    @property
    def penalty(self) -> float:
        """Number of sets of parameters to choose from, as twice its logarithm."""
        return 0.0 if self.choices is None else 2.0 * float(np.log(len(self.choices)))


@dataclass(frozen=True, slots=True)
class FittedCause:
    """A bug that explains headings, with its size."""

    names: tuple[str, ...]
    """The bug with its size, and others with the same answers at all poses."""
    places: tuple[str, ...]
    """Parts of the firmware to check."""
    explains_deg: float
    """rms error that appears if this cause alone is left out."""

    @property
    def words(self) -> str:
        """Names as part of a sentence."""
        return " or ".join(self.names[:_NAMED_AT_MOST])


@dataclass(frozen=True, slots=True)
class Explanation:
    """Causes of wrong headings, that of the largest error first."""

    causes: tuple[FittedCause, ...]
    remainder_deg: float
    """rms error that they do not explain, without isolated poses."""
    is_noise: bool
    pattern: str
    """Description of a remainder that is not noise."""

    @property
    def words(self) -> str:
        """Causes and pattern in words; empty without a cause."""
        words = ", and ".join(cause.words for cause in self.causes)
        if not words or self.is_noise:
            return words
        return f"{words}; this explains only a part: {self.remainder_deg:.2g} deg remain, {self.pattern}"

    @property
    def places(self) -> str:
        """Parts of the firmware to check."""
        return "; ".join(dict.fromkeys(place for cause in self.causes for place in cause.places[:_NAMED_AT_MOST]))


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    models: tuple[Model, ...]
    parameters: Array
    """Shape (p,), those of all models."""
    criterion: float
    """Criterion, with the least gain of each model."""
    penalty: float
    answers_deg: Array

    @property
    def fitted(self) -> int:
        return sum(len(model.limits) for model in self.models)

    def model_parameters(self) -> list[tuple[Model, Array]]:
        """Return the models with their parameters."""
        ends = np.cumsum([_count(model) for model in self.models], dtype=int)
        return list(zip(self.models, np.split(self.parameters, ends)[:-1], strict=True))


def fit_causes(poses: Poses) -> Explanation:
    """Return the bugs that explain the headings, added one after another.

    The criterion is that of Schwarz (BIC): minus twice the logarithm of the likelihood, with a share of outliers, and
    the logarithm of the number of poses for each parameter. Every cause must lower it by `LEAST_GAIN`. A bug that
    another one hides has no likelihood by itself, so the search also continues from the sets that are best at a larger
    noise.
    """
    models = [model for model in (*MODELS, *models_of_run(poses)) if model.stage in poses.stages]
    bases = sets = [_fit(poses, ())]
    for number in range(MOST_CAUSES):
        further = [
            _fit(poses, (*base.models, model), base.parameters)
            for base in bases
            for model in models
            if model not in base.models
            and not (model.stage is Stage.FORMULA and any(used.stage is Stage.FORMULA for used in base.models))
        ]
        if not number and not _is_noise(poses, _choose(further)):
            further += [_fit(poses, pair, start) for pair, start in _pairs(models)]
        sets, best = [*sets, *further], _choose(further)
        if _choose(sets) not in further and _is_noise(poses, _choose(sets)):
            break
        bases = [best] if len(best.models) < MOST_CAUSES else []
        if not _is_noise(poses, best):
            wide = [min(further, key=partial(_wide_criterion, poses, width_deg)) for width_deg in _WIDE]
            bases = list(dict.fromkeys([best, *wide]))
    return _explanation(poses, _choose(sets), sets)


def _pairs(models: Sequence[Model]) -> list[tuple[tuple[Model, Model], Array]]:
    """Return the pairs of models with few choices and no other parameter, and the choices of the first one."""
    simple = [model for model in models if not model.limits and (model.choices is None or len(model.choices) <= 4)]
    pairs = [(one, other) for one, other in combinations(simple, 2) if one.stage is not other.stage]
    return [((one, other), start) for one, other in pairs for start in _start_values(one).T]


def _choose(fits: Sequence[_Fit]) -> _Fit:
    """Return the fit of the lowest criterion, or a smaller one that is hardly worse."""
    lowest = min(fit.criterion for fit in fits)
    near = [fit for fit in fits if fit.criterion < lowest + LEAST_GAIN]
    return min(near, key=lambda fit: (fit.fitted + len(fit.models), fit.criterion))


def _wide_criterion(poses: Poses, width_deg: float, fit: _Fit) -> float:
    return float(_scores(poses, fit.answers_deg, width_deg)) + fit.penalty


def _is_noise(poses: Poses, fit: _Fit) -> bool:
    ratio = _wrap(poses.answered_deg - fit.answers_deg) / poses.noise_deg
    is_far = np.abs(ratio) >= _FAR
    return bool(is_far.mean() <= _MOST_ISOLATED and _rms(ratio[~is_far]) < _LARGEST_NOISE)


def _explanation(poses: Poses, best: _Fit, fits: Sequence[_Fit]) -> Explanation:
    causes = []
    for index, (model, parameters) in enumerate(best.model_parameters()):
        others = best.models[:index] + best.models[index + 1 :]
        rows = [(model, parameters)]
        rows += [
            next(row for row in fit.model_parameters() if row[0] not in others)
            for fit in fits
            if fit is not best and set(others) < set(fit.models) and _are_same(poses, fit, best)
        ]
        remaining = [values for other, values in best.model_parameters() if other is not model]
        without = answered_headings(poses, others, np.concatenate([np.zeros(0), *remaining])[:, None])[0]
        causes.append(
            FittedCause(
                tuple(dict.fromkeys(row.words(values) for row, values in rows)),
                tuple(dict.fromkeys(row.place for row, _ in rows)),
                _rms(_wrap(without - best.answers_deg)),
            )
        )
    errors = _wrap(poses.answered_deg - best.answers_deg)
    is_isolated = _share_of_outliers(errors / poses.noise_deg, poses.noise_deg) > 0.5
    inner, largest_deg = errors[~is_isolated], _LARGEST_NOISE * poses.noise_deg
    is_few = 0 < is_isolated.sum() <= _MOST_ISOLATED * len(errors) and _rms(inner) <= largest_deg
    if is_few and np.abs(errors[is_isolated]).min() >= _STICKS_OUT * np.abs(inner).max():
        causes.append(_isolated_poses(poses, errors, is_isolated))
        errors = np.where(is_isolated, 0.0, errors)
    causes.sort(key=lambda cause: -cause.explains_deg)
    remainder_deg = _rms(errors)
    is_noise = remainder_deg <= largest_deg
    if not is_noise and remainder_deg > _MOST_REMAINS * _rms(_wrap(poses.answered_deg - poses.headings_deg())):
        causes = []  # causes that explain so little are none
    return Explanation(tuple(causes), remainder_deg, is_noise, "" if is_noise else _pattern(poses, errors))


def _are_same(poses: Poses, one: _Fit, other: _Fit) -> bool:
    """Return whether two sets of as many models and parameters have equal answers."""
    if (len(one.models), one.fitted) != (len(other.models), other.fitted):
        return False
    return bool(np.abs(_wrap(one.answers_deg - other.answers_deg)).max() <= _SAME * poses.noise_deg)


def _isolated_poses(poses: Poses, errors: Array, is_isolated: NDArray[np.bool_]) -> FittedCause:
    """Describe the few poses that no bug of all poses explains."""
    before = np.abs(_wrap(poses.answered_deg - np.roll(poses.answered_deg, 1))) <= _FAR * poses.noise_deg
    before[0], count = False, int(is_isolated.sum())
    near_north = np.abs(_wrap(poses.headings_deg())) < _NEAR_NORTH_DEG
    numbers = ", ".join(str(index + 1) for index in np.flatnonzero(is_isolated)[:5]) + ", ..." * (count > 5)
    if before[is_isolated].all():
        name, place = "poses at which the board was not turned or stale samples", _PLACE_OF_STALE
    elif near_north[is_isolated].all() and count > 1:
        name, place = "an average of headings across 0 and 360 degrees", _PLACE_OF_AVERAGE
    else:
        name, place = "single corrupt headings", _PLACE_OF_CORRUPT
    size = f"pose{'s' * (count > 1)} {numbers} of {len(errors)}"
    return FittedCause((f"{name} ({size})",), (place,), _rms(np.where(is_isolated, errors, 0.0)))


_NEAR_NORTH_DEG = 5.0
_PLACE_OF_STALE = "the turntable at these poses, and the data-ready flag or the sequence number of samples"
_PLACE_OF_AVERAGE = "the average or filter of headings: average their sines and cosines"
_PLACE_OF_CORRUPT = "reading of the sensors: torn reads, samples that are 0, an unlocked bus"


def _pattern(poses: Poses, errors: Array) -> str:
    """Describe how errors depend on the pose."""
    pitch_deg, roll_deg = _tilt_deg(poses.gravity_g.T)
    is_level = np.hypot(pitch_deg, roll_deg) < 2.0
    if 0 < is_level.sum() < len(errors) and _rms(errors[is_level]) <= min(0.5 * _rms(errors), 2.0 * poses.noise_deg):
        by = {"pitch": np.abs(pitch_deg), "roll": np.abs(roll_deg)}
        share = {name: _correlation(np.abs(errors), tilt) for name, tilt in by.items()}
        first, second = sorted(share, key=lambda name: -share[name])
        tilt = first if share[first] > share[second] + 0.2 else "tilt"
        return f"level poses are right and the error grows with {tilt}"
    heading = np.radians(poses.headings_deg())
    for times, words in ((1, "once"), (2, "twice")):
        waves = np.column_stack([np.sin(times * heading), np.cos(times * heading), np.ones_like(heading)])
        if _rms(errors - waves @ np.linalg.lstsq(waves, errors, rcond=None)[0]) < 0.5 * _rms(errors - errors.mean()):
            return f"the error goes up and down {words} in a turn"
    if _correlation(np.abs(errors), np.arange(len(errors), dtype=float)) > 0.6:
        return "the error grows during the run"
    return "without a pattern in heading, tilt or time"


def _fit(poses: Poses, models: tuple[Model, ...], start: Array | None = None) -> _Fit:
    """Fit the last model, and the fitted parameters of the ones before together with it.

    Parameters
    ----------
    start : shape (p,)
        Parameters of the models before.
    """
    start = np.zeros(0) if start is None else start
    last = models[-1] if models else None
    further = np.zeros((0, 1)) if last is None else _start_values(last)
    values = np.vstack([np.repeat(start[:, None], further.shape[1], axis=1), further])
    limits = np.array([limit for model in models for limit in _limits(model)]).reshape(-1, 2)
    free = np.flatnonzero(limits[:, 0] < limits[:, 1])
    answers = answered_headings(poses, models, values)
    if values.shape[1] > _STARTS:
        # Wrong parameters of a right model have some large errors: a wide distribution tolerates them.
        width_deg = _WIDE_DEG if free.size else poses.noise_deg
        scores = _scores(poses, answers, width_deg)
        order = np.argsort(scores)[:_STARTS]
        values, answers = values[:, order], answers[order]
    scores = _scores(poses, answers, poses.noise_deg)
    index = int(np.argmin(scores))
    best = values[:, index], float(scores[index]), answers[index]
    if free.size:
        for width_deg, most in _APPROACH:
            for _ in range(most):
                before = values
                values, answers = _improved(poses, models, before, free, limits, max(width_deg, poses.noise_deg))
                scores = _scores(poses, answers, poses.noise_deg)
                index = int(np.argmin(scores))
                if scores[index] < best[1] - _CONVERGED:
                    best = before[:, index], float(scores[index]), answers[index]
                elif not width_deg:
                    break
    penalty = free.size * float(np.log(len(poses.answered_deg)))
    penalty += sum(model.penalty + LEAST_GAIN for model in models)
    return _Fit(models, best[0], best[1] + penalty, penalty, best[2])


def _start_values(model: Model) -> Array:
    """Return sets of parameters to start from, shape (p, k); small ones are more frequent."""
    if model.choices is not None:
        return model.choices.T
    if not model.limits:
        return np.zeros((0, 1))
    low, high = np.array(model.limits).T[:, :, None]
    uniform = np.random.default_rng(1).uniform(-1.0, 1.0, (len(model.limits), _SAMPLES))
    uniform[:, 0] = 0.0
    return np.asarray(np.clip(uniform * np.abs(uniform) * np.maximum(np.abs(low), np.abs(high)), low, high))


def _limits(model: Model) -> Sequence[tuple[float, float]]:
    return model.limits or ((0.0, 0.0),) * _count(model)


def _count(model: Model) -> int:
    return len(model.limits) if model.choices is None else model.choices.shape[1]


def _improved(
    poses: Poses, models: tuple[Model, ...], values: Array, free: NDArray[np.intp], limits: Array, width_deg: float
) -> tuple[Array, Array]:
    """Return the parameters after a step of Gauss and Newton, shape (p, k), and the answers before it, shape (k, n).

    Outliers have no weight.
    """
    p, k = len(free), values.shape[1]
    steps = _STEP * (limits[free, 1] - limits[free, 0])
    moved = np.repeat(values[:, None, :], p + 1, axis=1)
    moved[free, np.arange(p), :] += steps[:, None]
    answers = answered_headings(poses, models, moved.reshape(len(values), -1)).reshape(p + 1, k, -1)
    errors = _wrap(poses.answered_deg - answers[-1])
    slopes = np.moveaxis(_wrap(answers[:-1] - answers[-1]), 0, -1)  # (k, n, p) per step
    weights = 1.0 - _share_of_outliers(errors / width_deg, width_deg)
    weighted = slopes * weights[:, :, None]
    information = np.einsum("kni,knj->kij", weighted, slopes)
    diagonal = np.einsum("kii->ki", information)
    information = information + np.eye(p) * (1e-3 * diagonal + 1e-12)[:, None, :]
    change = np.linalg.solve(information, np.einsum("kni,kn->ki", weighted, errors)[:, :, None])[:, :, 0].T
    result = values.copy()
    result[free] = np.clip(values[free] + change * steps[:, None], limits[free, :1], limits[free, 1:])
    return result, answers[-1]


def _scores(poses: Poses, answers_deg: Array, width_deg: float) -> Array:
    """Return minus twice the logarithm of the likelihood, shape (k,)."""
    ratio = _wrap(poses.answered_deg - answers_deg) / width_deg
    density = (1.0 - _OUTLIERS) * np.exp(-0.5 * ratio**2) + _outlier_density(width_deg)
    return np.asarray(-2.0 * np.log(density).sum(axis=-1))


def _share_of_outliers(ratio: Array, width_deg: float) -> Array:
    """Return the probability that each error comes from no model."""
    outlier = _outlier_density(width_deg)
    return np.asarray(outlier / (outlier + (1.0 - _OUTLIERS) * np.exp(-0.5 * ratio**2)))


def _outlier_density(width_deg: float) -> float:
    """Return the density of an outlier in units of the highest density of the noise."""
    return float(_OUTLIERS * np.sqrt(2.0 * np.pi) * width_deg / 360.0)


def answered_headings(poses: Poses, models: Sequence[Model], values: Array) -> Array:
    """Return the headings of a compass with bugs, shape (k, n); `values` has the shape (p, k)."""
    field, gravity = poses.field_ut.T[:, None, :], poses.gravity_g.T[:, None, :]
    start, changes = 0, []
    for model in models:
        count = _count(model)
        changes.append((model, values[start : start + count, :, None]))
        start += count
    by_stage = {stage: [pair for pair in changes if pair[0].stage is stage] for stage in Stage}
    for model, parameters in by_stage[Stage.FIELD]:
        field = model.change(field, parameters)
    for model, parameters in by_stage[Stage.GRAVITY]:
        gravity = model.change(gravity, parameters)
    if by_stage[Stage.FORMULA]:
        ((model, parameters),) = by_stage[Stage.FORMULA]
        heading_deg = model.change(gravity, field, parameters)
    else:
        heading_deg = _heading_deg(gravity, field)
    for model, parameters in (*by_stage[Stage.HEADING], *by_stage[Stage.SEQUENCE]):
        heading_deg = model.change(heading_deg, parameters)
    return np.asarray(np.broadcast_to(heading_deg, (values.shape[1], len(poses.answered_deg))))


def _wrap(angle_deg: Array) -> Array:
    return np.asarray((angle_deg + 180.0) % 360.0 - 180.0)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _correlation(one: Array, other: Array) -> float:
    spread = float(one.std() * other.std())
    return float(np.mean((one - one.mean()) * (other - other.mean()))) / spread if spread else 0.0


# The formula: pitch and roll from gravity, the field turned back by them, the heading.


def _tilt_deg(gravity: Array) -> tuple[Array, Array]:
    pitch = np.arctan2(-gravity[0], np.hypot(gravity[1], gravity[2]))
    return np.degrees(pitch), np.degrees(np.arctan2(gravity[1], gravity[2]))


def _turned_back(field: Array, pitch: Array, roll: Array, signs: Sequence[float] = (1.0, 1.0, 1.0)) -> Array:
    """Return the heading of a field and angles [rad]; `signs` multiply the terms Y sin sin, Z sin cos and Z sin."""
    x, y, z = field
    north = x * np.cos(pitch) + np.sin(pitch) * (signs[0] * y * np.sin(roll) + signs[1] * z * np.cos(roll))
    west = y * np.cos(roll) - signs[2] * z * np.sin(roll)
    return np.asarray(np.degrees(np.arctan2(-west, north)))


def _heading_deg(
    gravity: Array,
    field: Array,
    parameters: Array | None = None,
    *,
    pitch: float = 1.0,
    roll: float = 1.0,
    signs: Sequence[float] = (1.0, 1.0, 1.0),
    unit: float = 1.0,
) -> Array:
    pitch_deg, roll_deg = _tilt_deg(gravity)
    return _turned_back(field, unit * pitch * np.radians(pitch_deg), unit * roll * np.radians(roll_deg), signs)


def _untilted(gravity: Array, field: Array, parameters: Array) -> Array:
    return np.asarray(np.degrees(np.arctan2(-field[1], field[0])))


def _pitch_first(gravity: Array, field: Array, parameters: Array) -> Array:
    pitch, roll = np.radians(_tilt_deg(gravity))
    x, y, z = field
    north = x * np.cos(pitch) + z * np.sin(pitch)
    west = x * np.sin(roll) * np.sin(pitch) + y * np.cos(roll) - z * np.sin(roll) * np.cos(pitch)
    return np.asarray(np.degrees(np.arctan2(-west, north)))


def _arcsine_heading(gravity: Array, field: Array, parameters: Array) -> Array:
    across = np.arctan2(gravity[1], np.hypot(gravity[0], gravity[2]))
    return _turned_back(field, np.radians(_tilt_deg(gravity)[0]), across)


def _pitch_from_two_axes(gravity: Array, field: Array, parameters: Array) -> Array:
    return _turned_back(field, np.arctan2(-gravity[0], gravity[2]), np.radians(_tilt_deg(gravity)[1]))


def _exchanged_tilt(gravity: Array, field: Array, parameters: Array) -> Array:
    pitch, roll = np.radians(_tilt_deg(gravity))
    return _turned_back(field, roll, pitch)


# Vectors.


def _add(vectors: Array, parameters: Array) -> Array:
    return vectors + parameters


def _scale_axis(vectors: Array, parameters: Array, *, axis: int) -> Array:
    factors = np.ones((3, *parameters.shape[1:]))
    factors[axis] = 2.0 ** parameters[0]
    return vectors * factors


def _drop_axis(vectors: Array, parameters: Array, *, axis: int) -> Array:
    return vectors * np.where(np.arange(3) == axis, 0.0, 1.0)[:, None, None]


def _distort(vectors: Array, parameters: Array) -> Array:
    """Multiply by a symmetric matrix with zz = 1: a common factor turns no heading."""
    xx, yy, xy, xz, yz = parameters
    x, y, z = vectors
    return np.stack(
        np.broadcast_arrays(x + xx * x + xy * y + xz * z, y + xy * x + yy * y + yz * z, z + xz * x + yz * y)
    )


def _rotate(vectors: Array, parameters: Array) -> Array:
    """Rotate by a vector [deg], as Rodrigues."""
    angle = np.radians(np.linalg.norm(parameters, axis=0)) + 1e-12
    axis = np.broadcast_to(np.radians(parameters) / angle, (3, *np.broadcast_shapes(angle.shape, vectors.shape[1:])))
    vectors = np.broadcast_to(vectors, axis.shape)
    along = (axis * vectors).sum(axis=0)
    across = np.cross(axis, vectors, axis=0)
    return np.asarray(vectors * np.cos(angle) + across * np.sin(angle) + axis * along * (1.0 - np.cos(angle)))


def _exchange_axes(vectors: Array, parameters: Array) -> Array:
    matrices = parameters[:, :, 0].reshape(3, 3, -1)
    return np.asarray(
        np.einsum("ijk,jkn->ikn", matrices, np.broadcast_to(vectors, (3, *matrices.shape[2:], vectors.shape[2])))
    )


def _add_to_negative(vectors: Array, parameters: Array) -> Array:
    return np.where(vectors < 0.0, vectors + parameters[0], vectors)


def _clip(vectors: Array, parameters: Array) -> Array:
    level = (1.0 - parameters[0]) * np.abs(vectors).max()
    return np.clip(vectors, -level, level)


# Headings.


def _reversed(heading_deg: Array, parameters: Array) -> Array:
    return np.asarray(parameters[0] - heading_deg)


def _turned(heading_deg: Array, parameters: Array) -> Array:
    return np.asarray(heading_deg + parameters[0])


def _truncated(heading_deg: Array, parameters: Array) -> Array:
    return np.asarray(np.floor(heading_deg % 360.0 / parameters[0]) * parameters[0])


def _multiplied(heading_deg: Array, parameters: Array) -> Array:
    return np.asarray(heading_deg % 360.0 * parameters[0])


def _overflown(heading_deg: Array, parameters: Array) -> Array:
    heading_deg = heading_deg % 360.0
    return np.where(heading_deg > parameters[0], heading_deg - 2.0 * parameters[0], heading_deg)


def _half_turn(heading_deg: Array, parameters: Array) -> Array:
    return np.asarray((heading_deg + 90.0) % 180.0 - 90.0)


# Sequences.


def _frozen(heading_deg: Array, parameters: Array) -> Array:
    """Keep the heading from one pose on; the parameter is the index of the last pose with a new one."""
    index = np.minimum(np.arange(heading_deg.shape[-1]), parameters[0].astype(int))
    return np.take_along_axis(np.broadcast_to(heading_deg, index.shape), index, axis=-1)


def _lagging(heading_deg: Array, parameters: Array, *, wraps: bool) -> Array:
    """Filter with a coefficient; without wrapping, headings of 359 and 1 degrees have the mean 180."""
    heading_deg = np.unwrap(heading_deg, period=360.0) if wraps else heading_deg % 360.0
    steps = np.diff(heading_deg, axis=-1, prepend=heading_deg[:, :1])
    index = np.arange(steps.shape[-1])
    age = index[:, None] - index
    decays = np.where(age >= 0, parameters[0][:, :, None] ** np.maximum(age + 1, 1), 0.0)
    return np.asarray(heading_deg - np.einsum("kij,kj->ki", decays, np.broadcast_to(steps, (len(decays), len(index)))))


# Sizes.


def _components(values: Array, unit: str, digits: int) -> str:
    parts = ", ".join(f"{axis} {value:+.{digits}f}" for axis, value in zip("xyz", values.tolist(), strict=True))
    return f"{float(np.linalg.norm(values)):.{digits}f} {unit}: {parts}"


def _axes_in_words(values: Array) -> str:
    sources = [f"{'-' if row.sum() < 0 else ''}{'xyz'[int(np.abs(row).argmax())]}" for row in values.reshape(3, 3)]
    return f"x, y and z are {', '.join(sources[:2])} and {sources[2]}"


def _turned_words(values: Array) -> str:
    return f"{values[0]:+.2f} deg"


def _frozen_words(values: Array) -> str:
    return f"after pose {int(values[0]) + 1}"


def _axes_choices() -> Array:
    signed = [
        (np.eye(3)[list(order)] * np.array(signs)[:, None]).ravel()
        for order in permutations(range(3))
        for signs in product((1.0, -1.0), repeat=3)
    ]
    return np.array(signed[1:])


_FIELD = "conversion and order of the magnetometer's axes in its driver, beside the data sheet"
_GRAVITY = "conversion and order of the accelerometer's axes in its driver, beside the data sheet"
_TILT = "pitch and roll from gravity, and the formula that turns the field back by them"
_ATAN2 = "order and signs of the arguments of atan2, or frame and heading under [device] in the rig"
_OUTPUT = "the step from the heading to the answer: unit, type and rounding"
_IRON = "the line that applies the calibration: (read - hard iron), once, multiplied by the soft iron from the left"
MODELS: tuple[Model, ...] = (
    Model(
        "constant offset",
        Stage.HEADING,
        "the mounting yaw in the rig, a declination and its sign, and the firmware's axes",
        _turned,
        limits=((-180.0, 180.0),),
        size=_turned_words,
    ),
    Model("headings counted the other way", Stage.HEADING, _ATAN2, _reversed, choices=np.array([[0.0]])),
    *(
        Model(
            f"headings counted the other way from {side}",
            Stage.HEADING,
            _ATAN2,
            _reversed,
            choices=np.array([[zero]]),
        )
        for side, zero in (("east", 90.0), ("south", 180.0), ("west", 270.0))
    ),
    *(
        Model(f"zero of the headings at {side}", Stage.HEADING, _ATAN2, _turned, choices=np.array([[zero]]))
        for side, zero in (("east", -90.0), ("south", 180.0), ("west", 90.0))
    ),
    Model("swapped arguments of atan2", Stage.HEADING, _ATAN2, _reversed, choices=np.array([[90.0]])),
    Model("atan instead of atan2", Stage.HEADING, _ATAN2, _half_turn),
    Model(
        "axes of the magnetometer", Stage.FIELD, _FIELD, _exchange_axes, choices=_axes_choices(), size=_axes_in_words
    ),
    Model(
        "axes of the accelerometer",
        Stage.GRAVITY,
        _GRAVITY,
        _exchange_axes,
        choices=_axes_choices(),
        size=_axes_in_words,
    ),
    Model("no tilt compensation", Stage.FORMULA, _TILT, _untilted),
    Model("sign of pitch", Stage.FORMULA, _TILT, partial(_heading_deg, pitch=-1.0)),
    Model("sign of roll", Stage.FORMULA, _TILT, partial(_heading_deg, roll=-1.0)),
    Model("signs of pitch and roll", Stage.FORMULA, _TILT, partial(_heading_deg, pitch=-1.0, roll=-1.0)),
    *(
        Model(f"sign in the tilt compensation, {term}", Stage.FORMULA, _TILT, partial(_heading_deg, signs=signs))
        for term, signs in (
            ("y sin(pitch) sin(roll)", (-1.0, 1.0, 1.0)),
            ("z sin(pitch) cos(roll)", (1.0, -1.0, 1.0)),
            ("z sin(roll)", (1.0, 1.0, -1.0)),
        )
    ),
    Model("rotation order: pitch before roll", Stage.FORMULA, _TILT, _pitch_first),
    Model("arcsine for roll", Stage.FORMULA, _TILT, _arcsine_heading),
    Model("pitch from x and z alone", Stage.FORMULA, _TILT, _pitch_from_two_axes),
    Model("pitch and roll exchanged", Stage.FORMULA, _TILT, _exchanged_tilt),
    Model("sine and cosine of degrees", Stage.FORMULA, _TILT, partial(_heading_deg, unit=180.0 / np.pi)),
    Model(
        "hard iron",
        Stage.FIELD,
        _IRON,
        _add,
        limits=((-200.0, 200.0),) * 3,
        size=partial(_components, unit="uT", digits=1),
    ),
    Model(
        "soft iron",
        Stage.FIELD,
        _IRON,
        _distort,
        limits=((-0.5, 1.0),) * 2 + ((-0.5, 0.5),) * 3,
        size=lambda values: ", ".join(
            f"{pair} {100 * value:+.0f} %" for pair, value in zip(("xx", "yy", "xy", "xz", "yz"), values, strict=True)
        ),
    ),
    Model(
        "residual rotation of the magnetometer",
        Stage.FIELD,
        _IRON,
        _rotate,
        limits=((-60.0, 60.0),) * 3,
        size=partial(_components, unit="deg", digits=1),
    ),
    *(
        Model(
            f"scale of the {sensor}'s {axis} axis",
            stage,
            place,
            partial(_scale_axis, axis=index),
            limits=((-1.0, 1.0),),
            size=lambda values: f"factor {2.0 ** values[0]:.2f}",
        )
        for sensor, stage, place in (
            ("magnetometer", Stage.FIELD, _FIELD),
            ("accelerometer", Stage.GRAVITY, _GRAVITY),
        )
        for index, axis in enumerate("xyz")
    ),
    *(
        Model(f"{sensor}'s {axis} axis that reads 0", stage, place, partial(_drop_axis, axis=index))
        for sensor, stage, place in (("magnetometer", Stage.FIELD, _FIELD), ("accelerometer", Stage.GRAVITY, _GRAVITY))
        for index, axis in enumerate("xyz")
    ),
    Model(
        "clipped magnetometer",
        Stage.FIELD,
        "range and gain of the magnetometer",
        _clip,
        limits=((0.0, 0.8),),
        size=lambda values: f"at {100 * (1 - values[0]):.0f} % of the largest component",
    ),
    Model(
        "accelerometer offset",
        Stage.GRAVITY,
        "calibration of the accelerometer",
        _add,
        limits=((-0.1, 0.1),) * 3,
        size=lambda values: _components(1000.0 * values, "mg", 0),
    ),
    Model(
        "accelerometer read as unsigned",
        Stage.GRAVITY,
        "type of the accelerometer's counts: two's complement, int16_t",
        _add_to_negative,
        choices=np.array([[4.0], [8.0], [16.0], [32.0]]),
        size=lambda values: f"negative values read {values[0]:g} g more",
    ),
    Model(
        "headings in whole degrees",
        Stage.HEADING,
        _OUTPUT,
        _truncated,
        choices=np.array([[1.0], [2.0], [5.0], [10.0]]),
        size=lambda values: f"rounded down to {values[0]:g} deg",
    ),
    Model("headings in gradians", Stage.HEADING, _OUTPUT, _multiplied, choices=np.array([[400.0 / 360.0]])),
    Model("headings in radians", Stage.HEADING, _OUTPUT, _multiplied, choices=np.array([[np.pi / 180.0]])),
    Model(
        "overflow of the heading",
        Stage.HEADING,
        _OUTPUT,
        _overflown,
        choices=np.array([[327.67], [127.0]]),
        size=lambda values: f"above {values[0]:g} deg",
    ),
    Model(
        "low-pass filter",
        Stage.SEQUENCE,
        "the filter's coefficient, and its time between two poses",
        partial(_lagging, wraps=True),
        limits=((0.0, 0.95),),
        size=lambda values: f"{100 * values[0]:.0f} % of the last turn are missing",
    ),
    Model(
        "average of headings across 0 and 360 degrees",
        Stage.SEQUENCE,
        _PLACE_OF_AVERAGE,
        partial(_lagging, wraps=False),
        limits=((0.0, 0.95),),
        size=lambda values: f"coefficient {values[0]:.2f}",
    ),
)
"""Known bugs: the sentence's words, the part of the firmware to check, and the model."""


def models_of_run(poses: Poses) -> list[Model]:
    """Return the models that depend on the run: its number of poses, and the firmware's hard iron."""
    last = np.arange(0.0, len(poses.answered_deg) - 2.0)[:, None]
    models = (
        [
            Model(
                "headings frozen",
                Stage.SEQUENCE,
                "the loop that reads the sensors: a full buffer, a missed interrupt, an error of the bus",
                _frozen,
                choices=last,
                size=_frozen_words,
            )
        ]
        if len(last)
        else []
    )
    if poses.hard_iron_ut is not None and np.any(poses.hard_iron_ut):
        models += [
            Model(f"hard iron {mistake}", Stage.FIELD, _IRON, _add, choices=times * poses.hard_iron_ut[None, :])
            for mistake, times in (("ignored", 1.0), ("added", 2.0), ("subtracted twice", -1.0))
        ]
    return models
