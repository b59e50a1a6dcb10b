"""The known-angle procedure with firmware that speaks its own language, step by step; each step is done once."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from hiltest.boards import Board, open_board
from hiltest.procedures import Progress, Turntable
from hiltest.procedures.compass import CompassHeadings, SelfCalibration, measure_headings, tumble_until_calibrated
from hiltest.rig import Rig
from hiltest.rig.bench_files import DEFAULT_RIG, shipped
from hiltest.rig.rig_file import load_rig
from hiltest.session.settings import Settings


@pytest.fixture(scope="session")
def before(
    board: Board, turntable: Turntable, rig: Rig, hil_settings: Settings, hil_progress: Progress
) -> CompassHeadings:
    """Headings of the known angles before the firmware has seen the board turned all round: not waited for long."""
    poses = rig.procedure.known_angle_poses(hil_settings.poses)
    longest_s = 2.0 * board.output.device.window_s
    return measure_headings(board, turntable, poses, longest_s=longest_s, progress=hil_progress)


@pytest.fixture(scope="session")
def self_calibration(
    before: CompassHeadings, board: Board, turntable: Turntable, hil_progress: Progress
) -> SelfCalibration:
    """The board turned all round, until the firmware has calibrated itself."""
    return tumble_until_calibrated(board, turntable, progress=hil_progress)


@pytest.fixture(scope="session")
def after(
    self_calibration: SelfCalibration,
    board: Board,
    turntable: Turntable,
    rig: Rig,
    hil_settings: Settings,
    hil_progress: Progress,
) -> CompassHeadings:
    """Headings of the known angles afterwards."""
    poses = rig.procedure.known_angle_poses(hil_settings.poses)
    return measure_headings(board, turntable, poses, progress=hil_progress)


@pytest.fixture(scope="session")
def ours() -> Iterator[Board]:
    """hiltest's own firmware on a virtual board beside: its calibrators get the samples of the firmware under test."""
    with open_board(load_rig(shipped() / "rigs" / DEFAULT_RIG)) as board:
        yield board
