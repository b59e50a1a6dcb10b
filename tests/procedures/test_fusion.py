"""The board runs the attitude filter through a motion; faults of its rates show."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from hiltest.boards import Board, VirtualBench
from hiltest.link.gyroscope import GetGyroscope, SetGyroscope
from hiltest.link.messages import SetCalibration
from hiltest.orientation.angles import Pose
from hiltest.orientation.quaternions import from_pose
from hiltest.procedures import BoardMovedError, FusionResult, SimulatedTurntable, measure_fusion
from hiltest.procedures.fusion import AttitudeErrors, _error
from hiltest.rig import COUNTS_PER_UT, Rig
from hiltest.world.motion import MOVE_GRID_S
from hiltest.world.sway import Sway

from ..orientation.quaternion_algebra import from_rotation_vector, product

SLOT = 12
# A third of the sway's time for all of it: three times as fast, and quicker to test.
SECONDS = 8.0


class QuickTurntable(SimulatedTurntable):
    """A simulated table in a hurry."""

    def __init__(self, bench: VirtualBench) -> None:
        super().__init__(bench, uncertainty_deg=0.1)
        self._bench = bench

    def sway(self) -> float:
        begin_s = self._bench.next_move_s()
        end_s = (round(begin_s / MOVE_GRID_S) + round(SECONDS / MOVE_GRID_S)) * MOVE_GRID_S
        self._bench.begin_move(Sway(begin_s, end_s))
        return SECONDS


@pytest.fixture(scope="module")
def calibrated(virtual_board: Board) -> Iterator[Board]:
    """The board with the world's own distortion for a calibration: what is left is noise."""
    truth = virtual_board.truth
    assert truth is not None
    soft_iron = np.linalg.inv(truth.soft_iron) / (COUNTS_PER_UT * truth.field_ut)
    virtual_board.session.request(SetCalibration(SLOT, soft_iron, COUNTS_PER_UT * truth.hard_iron_ut))
    before = virtual_board.session.request(GetGyroscope())
    nominal = truth.gyroscope_matrix
    virtual_board.session.request(SetGyroscope(nominal, before.bias))
    yield virtual_board
    virtual_board.session.request(SetGyroscope(before.matrix, before.bias))


def moved(board: Board, rig: Rig, *, bias_s: float = 2.0) -> FusionResult:
    assert isinstance(board.stage, VirtualBench)
    return measure_fusion(board, QuickTurntable(board.stage), slot=SLOT, bias_s=bias_s)


@pytest.fixture(scope="module")
def motion(calibrated: Board, bench_rig: Rig) -> FusionResult:
    return moved(calibrated, bench_rig)


def heading_limit_deg(rig: Rig) -> float:
    limit = rig.limits["fusion.heading.rms"].max
    assert limit is not None
    return limit


def test_the_filter_is_within_the_rigs_limits_and_better_than_its_measurements(
    motion: FusionResult, bench_rig: Rig
) -> None:
    fused, measured = motion.fused, motion.accelerometer_magnetometer
    assert fused is not None
    assert measured is not None
    assert fused.heading_rms_deg < heading_limit_deg(bench_rig)
    assert fused.tilt_rms_deg < (bench_rig.limits["fusion.tilt.rms"].max or 0.0)
    # 0.4 uT over a horizontal field of 22.8 uT are 1.0 degree; half as much again over 130 records and three times the
    # tilt error of a motion three times as fast.
    assert 0.9 < measured.heading_rms_deg < 2.0
    assert fused.heading_rms_deg < 0.6 * measured.heading_rms_deg


def test_the_gyroscope_alone_keeps_the_attitude_for_seconds(motion: FusionResult) -> None:
    assert motion.gyroscope is not None
    # The first attitude is the mean of 16 readings: 0.25 degrees. 8 s of what is left of the bias: 0.1.
    assert motion.gyroscope.heading_rms_deg < 1.0
    assert motion.gyroscope.tilt_rms_deg < 0.5


def test_nothing_is_lost_and_every_step_is_counted(motion: FusionResult) -> None:
    summary = motion.summary
    assert summary.left_out == 0
    assert len(motion.time_s) == summary.records == -(-summary.costs.updates // 6)
    assert motion.time_s[-1] == pytest.approx(SECONDS + 0.3, abs=0.1)
    assert summary.costs.largest is not None
    assert motion.cycle_model == "cortex-m4-trm/3@sram"


def test_the_truth_is_that_of_the_boards_clock(motion: FusionResult, calibrated: Board) -> None:
    """At 120 deg/s a clock that is wrong by 10 ms is an error of 1.2 degrees, in step with the rate."""
    assert motion.truth is not None
    assert motion.gyroscope is not None
    turning = np.array([pose.heading_deg for pose in motion.truth])
    rates_dps = np.gradient(np.unwrap(turning, period=360.0), motion.time_s)
    slope_s = np.polyfit(rates_dps, motion.gyroscope.heading_deg, 1)[0]
    # Looks come up to an eighth of a period, 0.6 and 1.6 ms, after their samples.
    assert abs(slope_s) < 2e-3
    assert abs(calibrated.now_s() - (1e-6 * motion.summary.began_us + SECONDS + 0.3)) < 1.0


def test_where_nobody_knows_the_truth_there_are_no_errors(
    calibrated: Board, bench_rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(type(calibrated), "true_attitude", Board.true_attitude)
    assert isinstance(calibrated.stage, VirtualBench)
    still = SimulatedTurntable(calibrated.stage, uncertainty_deg=0.1)
    monkeypatch.setattr(still, "sway", lambda: 0.2)
    fusion = measure_fusion(calibrated, still, slot=SLOT, bias_s=0.5)
    assert (fusion.truth, fusion.fused, fusion.accelerometer_magnetometer, fusion.gyroscope) == (None, None, None, None)
    assert fusion.summary.costs.updates > 30


# Those that show least: errors of 8, 8 and 49 degrees of heading. Wrong signs of all axes or of z alone make 86 and
# more; orientation/test_fusion.py has the filter by itself under each.
@pytest.mark.slow
@pytest.mark.parametrize(
    "wrong",
    [np.eye(3)[[1, 0, 2]], np.diag([1.0, -1.0, 1.0]), np.radians(np.eye(3))],
    ids=["x and y exchanged", "sign of y", "radians for degrees"],
)
def test_a_wrong_sign_axis_or_unit_of_the_rate_is_red(calibrated: Board, bench_rig: Rig, wrong: np.ndarray) -> None:
    right = calibrated.session.request(GetGyroscope())
    calibrated.session.request(SetGyroscope(wrong @ right.matrix, right.bias))
    try:
        # In half a second the bias is known to 0.04 deg/s, which a correct filter would not notice in 8 s.
        result = moved(calibrated, bench_rig, bias_s=0.5)
    finally:
        calibrated.session.request(SetGyroscope(right.matrix, right.bias))
    assert result.fused is not None
    tilt_limit_deg = bench_rig.limits["fusion.tilt.rms"].max
    assert tilt_limit_deg is not None
    assert result.fused.heading_rms_deg > heading_limit_deg(bench_rig) or result.fused.tilt_rms_deg > tilt_limit_deg


class Nudged(QuickTurntable):
    """A table that somebody pushes against while it rests."""

    def rest(self) -> None:
        super().rest()
        self._bench._world.turn_to(Pose(3.0), time_s=self._bench.time_s + 1.0)


def test_a_board_that_is_moved_while_its_bias_is_measured_is_refused(calibrated: Board) -> None:
    assert isinstance(calibrated.stage, VirtualBench)
    bias = calibrated.session.request(GetGyroscope()).bias
    with pytest.raises(BoardMovedError, match="about its z axis"):
        measure_fusion(calibrated, Nudged(calibrated.stage), slot=SLOT, bias_s=2.0)
    assert np.array_equal(calibrated.session.request(GetGyroscope()).bias, bias)


def test_errors_of_an_attitude_are_those_of_its_heading_and_of_its_vertical() -> None:
    truth = Pose(350.0, 10.0, -20.0)
    assert _error(from_pose(truth), truth) == pytest.approx((0.0, 0.0), abs=1e-6)
    turned = from_pose(Pose(5.0, 10.0, -20.0))
    assert _error(turned, truth) == pytest.approx((15.0, 0.0), abs=1e-6)
    about_east = product(from_rotation_vector(np.radians([0.0, 2.0, 0.0])), from_pose(truth))
    assert _error(about_east, truth)[1] == pytest.approx(2.0, abs=1e-3)
    assert np.isnan(_error(np.full(4, np.nan), truth)).all()


def test_a_record_without_an_attitude_does_not_count() -> None:
    errors = AttitudeErrors(np.array([3.0, np.nan, -4.0]), np.array([1.0, np.nan, 1.0]))
    assert errors.heading_rms_deg == pytest.approx(np.sqrt(12.5))
    assert (errors.heading_max_deg, errors.tilt_rms_deg) == (4.0, 1.0)
