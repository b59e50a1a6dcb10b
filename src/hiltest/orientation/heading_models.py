"""Models of known bugs in compass firmware, fitted to the headings that it answers at known poses.

A model changes one stage of a right compass: its field, its gravity, the formula for the heading, the heading, or the
sequence of headings. Models of several stages combine. Vectors have the shape (3, k, n) and headings (k, n), for k sets
of parameters and n poses; parameters have the shape (p, k, 1). A parameter of 0 changes nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from functools import cached_property, partial
from itertools import combinations, permutations, product
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]

MOST_CAUSES = 3
LEAST_GAIN = 10.0  # decrease of the criterion that a further cause, or a larger model than another one, must achieve
_TIE = 1.0
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
_NEAR_NORTH_DEG = 5.0
_DRAWS = 16
_MOST_UNCERTAIN = 0.5
AVERAGED = "headings averaged across 0 and 360 degrees"
_ROUNDED = "whole degrees"
_NEAR_A_STEP = 0.1  # distance of a rounded answer from a multiple, as a share of the step: an answer may be a mean
_LEAST_ROUNDED = 2.0 / 3.0  # share of answers that are multiples; of unrounded ones a fifth are near one
_PLACE_OF_AVERAGE = "the average or filter of headings: average their sines and cosines"
_SAMPLES, _STARTS = 200, 3
_STEP = 1e-5
_NAMED_AT_MOST = 3
_LEAST_SOFT_IRON = 0.003  # largest number by which a matrix differs from another one that turns no heading


class Stage(IntEnum):
    """Stage of a compass that a bug changes, in the order of computation."""

    FIELD = 0
    GRAVITY = 1
    FORMULA = 2
    HEADING = 3
    SEQUENCE = 4


@dataclass(frozen=True, eq=False)
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
    inverse_soft_iron: Array | None = None
    """Shape (3, 3). Matrix by which the firmware multiplies the field, if it reports it."""

    def headings_deg(self) -> Array:
        """Return the true headings, shape (n,)."""
        return np.asarray(answered_headings(self, (), np.zeros((0, 1)))[0])

    @cached_property
    def noisy(self) -> Poses:
        """Poses with draws of noise in field and gravity, which have the shape (n, k, 3).

        Each turns a level heading by the noise of the poses.
        """
        noise_rad, random = np.radians(self.noise_deg) / np.sqrt(2.0), np.random.default_rng(1)
        across = np.linalg.norm(np.cross(self.field_ut, self.gravity_g), axis=1).mean()
        down = np.abs(np.einsum("ni,ni->n", self.field_ut, self.gravity_g)).mean()
        field, gravity = (
            vectors[:, None] + size * random.normal(size=(len(vectors), _DRAWS, 3))
            for vectors, size in (
                (self.field_ut, noise_rad * across),
                (self.gravity_g, noise_rad * across / max(across, down)),
            )
        )
        return replace(self, field_ut=field, gravity_g=gravity)


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
    size: str = ""
    """Format of the parameters in words."""
    limits: tuple[tuple[float, float], ...] = ()
    """Range of each fitted parameter."""
    choices: Array | None = None
    """Shape (k, p). Sets of parameters to choose from, if they are not fitted; the most likely first."""

    def words(self, parameters: Array) -> str:
        """Return name and size."""
        size = _axes_in_words(parameters) if len(parameters) == 9 else self.size.format(*parameters).replace("%", " %")
        return f"{self.name} ({size})" if size else self.name

    def penalties(self) -> Array:
        """Return the term of the criterion for each choice, shape (k,); later ones are less likely."""
        return np.asarray(2.0 * np.log([1.0] if self.choices is None else 2.0 + np.arange(len(self.choices))))

    def penalty(self, parameters: Array) -> float:
        """Return the term of the criterion for chosen parameters."""
        index = 0 if self.choices is None else int(np.abs(self.choices - parameters).sum(axis=1).argmin())
        return float(self.penalties()[index])


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


@dataclass(frozen=True, slots=True, eq=False)
class Explanation:
    """Causes of wrong headings, that of the largest error first."""

    causes: tuple[FittedCause, ...]
    remainder_deg: float
    """rms error that they do not explain, without isolated poses."""
    is_noise: bool
    pattern: str
    """Description of a remainder that is not noise."""
    errors_deg: Array
    """Shape (n,). Heading errors that the causes predict at the poses, without isolated ones."""

    @property
    def is_complete(self) -> bool:
        """True if known bugs explain the headings to noise."""
        return bool(self.causes) and self.is_noise

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
    noise_deg: Array
    """Shape (n,). Noise of the answers: large where a small change of the vectors changes them much."""

    def ratios(self, poses: Poses) -> Array:
        """Return the errors of the answers as multiples of their noise, shape (n,)."""
        return np.asarray(_wrap(poses.answered_deg - self.answers_deg) / self.noise_deg)

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
    models = [possible for model in models if (possible := _leave_out_refuted_steps(model, poses)) is not None]
    bases = sets = [_fit(poses, ())]
    for number in range(MOST_CAUSES if models else 0):
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
        bases = [best]
        if not _is_noise(poses, best):
            for width in (_WIDE_DEG, 0.3 * _WIDE_DEG):
                bases.append(min(further, key=lambda fit: _scores(poses, fit.answers_deg, width) + fit.penalty))
            bases = list(dict.fromkeys(bases))
    return _explanation(poses, _choose(sets), sets)


def _leave_out_refuted_steps(model: Model, poses: Poses) -> Model | None:
    """Return a model; of rounding only the steps whose multiples most answers are, and None without such a step."""
    if model.name != _ROUNDED or model.choices is None:
        return model
    answered_steps = poses.answered_deg / model.choices  # shape (k, n)
    is_near = np.abs(answered_steps - np.round(answered_steps)) < _NEAR_A_STEP
    steps = model.choices[is_near.mean(axis=1) > _LEAST_ROUNDED]
    return replace(model, choices=steps) if len(steps) else None


def _pairs(models: Sequence[Model]) -> list[tuple[tuple[Model, Model], Array]]:
    """Return the pairs of models with few choices and no other parameter, and the choices of the first one."""
    simple = [model for model in models if not model.limits and (model.choices is None or len(model.choices) <= 4)]
    pairs = [(one, other) for one, other in combinations(simple, 2) if one.stage is not other.stage]
    return [((one, other), start) for one, other in pairs for start in _start_values(one).T]


def _choose(fits: Sequence[_Fit]) -> _Fit:
    """Return the fit of the lowest criterion, or a smaller one that is hardly worse; of equal ones, the first."""
    lowest = min(fit.criterion for fit in fits)
    near = [fit for fit in fits if fit.criterion < lowest + LEAST_GAIN]
    fewest = min(fit.fitted + len(fit.models) for fit in near)
    small = [fit for fit in near if fit.fitted + len(fit.models) == fewest]
    lowest = min(fit.criterion for fit in small)
    return next(fit for fit in small if fit.criterion < lowest + _TIE)


def _is_noise(poses: Poses, fit: _Fit) -> bool:
    ratio = fit.ratios(poses)
    is_far = np.abs(ratio) >= _FAR
    return bool(is_far.mean() <= _MOST_ISOLATED and _rms(ratio[~is_far]) < _LARGEST_NOISE)


def _explanation(poses: Poses, best: _Fit, fits: Sequence[_Fit]) -> Explanation:
    causes = []
    for index, (model, parameters) in enumerate(best.model_parameters()):
        others = best.models[:index] + best.models[index + 1 :]
        alike = [
            fit
            for fit in fits
            if fit is not best
            and set(others) < set(fit.models)
            and (_are_same(poses, fit, best) or _are_as_likely(poses, fit, best))
        ]
        rows = [(model, parameters)]
        for fit in sorted(alike, key=lambda fit: fit.criterion):
            rows += [row for row in fit.model_parameters() if row[0] not in others]
        remaining = [values for other, values in best.model_parameters() if other is not model]
        without = answered_headings(poses, others, np.hstack([[], *remaining])[:, None])[0]
        causes.append(
            FittedCause(
                tuple(dict.fromkeys(row.words(values) for row, values in rows)),
                tuple(dict.fromkeys(row.place for row, _ in rows)),
                _rms(_wrap(without - best.answers_deg)),
            )
        )
    errors = poses.noise_deg * best.ratios(poses)
    is_isolated = _share_of_outliers(best.ratios(poses), poses.noise_deg) > 0.5
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
    predicted_deg = _wrap(best.answers_deg - poses.headings_deg())
    pattern = "" if is_noise else _pattern(poses, errors)
    return Explanation(tuple(causes), remainder_deg, is_noise, pattern, predicted_deg)


def _are_same(poses: Poses, one: _Fit, other: _Fit) -> bool:
    """Return whether two sets of as many models and parameters have equal answers."""
    is_as_large = (len(one.models), one.fitted) == (len(other.models), other.fitted)
    return is_as_large and float(np.abs(_wrap(one.answers_deg - other.answers_deg)).max()) <= _SAME * poses.noise_deg


def _are_as_likely(poses: Poses, one: _Fit, other: _Fit) -> bool:
    """Return whether two sets of as many models explain the headings to noise, neither better by `LEAST_GAIN`.

    The first set must not have more parameters: a more general cause always explains the headings of a special one.
    """
    is_as_small = len(one.models) == len(other.models) and one.fitted <= other.fitted
    is_near = is_as_small and abs(one.criterion - other.criterion) < LEAST_GAIN
    return is_near and _is_noise(poses, one) and _is_noise(poses, other)


_EXCEPTIONS = {
    "poses at which the board was not turned or stale samples": "the turntable there, and the flag of new samples",
    AVERAGED: _PLACE_OF_AVERAGE,
    "single corrupt headings": "reading of the sensors: torn reads, samples that are 0, an unlocked bus",
}
"""Kinds of poses that no bug of all poses explains, and the part of the firmware to check."""


def _isolated_poses(poses: Poses, errors: Array, is_isolated: NDArray[np.bool_]) -> FittedCause:
    """Describe the few poses that no bug of all poses explains."""
    changes = np.abs(_wrap(np.diff(poses.answered_deg, prepend=np.nan)))
    is_repeated, count = changes <= _FAR * poses.noise_deg, int(is_isolated.sum())
    is_near_north = np.abs(_wrap(poses.headings_deg())) < _NEAR_NORTH_DEG
    # An average also carries the error to the next pose.
    may_be_averaged = is_near_north | np.append(False, (is_near_north & is_isolated)[:-1])
    is_averaged = may_be_averaged[is_isolated].all() and (count > 1 or is_near_north.sum() == 1)
    kinds = is_repeated[is_isolated].all(), is_averaged, True
    name, place = next(row for row, applies in zip(_EXCEPTIONS.items(), kinds, strict=True) if applies)
    numbers = ", ".join(str(index + 1) for index in np.flatnonzero(is_isolated)[:5]) + ", ..." * (count > 5)
    words = f"{name} (pose{'s' * (count > 1)} {numbers} of {len(errors)})"
    return FittedCause((words,), (place,), _rms(np.where(is_isolated, errors, 0.0)))


def _pattern(poses: Poses, errors: Array) -> str:
    """Describe how errors depend on the pose."""
    pitch_deg, roll_deg = np.degrees(_tilt(poses.gravity_g.T))
    is_level = np.hypot(pitch_deg, roll_deg) < 2.0
    if 0 < is_level.sum() < len(errors) and _rms(errors[is_level]) <= min(0.5 * _rms(errors), 2.0 * poses.noise_deg):
        tilts = {name: np.abs(angle) for name, angle in (("pitch", pitch_deg), ("roll", roll_deg))}
        share = {name: float(np.abs(errors) @ tilt) / (_rms(tilt) + 1e-9) for name, tilt in tilts.items()}
        first, second = sorted(share, key=lambda name: -share[name])
        tilt = first if share[first] > 1.5 * share[second] else "tilt"
        return f"level poses are right and the error grows with {tilt}"
    return "without a pattern in heading or tilt"


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
    limits = np.array([limit for model in models for limit in model.limits or ((0.0, 0.0),) * _count(model)]).reshape(
        -1, 2
    )
    free = np.flatnonzero(limits[:, 0] < limits[:, 1])
    answers = answered_headings(poses, models, values)
    if values.shape[1] > _STARTS:
        # Wrong parameters of a right model have some large errors: a wide distribution tolerates them.
        width_deg = _WIDE_DEG if free.size else poses.noise_deg
        scores = _scores(poses, answers, width_deg)
        order = np.argsort(scores)[:_STARTS]
        values, answers = values[:, order], answers[order]
    if free.size:
        scores = _scores(poses, answers, poses.noise_deg)
        index = int(np.argmin(scores))
        best, lowest = (values[:, index], answers[index]), float(scores[index])
        for width_deg, most in _APPROACH:
            for _ in range(most):
                before = values
                values, answers = _improved(poses, models, before, free, limits, max(width_deg, poses.noise_deg))
                scores = _scores(poses, answers, poses.noise_deg)
                index = int(np.argmin(scores))
                if scores[index] < lowest - _CONVERGED:
                    best, lowest = (before[:, index], answers[index]), float(scores[index])
                elif not width_deg:
                    break
    penalty = free.size * float(np.log(len(poses.answered_deg))) + LEAST_GAIN * len(models)
    fits = []
    for parameters, answers_deg in [best] if free.size else zip(values.T, answers, strict=True):
        noise_deg = _noise(poses, models, parameters, answers_deg)
        fit = _Fit(models, parameters, 0.0, penalty, answers_deg, noise_deg)
        fit_penalty = penalty + sum(model.penalty(chosen) for model, chosen in fit.model_parameters())
        score = float(_scores(poses, answers_deg, poses.noise_deg, noise_deg))
        fits.append(replace(fit, criterion=score + fit_penalty, penalty=fit_penalty))
    return min(fits, key=lambda fit: fit.criterion)


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


def _noise(poses: Poses, models: Sequence[Model], parameters: Array, answers_deg: Array) -> Array:
    """Return the noise of a model's answers by that of the vectors, at least that of the poses, shape (n,).

    A model that answers with noise at most poses explains nothing, so its noise is that of the poses.
    """
    draws = noisy_answers(poses, models, parameters)
    noise_deg = np.maximum(poses.noise_deg, np.sqrt((_wrap(draws - answers_deg) ** 2).mean(axis=0)))
    is_uncertain = (noise_deg > _FAR * poses.noise_deg).mean() > _MOST_UNCERTAIN
    return np.asarray(np.full_like(noise_deg, poses.noise_deg) if is_uncertain else noise_deg)


def _scores(poses: Poses, answers_deg: Array, width_deg: float, noise_deg: Array | float = 0.0) -> Array:
    """Return minus twice the logarithm of the likelihood, shape (k,), at a width or the noise of each pose."""
    wider = np.maximum(noise_deg / width_deg, 1.0)
    ratio = _wrap(poses.answered_deg - answers_deg) / (wider * width_deg)
    density = (1.0 - _OUTLIERS) * np.exp(-0.5 * ratio**2) / wider + _outlier_density(width_deg)
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
    field, gravity = (vectors.T.reshape(3, -1, len(vectors)) for vectors in (poses.field_ut, poses.gravity_g))
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


def noisy_answers(poses: Poses, models: Sequence[Model], parameters: Array) -> Array:
    """Return the headings of a compass with bugs for several draws of the noise, shape (k, n)."""
    return answered_headings(poses.noisy, models, np.repeat(parameters[:, None], _DRAWS, axis=1))


def _wrap(angle_deg: Array) -> Array:
    return np.asarray((angle_deg + 180.0) % 360.0 - 180.0)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


# The formula: pitch and roll from gravity, the field turned back by them, the heading.


def _tilt(gravity: Array) -> list[Array]:
    """Return pitch and roll [rad]."""
    return [np.arctan2(-gravity[0], np.hypot(gravity[1], gravity[2])), np.arctan2(gravity[1], gravity[2])]


def _heading_deg(
    gravity: Array,
    field: Array,
    parameters: Array | None = None,
    *,
    tilt: Callable[[Array], Sequence[Array]] = _tilt,
    factors: tuple[float, float] = (1.0, 1.0),
    signs: tuple[float, float, float] = (1.0, 1.0, 1.0),
) -> Array:
    """Return headings from multiples of pitch and roll; `signs` multiply the terms Y sin sin, Z sin cos and Z sin."""
    pitch, roll = (factor * angle for factor, angle in zip(factors, tilt(gravity), strict=True))
    x, y, z = field
    north = x * np.cos(pitch) + np.sin(pitch) * (signs[0] * y * np.sin(roll) + signs[1] * z * np.cos(roll))
    west = y * np.cos(roll) - signs[2] * z * np.sin(roll)
    return np.asarray(np.degrees(np.arctan2(-west, north)))


def _pitch_first(gravity: Array, field: Array, parameters: Array) -> Array:
    pitch, roll = _tilt(gravity)
    x, y, z = field
    north = x * np.cos(pitch) + z * np.sin(pitch)
    west = x * np.sin(roll) * np.sin(pitch) + y * np.cos(roll) - z * np.sin(roll) * np.cos(pitch)
    return np.asarray(np.degrees(np.arctan2(-west, north)))


# Vectors.


def _add(vectors: Array, parameters: Array, *, unit: float = 1.0) -> Array:
    return vectors + unit * parameters


def _scale_axis(vectors: Array, parameters: Array, *, axis: int) -> Array:
    factors = np.ones((3, *parameters.shape[1:]))
    factors[axis] += parameters[0]
    return vectors * factors


def _distort(vectors: Array, parameters: Array) -> Array:
    """Multiply by a symmetric matrix with zz = 1: a common factor turns no heading."""
    xx, yy, xy, xz, yz = parameters
    x, y, z = vectors
    return np.stack(
        np.broadcast_arrays(x + xx * x + xy * y + xz * z, y + xy * x + yy * y + yz * z, z + xz * x + yz * y)
    )


def _apply(vectors: Array, parameters: Array, *, matrix: Array, offset: Array) -> Array:
    return np.asarray(np.einsum("ij,jkn->ikn", matrix, vectors) + offset[:, None, None])


def _rotate(vectors: Array, parameters: Array) -> Array:
    """Rotate by a vector [deg], as Rodrigues."""
    angle = np.radians(np.linalg.norm(parameters, axis=0)) + 1e-12
    axis, vectors = np.broadcast_arrays(np.radians(parameters) / angle, vectors)
    along, across = (axis * vectors).sum(axis=0), np.cross(axis, vectors, axis=0)
    return np.asarray(vectors * np.cos(angle) + across * np.sin(angle) + axis * along * (1.0 - np.cos(angle)))


def _exchange_axes(vectors: Array, parameters: Array) -> Array:
    matrices = parameters[:, :, 0].reshape(3, 3, -1)
    return np.stack([(row[:, :, None] * vectors).sum(axis=0) for row in matrices])


# Headings.


def _convert(heading_deg: Array, parameters: Array, *, factor: float = 1.0, zero: float = 0.0) -> Array:
    return np.asarray(zero + factor * (heading_deg % 360.0))


def _scale_from(heading_deg: Array, parameters: Array, *, start: float) -> Array:
    return np.asarray(((heading_deg - start) % 360.0 + start) * (1.0 + parameters[0]))


# Sequences.


def _freeze(heading_deg: Array, parameters: Array) -> Array:
    """Keep a heading from one pose on; the parameter is the number of that pose."""
    index = np.minimum(np.arange(heading_deg.shape[-1]), parameters[0].astype(int) - 1)
    return np.take_along_axis(np.broadcast_to(heading_deg, index.shape), index, axis=-1)


def _hold(heading_deg: Array, parameters: Array) -> Array:
    """Follow the heading only as far as it leaves a range about the answer."""
    heading_deg, band = np.broadcast_arrays(heading_deg, parameters[0])
    answers = [heading_deg[:, 0]]
    for column in range(1, heading_deg.shape[1]):
        step = _wrap(heading_deg[:, column] - answers[-1])
        answers.append(answers[-1] + step - np.clip(step, -band[:, column], band[:, column]))
    return np.stack(answers, axis=1)


def _filter(heading_deg: Array, parameters: Array, *, wraps: bool) -> Array:
    """Filter with a coefficient; without wrapping, headings of 359 and 1 degrees have the mean 180."""
    heading_deg = np.unwrap(heading_deg, period=360.0) if wraps else heading_deg % 360.0
    steps = np.diff(heading_deg, axis=-1, prepend=heading_deg[:, :1])
    index = np.arange(steps.shape[-1])
    age = index[:, None] - index
    decays = np.where(age >= 0, parameters[0][:, :, None] ** np.maximum(age + 1, 1), 0.0)
    return np.asarray(heading_deg - np.einsum("kij,kj->ki", decays, np.broadcast_to(steps, (len(decays), len(index)))))


# The table.


def _axes_in_words(matrix: Array) -> str:
    rows = matrix.reshape(3, 3)
    sources = [f"{'-' if row.sum() < 0 else ''}{'xyz'[int(np.abs(row).argmax())]}" for row in rows]
    return f"x, y and z are {', '.join(sources[:2])} and {sources[2]}"


def _axes_choices() -> Array:
    """Return the signed permutations of three axes, those that change the fewest axes first; shape (47, 9)."""
    signed = [
        (np.eye(3)[list(order)] * np.array(signs)[:, None]).ravel()
        for order in permutations(range(3))
        for signs in product((1.0, -1.0), repeat=3)
    ]
    return np.array(sorted(signed, key=lambda matrix: np.abs(matrix - np.eye(3).ravel()).sum())[1:])


_DRIVER = "conversion and order of its axes in the driver of the {}, beside the data sheet"
_TILT = "pitch and roll from gravity, and the formula that turns the field back by them"
_ATAN2 = "order and signs of the arguments of atan2, or frame and heading under [device] in the rig"
_OFFSET = "the mounting yaw in the rig, a declination and its sign, and the firmware's axes"
OUTPUT_STEP = "the step from the heading to the answer: unit, type and rounding"
_SCALE = "the factor from radians or counts to degrees, such as 180 / pi or 360 / 65536"
_IRON = "the line that applies the calibration: (read - hard iron), once, multiplied by the soft iron from the left"
_UNSIGNED = "type of the accelerometer's counts: two's complement, int16_t"
_FILTER = "the filter's coefficient, and its time between two poses"
_HYSTERESIS = "the threshold below which a change of the heading is ignored"
_DRIFT = "integration of the gyroscope's rate, and offsets that depend on temperature"
_TRIM = "calibration of the accelerometer"
_LOOP = "the loop that reads the sensors: a full buffer, a missed interrupt, an error of the bus"
_SIDES = {" from east": 90.0, " from south": 180.0, " from west": 270.0}
_XYZ = "x {:+.1f}, y {:+.1f}, z {:+.1f} "
_PERCENTS = "xx {:+.0%}, yy {:+.0%}, xy {:+.0%}, xz {:+.0%}, yz {:+.0%}"
_FORMULAS: dict[str, Callable[..., Array]] = {
    "no tilt compensation": partial(_heading_deg, factors=(0.0, 0.0)),
    "sign of pitch": partial(_heading_deg, factors=(-1.0, 1.0)),
    "sign of roll": partial(_heading_deg, factors=(1.0, -1.0)),
    "signs of pitch and roll": partial(_heading_deg, factors=(-1.0, -1.0)),
    "sign in the tilt compensation, y sin(pitch) sin(roll)": partial(_heading_deg, signs=(-1.0, 1.0, 1.0)),
    "sign in the tilt compensation, z sin(pitch) cos(roll)": partial(_heading_deg, signs=(1.0, -1.0, 1.0)),
    "sign in the tilt compensation, z sin(roll)": partial(_heading_deg, signs=(1.0, 1.0, -1.0)),
    "rotation order: pitch before roll": _pitch_first,
    "arcsine for roll": partial(
        _heading_deg, tilt=lambda gravity: [_tilt(gravity)[0], np.arctan2(gravity[1], np.hypot(gravity[0], gravity[2]))]
    ),
    "pitch from x and z alone": partial(
        _heading_deg, tilt=lambda gravity: [np.arctan2(-gravity[0], gravity[2]), _tilt(gravity)[1]]
    ),
    "pitch and roll exchanged": partial(_heading_deg, tilt=lambda gravity: _tilt(gravity)[::-1]),
    "sine and cosine of degrees": partial(_heading_deg, factors=(180.0 / np.pi, 180.0 / np.pi)),
}
_HEADINGS: dict[str, tuple[str, Callable[..., Array]]] = {
    "headings counted the other way": (_ATAN2, partial(_convert, factor=-1.0)),
    **{
        f"headings counted the other way{side}": (_ATAN2, partial(_convert, factor=-1.0, zero=zero))
        for side, zero in _SIDES.items()
    },
    **{f"headings counted{side}": (_ATAN2, partial(_convert, zero=-zero)) for side, zero in _SIDES.items()},
    "swapped arguments of atan2": (_ATAN2, partial(_convert, factor=-1.0, zero=90.0)),
    "atan instead of atan2": (_ATAN2, lambda heading_deg, _: (heading_deg + 90.0) % 180.0 - 90.0),
    "headings in gradians": (OUTPUT_STEP, partial(_convert, factor=400.0 / 360.0)),
    "headings in radians": (OUTPUT_STEP, partial(_convert, factor=np.pi / 180.0)),
}


def _column(*values: float) -> Array:
    return np.array(values)[:, None]


def _integers() -> Array:
    """Return largest heading and period [deg] of integers of 8 and 16 bits that a heading exceeds, shape (k, 2).

    Units are those that people use: decimals of a degree and of a radian, and double degrees.
    """
    units = [*(10.0**-digits for digits in range(4)), *(np.degrees(10.0**-digits) for digits in range(2, 6)), 2.0, 0.5]
    integers = [
        (unit * (2 ** (bits - is_signed) - 1), unit * 2**bits)
        for bits in (8, 16)
        for unit in units
        for is_signed in (1, 0)
    ]
    return np.array([integer for integer in integers if 10.0 < integer[0] < 360.0])


def _sensor_models(sensor: str, stage: Stage) -> list[Model]:
    """Return the models of the axes of a sensor."""
    place = _DRIVER.format(sensor)
    models = [Model(f"axes of the {sensor}", stage, place, _exchange_axes, choices=_axes_choices())]
    for index, axis in enumerate("xyz"):
        scale, name = partial(_scale_axis, axis=index), f"{axis} axis of the {sensor}"
        models += [
            Model(f"scale of the {name}", stage, place, scale, "{:+.0%}", ((-0.5, 1.0),)),
            Model(f"{name} reads 0", stage, place, scale, choices=_column(-1.0)),
        ]
    return models


MODELS: tuple[Model, ...] = (
    Model(
        "constant offset",
        Stage.HEADING,
        _OFFSET,
        lambda heading, offset: heading % 360.0 + offset[0],
        "{:+.2f} deg",
        ((-180.0, 180.0),),
    ),
    *(
        Model(
            f"scale of the heading, counted from {start:g} to {start + 360.0:g} degrees",
            Stage.HEADING,
            _SCALE,
            partial(_scale_from, start=start),
            "{:+.1%}",
            ((-0.2, 0.2),),
        )
        for start in (-180.0, 0.0)
    ),
    *(Model(name, Stage.HEADING, place, change) for name, (place, change) in _HEADINGS.items()),
    *(Model(name, Stage.FORMULA, _TILT, change) for name, change in _FORMULAS.items()),
    *_sensor_models("magnetometer", Stage.FIELD),
    *_sensor_models("accelerometer", Stage.GRAVITY),
    Model("hard iron", Stage.FIELD, _IRON, _add, f"{_XYZ}uT", ((-200.0, 200.0),) * 3),
    Model("soft iron", Stage.FIELD, _IRON, _distort, _PERCENTS, ((-0.5, 1.0),) * 2 + ((-0.5, 0.5),) * 3),
    Model("residual rotation", Stage.FIELD, _IRON, _rotate, f"{_XYZ}deg", ((-60.0, 60.0),) * 3),
    Model(
        "clipped magnetometer",
        Stage.FIELD,
        "its range and gain",
        lambda field, lost: np.sign(field) * np.minimum(np.abs(field), (1.0 - lost[0]) * np.abs(field).max()),
        "{:.0%} lost",
        ((0.0, 0.8),),
    ),
    Model("accelerometer offset", Stage.GRAVITY, _TRIM, partial(_add, unit=0.001), f"{_XYZ}mg", ((-100.0, 100.0),) * 3),
    Model(
        "accelerometer read as unsigned",
        Stage.GRAVITY,
        _UNSIGNED,
        lambda gravity, added: gravity + (gravity < 0.0) * added[0],
        "negative values {:g} g more",
        choices=_column(4.0, 8.0, 16.0, 32.0),
    ),
    Model(
        _ROUNDED,
        Stage.HEADING,
        OUTPUT_STEP,
        lambda heading, step: heading % 360.0 // step[0] * step[0],
        "multiples of {:g}",
        choices=_column(1.0, 2.0, 5.0, 10.0),
    ),
    Model(
        "overflow of the heading",
        Stage.HEADING,
        OUTPUT_STEP,
        lambda heading, integer: (heading % 360.0 - integer[0]) % -integer[1] + integer[0],
        "above {:.5g} deg",
        choices=_integers(),
    ),
    Model(
        "headings below 0 or above 360 clamped", Stage.HEADING, OUTPUT_STEP, lambda heading, _: heading.clip(0.0, 360.0)
    ),
    Model(
        "drift with time or temperature",
        Stage.SEQUENCE,
        _DRIFT,
        lambda heading, change: heading + change[0] * np.linspace(0.0, 1.0, heading.shape[-1]),
        "{:+.1f} deg from the first pose to the last",
        ((-180.0, 180.0),),
    ),
    Model("hysteresis", Stage.SEQUENCE, _HYSTERESIS, _hold, "{:.1f} deg", ((0.0, 45.0),)),
    Model(
        "low-pass filter",
        Stage.SEQUENCE,
        _FILTER,
        partial(_filter, wraps=True),
        "{:.0%} of a turn missing",
        ((0.0, 0.95),),
    ),
    Model(
        AVERAGED,
        Stage.SEQUENCE,
        _PLACE_OF_AVERAGE,
        partial(_filter, wraps=False),
        "coefficient {:.2f}",
        ((0.0, 0.95),),
    ),
)
"""Known bugs."""


def models_of_run(poses: Poses) -> list[Model]:
    """Return the models that depend on the run: its number of poses, and the hard iron that the firmware reports."""
    last, models = np.arange(1.0, len(poses.answered_deg) - 1.0)[:, None], []
    if len(last):
        models += [Model("headings frozen", Stage.SEQUENCE, _LOOP, _freeze, "after pose {:.0f}", choices=last)]
    iron, inverse = poses.hard_iron_ut, poses.inverse_soft_iron
    if iron is not None and np.any(iron):
        irons = np.array([iron] if inverse is None else [inverse @ iron, iron])  # before or after the soft iron
        models += [
            Model(f"hard iron {mistake}", Stage.FIELD, _IRON, _add, choices=times * irons)
            for mistake, times in (("ignored", 1.0), ("added", 2.0), ("subtracted twice", -1.0))
        ]
    if inverse is not None and np.abs(inverse - np.eye(3)).max() > _LEAST_SOFT_IRON:
        ignored = np.asarray(np.linalg.inv(inverse), np.float64)
        changes: list[tuple[str, Array, Array | float]] = [
            ("soft iron ignored", ignored, 0.0),
            ("soft iron applied twice", inverse, 0.0),
        ]
        if np.abs(inverse - inverse.T).max() > _LEAST_SOFT_IRON:
            changes.append(("soft iron transposed", inverse.T @ ignored, 0.0))
        if iron is not None and np.any(iron):
            changes.append(("hard and soft iron ignored", ignored, iron))
        models += [
            Model(name, Stage.FIELD, _IRON, partial(_apply, matrix=matrix, offset=np.zeros(3) + offset))
            for name, matrix, offset in changes
        ]
    return models
