"""A board on a serial port: real bytes over a pseudo-terminal, real firmware behind it."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from hiltest.angles import Pose
from hiltest.boards import BoardKind, RealBoard, open_board
from hiltest.errors import BenchError, ConfigError, PortNotFoundError, SensorAbsentError
from hiltest.link.messages import SensorKind
from hiltest.link.session import Outcome
from hiltest.link.transcript import Direction, Transcript
from hiltest.procedures import (
    check_link,
    collect_tumble,
    measure_cycles,
    measure_known_angles,
    open_turntable,
    run_calibrators,
)
from hiltest.rig import Rig

StartPtyBoard = Callable[[Rig], Any]


def test_a_board_on_a_port_identifies_itself_and_offers_no_truth(
    pty_board: StartPtyBoard, rig: Rig, real_rig: Rig
) -> None:
    transcript = Transcript("wall")
    with open_board(real_rig, port=pty_board(rig).path, transcript=transcript) as board:
        assert isinstance(board, RealBoard)
        assert board.kind is BoardKind.REAL
        assert board.identity.name == "hiltest-frdm-k64f"
        assert board.cycle_model == "silicon-dwt@sram"
        assert board.sensor(SensorKind.MAGNETOMETER).name == "MAG3110"
        assert (board.clock, board.truth, board.virtual_seconds, board.instructions, board.seed) == (
            "wall", None, None, None, None,
        )  # fmt: skip
        assert {attempt.outcome for attempt in board.session.attempts} == {Outcome.ANSWERED}
    assert {entry.direction for entry in transcript.entries} == {Direction.TO_BOARD, Direction.TO_HOST}


def test_a_missing_shield_is_named_with_the_way_out_and_the_rest_still_runs(
    pty_board: StartPtyBoard, rig_without_shield: Rig, real_rig: Rig
) -> None:
    with open_board(real_rig, port=pty_board(rig_without_shield).path) as board:
        assert not board.has_shield()
        with pytest.raises(SensorAbsentError, match=r"no magnetometer MAG3110 .*FRDM-FXS-MULTI-B") as caught:
            board.sensor(SensorKind.MAGNETOMETER)
        assert any("on-board" in name.lower() or "onboard" in name.lower() for name in caught.value.seen)
        with pytest.raises(SensorAbsentError):
            collect_tumble(board, open_turntable(board, uncertainty_deg=0.5, prompt=lambda _: ""))
        cost = measure_cycles(board, ["direct"], clouds=2, sizes=(20, 40, 100))["direct"]
        assert 0 < cost.total <= 12_500
        assert cost.model == "silicon-dwt@sram"
        assert cost.instructions is None
        link = check_link(board)
        assert (link.echoed, link.damaged_answered, link.executed_once) == (link.expected, 0, True)
        assert link.damaged_counted == link.damaged_sent


def test_an_operator_who_follows_the_prompts_gets_the_headings_judged(
    pty_board: StartPtyBoard, rig: Rig, real_rig: Rig
) -> None:
    bench = pty_board(rig)
    asked: list[str] = []

    def operator(question: str) -> str:
        asked.append(question)
        pose = re.search(r"heading (\S+), pitch (\S+), roll (\S+) ", question)
        if pose:
            bench.turn_to(Pose(*(float(angle) for angle in pose.groups())))
        else:
            bench.tumble(8.0)
        return ""

    assert rig.mounting is not None
    with open_board(real_rig, port=bench.path) as board:
        turntable = open_turntable(board, uncertainty_deg=0.5, prompt=operator)
        assert turntable.name == "operator"
        tumble = collect_tumble(board, turntable, points=150)
        run = run_calibrators(board, tumble, calibrators=["direct"])["direct"]
        assert run.usable
        assert (run.offset_error_ut, run.rotation_left_deg) == (None, None)
        angles = measure_known_angles(
            board, turntable, poses=rig.procedure.judged_poses("level")[::3],
            slots={"uncalibrated": 0, "direct": run.slot}, mounting_yaw_deg=rig.mounting.yaw_deg,
        )
    assert "all round" in asked[0]
    assert asked[1].startswith("pose 1: turn to heading 0, pitch +0, roll +0")
    assert np.allclose(angles.reference_deg, [1.7, 91.7, 181.7, 271.7])
    # The rig's own limit: the operator turned the very table that the simulated one is.
    assert angles.summary("direct").max_deg < 1.8
    assert angles.max_level_deg("uncalibrated") > 1.8


def test_what_does_not_go_together_is_refused(real_rig: Rig, rig: Rig, tmp_path: Any) -> None:
    with pytest.raises(ConfigError, match=r"names no port: set board\.port in it, or give --hil-port"):
        open_board(real_rig)
    with pytest.raises(ConfigError, match="is for the virtual board"):
        open_board(real_rig, port="/dev/ttyACM7", firmware=tmp_path / "own.elf")
    with pytest.raises(ConfigError, match="no world to simulate"):
        open_board(real_rig, port="hil://")
    with pytest.raises(ConfigError, match=r"from its own options; give --hil-port hil://"):
        open_board(rig, port="hil://?seed=4")
    with pytest.raises(PortNotFoundError):
        open_board(real_rig, port="/dev/ttyNOSUCH7")


def test_nobody_to_ask_is_a_bench_error(pty_board: StartPtyBoard, rig: Rig, real_rig: Rig) -> None:
    with (
        open_board(real_rig, port=pty_board(rig).path) as board,
        pytest.raises(BenchError, match="nobody to ask"),
    ):
        open_turntable(board, uncertainty_deg=0.5)
