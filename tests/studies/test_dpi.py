"""The study of calibration against gravity: its angles are the compass's, its instances any block's, its claim true."""

from __future__ import annotations

import numpy as np
import pytest

from hiltest.orientation.angles import wrap_180
from hiltest.orientation.tilt_heading import tilt_heading
from hiltest.studies.dpi import ANGLES, METHODS, attitudes_deg, conclude, measure
from hiltest.studies.study import Block, Plan

PLAN = Plan("dpi", 2, 12, 0)


def test_heading_pitch_and_roll_are_those_of_the_compass() -> None:
    random = np.random.default_rng(4)
    down, field = random.standard_normal((2, 50, 3))
    for result, *vectors in zip(attitudes_deg(down, field).tolist(), down, field, strict=True):
        pose = tilt_heading(*vectors)
        expected = (wrap_180(pose.heading_deg), pose.pitch_deg, pose.roll_deg)
        assert result == pytest.approx(expected, abs=1e-9)


def test_an_instance_is_the_same_in_any_block() -> None:
    whole = [*measure(PLAN, Block(0, 0, 3))]
    parts = [*measure(PLAN, Block(0, 0, 1)), *measure(PLAN, Block(0, 1, 2))]
    assert whole == parts


def test_gravity_takes_off_all_but_the_accelerometer_s_own_rotation() -> None:
    result = conclude(PLAN, [[measure(PLAN, Block(0, 0, PLAN.instances))]])
    values = {measurement.name: measurement.value or 0.0 for measurement in result.measurements}
    heading = [values[f"study.dpi.{method}.heading"] for method in METHODS]
    # Axes that are turned by up to 8 degrees turn the heading by as much; half a degree of the accelerometer by that.
    assert heading[0] > 20.0 > heading[1] > 4.0 > 1.0 > heading[2]
    for angle in ANGLES[1:]:  # the accelerometer is calibrated alike for both
        assert values[f"study.dpi.dpi.{angle}"] == values[f"study.dpi.ellipsoids.{angle}"]
    assert [figure.reproduced for figure in result.printed] == [True]


def test_a_rotation_that_is_not_the_accelerometer_s_is_not_what_the_paper_says() -> None:
    numbers = np.reshape(measure(PLAN, Block(0, 0, PLAN.instances)), (PLAN.instances, -1))
    numbers[:, -2] += 0.1
    (printed,) = conclude(PLAN, [[numbers.ravel().tolist()]]).printed
    assert not printed.reproduced
