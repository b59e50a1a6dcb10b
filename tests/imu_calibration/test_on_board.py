"""A calibration file's numbers on the board: what is measured under them is measured as without them."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from hiltest.boards import Board, VirtualBench, open_board
from hiltest.link.gyroscope import GetGyroscope
from hiltest.orientation.angles import Pose
from hiltest.procedures import BoardMovedError
from hiltest.procedures.imu_calibration import ImuCalibration
from hiltest.procedures.imu_calibration.on_board import gyroscope_bias_error_dps
from hiltest.rig.bench_files import shipped
from hiltest.rig.rig_file import load_rig


@pytest.fixture
def virtual_board() -> Iterator[Board]:
    with open_board(load_rig(shipped() / "rigs" / "virtual-k64f.toml")) as board:
        yield board


def test_a_rest_in_which_the_board_is_moved_judges_no_file(virtual_board: Board, calibration: ImuCalibration) -> None:
    assert isinstance(virtual_board.stage, VirtualBench)
    assert calibration.gyroscope is not None
    own = virtual_board.session.request(GetGyroscope())
    # There and back: the mean of the rate is that of a board at rest.
    for heading_deg, after_s in ((3.0, 0.6), (0.0, 0.9)):
        virtual_board.stage._world.turn_to(Pose(heading_deg), time_s=virtual_board.stage.time_s + after_s)
    with pytest.raises(BoardMovedError, match="about its z axis"):
        gyroscope_bias_error_dps(virtual_board, calibration.gyroscope, seconds=2.0)
    held = virtual_board.session.request(GetGyroscope())
    assert np.array_equal(held.matrix, own.matrix)
    assert np.array_equal(held.bias, own.bias)
