"""The field at a bench beside the World Magnetic Model: as declared, and as a calibrated board measures it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from datetime import date

import numpy as np
import pytest

from hiltest.boards import Board, open_board
from hiltest.doctor.check import Health
from hiltest.doctor.field_checks import ModelField, model_field, see_declared_field, see_measured_field
from hiltest.link.messages import ClearCalibration, SetCalibration
from hiltest.orientation.angles import Pose
from hiltest.rig import COUNTS_PER_UT, Rig, world_truth

HERE = ModelField(48.3, 62.4, 3.1, "WMM-2025")


def at(rig: Rig, latitude_deg: float, longitude_deg: float, altitude_m: float = 0.0) -> Rig:
    place = {"latitude_deg": latitude_deg, "longitude_deg": longitude_deg, "altitude_m": altitude_m}
    return replace(rig, field=replace(rig.field, **place))


def test_the_model_is_the_published_one(rig: Rig) -> None:
    # The example of another implementation's documentation, MathWorks' wrldmagm with WMM-2025, to its digits.
    result = model_field(at(rig, 42.283, -71.35, 1000.0), date(2028, 7, 4))
    assert isinstance(result, ModelField)
    assert result.strength_ut == pytest.approx(50.940, abs=5e-4)
    assert result.dip_deg == pytest.approx(65.9899, abs=5e-4)
    assert result.declination_deg == pytest.approx(-13.6891, abs=5e-4)
    assert result.model == "WMM-2025"


def test_a_rig_without_a_place_and_a_day_behind_the_models_end_say_so(rig: Rig) -> None:
    for unknown in (model_field(rig, date(2026, 6, 1)), model_field(at(rig, 47.0, 8.0), date(2031, 1, 1))):
        assert isinstance(unknown, str)
        assert see_declared_field(rig, unknown).health is Health.NOT_LOOKED_AT


@pytest.mark.parametrize(
    ("model", "health"),
    [
        (HERE, Health.OK),
        (replace(HERE, strength_ut=51.0), Health.WARNING),
        (replace(HERE, dip_deg=64.0), Health.WARNING),
        (replace(HERE, declination_deg=-3.0), Health.WARNING),
    ],
)
def test_a_declared_field_far_from_the_models_is_a_warning(rig: Rig, model: ModelField, health: Health) -> None:
    result = see_declared_field(rig, model)
    assert result.health is health
    assert ("iron" in result.remedy) is (health is Health.WARNING)


def test_a_declination_is_compared_round_the_circle(rig: Rig) -> None:
    turned = replace(rig, field=replace(rig.field, declination_deg=179.9))
    assert see_declared_field(turned, replace(HERE, declination_deg=-179.9)).health is Health.OK


@pytest.fixture(scope="module")
def board(rig: Rig) -> Iterator[Board]:
    with open_board(rig) as opened:
        yield opened


def hold_calibration(board: Board, rig: Rig, slot: int) -> None:
    """Let a board hold the true calibration of its world, as after a run."""
    truth = world_truth(rig)
    assert truth is not None
    matrix = np.linalg.inv(np.array(truth.soft_iron)) / (COUNTS_PER_UT * truth.field.strength_ut)
    board.session.request(SetCalibration(slot, matrix, truth.hard_iron_counts))


def test_a_board_without_a_calibration_cannot_tell(board: Board, rig: Rig) -> None:
    board.session.request(SetCalibration(0, np.eye(3), np.zeros(3)))  # as a run has it for "uncalibrated"
    result = see_measured_field(board, rig, HERE)
    board.session.request(ClearCalibration(0))
    assert result.health is Health.NOT_LOOKED_AT


@pytest.mark.parametrize("pose", [Pose(0.0, 0.0, 0.0), Pose(130.0, 20.0, -15.0), Pose(250.0, -40.0, 80.0)])
def test_a_calibrated_board_measures_the_field_in_any_pose(board: Board, rig: Rig, pose: Pose) -> None:
    hold_calibration(board, rig, 3)
    assert board.stage is not None
    board.stage.turn_to(pose)
    result = see_measured_field(board, rig, "no place")
    assert result.health is Health.OK
    strength_ut, dip_deg = (float(text) for text in result.finding.replace(" uT, dip", "").split()[:2])
    # Of 64 readings with 0.4 uT of noise; the determinant of this soft iron is within 1 % of 1. An untrimmed part of
    # this world tilts the horizon by less than 0.3 degrees.
    assert strength_ut == pytest.approx(rig.field.strength_ut, rel=0.01)
    assert dip_deg == pytest.approx(rig.field.dip_deg, abs=0.5)


@pytest.mark.parametrize(("strength", "dip_deg"), [(1.3, 0.0), (1.0, 8.0)])
def test_iron_near_a_calibrated_board_is_a_warning(rig: Rig, strength: float, dip_deg: float) -> None:
    field = replace(rig.field, strength_ut=strength * rig.field.strength_ut, dip_deg=rig.field.dip_deg + dip_deg)
    with open_board(replace(rig, field=field)) as disturbed:
        hold_calibration(disturbed, rig, 1)
        result = see_measured_field(disturbed, rig, HERE)
    assert result.health is Health.WARNING
    assert "iron" in result.finding or "iron" in result.remedy
