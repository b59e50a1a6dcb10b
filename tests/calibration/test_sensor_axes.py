"""Axes of both sensors, named from what they read at known attitudes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hiltest.calibration.axes import ALL_AXES, RIGHT, Axes, linear_map
from hiltest.calibration.sensor_axes import SensorAxes, sensor_axes
from hiltest.orientation.angles import Pose, rotation_body_from_ned

TILTS = ((0, 0), (20, 0), (-20, 0), (0, 20), (0, -20))
LEVEL = ((0, 0),)
FIELD_NED = 48.5 * np.array([np.cos(np.radians(62)), 0.0, np.sin(np.radians(62))])
OPPOSITE = FIELD_NED * [1, 1, -1]
Tilts = tuple[tuple[int, int], ...]


def known(vector_ned: np.ndarray | tuple[float, ...], tilts: Tilts = TILTS, yaw: float = 1.7) -> np.ndarray:
    """What a vector of the earth is along the board's axes at twelve headings and some tilts."""
    poses = [Pose(heading + yaw, pitch, roll) for pitch, roll in tilts for heading in range(0, 360, 30)]
    return np.array([rotation_body_from_ned(pose) @ np.array(vector_ned) for pose in poses])


def seen(
    magnetometer: np.ndarray = RIGHT.matrix,
    accelerometer: np.ndarray = RIGHT.matrix,
    *,
    tilts: Tilts = TILTS,
    hard_iron: tuple[float, ...] = (24.0, -22.0, 40.0),
    real: np.ndarray = FIELD_NED,
    yaw: float = 0.0,
) -> SensorAxes:
    """Axes of sensors that read these maps of field and gravity, with the noise of 16 readings and offsets."""
    noise = np.random.default_rng(7).normal(size=(2, 12 * len(tilts), 3))
    field = 10.0 * known(real, tilts, 1.7 + yaw) @ magnetometer.T + np.array(hard_iron) + 1.0 * noise[0]
    gravity = 8192.0 * (known((0, 0, 1), tilts, 1.7 + yaw) @ accelerometer.T + [0.06, -0.05, 0.04]) + 3.0 * noise[1]
    return sensor_axes(known(FIELD_NED, tilts), known((0, 0, 1), tilts), field, gravity, hard_iron=np.array(hard_iron))


def test_each_of_48_maps_of_either_sensor_is_named() -> None:
    for axes in ALL_AXES:
        assert seen(magnetometer=axes.matrix) == SensorAxes(axes, RIGHT)
        assert seen(accelerometer=axes.matrix) == SensorAxes(RIGHT, axes)
        named = str(seen(magnetometer=axes.matrix))
        assert named == ("" if axes == RIGHT else f"magnetometer: {axes}")


def test_all_48_are_different_and_half_of_them_are_left_handed() -> None:
    assert len({axes.matrix.tobytes() for axes in ALL_AXES}) == len({str(axes) for axes in ALL_AXES}) == 48
    assert sum(axes.are_left_handed for axes in ALL_AXES) == 24


@given(
    st.sampled_from(ALL_AXES),
    st.lists(st.floats(0.7, 1.3), min_size=3, max_size=3),
    st.integers(0, 1000),
    st.lists(st.floats(-800, 800), min_size=3, max_size=3),
)
def test_soft_iron_of_30_percent_and_hard_iron_beyond_the_field_do_not_confuse_it(
    axes: Axes, gains: list[float], draw: int, hard_iron: list[float]
) -> None:
    turn = np.linalg.qr(np.random.default_rng(draw).normal(size=(3, 3)))[0]
    soft_iron = turn @ np.diag(gains) @ turn.T
    offset = (hard_iron[0], hard_iron[1], hard_iron[2])
    assert seen(soft_iron @ axes.matrix, hard_iron=offset).magnetometer == axes
    assert seen(axes.matrix @ soft_iron, hard_iron=offset).magnetometer == axes


@given(st.sampled_from("xyz"), st.floats(-15, 15))
def test_a_rotation_of_some_degrees_is_no_change_of_axes(axis: str, degrees: float) -> None:
    pose = {"x": Pose(0, 0, degrees), "y": Pose(0, degrees), "z": Pose(degrees)}[axis]
    assert seen(rotation_body_from_ned(pose)).magnetometer == RIGHT


@pytest.mark.parametrize(
    "matrix",
    [rotation_body_from_ned(Pose(45)), np.diag([1.0, 1.0, 0.1]), np.zeros((3, 3))],
    ids=["half way between two", "an axis that hardly reads", "nothing but noise"],
)
def test_near_no_signed_permutation_nothing_is_said(matrix: np.ndarray) -> None:
    assert seen(matrix) == SensorAxes(None, RIGHT)


def test_a_heading_that_is_declared_wrongly_by_90_degrees_is_no_change_of_axes() -> None:
    assert str(seen(yaw=90.0)) == ""


@pytest.mark.parametrize(
    ("axes", "words"),
    [
        (Axes((1, 0, 2), (1, -1, 1)), "x and y are exchanged, y is negated (as turned by 90 deg about z)"),
        (Axes((0, 1, 2), (-1, -1, 1)), "x and y are negated (as turned by 180 deg about z)"),
        (Axes((0, 2, 1), (1, 1, -1)), "y and z are exchanged, z is negated (as turned by 90 deg about x)"),
    ],
)
def test_a_board_that_is_mounted_turned_shows_it_in_both_sensors(axes: Axes, words: str) -> None:
    result = seen(axes.matrix, axes.matrix)
    assert str(result) == f"board (magnetometer and accelerometer alike): {words}"
    assert result.explain_headings


def test_two_sensors_that_are_wrong_differently_are_both_named() -> None:
    named = str(seen(Axes((1, 0, 2), (1, 1, -1)).matrix, Axes((1, 2, 0), (1, 1, 1)).matrix))
    assert named == (
        "magnetometer: x and y are exchanged, z is negated; "
        "accelerometer: x, y and z are exchanged cyclically: x reads y, y reads z, z reads x"
    )


def test_a_dip_of_the_opposite_sign_is_told_from_a_negated_axis_on_a_tilted_board_alone() -> None:
    tilted, level = seen(real=OPPOSITE), seen(real=OPPOSITE, tilts=LEVEL)
    assert str(tilted) == "the dip has the opposite sign of the declared one"
    assert not tilted.explain_headings  # a heading does not depend on it
    assert str(level).startswith("magnetometer: z is negated (left-handed: no mounting makes it), or the dip has")
    assert str(seen(Axes((0, 1, 2), (1, 1, -1)).matrix)).startswith("magnetometer: z is negated")


def test_a_level_board_shows_the_magnetometers_axes_with_a_known_hard_iron() -> None:
    for axes in ALL_AXES:
        result = seen(axes.matrix, tilts=LEVEL)
        assert (result.magnetometer, result.accelerometer) == (axes, None)
        # About the vertical a turn of the part and one of the board look the same.
        is_turn = axes.order[2] == 2 and axes.signs[2] == 1 and not axes.are_left_handed
        assert result.explain_headings is not is_turn, axes


def test_too_few_attitudes_determine_no_map() -> None:
    assert linear_map(np.zeros((0, 3)), np.zeros((0, 3))) is None
    assert linear_map(known(FIELD_NED, LEVEL)[:3], np.ones((3, 3)), offset=np.zeros(3)) is None
    assert linear_map(known(FIELD_NED, LEVEL), np.ones((12, 3))) is None
