"""A vector or a heading of any convention becomes that of hiltest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hiltest.interfaces.frames import FRAMES
from hiltest.orientation import tilt_heading
from hiltest.orientation.angles import Pose, heading_error_deg, rotation_body_from_ned

ANGLES = st.floats(-180.0, 180.0)


# A level board that points north, in the Toolbox' own words: x forward in NED, y forward in the others, whose z is up.
@pytest.mark.parametrize(
    ("frame", "gravity", "field"),
    [
        ("ned", (0, 0, 1), (22.8, 0, 42.8)),
        ("android", (0, 0, 1), (0, 22.8, -42.8)),
        ("windows", (0, 0, -1), (0, 22.8, -42.8)),
        ("enu", (0, 0, 1), (0, 22.8, -42.8)),
    ],
)
def test_a_level_board_that_points_north(frame: str, gravity: tuple[float, ...], field: tuple[float, ...]) -> None:
    of = FRAMES[frame]
    assert of.gravity(gravity).tolist() == [0.0, 0.0, 1.0]
    assert tilt_heading(of.gravity(gravity), of.vector(field)) == Pose(0.0, 0.0, 0.0)


@pytest.mark.parametrize("frame", FRAMES)
@given(heading=st.floats(0.0, 360.0), pitch=st.floats(-80.0, 80.0), roll=ANGLES)
def test_the_way_back_from_any_attitude(frame: str, heading: float, pitch: float, roll: float) -> None:
    of = FRAMES[frame]
    turn = rotation_body_from_ned(Pose(heading, pitch, roll))
    field, gravity = turn @ np.array([22.8, 0.0, 42.8]), turn @ np.array([0.0, 0.0, 1.0])
    back = np.array(of.to_body).T  # what such firmware would say
    result = tilt_heading(of.gravity(of.gravity_sign * back @ gravity), of.vector(back @ field))
    assert abs(heading_error_deg(result.heading_deg, heading)) < 1e-6  # float64 of a field at 62 degrees of dip


@pytest.mark.parametrize("chip_to_body", [None, ((0.0, -1.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0))])
def test_a_soft_iron_acts_on_raw_fields_as_before(chip_to_body: tuple[tuple[float, ...], ...] | None) -> None:
    of = replace(FRAMES["android"], chip_to_body=chip_to_body)
    matrix, vector = np.arange(9.0), np.array([1.0, -2.0, 3.0])
    assert of.soft_iron(matrix) @ of.raw_field(vector) == pytest.approx(of.raw_field(matrix.reshape(3, 3) @ vector))


def test_raw_fields_are_along_the_chips_axes_and_calibrated_ones_along_the_firmwares() -> None:
    of = replace(FRAMES["ned"], chip_to_body=((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)))
    assert of.raw_field([1.0, 2.0, 3.0]).tolist() == [-2.0, 1.0, 3.0]
    assert of.vector([1.0, 2.0, 3.0]).tolist() == [1.0, 2.0, 3.0]


def test_headings_that_grow_the_other_way() -> None:
    assert [FRAMES["ned"].heading_deg(item) for item in (0.0, 90.0, -10.0)] == [0.0, 90.0, 350.0]
    assert [FRAMES["enu"].heading_deg(item) for item in (0.0, 90.0, -10.0)] == [0.0, 270.0, 10.0]
