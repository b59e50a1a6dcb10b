"""Known bugs in compass firmware are named from the headings that it answers, with their size."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from hiltest.orientation.angles import Pose, rotation_body_from_ned
from hiltest.orientation.heading_models import (
    MODELS,
    Explanation,
    Model,
    Poses,
    answered_headings,
    fit_causes,
    models_of_run,
)

NOISE_DEG = 0.3
ATTITUDES = [Pose(heading + 1.7, *tilt) for tilt in ((0, 0), (20, 25), (-25, -15)) for heading in range(0, 360, 30)]
ROTATIONS = np.array([rotation_body_from_ned(attitude) for attitude in ATTITUDES])
RIGHT = Poses(
    field_ut=ROTATIONS @ np.array([22.8, 0.0, 42.8]),
    gravity_g=ROTATIONS @ np.array([0.0, 0.0, 1.0]),
    answered_deg=np.array([attitude.heading_deg for attitude in ATTITUDES]),
    noise_deg=NOISE_DEG,
    hard_iron_ut=np.array([5.0, -8.0, 6.0]),
)
SIZES = {
    "constant offset": [10.5],
    "scale of the heading, counted from -180 to 180 degrees": [0.012],
    "scale of the heading, counted from 0 to 360 degrees": [-0.012],
    "hard iron": [25.0, -18.0, 16.0],
    "soft iron": [0.1, -0.08, 0.06, 0.05, -0.04],
    "residual rotation": [3.0, -5.0, 4.0],
    "clipped magnetometer": [0.4],
    "accelerometer offset": [40.0, -50.0, 30.0],
    "low-pass filter": [0.4],
    "headings averaged across 0 and 360 degrees": [0.3],
    "drift with time or temperature": [30.0],
    "hysteresis": [8.0],
}
BY_NAME = {model.name: model for model in (*MODELS, *models_of_run(RIGHT))}


def answers(seed: int, *bugs: Model) -> NDArray[np.float64]:
    """Return the headings of a compass with bugs, each with its size or the middle one of its choices."""
    values = [_size(bug) for bug in bugs]
    headings = answered_headings(RIGHT, bugs, np.concatenate([np.zeros(0), *values])[:, None])[0]
    noise = np.random.default_rng(seed).normal(0.0, NOISE_DEG, len(headings))
    return np.asarray((headings + noise) % 360.0)


def _size(bug: Model) -> Sequence[float]:
    if bug.choices is not None:
        return list(bug.choices[len(bug.choices) // 2])
    return SIZES.get(bug.name, [0.3] * len(bug.limits))


def explain(answered_deg: NDArray[np.float64], rows: slice = slice(None)) -> Explanation:
    return fit_causes(
        Poses(
            RIGHT.field_ut[rows],
            RIGHT.gravity_g[rows],
            answered_deg[rows],
            NOISE_DEG,
            hard_iron_ut=RIGHT.hard_iron_ut,
        )
    )


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("name", BY_NAME)
def test_every_known_bug_is_named_by_its_headings(name: str, seed: int) -> None:
    bug = BY_NAME[name]
    answered = answers(seed, bug)
    explanation = explain(answered)
    (cause,) = explanation.causes
    assert any(words.partition(" (")[0] == name for words in cause.names), explanation.words
    assert bug.place in cause.places
    assert explanation.is_noise
    errors = answered - RIGHT.answered_deg - explanation.errors_deg
    assert np.abs((errors + 180.0) % 360.0 - 180.0).max() < 5.0 * NOISE_DEG


@pytest.mark.parametrize(("spread", "is_rounded"), [(0.0, True), (2.5, False)])
def test_rounding_is_no_cause_if_the_answers_are_no_multiples_of_its_step(spread: float, is_rounded: bool) -> None:
    headings = np.random.default_rng(1).uniform(0.0, 360.0, 36)
    rotations = np.array([rotation_body_from_ned(Pose(heading, 0.0, 0.0)) for heading in headings.tolist()])
    answered = headings // 10.0 * 10.0 + spread * (np.arange(36) % 3 - 1.0)
    field, gravity = rotations @ np.array([22.8, 0.0, 42.8]), rotations @ np.array([0.0, 0.0, 1.0])
    words = fit_causes(Poses(field, gravity, answered % 360.0, NOISE_DEG)).words
    assert ("multiples of 10" in words) == is_rounded, words


@pytest.mark.parametrize("degrees", [0.55, 0.9, 1.3, 2.0, 4.0, 9.0])
@pytest.mark.parametrize("kind", ["0 to 360", "-180 to 180", "hard iron"])
def test_a_scale_of_the_angle_and_a_hard_iron_are_told_apart_or_both_named(kind: str, degrees: float) -> None:
    noise = np.random.default_rng([int(10.0 * degrees), len(kind)])
    for sign in (-1.0, 1.0):
        if kind == "hard iron":
            direction = noise.normal(size=3) * [1.0, 1.0, 0.3]
            size = sign * np.radians(degrees) * 22.8 * direction / np.linalg.norm(direction)
            (name,) = (name for name in BY_NAME if name == kind)
        else:
            size = np.array([sign * degrees / (360.0 if kind == "0 to 360" else 180.0)])
            (name,) = (name for name in BY_NAME if f"from {kind} degrees" in name)
        exact = answered_headings(RIGHT, [BY_NAME[name]], size[:, None])[0]
        causes = explain((exact + noise.normal(0.0, 0.5 * NOISE_DEG, len(exact))) % 360.0).causes
        assert all(any(words.startswith(name) for words in cause.names) for cause in causes), causes
        other = "scale of the heading" if kind == "hard iron" else "hard iron"
        is_out_of_its_limit = degrees >= 4.0 * NOISE_DEG
        assert not is_out_of_its_limit or [other in cause.words for cause in causes] == [False]


@pytest.mark.parametrize(
    "name", ["headings counted from east", "hard iron subtracted twice", "scale of the z axis of the magnetometer"]
)
def test_a_cause_with_more_parameters_is_not_named_beside_the_simpler_one(name: str) -> None:
    (cause,) = explain(answers(1, BY_NAME[name])).causes
    assert [words.partition(" (")[0] for words in cause.names] == [name]


@pytest.mark.parametrize("seed", range(10))
def test_a_right_compass_has_no_cause(seed: int) -> None:
    explanation = explain(answers(seed))
    assert explanation.causes == ()
    assert explanation.is_noise


@pytest.mark.parametrize(
    ("bugs", "words"),
    [
        (
            ("sign of pitch", "constant offset"),
            "sign of pitch or axes of the accelerometer (x, y and z are -x, y and z)",
        ),
        (("no tilt compensation", "headings counted the other way"), "no tilt compensation"),
        (("hard iron", "constant offset"), "hard iron (x +2"),
        (("accelerometer offset", "constant offset"), "constant offset (+10.5"),
    ],
)
def test_two_bugs_are_named_in_the_order_of_their_errors(bugs: tuple[str, str], words: str) -> None:
    explanation = explain(answers(1, *(BY_NAME[name] for name in bugs)))
    assert len(explanation.causes) == 2
    first, second = explanation.causes
    assert first.explains_deg >= second.explains_deg
    assert any(words in cause.words for cause in explanation.causes), explanation.words
    assert all(any(name in cause.words for cause in explanation.causes) for name in bugs), explanation.words
    assert explanation.is_noise


@pytest.mark.parametrize(
    ("places", "shift", "words"),
    [
        (
            [4, 15, 29],
            "pose before",
            "poses at which the board was not turned or stale samples (poses 5, 16, 30 of 36)",
        ),
        ([4, 15, 29], "random", "single corrupt headings (poses 5, 16, 30 of 36)"),
        ([0, 12, 24], "half a turn", "headings averaged across 0 and 360 degrees (poses 1, 13, 25 of 36)"),
    ],
)
def test_a_few_wrong_poses_are_exceptions_and_no_bug_of_all_poses(places: list[int], shift: str, words: str) -> None:
    answered = answers(1)
    replaced = {"pose before": np.roll(answered, 1), "random": answered * 7.3 + 50.0, "half a turn": answered + 180.0}
    answered[places] = replaced[shift][places] % 360.0
    assert explain(answered).words == words


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (lambda pose, sign: sign * (pose.roll_deg > 20.0) * 8.0, "level poses are right and the error grows with tilt"),
        (lambda pose, sign: sign * 4.0, "without a pattern in heading or tilt"),
    ],
)
def test_a_remainder_is_described(error: Callable[[Pose, float], float], words: str) -> None:
    signs = np.random.default_rng(4).choice([-1.0, 1.0], len(ATTITUDES))
    errors = [error(attitude, sign) for attitude, sign in zip(ATTITUDES, signs, strict=True)]
    explanation = explain((answers(1, BY_NAME["constant offset"]) + errors) % 360.0)
    assert not explanation.is_noise
    assert words in explanation.pattern
    assert [words in explanation.words for _ in explanation.causes[:1]] == [True]


def test_level_poses_alone_give_every_bug_that_they_cannot_distinguish() -> None:
    (cause,) = explain(answers(1, BY_NAME["headings counted the other way"]), slice(0, 12)).causes
    assert cause.names[0] == "headings counted the other way"
    assert any("axes of the magnetometer (x, y and z are x, -y" in name for name in cause.names)
    assert explain(answers(1, BY_NAME["sign of pitch"]), slice(0, 12)).causes == ()


@pytest.mark.parametrize("seed", range(3))
def test_headings_with_more_noise_or_without_any_relation_to_the_board_get_no_bug(seed: int) -> None:
    noise = np.random.default_rng(seed)
    noisier = [(answers(seed) + noise.normal(0.0, added, 36)) % 360.0 for added in (0.4, 0.5, 0.8)]
    for answered in (*noisier, noise.uniform(0.0, 360.0, 36)):
        assert explain(answered).causes == ()
