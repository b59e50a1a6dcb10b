"""Headings in a disturbed field: what they must err by, and how a run through it is summed up."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from hiltest.boards import open_board
from hiltest.errors import BenchError
from hiltest.link.messages import Average, Points, SetCalibration
from hiltest.orientation.angles import Pose
from hiltest.procedures import SimulatedTurntable, calibrate_while_driving, collect_tumble, measure_driving
from hiltest.procedures.driven_calibrations import is_disturbed
from hiltest.procedures.driving import driven_headings
from hiltest.rig import COUNTS_PER_UT, Rig
from hiltest.rig.disturbances import CurrentTable, PassingTable

SLOT = 3
# Forward, right and down [uT/A].
PER_A = (0.6, -0.4, 0.3)


def with_disturbances(rig: Rig, **tables: CurrentTable | PassingTable) -> Rig:
    assert rig.world is not None
    exact = {
        "accelerometer_offset_mg": (0.0,) * 3,
        "accelerometer_gain_error_percent": (0.0,) * 3,
        "accelerometer_cross_axis_percent": ((0.0,) * 3,) * 3,
    }
    return replace(rig, world=replace(rig.world, **exact, **tables))


def test_a_heading_errs_by_what_the_disturbance_is_across_it(bench_rig: Rig) -> None:
    rig = with_disturbances(bench_rig, current=CurrentTable(PER_A, ((0.0, 0.0), (2.0, 0.0), (2.0, 8.0))))
    with open_board(rig) as board:
        truth, table = board.truth, SimulatedTurntable(board.stage, uncertainty_deg=0.1)
        assert truth is not None
        soft_iron = np.linalg.inv(truth.soft_iron) / (COUNTS_PER_UT * truth.field_ut)
        board.session.request(SetCalibration(SLOT, soft_iron, COUNTS_PER_UT * truth.hard_iron_ut))
        board.sleep(2.0)
        assert is_disturbed(board)
        # What a calibration leaves of a field at the part is its inverse soft iron times it.
        forward, right, _ = np.linalg.inv(truth.soft_iron) @ (8.0 * np.array(PER_A))
        horizontal_ut = truth.field_ut * math.cos(math.radians(truth.dip_deg))
        for heading_deg in (0.0, 90.0, 200.0):
            table.turn_to(Pose(heading_deg))
            answer = board.session.request(Average(64, slot_bitmask=1 << SLOT, timeout_us=3_000_000))
            heading = answer.headings[SLOT]
            true_rad = math.radians(heading_deg + rig.world.mounting_yaw_deg)
            x, y = horizontal_ut * math.cos(true_rad) + forward, -horizontal_ut * math.sin(true_rad) + right
            assert heading.attitude is not None
            error_deg = (heading.attitude.heading_deg - math.degrees(math.atan2(-y, x)) + 180.0) % 360.0 - 180.0
            # 0.4 uT over 22.8 uT and the root of 64 are 0.13 degree; four of them.
            assert abs(error_deg) < 0.52
        with pytest.raises(BenchError, match=r"disturbed from 2 s on, and the board was ready for it at .* later"):
            measure_driving(board, table, begins_s=2.0, slot=SLOT)


def test_what_passes_disturbs_while_it_is_near(bench_rig: Rig) -> None:
    passing = PassingTable((300.0, 0.0, 0.0), (0.0, 2.0, 0.0), (5.0, 0.0, 0.0), 3.0)
    with open_board(with_disturbances(bench_rig, passing=passing)) as board:
        observations = []
        for until_s in (1.0, 3.0, 6.0):
            board.sleep(until_s - (board.virtual_seconds or 0.0))
            observations.append(is_disturbed(board))
    assert observations == [False, True, False]


@pytest.mark.slow
def test_points_of_a_disturbed_field_are_fitted_as_hard_iron_and_the_good_ones_are_put_back(bench_rig: Rig) -> None:
    current = CurrentTable(PER_A, ((0.0, 0.0), (14.0, 0.0), (14.0, 8.0), (20.0, 8.0), (20.0, 0.0)))
    with open_board(with_disturbances(bench_rig, current=current)) as board:
        table = SimulatedTurntable(board.stage, uncertainty_deg=0.1)
        tumble = collect_tumble(board, table, points=300)
        result = calibrate_while_driving(board, table, tumble=tumble, calibrator="direct", n=100)
        truth = board.truth
        assert truth is not None
        shifted = result.fit.hard_iron / COUNTS_PER_UT - truth.hard_iron_ut
        # 0.4 uT on 100 points leaves 0.1 uT of an offset.
        assert np.abs(shifted - 8.0 * np.array(PER_A)).max() < 0.4
        assert result.residual_percent < 1.2  # 0.4 uT of 48.5: it says nothing of what shifted it
        assert (board.session.request(Points(0, 80)).magnetometer == tumble.points[:80]).all()
        stages = result.begun_disturbed["iterative-stream"]
        assert [stage.disturbed for stage in stages] == [*[True] * (len(stages) - 6), *[False] * 6]


def field(*strengths: float) -> np.ndarray:
    return np.array([[strength, 0.0, 0.0] for strength in strengths])


def test_a_run_is_summed_up_by_what_disturbs_it() -> None:
    time_s = np.arange(10.0)
    errors = np.array([1.0, -1.0, 6.0, 8.0, 7.0, 6.0, 2.0, -10.0, 1.0, math.nan])
    motor, car = field(0, 0, 5, 5, 0, 0, 0, 0, 0, 0), field(0, 0, 0, 0, 0, 0, 0, 3, 0.4, 0)
    result = driven_headings(time_s, errors, {"current": motor, "passing": car})
    assert result.quiet_rms_deg == 1.0
    assert result.rms_by_cause_deg == pytest.approx({"current": math.sqrt(50.0), "passing": 10.0})
    assert result.rms_deg == pytest.approx(math.sqrt(200.0 / 3.0))
    assert result.max_deg == 10.0
    # Wrong for two records after the motor, at none after the car; five in all.
    assert (result.recovery_s, result.recovered) == (2.0, True)
    assert result.unsaid_s == 5.0


def test_a_heading_that_is_still_wrong_at_the_next_disturbance_or_the_end_has_not_recovered() -> None:
    time_s, errors = np.arange(6.0), np.array([0.0, 9.0, 9.0, 9.0, 9.0, 9.0])
    for strengths, longest_s in (((0, 5, 0, 0, 5, 5), 2.0), ((0, 5, 0, 0, 0, 0), 4.0)):
        result = driven_headings(time_s, errors, {"current": field(*strengths)})
        assert (result.recovery_s, result.recovered) == (longest_s, False)


def test_a_source_that_answers_no_heading_while_it_is_disturbed_has_said_so() -> None:
    errors = np.array([0.0, math.nan, math.nan, 0.0])
    result = driven_headings(np.arange(4.0), errors, {"cable": field(0, 5, 5, 0)})
    assert (result.unsaid_s, result.recovery_s) == (0.0, 0.0)
    assert math.isnan(result.rms_deg)
