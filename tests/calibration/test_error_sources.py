"""What makes calibrated vectors differ from the known ones."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hiltest.calibration.error_sources import Source, error_sources
from hiltest.orientation.angles import Pose, rotation_body_from_ned

from .test_sensor_axes import FIELD_NED, LEVEL, known

FIELD = known(FIELD_NED / 48.5)
GRAVITY = known((0, 0, 1))
# 0.4 uT a reading, 16 readings a pose.
NOISE = 0.1 / 48.5 * np.random.default_rng(3).normal(size=FIELD.shape)
OFF_DIAGONAL = np.array([[1, 0.03, 0], [0.03, 1, -0.02], [0, -0.02, 1]])


@pytest.mark.parametrize(
    ("result", "source", "size"),
    [
        (FIELD + np.array([0.0124, 0, 0]), Source.OFFSET, [0.0124, 0, 0]),
        (FIELD + np.array([0, -0.01, 0.03]), Source.OFFSET, [0, -0.01, 0.03]),
        (FIELD * [1.03, 1, 1], Source.SCALE, [0.03, 0, 0]),
        (FIELD @ OFF_DIAGONAL, Source.SOFT_IRON, [-0.02, 0, 0.03]),
        (FIELD @ rotation_body_from_ned(Pose(0, -3)), Source.ROTATION, [0, -3, 0]),
        (FIELD @ rotation_body_from_ned(Pose(40)), Source.ROTATION, [0, 0, 40]),
        (known(FIELD_NED / 48.5, yaw=4.7), Source.CONSTANT_TURN, [0, 0, 3]),
    ],
    ids=["offset", "offset all round", "scale", "soft iron", "rotation", "a large rotation", "constant"],
)
def test_the_source_that_was_made_explains_best_and_has_its_size(
    result: np.ndarray, source: Source, size: list[float]
) -> None:
    first, second, *_ = error_sources(FIELD, result + NOISE, down=GRAVITY)
    assert first.source is source
    # The criterion's difference of 10 is 150 to 1 in odds.
    assert second.criterion - first.criterion > 10
    # 0.1 uT over 60 poses, 4 sigma: 0.0011 of the field; z, which hardly varies, 0.006 beside an offset.
    tolerance = 0.4 if source in (Source.ROTATION, Source.CONSTANT_TURN) else 0.006
    assert first.size == pytest.approx(np.array(size), abs=tolerance)
    assert first.undone == pytest.approx(FIELD, abs=0.02)


@given(st.floats(0.2, 5.0))
def test_a_common_factor_hides_no_source(factor: float) -> None:
    offset, *_ = error_sources(FIELD, factor * (FIELD + np.array([0.02, 0, 0]) + NOISE))
    assert offset.source is Source.OFFSET
    assert factor * (FIELD + np.array([0.02, 0, 0])) @ offset.gain.T - offset.shift == pytest.approx(FIELD, abs=0.01)


def test_on_a_level_board_nothing_is_made_of_axes_along_which_there_was_nothing_to_read() -> None:
    down = known((0, 0, 1), LEVEL)
    best, *_ = error_sources(down, down * 1.02)
    assert np.isfinite(best.size).all()
    assert best.undone == pytest.approx(down, abs=1e-6)


def test_readings_that_are_all_zero_have_sources_of_finite_size() -> None:
    assert all(np.isfinite(error_source.size).all() for error_source in error_sources(FIELD, 0.0 * FIELD, down=GRAVITY))
