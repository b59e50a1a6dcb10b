"""A still board, and a link that keeps its word, on the virtual board."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hiltest.boards import Board, open_board
from hiltest.errors import CalibrationError
from hiltest.link.framing import DamagedFrame, FrameDecoder
from hiltest.link.gyroscope import GetGyroscope, GyroscopeRestReply, StillnessKind
from hiltest.link.replies import DPS_PER_COUNT
from hiltest.procedures import Turntable, check_link, measure_accelerometer_rest, rest_gyroscope
from hiltest.procedures.link_checks import damaged_frames
from hiltest.rig import Rig
from hiltest.rig.world import TemperatureDrift


def two_rests(board: Board) -> tuple[GyroscopeRestReply, GyroscopeRestReply]:
    """The first stores the bias, the second judges it."""
    return rest_gyroscope(board, seconds=2.0, store=True), rest_gyroscope(board, seconds=2.0)


def test_the_bias_of_a_first_rest_is_gone_in_a_second(virtual_board: Board, simulated_turntable: Turntable) -> None:
    simulated_turntable.rest()
    before = virtual_board.now_s()
    first, second = two_rests(virtual_board)
    assert virtual_board.now_s() - before >= 4.0  # two rests of 2 s, by the board's clock
    assert first.n == second.n == 400
    truth = virtual_board.truth
    assert truth is not None
    assert np.allclose(DPS_PER_COUNT * first.rate.mean, truth.gyroscope_bias_dps, atol=0.1)
    assert DPS_PER_COUNT * np.abs(second.corrected_mean).max() <= 0.1 < DPS_PER_COUNT * np.abs(second.rate.mean).max()


def test_a_bias_that_drifts_between_the_rests_is_not_gone(bench_rig: Rig) -> None:
    assert bench_rig.world is not None
    drift = TemperatureDrift(gyroscope_bias_dps_per_degc=(0.0, 0.3, 0.1))
    warming = replace(
        bench_rig.world, temperature_degc=25.0, temperature_end_degc=45.0, temperature_ramp_s=40.0, drift=drift
    )
    with open_board(replace(bench_rig, world=warming)) as board:
        _, rest = two_rests(board)
    corrected_dps = DPS_PER_COUNT * rest.corrected_mean
    # Half a degree a second, and the second rest begins when the first has been reported, some ms after its end.
    # Tolerance: 4.5 sigma of the difference of two means of 400 readings with 0.2 dps rms.
    assert np.allclose(corrected_dps, [0.0, 0.3, 0.1], atol=4.5 * 0.2 * np.sqrt(2 / 400) + 0.3 * 0.5 * 0.05)
    assert np.abs(corrected_dps).max() > 0.1
    assert rest.die_temperature_degc == 27  # 4.2 s after power-on


def test_a_rest_too_short_to_test_stillness_is_refused_and_not_stored(virtual_board: Board) -> None:
    before = virtual_board.session.request(GetGyroscope())
    with pytest.raises(CalibrationError, match=r"rest of 0\.05 s is shorter than the 0\.1 s"):
        rest_gyroscope(virtual_board, seconds=0.05, store=True)
    assert np.array_equal(virtual_board.session.request(GetGyroscope()).bias, before.bias)
    assert rest_gyroscope(virtual_board, seconds=0.1).stillness.kind is StillnessKind.STILL


def test_gravity_at_rest_is_one_g_and_level(virtual_board: Board, simulated_turntable: Turntable) -> None:
    simulated_turntable.rest()
    rest = measure_accelerometer_rest(virtual_board)
    assert rest.n == 64
    # 3 mg of offset and 0.3 % of gain.
    assert abs(rest.norm_error_mg) < 6.0
    assert abs(rest.pitch_deg) < 0.35
    assert abs(rest.roll_deg) < 0.35


def test_each_damaged_frame_is_one_damaged_frame() -> None:
    frames = damaged_frames()
    assert len(set(frames)) == len(frames) >= 8
    for wire in frames:
        (result,) = FrameDecoder().feed(wire)
        assert isinstance(result, DamagedFrame)


def test_the_firmware_keeps_the_link_s_word(virtual_board: Board) -> None:
    check = check_link(virtual_board)
    assert check.echoed == check.expected
    assert check.damaged_counted == check.damaged_sent
    assert check.damaged_answered == 0
    assert check.repeated_answered
    assert check.executed_once
    assert check.uart_overruns == 0
    assert virtual_board.session.retried == 0
