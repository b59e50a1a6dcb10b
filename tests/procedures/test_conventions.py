"""Conventions of firmware that are declared wrong: the right one is found from what it says at known angles."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from hiltest.interfaces.frames import FRAMES
from hiltest.orientation.angles import Pose, rotation_body_from_ned, wrap_360
from hiltest.procedures.conventions import Vectors, other_frame, other_tilt, standing_still

REFERENCE = [heading + 1.7 for heading in range(0, 360, 30)]
EARTH_FIELD_UT = [22.8, 0.0, 42.8]
TILTS = [(0.0, 0.0), (20.0, 0.0), (0.0, 20.0)]


@pytest.mark.parametrize(
    ("scale", "words"),
    [(1.0, ""), (0.1, "33.0 deg"), (0.0175, "5.8 deg"), (0.0, "0.0 deg while the board is turned through 330")],
)
def test_headings_that_do_not_follow_the_board_are_named(scale: float, words: str) -> None:
    result = standing_still([wrap_360(scale * figure) for figure in REFERENCE], REFERENCE)
    assert words in result
    assert bool(result) is bool(words)


def test_one_known_angle_shows_no_standing_still() -> None:
    assert standing_still([3.0], [1.7]) == ""


def said_in(actual: str, declared: str) -> tuple[list[Vectors], list[float]]:
    """Return vectors of a board whose firmware has them in one frame, read as if in another."""
    vectors, reference = [], []
    for pitch, roll in TILTS:
        for heading in REFERENCE:
            turn = rotation_body_from_ned(Pose(heading, pitch, roll))
            field, gravity = turn @ EARTH_FIELD_UT, turn @ [0.0, 0.0, 1.0]
            out, back = FRAMES[actual], FRAMES[declared]
            raw_field = np.array(out.to_body).T @ field
            raw_gravity = out.gravity_sign * np.array(out.to_body).T @ gravity
            vectors.append((back.gravity(raw_gravity), back.vector(raw_field)))
            reference.append(heading)
    return vectors, reference


@pytest.mark.parametrize("actual", FRAMES)
@pytest.mark.parametrize("declared", FRAMES)
def test_vectors_of_another_frame_are_named(actual: str, declared: str) -> None:
    result = other_frame(*said_in(actual, declared), declared, FRAMES[actual])
    one, other = FRAMES[actual], FRAMES[declared]
    same = (one.to_body, one.gravity_sign) == (other.to_body, other.gravity_sign)
    words = f'headings computed from its vectors are right, within 0.0 deg, with frame = "{actual}"'
    assert result == ("" if same else words)


def test_vectors_that_no_frame_explains_have_none() -> None:
    vectors, reference = said_in("ned", "ned")
    exchanged = [(gravity, field[[0, 2, 1]]) for gravity, field in vectors]
    assert other_frame(exchanged, reference, "ned", FRAMES["ned"]) == ""


@pytest.mark.parametrize(
    ("message", "words"),
    [
        (lambda pitch, roll: (pitch, roll), ""),
        (lambda pitch, roll: (roll, pitch), "right within 0.0 deg with pitch and roll exchanged"),
        (lambda pitch, roll: (-pitch, roll), "right within 0.0 deg with pitch negated"),
        (lambda pitch, roll: (-pitch, -roll), "right within 0.0 deg with pitch and roll negated"),
        (lambda pitch, roll: (roll, -pitch), "right within 0.0 deg with pitch and roll exchanged, pitch negated"),
        (lambda pitch, roll: (0.0, 0.0), ""),
    ],
)
def test_pitch_and_roll_that_are_exchanged_or_negated_are_named(
    message: Callable[[float, float], tuple[float, float]], words: str
) -> None:
    assert other_tilt([message(*tilt) for tilt in TILTS], TILTS) == words
