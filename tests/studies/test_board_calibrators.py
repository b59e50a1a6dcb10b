"""Calibrators that are called without booting are those of the firmware: names, fits and cycles."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from hiltest.boards import Board, open_board
from hiltest.calibration.fit import FitStatus
from hiltest.procedures.calibrate import calibrate_once
from hiltest.procedures.cycles import upload_points
from hiltest.procedures.golden_points import golden_points
from hiltest.rig.bench_files import shipped
from hiltest.rig.rig_file import load_rig
from hiltest.studies.board_calibrators import MOST_POINTS, board_calibrators


@pytest.fixture(scope="module")
def board() -> Iterator[Board]:
    opened = open_board(load_rig(shipped() / "rigs" / "virtual-k64f.toml"))
    yield opened
    opened.close()


def test_names_and_cycle_model_are_those_of_the_firmware_s_identity(board: Board) -> None:
    called = board_calibrators()
    assert called.names == tuple(board.identity.calibrators)
    assert called.cycle_model == board.cycle_model


def test_fits_and_cycles_are_those_that_the_firmware_answers(board: Board) -> None:
    called = board_calibrators()
    points = golden_points(60, index=3)
    upload_points(board, points)
    for name in called.names:
        expected, cost = calibrate_once(board, name, len(points))
        fit, cycles = called.calibrate(name, points.astype(float))
        assert cost is not None
        assert cycles == cost.cycles, name
        assert (fit.status, fit.iterations, fit.coverage) == (expected.status, expected.iterations, expected.coverage)
        assert np.array_equal(fit.soft_iron, expected.soft_iron)
        assert np.array_equal(fit.hard_iron, expected.hard_iron)


def test_counts_that_no_sensor_gives_are_refused() -> None:
    with pytest.raises(ValueError, match="int16"):
        board_calibrators().calibrate("direct", np.full((20, 3), 40_000.0))


def test_the_most_points_have_room_on_the_board() -> None:
    fit, _ = board_calibrators().calibrate("direct", golden_points(MOST_POINTS, index=0).astype(float))
    assert fit.status is FitStatus.ELLIPSOID
