"""The part of the sphere that a cloud covers."""

from __future__ import annotations

import numpy as np
import pytest

from hiltest.calibration.quality import sphere_directions
from hiltest.calibration.solid_angle import solid_angle_covered


def _cap(part: float, count: int) -> np.ndarray:
    """Return evenly spread directions over a part of the sphere about +z."""
    many = sphere_directions(round(count / part))
    return many[many[:, 2] > 1.0 - 2.0 * part]


@pytest.mark.parametrize("part", [0.1, 0.3, 0.5, 0.75])
@pytest.mark.parametrize("count", [100, 1000, 2500])
def test_a_cap_covers_its_part(part: float, count: int) -> None:
    # Points lie inside the edge by up to their spacing of sqrt(4 pi part / count): 0.2 part of a tenth at 100.
    edge = np.sqrt(4.0 * np.pi * part / count) * 2.0 * np.pi * np.sqrt(part * (1.0 - part)) / (4.0 * np.pi)
    assert solid_angle_covered(_cap(part, count)) == pytest.approx(part, abs=2.0 * edge + 0.01)


@pytest.mark.parametrize("count", [12, 30, 100, 1000])
def test_points_all_round_cover_everything(count: int) -> None:
    assert solid_angle_covered(7.0 * sphere_directions(count)) == 1.0


def test_one_turn_about_an_axis_covers_only_its_belt() -> None:
    """The largest hole is a polar cap, and there are two: a belt of no width covers little."""
    turn = np.radians(np.arange(0.0, 360.0, 1.0))
    belt = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(360)])
    # Caps of 20 degrees fit between belt and poles, but for what their roundness leaves beside the belt.
    assert solid_angle_covered(belt) < 0.05


def test_no_points_cover_nothing() -> None:
    assert solid_angle_covered(np.zeros((0, 3))) == 0.0
    assert solid_angle_covered(np.zeros((5, 3))) == 0.0
