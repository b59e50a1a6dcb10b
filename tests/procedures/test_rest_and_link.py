"""A still board, and a link that keeps its word, on the virtual board."""

from __future__ import annotations

import numpy as np

from hiltest.boards import Board
from hiltest.link.framing import DamagedFrame, FrameDecoder
from hiltest.procedures import Turntable, check_link, measure_accelerometer_rest, measure_gyroscope_rest
from hiltest.procedures.link_checks import damaged_frames


def test_the_bias_of_a_first_rest_is_gone_in_a_second(virtual_board: Board, simulated_turntable: Turntable) -> None:
    simulated_turntable.rest()
    before = virtual_board.now_s()
    rest = measure_gyroscope_rest(virtual_board, seconds=2.0)
    assert virtual_board.now_s() - before >= 4.0  # two rests of 2 s, by the board's clock
    assert (rest.n, rest.seconds) == (400, 2.0)
    truth = virtual_board.truth
    assert truth is not None
    assert np.allclose(rest.bias_dps, truth.gyroscope_bias_dps, atol=0.1)
    assert rest.bias_error_dps <= 0.1 < rest.uncorrected_error_dps
    assert rest.bias_error_dps == np.abs(rest.corrected_dps).max()


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
        (found,) = FrameDecoder().feed(wire)
        assert isinstance(found, DamagedFrame)


def test_the_firmware_keeps_the_link_s_word(virtual_board: Board) -> None:
    check = check_link(virtual_board)
    assert check.echoed == check.expected
    assert check.damaged_counted == check.damaged_sent
    assert check.damaged_answered == 0
    assert check.repeated_answered
    assert check.executed_once
    assert check.uart_overruns == 0
    assert virtual_board.session.retried == 0
