"""Rests and whole turns on the virtual board: what is found is the world's, and what is wrong is named."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest

from hiltest.boards import Board, Declared, VirtualBench, VirtualBoard, open_board
from hiltest.calibration.gyroscope import GyroscopeFit
from hiltest.calibration.noise_density import noise_density
from hiltest.errors import CalibrationError
from hiltest.link.gyroscope import Axis, GetGyroscope, GyroscopeRest
from hiltest.orientation.angles import Pose
from hiltest.procedures import (
    BoardMovedError,
    FittedTurns,
    MeasuredTurn,
    OperatorTurntable,
    SimulatedTurntable,
    TurnInvalidError,
    Turntable,
    fit_on_board,
    log_gyroscope,
    measure_turn,
    rest_gyroscope,
    turns,
)
from hiltest.procedures.gyroscope_log import log_chunks
from hiltest.procedures.rest import SamplesLostError
from hiltest.rig import Rig
from hiltest.rig.world import TemperatureDrift
from hiltest.world.sensors.fifo import OVERFLOW, SampleFifo

RATE_DPS, REST_S = 90.0, 2.0


def turns_about(board: Board, table: Turntable, *axes: Axis, degrees: float = 360.0) -> list[MeasuredTurn]:
    return [measure_turn(board, table, axis, degrees=degrees, rate_dps=RATE_DPS, rest_s=REST_S) for axis in axes]


@pytest.fixture
def board(bench_rig: Rig) -> Iterator[Board]:
    with open_board(bench_rig) as board:
        yield board


@pytest.fixture
def table(board: Board) -> Turntable:
    return SimulatedTurntable(board.stage, uncertainty_deg=0.1)


def test_three_turns_find_scale_and_axes_of_the_world(board: Board, table: Turntable) -> None:
    result = turns_about(board, table, *Axis)
    truth = board.truth
    assert truth is not None
    for item in result:
        # With rests of 2 s a turn is known to 0.09 deg rms on each axis: 0.025 % and 0.014 deg; four sigma.
        assert abs(item.scale_error_percent(truth.gyroscope_response)) < 0.1
        assert item.misalignment_deg(truth.gyroscope_response) < 0.06
        assert item.bias_error_dps < 0.1 < item.uncorrected_error_dps
    assert [item.sensitivity_error_percent for item in result] == pytest.approx([1.2, -1.47, 1.8], abs=0.15)
    fitted = fit_on_board(board, result, uncertainty_deg=0.1)
    assert np.allclose(fitted.fit.matrix, truth.gyroscope_matrix, atol=0.001 * 0.0625)
    assert fitted.residual_deg == pytest.approx(0.0, abs=1e-4)  # three turns are met exactly, in float32
    assert fitted.cost is not None
    held = board.session.request(GetGyroscope())
    assert np.array_equal(held.matrix, fitted.fit.matrix)
    assert np.allclose(held.bias, result[-1].after.rate.mean, rtol=1e-6)
    # What the calibrated gyroscope makes of a turn that it was not fitted to.
    (back,) = turns_about(board, table, Axis.Y, degrees=-360.0)
    assert np.linalg.norm(held.matrix @ back.turn.integral - back.turn.turned_deg) < 0.72  # 0.2 %; two turns' noise


@pytest.mark.parametrize("axis", Axis)
def test_what_the_board_made_of_the_turns_is_judged_and_not_the_turns(axis: Axis) -> None:
    response = np.diag([1.012, 0.985, 1.018]) / 0.0625
    right = FittedTurns(GyroscopeFit(np.linalg.inv(response), np.zeros(3)), 0.0, None, 0.0, 0.0)
    assert right.scale_errors_percent(0.0625 * response) == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)
    assert right.misalignments_deg(0.0625 * response) == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)
    # A board that fits an axis wrong, of turns that were right.
    longer, turned = np.eye(3), np.eye(3)
    longer[axis, axis] = 1.005
    turned[(axis + 1) % 3, axis] = np.tan(np.radians(0.5))
    long, askew = (
        replace(right, fit=GyroscopeFit(np.linalg.inv(wrong @ response), np.zeros(3))) for wrong in (longer, turned)
    )
    assert long.scale_errors_percent(0.0625 * response)[axis] == pytest.approx(0.5)
    assert askew.misalignments_deg(0.0625 * response)[axis] == pytest.approx(0.5)


def test_stated_uncertainties_are_those_of_noise_and_table(board: Board, table: Turntable) -> None:
    result = turns_about(board, table, *Axis)
    exact, worse = (fit_on_board(board, result, uncertainty_deg=item) for item in (0.0, 0.5))
    # 25 mdps/sqrt(Hz) over 5.2 s, and the bias of two rests of 2 s.
    noise_deg = 0.025 * np.sqrt(0.5 * 5.2 * (1.0 + 5.2 / 4.0))
    assert exact.scale_uncertainty_percent == pytest.approx(100.0 * noise_deg / 360.0, rel=0.02)
    assert exact.misalignment_uncertainty_deg == pytest.approx(np.degrees(noise_deg / 360.0), rel=0.02)
    assert worse.scale_uncertainty_percent == pytest.approx(100.0 * np.hypot(noise_deg, 0.7071) / 360.0, rel=0.02)
    assert worse.misalignment_uncertainty_deg == pytest.approx(0.5, rel=0.01)


def test_turns_about_one_axis_do_not_calibrate(board: Board, table: Turntable) -> None:
    (turn,) = turns_about(board, table, Axis.Z)
    with pytest.raises(CalibrationError, match="TOO_FEW"):
        fit_on_board(board, [turn, turn], uncertainty_deg=0.1)
    with pytest.raises(CalibrationError, match="NOT_SPANNING"):
        fit_on_board(board, [turn, turn, turn], uncertainty_deg=0.1)


def test_a_bias_that_drifts_in_a_straight_line_spoils_no_turn(bench_rig: Rig) -> None:
    assert bench_rig.world is not None
    drift = TemperatureDrift(gyroscope_bias_dps_per_degc=(0.0, 0.1, 0.3))
    warming = replace(
        bench_rig.world, temperature_degc=25.0, temperature_end_degc=35.0, temperature_ramp_s=100.0, drift=drift
    )
    with open_board(replace(bench_rig, world=warming)) as board:
        (turn,) = turns_about(board, SimulatedTurntable(board.stage, uncertainty_deg=0.1), Axis.Z)
        truth = board.truth
        assert truth is not None
        # 0.03 dps a second: by the rest before alone the turn would be 0.6 deg, 0.17 %, too long.
        assert turn.after.rate.mean[2] - turn.before.rate.mean[2] == pytest.approx(16 * 0.03 * 7.3, abs=1.0)
        assert abs(turn.scale_error_percent(truth.gyroscope_response)) < 0.1


@pytest.mark.parametrize(
    ("response", "felt"),
    [
        (((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, -1.0)), r"\([+-]\d, [+-]\d, -360\) deg"),
        (((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0)), r"\(\+360, [+-]\d, [+-]\d\) deg"),
        (((2.0, 0.0, 0.0), (0.0, 2.0, 0.0), (0.0, 0.0, 2.0)), r"\([+-]\d, [+-]\d, \+720\) deg"),
    ],
    ids=["sign", "axes swapped", "unit"],
)
def test_a_gyroscope_of_wrong_sign_axis_or_unit_is_refused_with_what_it_felt(
    bench_rig: Rig, response: tuple[tuple[float, float, float], ...], felt: str
) -> None:
    assert bench_rig.world is not None
    a, b, c = response
    wrong = replace(bench_rig, world=replace(bench_rig.world, gyroscope_response=(a, b, c)))
    with (
        open_board(wrong) as board,
        pytest.raises(TurnInvalidError, match=rf"measured {felt} .* turn by \+360 about z"),
    ):
        turns_about(board, SimulatedTurntable(board.stage, uncertainty_deg=0.1), Axis.Z)


def test_a_scale_that_is_wrong_by_half_a_percent_is_seen(bench_rig: Rig) -> None:
    assert bench_rig.world is not None
    with open_board(bench_rig) as board:
        (turn,) = turns_about(board, SimulatedTurntable(board.stage, uncertainty_deg=0.1), Axis.Z)
        truth = board.truth
        assert truth is not None
        assert turn.scale_error_percent(truth.gyroscope_response / 1.005) == pytest.approx(0.5, abs=0.1)


class Nudged(SimulatedTurntable):
    """A table that somebody pushes against, some time after a rest has begun."""

    def __init__(self, bench: VirtualBench, *, after_s: float) -> None:
        super().__init__(bench, uncertainty_deg=0.1)
        self._bench, self._after_s = bench, after_s

    def mount(self, axis: Axis) -> None:
        super().mount(axis)
        self._bench._world.turn_to(Pose(3.0), time_s=self._bench.time_s + self._after_s)


def bench_of(board: Board) -> VirtualBench:
    assert isinstance(board.stage, VirtualBench)
    return board.stage


def test_a_board_that_is_moved_in_a_rest_is_refused_with_time_and_axis(board: Board) -> None:
    table = Nudged(bench_of(board), after_s=1.0)
    held = board.session.request(GetGyroscope()).bias
    with pytest.raises(
        BoardMovedError, match=r"moved 0\.9 s into the rest: [+]\d+\.\d\d deg/s about its z axis.* alone for 2 s"
    ) as refused:
        turns_about(board, table, Axis.Z)
    assert (refused.value.axis, refused.value.at_s) == (Axis.Z, pytest.approx(0.95, abs=0.06))
    assert np.array_equal(board.session.request(GetGyroscope()).bias, held)


class Hasty(SimulatedTurntable):
    """A table that turns for longer than it says."""

    def turn(self, axis: Axis, degrees: float, *, rate_dps: float) -> float:
        return super().turn(axis, degrees, rate_dps=rate_dps) - 0.6


def test_a_turn_that_is_not_over_in_time_is_invalid(board: Board) -> None:
    with pytest.raises(TurnInvalidError, match=r"the turn about z is invalid: it was not over at the last sample"):
        turns_about(board, Hasty(bench_of(board), uncertainty_deg=0.1), Axis.Z)


class Early(SimulatedTurntable):
    """A table that begins before the board samples."""

    def turn(self, axis: Axis, degrees: float, *, rate_dps: float) -> float:
        return self._stage.turn_round(degrees, rate_dps=rate_dps, after_s=0.0) + 0.3


def test_a_turn_that_has_begun_too_early_is_invalid(board: Board) -> None:
    with pytest.raises(TurnInvalidError, match="it had begun before the first sample"):
        turns_about(board, Early(bench_of(board), uncertainty_deg=0.1), Axis.Z)


def test_a_table_that_is_too_slow_for_the_board_is_told_so(board: Board) -> None:
    class Slow(SimulatedTurntable):
        def turn(self, axis: Axis, degrees: float, *, rate_dps: float) -> float:
            return super().turn(axis, degrees, rate_dps=rate_dps) + 60.0

    with pytest.raises(TurnInvalidError, match=r"the turn about z is invalid: the table takes 65 s for it"):
        turns_about(board, Slow(bench_of(board), uncertainty_deg=0.1), Axis.Z)


def test_half_a_turn_is_not_a_turn(board: Board, table: Turntable) -> None:
    class Half(SimulatedTurntable):
        def turn(self, axis: Axis, degrees: float, *, rate_dps: float) -> float:
            return super().turn(axis, 0.5 * degrees, rate_dps=rate_dps)

    with pytest.raises(
        TurnInvalidError, match=r"\+18\d\) deg about x, y, z, and the table was to turn by \+360 about z"
    ):
        turns_about(board, Half(bench_of(board), uncertainty_deg=0.1), Axis.Z)


@pytest.mark.parametrize(("slips", "is_refused"), [(["half", "none", "whole"], False), (["half"] * 3, True)])
def test_an_operator_who_slips_is_asked_for_the_turn_up_to_three_times(
    board: Board, slips: list[str], is_refused: bool
) -> None:
    stage, asked, shares = bench_of(board), list[str](), {"half": 0.5, "none": 0.0, "whole": 1.0}

    def prompt(question: str) -> str:
        asked.append(question)
        if "turn the table" in question and (share := shares[slips.pop(0)]):
            stage.turn_round(share * 360.0, rate_dps=RATE_DPS, after_s=0.4)
        return ""

    hand = OperatorTurntable(prompt=prompt, uncertainty_deg=0.5)
    with pytest.raises(TurnInvalidError) if is_refused else nullcontext():
        (turn,) = turns_about(board, hand, Axis.Z)
        assert turn.sensitivity_error_percent == pytest.approx(1.8, abs=0.15)
    assert slips == []
    reasons = [
        re.match(r"the turn about z is invalid: .* \(.*, ([+-]\d+)\) deg about x, y, z", question) for question in asked
    ]
    measured_deg = [int(reason[1]) for reason in reasons if reason]
    assert measured_deg == pytest.approx([183, 183] if is_refused else [183, 0], abs=2)


def test_lost_samples_make_a_turn_invalid(board: Board, table: Turntable, monkeypatch: pytest.MonkeyPatch) -> None:
    status, begins_s = SampleFifo.status, bench_of(board).time_s + 4.0

    def overflowed(fifo: SampleFifo, time_s: float) -> int:
        return status(fifo, time_s) | (OVERFLOW if time_s > begins_s else 0)

    monkeypatch.setattr(SampleFifo, "status", overflowed)
    with pytest.raises(TurnInvalidError, match=r"the turn about z is invalid: samples .* lost \(overrun\)"):
        _turn_in_spite_of_rests(board, table, monkeypatch)


def _turn_in_spite_of_rests(board: Board, table: Turntable, monkeypatch: pytest.MonkeyPatch) -> None:
    """Only the turn is to be judged here: a rest that lost samples is refused by itself."""
    monkeypatch.setattr(
        turns,
        "rest_gyroscope",
        lambda board, seconds, store=False: board.session.request(GyroscopeRest(int(200 * seconds), store)),
    )
    turns_about(board, table, Axis.Z)


def test_lost_samples_make_a_rest_invalid(board: Board, monkeypatch: pytest.MonkeyPatch) -> None:
    status = SampleFifo.status
    monkeypatch.setattr(SampleFifo, "status", lambda fifo, time_s: status(fifo, time_s) | OVERFLOW)
    with pytest.raises(SamplesLostError, match="lost in a rest of 2 s"):
        rest_gyroscope(board, seconds=2.0)
    with pytest.raises(SamplesLostError, match=r"lost 0\.0 s into the log"):
        log_gyroscope(board, seconds=1.0)


def test_a_log_has_every_sample_and_the_noise_of_the_rig(board: Board, table: Turntable) -> None:
    table.rest()
    log = log_gyroscope(board, seconds=5.0)
    assert log.rates_dps.shape == (1000, 3)
    assert log.rate_hz == pytest.approx(200.0, rel=1e-4)
    result = noise_density(log.rates_dps, rate_hz=log.rate_hz)
    assert result.together == pytest.approx(0.025, rel=5 * result.relative_uncertainty)
    times_s = np.concatenate([chunk.times_s for chunk in log_chunks(board, samples=300)])
    # A look finds a sample up to a sixteenth of a period late.
    assert np.diff(times_s) == pytest.approx(np.full(299, 0.005), abs=0.005 / 8)


def test_a_rest_of_the_declared_noise_is_still_and_one_of_a_noisier_part_is_not(bench_rig: Rig) -> None:
    # The board's own: a rig that declares so much less than its world has is refused.
    quieter = replace(Declared.select(bench_rig), gyroscope_density_dps=0.008)
    answer = "gyroscope_noise_mdps_per_rthz in the rig"
    with VirtualBoard(VirtualBench(bench_rig), declared=quieter) as board, pytest.raises(BoardMovedError, match=answer):
        rest_gyroscope(board, seconds=2.0)
