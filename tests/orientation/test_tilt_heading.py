"""The tilt-compensated compass, in float64 and in the firmware's C."""

from __future__ import annotations

import ctypes
import math
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from hiltest.orientation import DegenerateFieldError, tilt_heading
from hiltest.orientation.angles import Pose, heading_error_deg, rotation_body_from_ned

SOURCE = Path(__file__).parents[2] / "firmware_stub" / "orientation" / "tilt_heading.c"
DIP_DEG = 62.0
FIELD_NED = np.array([math.cos(math.radians(DIP_DEG)), 0.0, math.sin(math.radians(DIP_DEG))])
DOWN_NED = np.array([0.0, 0.0, 1.0])
# float32: 360 degrees has an ulp of 3e-5, and 6e-8 on vectors is up to as much again over a horizontal field of half.
FIRMWARE_DEG = 6e-5
REFERENCE_DEG = 1e-9

Compass = Callable[[np.ndarray, np.ndarray], Pose | None]


@pytest.fixture(scope="module", params=["reference", "firmware"])
def compass(
    request: pytest.FixtureRequest, require_tool: Callable[[str], str], tmp_path_factory: pytest.TempPathFactory
) -> tuple[Compass, float]:
    """Return a compass that gives None when there is no heading, and its rounding [deg]."""
    if request.param == "reference":
        return _reference, REFERENCE_DEG
    library = tmp_path_factory.mktemp("tilt") / "tilt.so"
    options = ["-std=c11", "-O2", "-ffp-contract=off", "-fshort-enums", "-shared", "-fPIC", "-Wall", "-Wextra"]
    subprocess.run([require_tool("gcc"), *options, str(SOURCE), "-o", str(library), "-lm"], check=True)
    function = ctypes.CDLL(str(library)).tilt_heading
    function.restype = ctypes.c_uint8

    def firmware(gravity: np.ndarray, field: np.ndarray) -> Pose | None:
        angles = [ctypes.c_float(-999.0) for _ in range(3)]
        vectors = [(ctypes.c_float * 3)(*vector) for vector in (gravity, field)]
        status = function(*vectors, *(ctypes.byref(angle) for angle in angles))
        if status != 0:
            assert [angle.value for angle in angles] == [-999.0] * 3, "nothing is stored without a heading"
            return None
        return Pose(*(angle.value for angle in angles))

    return firmware, FIRMWARE_DEG


def _reference(gravity: np.ndarray, field: np.ndarray) -> Pose | None:
    try:
        return tilt_heading(gravity, field)
    except DegenerateFieldError:
        return None


@pytest.mark.parametrize(
    ("gravity", "field", "pose"),
    [
        ((0, 0, 1), (1, 0, 0), Pose(0, 0, 0)),
        ((0, 0, 1), (0, -1, 0), Pose(90, 0, 0)),  # facing east, north is at the left
        ((0, 0, 1), (-1, 0, 5), Pose(180, 0, 0)),
        ((0, 0, 1), (0, 1, 0), Pose(270, 0, 0)),
        ((0, 1, 0), (1, 0, 0), Pose(0, 0, 90)),  # right side down
        ((0, 0, -1), (1, 0, 0), Pose(0, 0, 180)),  # on its back, nose still north
        ((-1, 0, 0), (0, -1, 0), Pose(90, 90, 0)),  # nose up, belly east
        ((-1, 0, 0), (0, 0, 1), Pose(0, 90, 0)),  # nose up: the belly, then, points where the nose pointed
        ((1, 0, 0), (0, 0, -1), Pose(0, -90, 0)),
    ],
)
def test_poses_derived_by_hand(
    compass: tuple[Compass, float], gravity: tuple[int, ...], field: tuple[int, ...], pose: Pose
) -> None:
    result = compass[0](np.array(gravity, dtype=float), np.array(field, dtype=float))
    assert result is not None
    assert abs(heading_error_deg(result.heading_deg, pose.heading_deg)) <= compass[1]
    assert result.pitch_deg == pytest.approx(pose.pitch_deg, abs=compass[1])
    assert abs(heading_error_deg(result.roll_deg, pose.roll_deg)) <= compass[1]


@given(
    st.floats(0.0, 360.0, exclude_max=True),
    st.floats(-80.0, 80.0),
    st.floats(-179.0, 179.0),
    st.sampled_from([1e-3, 1.0, 8192.0]),
    st.sampled_from([1e-3, 1.0, 485.0]),
)
def test_any_attitude_comes_back(
    compass: tuple[Compass, float], heading: float, pitch: float, roll: float, gravity_scale: float, field_scale: float
) -> None:
    turn = rotation_body_from_ned(Pose(heading, pitch, roll))
    result = compass[0](gravity_scale * turn @ DOWN_NED, field_scale * turn @ FIELD_NED)
    assert result is not None
    assert 0.0 <= result.heading_deg < 360.0
    # Roll's rounding grows as 1/cos(pitch), and heading takes tan(pitch) and tan(dip) of it over.
    limit = compass[1] / math.cos(math.radians(pitch)) * (1.0 + math.tan(math.radians(DIP_DEG)))
    assert abs(heading_error_deg(result.heading_deg, heading)) <= limit
    assert abs(result.pitch_deg - pitch) <= limit
    assert abs(heading_error_deg(result.roll_deg, roll)) <= limit


@pytest.mark.parametrize("tilt", [Pose(0, 20, 0), Pose(0, -20, 0), Pose(0, 0, 20), Pose(0, 0, -20)])
def test_tilt_does_not_move_heading(compass: tuple[Compass, float], tilt: Pose) -> None:
    for heading in range(0, 360, 30):
        turn = rotation_body_from_ned(Pose(heading, tilt.pitch_deg, tilt.roll_deg))
        result = compass[0](turn @ DOWN_NED, turn @ FIELD_NED)
        assert result is not None
        assert abs(heading_error_deg(result.heading_deg, heading)) <= 3 * compass[1]


@pytest.mark.parametrize(
    ("gravity", "field"),
    [
        ((0, 0, 0), (1, 0, 0)),
        ((0, 0, 1), (0, 0, 0)),
        ((0, 0, 1), (0, 0, 1)),
        ((3, -4, 5), (-6, 8, -10)),
        ((0, 0, math.inf), (1, 0, 0)),
        ((0, 0, 1), (math.nan, 0, 0)),
    ],
    ids=["no gravity", "no field", "at the pole", "antiparallel", "infinite", "not a number"],
)
def test_no_heading_is_a_status_not_a_number(
    compass: tuple[Compass, float], gravity: tuple[float, ...], field: tuple[float, ...]
) -> None:
    assert compass[0](np.array(gravity, dtype=float), np.array(field, dtype=float)) is None


@given(st.tuples(*[st.floats(-(2.0**100), 2.0**100, width=32)] * 6))
def test_any_vectors_give_finite_angles_or_none(compass: tuple[Compass, float], values: tuple[float, ...]) -> None:
    result = compass[0](np.array(values[:3]), np.array(values[3:]))
    assume(result is not None)
    assert result is not None
    assert 0.0 <= result.heading_deg < 360.0
    assert -90.0 - FIRMWARE_DEG <= result.pitch_deg <= 90.0 + FIRMWARE_DEG
    assert -180.0 - FIRMWARE_DEG <= result.roll_deg <= 180.0 + FIRMWARE_DEG
