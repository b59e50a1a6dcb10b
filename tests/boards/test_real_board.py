"""A board on a serial port: real bytes over a pseudo-terminal, real firmware behind it."""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.usb_tree import K64F, SECOND_K64F, UsbTree

from hiltest.boards import BoardKind, RealBoard, open_board
from hiltest.boards.served_lines import PseudoTerminal
from hiltest.errors import (
    BenchError,
    BoardFault,
    ConfigError,
    DeviceTimeoutError,
    LinkLostError,
    NoBoardError,
    PortNotFoundError,
    PortRefusedError,
    SensorAbsentError,
    SeveralBoardsError,
    SyncError,
)
from hiltest.link.gyroscope import GyroscopeRest
from hiltest.link.messages import Identify, LinkStatistics
from hiltest.link.ports import READ_SLICE_S
from hiltest.link.replies import SensorKind
from hiltest.link.session import ATTEMPTS, REPLY_DEADLINE_S, RequestOutcome
from hiltest.link.transcript import Direction, Transcript
from hiltest.orientation.angles import Pose
from hiltest.procedures import (
    OperatorTurntable,
    check_link,
    collect_tumble,
    measure_cycles,
    measure_known_angles,
    open_table,
    run_calibrators,
)
from hiltest.rig import Rig
from hiltest.rig.faults import Absence, Faults

pytestmark = pytest.mark.slow

StartPtyBoard = Callable[[Rig], Any]


def test_a_board_on_a_port_identifies_itself_and_offers_no_truth(
    pty_board: StartPtyBoard, rig: Rig, real_rig: Rig
) -> None:
    transcript = Transcript("wall")
    with open_board(real_rig, port=pty_board(rig).path, transcript=transcript) as board:
        assert isinstance(board, RealBoard)
        assert board.kind is BoardKind.REAL
        assert board.identity.name == "hiltest-frdm-k64f"
        # It is a virtual one, and says so: its numbers must not pass for silicon's.
        assert board.identity.unique_id == b"virtual-frdmk64f"
        assert board.cycle_model == "undeclared@sram"
        assert board.sensor(SensorKind.MAGNETOMETER).name == "MAG3110"
        assert (board.clock, board.truth, board.virtual_seconds, board.seed) == ("wall", None, None, None)
        assert {attempt.outcome for attempt in board.session.attempts} == {RequestOutcome.ANSWERED}
    assert {entry.direction for entry in transcript.entries} == {Direction.TO_BOARD, Direction.TO_HOST}


def test_a_rig_that_takes_a_virtual_board_for_silicon_is_refused(
    pty_board: StartPtyBoard, rig: Rig, real_rig: Rig
) -> None:
    wrong = replace(real_rig, board=replace(real_rig.board, cycle_model="silicon-dwt"))
    with pytest.raises(ConfigError, match=r"declares cycle_model = 'silicon-dwt', but .* is a virtual board"):
        open_board(wrong, port=pty_board(rig).path)


def test_a_chip_is_known_by_its_unique_id_behind_any_port(
    pty_board: StartPtyBoard, rig: Rig, real_rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    chip = bytes(range(1, 17))
    monkeypatch.setattr("hiltest.virtual.peripherals.sim.VIRTUAL_UNIQUE_ID", chip)
    port = pty_board(rig).path
    with open_board(real_rig, port=port) as board:
        assert (board.identity.unique_id, board.cycle_model) == (chip, "silicon-dwt@sram")
    wrong = replace(real_rig, board=replace(real_rig.board, cycle_model="cortex-m4-trm/3"))
    with pytest.raises(ConfigError, match="is a chip"):
        open_board(wrong, port=port)


@pytest.mark.parametrize("nobodys", [bytes(16), b"\xff" * 16])
def test_a_register_that_an_emulator_leaves_blank_is_no_chip(
    pty_board: StartPtyBoard, rig: Rig, real_rig: Rig, monkeypatch: pytest.MonkeyPatch, nobodys: bytes
) -> None:
    monkeypatch.setattr("hiltest.virtual.peripherals.sim.VIRTUAL_UNIQUE_ID", nobodys)
    with open_board(real_rig, port=pty_board(rig).path) as board:
        assert board.cycle_model == "undeclared@sram"


def test_a_missing_shield_is_named_with_the_way_out_and_the_rest_still_runs(
    pty_board: StartPtyBoard, rig_without_shield: Rig, real_rig: Rig
) -> None:
    with open_board(real_rig, port=pty_board(rig_without_shield).path) as board:
        with pytest.raises(SensorAbsentError, match=r"no magnetometer MAG3110 .*FRDM-FXS-MULTI-B") as caught:
            board.sensor(SensorKind.MAGNETOMETER)
        assert any("on-board" in name.lower() or "onboard" in name.lower() for name in caught.value.available)
        with pytest.raises(SensorAbsentError):
            collect_tumble(board, OperatorTurntable(uncertainty_deg=0.5, prompt=lambda _: ""))
        cost = measure_cycles(board, ["direct"], point_sets=2, sizes=(20, 40, 100))["direct"]
        assert 0 < cost.total <= 12_500
        assert cost.model == "undeclared@sram"
        assert cost.instructions is None
        link = check_link(board)
        assert (link.echoed, link.damaged_answered, link.executed_once) == (link.expected, 0, True)
        assert link.damaged_counted == link.damaged_sent


def test_an_operator_who_follows_the_prompts_gets_the_headings_judged(
    pty_board: StartPtyBoard, rig: Rig, real_rig: Rig
) -> None:
    paced = pty_board(rig)
    asked: list[str] = []

    def operator(question: str) -> str:
        asked.append(question)
        pose = re.search(r"heading (\S+), pitch (\S+), roll (\S+) ", question)
        if pose:
            paced.bench.turn_to(Pose(*(float(angle) for angle in pose.groups())))
        elif "all round" in question:
            paced.tumble_by_hand()
        return ""

    assert rig.mounting is not None
    with open_board(real_rig, port=paced.path) as board:
        turntable = OperatorTurntable(uncertainty_deg=0.5, prompt=operator, tumble_s=4.0)
        assert turntable.name == "operator"
        tumble = collect_tumble(board, turntable, points=100)
        run = run_calibrators(board, tumble, calibrators=["direct"])["direct"]
        assert run.usable
        assert (run.offset_error_ut, run.rotation_left_deg) == (None, None)
        angles = measure_known_angles(
            board,
            turntable,
            poses=rig.procedure.known_angle_poses("level")[::4],
            slots={"uncalibrated": 0, "direct": run.slot},
            mounting_yaw_deg=rig.mounting.yaw_deg,
        )
    assert "all round" in asked[0]
    assert "\npose 1: turn to heading 358.3, pitch +0, roll +0" in asked[1]
    assert asked[-1].startswith("3 of 3 known angles are taken.")
    assert np.allclose(angles.reference_deg, [0.0, 240.0, 210.0])
    # The rig's own limit: the operator turned the very table that the simulated one is.
    assert angles.summary("direct").max_deg < 1.8
    assert angles.max_level_deg("uncalibrated") > 1.8


def test_a_rig_without_a_port_takes_the_board_that_is_plugged_in(
    pty_board: StartPtyBoard, rig: Rig, real_rig: Rig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tree = UsbTree(tmp_path / "machine")
    monkeypatch.setenv("HILTEST_ROOT", str(tree.root))
    with pytest.raises(NoBoardError):
        open_board(real_rig)
    tree.plug_in(serial=K64F, behind=Path(pty_board(rig).path))
    with open_board(real_rig) as board:
        assert board.identity.name == "hiltest-frdm-k64f"
    tree.plug_in(serial=SECOND_K64F, tty="ttyACM1")
    with pytest.raises(SeveralBoardsError):
        open_board(real_rig)
    with open_board(real_rig, port=f"usb://{K64F[:16]}") as board:
        # It is a serial device like any other: two programs would each read a part of what it says.
        with pytest.raises(PortRefusedError):
            open_board(real_rig, port=f"usb://{K64F}")
        assert board.session.request(Identify()) == board.identity


def test_what_does_not_go_together_is_refused(real_rig: Rig, rig: Rig, tmp_path: Any) -> None:
    with pytest.raises(ConfigError, match="is for the virtual board"):
        open_board(real_rig, port="/dev/ttyACM7", firmware=tmp_path / "own.elf")
    with pytest.raises(ConfigError, match="no simulated world"):
        open_board(real_rig, port="hil://")
    with pytest.raises(ConfigError, match=r"takes from its options: use --port hil://"):
        open_board(rig, port="hil://?seed=4")
    # Without the option there is a virtual board only where the rig is of one.
    with pytest.raises(PortNotFoundError, match=r"Name one of them with --port\.$"):
        open_board(real_rig, port="/dev/ttyNOSUCH7")
    with pytest.raises(PortNotFoundError, match=r"with --port, or leave the option out for the virtual board\.$"):
        open_board(rig, port="/dev/ttyNOSUCH7")


def test_a_rig_declares_what_the_cycles_of_a_board_behind_a_port_are(
    pty_board: StartPtyBoard, rig: Rig, real_rig: Rig
) -> None:
    served = replace(real_rig, board=replace(real_rig.board, cycle_model="cortex-m4-trm/3"))
    with open_board(served, port=pty_board(rig).path) as board:
        assert board.cycle_model == "cortex-m4-trm/3@sram"


def test_nobody_to_ask_is_a_bench_error(pty_board: StartPtyBoard, rig: Rig, real_rig: Rig) -> None:
    with (
        open_board(real_rig, port=pty_board(rig).path) as board,
        pytest.raises(BenchError, match="no one to ask"),
    ):
        open_table(board, real_rig)


def test_cycles_over_a_port_are_those_of_the_stepped_board(pty_board: StartPtyBoard, rig: Rig, real_rig: Rig) -> None:
    calibrators = ["direct", "iterative"]
    with open_board(rig) as stepped:
        expected = measure_cycles(stepped, calibrators, point_sets=1, sizes=(20, 100))
    with open_board(real_rig, port=pty_board(rig).path) as board:
        cycles = measure_cycles(board, calibrators, point_sets=1, sizes=(20, 100))
    assert {name: cost.cycles.tolist() for name, cost in cycles.items()} == {
        name: cost.cycles.tolist() for name, cost in expected.items()
    }


def test_the_paced_board_is_never_ahead_of_wall_time(pty_board: StartPtyBoard, rig: Rig) -> None:
    paced = pty_board(rig)
    began_s, virtual_s = time.monotonic(), paced.bench.time_s
    paced.bench.turn_to(Pose(60.0, 0.0, 0.0))
    # 0.5 s at 120 degrees a second, begun on the 0.05 s grid; one step is under way at either end.
    assert paced.bench.time_s - virtual_s >= 0.5
    assert paced.bench.time_s - virtual_s <= time.monotonic() - began_s + 0.02


def test_a_cable_pulled_while_the_board_works_is_a_lost_link_not_a_late_answer(
    pty_board: StartPtyBoard, rig: Rig, real_rig: Rig
) -> None:
    paced = pty_board(rig)
    with open_board(real_rig, port=paced.path) as board:
        hand = threading.Timer(0.3, paced.unplug)
        hand.start()
        began_s = time.monotonic()
        with pytest.raises(LinkLostError, match="Check cable and power") as caught:
            board.session.request(GyroscopeRest(4000, timeout_us=30_000_000))
        # The request would have taken 20 s: the loss is noticed when it happens.
        assert 0.3 <= time.monotonic() - began_s < 20.0
        assert not isinstance(caught.value, TimeoutError)
        assert caught.value.port == paced.path
        assert board.session.attempts[-1].outcome is RequestOutcome.ERROR
        with pytest.raises(LinkLostError):
            board.session.request(LinkStatistics())
        hand.join()


def test_the_faults_of_a_rig_are_those_of_a_real_boards_line_too(
    pty_board: StartPtyBoard, rig: Rig, real_rig: Rig
) -> None:
    faulty = replace(real_rig, faults=Faults(disappear=Absence(3.0)))
    with open_board(faulty, port=pty_board(rig).path) as board:
        time.sleep(3.0)
        with pytest.raises(LinkLostError, match="Check cable and power"):
            board.session.request(LinkStatistics())


def test_a_board_that_falls_silent_is_late_and_its_deadline_is_kept(
    pty_board: StartPtyBoard, rig: Rig, real_rig: Rig
) -> None:
    paced = pty_board(rig)
    with open_board(real_rig, port=paced.path) as board:
        paced.bench.stop()
        began_s = time.monotonic()
        with pytest.raises(DeviceTimeoutError, match=r"LINK_STATISTICS within 0\.2 s \(wall time\)") as caught:
            board.session.request(LinkStatistics(), deadline_s=0.2)
        # Every attempt has its deadline, late by a read slice at most; the rest is a busy machine.
        late_s = time.monotonic() - began_s - 0.2 * ATTEMPTS
        assert 0.0 <= late_s < READ_SLICE_S * ATTEMPTS + 1.0
        assert caught.value.state == ""  # nobody can look into a real board


def test_a_port_on_which_nobody_answers_is_a_sync_error(real_rig: Rig) -> None:
    terminal = PseudoTerminal()
    try:
        began_s = time.monotonic()
        with pytest.raises(SyncError, match=f"3 synchronisation requests on {terminal.path}, and no other byte"):
            open_board(real_rig, port=terminal.path)
        late_s = time.monotonic() - began_s - REPLY_DEADLINE_S * ATTEMPTS
        assert 0.0 <= late_s < READ_SLICE_S * ATTEMPTS + 1.0
    finally:
        terminal.unplug()


def test_firmware_that_faults_is_silent_and_the_far_end_keeps_why(
    pty_board: StartPtyBoard, rig: Rig, real_rig: Rig
) -> None:
    paced = pty_board(rig)
    with open_board(real_rig, port=paced.path) as board:
        machine = paced.machine
        # udf #0, in a function that has not run yet.
        machine.processor.memory.write(machine.image.symbols["command_link_statistics"].address & ~1, b"\x00\xde")
        board.session.request(Identify())
        with pytest.raises(DeviceTimeoutError):
            board.session.request(LinkStatistics(), deadline_s=0.1)
    with pytest.raises(BoardFault, match="command_link_statistics"):
        paced.bench.turn_to(Pose(180.0))
    assert isinstance(paced.bench.fault, BoardFault)
