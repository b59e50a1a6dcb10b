"""A rig with `fewest_poses`: the run ends as soon as every limit of a heading is decided, and states it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hiltest.boards import Board
from hiltest.errors import ConfigError
from hiltest.link.messages import SetCalibration
from hiltest.measurement import Limit
from hiltest.procedures import KnownAngles, OperatorTurntable, SimulatedTurntable, Turntable, measure_known_angles
from hiltest.procedures.fewest_poses import plan_fewest_poses
from hiltest.rig import Rig, world_truth
from hiltest.rig.bench_files import shipped
from hiltest.rig.rig_file import parse_rig
from hiltest.rig.toml_tables import BoardPlace, TurntableSettings

LIMITS = {"direct": {"max": Limit(max=2.0), "bias": Limit.within(1.0)}}


@pytest.fixture
def board(virtual_board: Board, bench_rig: Rig) -> Board:
    """A board with its true calibration in slot 1, and one with 5 uT of hard iron in slot 2."""
    truth = world_truth(bench_rig)
    assert truth is not None
    inverse, iron = np.linalg.inv(np.array(truth.soft_iron)), np.array(truth.hard_iron_counts)
    virtual_board.session.request(SetCalibration(1, inverse, iron))
    virtual_board.session.request(SetCalibration(2, inverse, iron + np.array([50.0, 0.0, 0.0])))
    return virtual_board


def measured(board: Board, rig: Rig, table: Turntable, slot: int) -> KnownAngles:
    rig = replace(rig, turntable=replace(rig.turntable, fewest_poses=True), limits={})
    poses = rig.procedure.known_angle_poses("all")
    return measure_known_angles(
        board,
        table,
        poses=poses,
        slots={"direct": slot},
        mounting_yaw_deg=rig.mounting.yaw_deg if rig.mounting else 0.0,
        fewest=plan_fewest_poses(board, rig, poses, LIMITS),
    )


def test_a_right_calibration_is_proven_by_few_poses(board: Board, bench_rig: Rig) -> None:
    angles = measured(board, bench_rig, SimulatedTurntable(board.stage, uncertainty_deg=0.1), 1)
    assert 6 <= len(angles.poses) <= 16
    assert angles.decision == (
        f"{len(angles.poses)} of 60 known angles prove that all limits of headings are met (risk 3% each)"
    )
    assert angles.not_measured == angles.decision
    value, uncertainty = angles.estimates["direct"]["max"]
    assert value + uncertainty <= 2.0


def test_hard_iron_is_proven_to_miss_its_limit(board: Board, bench_rig: Rig) -> None:
    angles = measured(board, bench_rig, SimulatedTurntable(board.stage, uncertainty_deg=0.1), 2)
    assert len(angles.poses) <= 8
    assert angles.decision.endswith("prove that heading.direct.max is out of its limit (risk 3%)")
    value, uncertainty = angles.estimates["direct"]["max"]
    assert value - uncertainty > 2.0


def test_an_operator_is_asked_in_the_order_of_information_until_it_is_decided(board: Board, bench_rig: Rig) -> None:
    rig = replace(bench_rig, board=BoardPlace("real"), world=None, turntable=TurntableSettings("operator", 1.0))
    poses, asked = rig.procedure.known_angle_poses("all"), list[str]()
    draws = np.random.default_rng(2)

    def hand(question: str) -> str:
        asked.append(question)
        if "turn to heading" in question:
            number = int(question.rpartition("pose ")[2].partition(":")[0])
            pose = poses[number - 1]
            assert board.stage is not None
            board.stage.turn_to(replace(pose, heading_deg=pose.heading_deg + draws.normal(0.0, 0.5)))
        return ""

    angles = measured(board, rig, OperatorTurntable(prompt=hand, uncertainty_deg=1.0), 1)
    assert 8 <= len(angles.poses) < 60
    assert len(asked) == len(angles.poses) + 1
    assert f"{angles.decision}.\n{len(angles.poses)} of 60 known angles are taken." in asked[-1]


def test_it_needs_requests_and_a_mounting() -> None:
    for name, text in (("text-compass", 'kind = "simulated"'), ("virtual-k64f", 'kind = "simulated"')):
        path = shipped() / "rigs" / f"{name}.toml"
        rig = path.read_text(encoding="utf-8").replace(text, f"{text}\nfewest_poses = true")
        if name == "virtual-k64f":
            assert parse_rig(path, rig.encode()).turntable.fewest_poses
        else:
            with pytest.raises(ConfigError, match=r"fewest_poses.*requires firmware that answers"):
                parse_rig(path, rig.encode())
