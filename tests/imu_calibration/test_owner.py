"""A calibration is of one board: another chip, another world, another part is refused."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from hiltest.boards import Board, open_board
from hiltest.errors import ConfigError
from hiltest.procedures.imu_calibration import ImuCalibration
from hiltest.procedures.imu_calibration.calibration_file import CalibrationFile
from hiltest.procedures.imu_calibration.owner import made_on, refuse_another_board
from hiltest.rig import Rig
from hiltest.rig.bench_files import shipped
from hiltest.rig.rig_file import load_rig


@pytest.fixture(scope="module")
def rig() -> Rig:
    return load_rig(shipped() / "rigs" / "virtual-k64f.toml")


@pytest.fixture(scope="module")
def board(rig: Rig) -> Iterator[Board]:
    with open_board(rig) as board:
        yield board


@pytest.fixture
def own(calibration: ImuCalibration, board: Board, rig: Rig) -> ImuCalibration:
    """A calibration of this board."""
    return replace(calibration, made_on=made_on(board, rig))


def check(calibration: ImuCalibration, board: Board, rig: Rig) -> None:
    refuse_another_board(CalibrationFile(Path("calibration.json"), "", calibration), board, rig)


def test_the_boards_own_is_taken(own: ImuCalibration, board: Board, rig: Rig) -> None:
    check(own, board, rig)


def test_another_build_of_the_firmware_and_another_seed_are_the_same_board(
    own: ImuCalibration, board: Board, rig: Rig
) -> None:
    check(replace(own, made_on=replace(own.made_on, build_id="f" * 16)), board, replace(rig, seed=rig.seed + 1))


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"unique_id": "00" * 16}, "it was made on the chip with unique id 0000"),
        ({"firmware": "other"}, "it was made with firmware 'other'"),
        ({"world_sha256": "00" * 32}, "it was made in the world of rig 'virtual-k64f' as that was then"),
        ({"world_sha256": None, "rig": "served-k64f"}, "it was made on the virtual board of rig 'served-k64f'"),
    ],
    ids=["chip", "firmware", "world", "rig"],
)
def test_another_board_is_refused(
    own: ImuCalibration, board: Board, rig: Rig, change: dict[str, str], complaint: str
) -> None:
    other = replace(own, made_on=replace(own.made_on, **change))  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match=r"calibration\.json is not of this board: .*hiltest calibrate") as caught:
        check(other, board, rig)
    assert complaint in str(caught.value)


def test_a_world_that_has_changed_is_another_board(own: ImuCalibration, board: Board, rig: Rig) -> None:
    assert rig.world is not None
    magnetised = replace(rig, world=replace(rig.world, hard_iron_ut=(30.0, 0.0, 0.0)))
    with pytest.raises(ConfigError, match="that of 'virtual-k64f' is another"):
        check(own, board, magnetised)


def test_another_part_is_refused(own: ImuCalibration, board: Board, rig: Rig) -> None:
    other = replace(own, magnetometer=replace(own.magnetometer, sensor="FXOS8700CQ magnetometer"))
    with pytest.raises(ConfigError, match=r"calibrates the magnetometer 'FXOS8700CQ magnetometer', .* uses 'MAG3110'"):
        check(other, board, rig)
