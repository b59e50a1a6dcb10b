"""The default virtual board, shared by the tests of this folder."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from hiltest.boards import Board, open_board
from hiltest.procedures import SimulatedTurntable, Turntable
from hiltest.rig import Rig
from hiltest.rig.bench_files import shipped
from hiltest.rig.rig_file import load_rig


@pytest.fixture(scope="session")
def bench_rig() -> Rig:
    return load_rig(shipped() / "rigs" / "virtual-k64f.toml")


@pytest.fixture(scope="session")
def virtual_board(bench_rig: Rig) -> Iterator[Board]:
    with open_board(bench_rig) as board:
        yield board


@pytest.fixture
def simulated_turntable(virtual_board: Board, bench_rig: Rig) -> Turntable:
    return SimulatedTurntable(virtual_board.stage, uncertainty_deg=bench_rig.turntable.uncertainty_deg)
