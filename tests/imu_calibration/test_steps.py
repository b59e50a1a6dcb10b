"""The steps of a calibration: one that is refused is done again if its guide wants it, and a reset ends them all."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import pytest

from hiltest.boards import open_board
from hiltest.errors import BoardResetError, SensorFaultError
from hiltest.procedures import open_table
from hiltest.procedures.imu_calibration.contents import FigureOfMerit
from hiltest.procedures.imu_calibration.guided import calibrate_imu
from hiltest.rig.bench_files import shipped
from hiltest.rig.board_faults import BoardReset, SensorFault
from hiltest.rig.faults import Faults
from hiltest.rig.rig_file import load_rig

RIG = load_rig(shipped() / "rigs" / "virtual-k64f.toml")


@dataclass
class Guide:
    """A person who tries so many times again."""

    patience: int
    begun: list[str] = field(default_factory=list)
    refused: list[str] = field(default_factory=list)

    def begin(self, step: int, of: int, case: str) -> None:
        self.begun.append(case)

    def found(self, part: str, method: str, figures: tuple[FigureOfMerit, ...]) -> None:
        pass

    def again(self, why: str) -> bool:
        self.refused.append(why)
        return len(self.refused) <= self.patience


def calibrate(faults: Faults, guide: Guide) -> None:
    with open_board(replace(RIG, faults=faults)) as board:
        table = open_table(board, RIG, prompt=lambda _: "")
        calibrate_imu(board, table, RIG, guide=guide, made_utc="2026-11-26T00:00:00Z", calibrator="direct")


def test_a_step_with_a_sensor_at_the_end_of_its_range_can_be_done_again() -> None:
    guide = Guide(patience=1)
    calibrate(Faults(sensor=SensorFault("mag3110", "saturated", for_s=1.5)), guide)
    assert guide.begun == ["accelerometer", "gyroscope", "magnetometer"]
    assert [item.startswith("MAG3110: its y axis is at the end of its range") for item in guide.refused] == [True]


def test_who_does_it_not_again_reads_which_sensor_it_was() -> None:
    guide = Guide(patience=1)
    with pytest.raises(SensorFaultError, match="MAG3110"):
        calibrate(Faults(sensor=SensorFault("mag3110", "saturated")), guide)
    assert len(guide.refused) == 2


def test_a_reset_ends_the_calibration_and_no_step_after_it_begins() -> None:
    guide = Guide(patience=2)
    with pytest.raises(BoardResetError):
        calibrate(Faults(reset=BoardReset("brown-out", 3.0)), guide)
    assert guide.begun == ["accelerometer"]
