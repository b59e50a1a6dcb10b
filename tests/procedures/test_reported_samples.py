"""Raw samples that firmware reports are compared with those that its sensor delivered, and the fault is named."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
import pytest
from numpy.typing import NDArray

from hiltest.procedures.reported_samples import Lines, describe_samples, merge_faults

Array: TypeAlias = NDArray[np.float64]

RATE_HZ, IN_A_LINE, LATE_S = 80.0, 8, 0.07
UNIT = (10.0, "uT")
TIME_S = np.arange(2000) / RATE_HZ + 40.0


def delivered(*, is_moving: bool = True) -> Array:
    """Return a field of 48.5 uT with hard iron and noise in whole counts, tumbled or at 36 poses one after another."""
    random = np.random.default_rng(1)
    phase = np.arange(len(TIME_S)) / RATE_HZ
    if not is_moving:
        phase = np.floor(phase / phase[-1] * 35.99)
    turn, tilt = 2.9 * phase, 1.3 * phase
    directions = np.column_stack([np.cos(turn) * np.cos(tilt), np.sin(turn) * np.cos(tilt), np.sin(tilt)])
    return np.asarray(np.round(485.0 * directions + [24.0, -22.0, 40.0] + 4.0 * random.normal(size=(len(TIME_S), 3))))


def words(
    change: Callable[[Array], Array],
    *,
    size: int = IN_A_LINE,
    is_moving: bool = True,
    sees_samples: bool = True,
    after: Callable[[Array], Array] = lambda lines: lines,
) -> list[str]:
    samples = delivered(is_moving=is_moving)
    means = change(samples.copy())[: len(samples) // IN_A_LINE * IN_A_LINE].reshape(-1, IN_A_LINE, 3)[:, -size:]
    readings = after(np.round(means.mean(axis=1), 1))
    rows = [np.column_stack([TIME_S, samples])] if sees_samples else None
    lines = Lines(np.ceil(10.0 * (TIME_S[IN_A_LINE - 1 :: IN_A_LINE] + LATE_S)) / 10.0, readings, rows)
    return [fault.words for fault in describe_samples("magnetometer", UNIT, lines, is_moving=is_moving)]


def once_in(count: int, corrupt: Callable[[Array, Array], Array]) -> Callable[[Array], Array]:
    """Return a change of each sample with such a number."""

    def change(samples: Array) -> Array:
        wrong = np.arange(count, len(samples), count)
        samples[wrong] = corrupt(samples[wrong], samples[wrong - 1])
        return samples

    return change


def of_axis(axis: int, change: Callable[[Array], Array]) -> Callable[[Array], Array]:
    def changed(samples: Array) -> Array:
        samples[:, axis] = change(samples[:, axis])
        return samples

    return changed


def exchange_bytes(samples: Array) -> Array:
    return samples.astype(np.int16).byteswap().astype(np.float64)


FAULTS: dict[str, Callable[[Array], Array]] = {
    "the y axis of the magnetometer does not move: it stays at 0.3 uT": of_axis(1, lambda y: 0.0 * y + 3.0),
    "the magnetometer has its two bytes exchanged": exchange_bytes,
    "the x axis of the magnetometer has its two bytes exchanged": of_axis(0, lambda x: -exchange_bytes(-x)),
    "the magnetometer overflows at +-25.6 uT, 512 counts": lambda all_: (all_ + 256.0) % 512.0 - 256.0,
    "the magnetometer is clipped at +-33 uT": lambda all_: np.clip(all_, -330.0, 330.0),
    "the z axis of the magnetometer is clipped at 20 uT": of_axis(2, lambda z: np.minimum(z, 200.0)),
    "the x axis of the magnetometer is read as unsigned, negative values are 6554 uT more": of_axis(
        0, lambda x: x % 65536.0
    ),
    "the y axis of the magnetometer has lost its sign": of_axis(1, np.abs),
    "axes of the magnetometer (x, y and z are x, z and y)": lambda all_: all_[:, [0, 2, 1]],
    "axes of the magnetometer (x, y and z are x, y and -z)": lambda all_: all_ * [1.0, 1.0, -1.0],
    "the magnetometer is 0.667 times what was delivered": lambda all_: all_ / 1.5,
    "the axes of the magnetometer have an offset (x 0.00, y 0.00, z 20.00 uT)": of_axis(2, lambda z: z + 200.0),
    "corrupt samples: about 33 % of the magnetometer's are 0, 0, 0": once_in(3, lambda now, _: 0.0 * now),
    "frozen samples of the magnetometer after 5": lambda all_: all_[np.minimum(np.arange(len(all_)), 1200)],
    "corrupt samples: about 2 % of the magnetometer's are 0, 0, 0": once_in(51, lambda now, _: 0.0 * now),
    "corrupt samples: about 4.7 % of the magnetometer's are the one before once more": once_in(21, lambda _, old: old),
    "corrupt samples: about 7.7 % of the magnetometer's are torn": once_in(
        13, lambda now, old: np.column_stack([now[:, 0], -(-now[:, 1] // 256 * 256 + -old[:, 1] % 256), old[:, 2]])
    ),
    "corrupt samples: about 3.2 % of the magnetometer's have a flipped bit": once_in(
        31, lambda now, _: now - [0, 2**9, 0]
    ),
    "corrupt samples: about 12 % of the magnetometer's have their axes turned once more (x, y and z are -y, x and z)": (
        once_in(9, lambda now, _: now[:, [1, 0, 2]] * [-1.0, 1.0, 1.0])
    ),
}


@pytest.mark.parametrize("size", [1, IN_A_LINE])
@pytest.mark.parametrize("expected", FAULTS)
def test_a_fault_is_named_by_the_samples_of_a_tumble(expected: str, size: int) -> None:
    if size == 1 and "the one before" in expected:
        return  # a line that shows the sample before is a line that came early
    found = words(FAULTS[expected], size=size)
    assert len(found) == 1
    assert found[0].partition("magnetometer")[2].startswith(expected.partition("magnetometer")[2]), found
    assert found[0].startswith(expected.partition("about")[0])


@pytest.mark.parametrize("is_moving", [True, False])
@pytest.mark.parametrize("sees_samples", [True, False])
@pytest.mark.parametrize("size", [1, 5, IN_A_LINE])
def test_right_samples_have_no_fault(is_moving: bool, sees_samples: bool, size: int) -> None:
    assert words(lambda samples: samples, size=size, is_moving=is_moving, sees_samples=sees_samples) == []


def test_readings_of_a_filter_are_called_so() -> None:
    def smooth(lines: Array) -> Array:
        smoothed = [lines[0]]
        for line in lines[1:]:
            smoothed.append(0.3 * smoothed[-1] + 0.7 * line)
        return np.round(smoothed, 1)

    (found,) = words(lambda samples: samples, after=smooth)
    assert found.endswith("(a filter or another conversion)")


@pytest.mark.parametrize(
    "expected",
    [
        "the y axis of the magnetometer does not move: it stays at 0.3 uT",
        "the magnetometer is clipped at +-33 uT",
    ],
)
def test_a_real_board_shows_some_faults_by_its_readings_alone(expected: str) -> None:
    assert words(FAULTS[expected], sees_samples=False) == [expected.replace("+-", "")]


def test_zeros_and_outliers_and_frozen_samples_are_seen_in_readings_alone() -> None:
    zeros = words(once_in(41, lambda now, _: 0.0 * now), size=1, sees_samples=False)
    jumps = words(once_in(81, lambda now, _: now + 4000.0), sees_samples=False)
    frozen = words(lambda samples: samples[[0] * len(samples)], sees_samples=False)
    assert [found[0].partition("magnetometer")[2] for found in (zeros, jumps, frozen)] == [
        "'s are 0, 0, 0",
        "'s readings stick out from those beside them",
        ": one value in 250 readings",
    ]


def test_turns_by_hand_with_rests_are_no_fault_of_a_real_board() -> None:
    faces = np.repeat([[480.0, 0, 0], [0, 480, 0], [0, 0, 480], [-460, 0, 0], [0, -470, 0], [0, 0, -450]], 20, axis=0)
    lines = Lines(0.1 * np.arange(len(faces)), faces + np.array([30.0, -20.0, 45.0]))
    assert describe_samples("magnetometer", UNIT, lines, is_moving=True) == ()


def test_the_same_fault_of_both_sensors_is_one() -> None:
    lines = Lines(np.arange(30.0), np.ones((30, 3)))
    fault, other = (
        describe_samples(sensor, UNIT, lines, is_moving=True) for sensor in ("magnetometer", "accelerometer")
    )
    assert [one.words for one in merge_faults(fault, other)] == [
        "frozen samples of the magnetometer and the accelerometer: one value in 30 readings"
    ]
    assert merge_faults(fault, ()) == fault
    assert merge_faults((), other) == other
    assert describe_samples("accelerometer", UNIT, lines, is_moving=False) == ()  # level poses, coarse digits
