"""A run by hand that was stopped or killed: the next in the same folder goes on at the next pose, or says why not."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hiltest.boards import Board
from hiltest.calibration.still_pose import FACES
from hiltest.link.messages import SetCalibration
from hiltest.orientation.angles import Pose
from hiltest.procedures import (
    AccelerometerRun,
    KnownAngles,
    OperatorTurntable,
    Tumble,
    collect_tumble,
    measure_known_angles,
    measure_six_positions,
)
from hiltest.procedures.turntables import FACE_WORDS
from hiltest.run_record.journal import JOURNAL_FILE, Journal
from hiltest.run_record.recorder import Recorder
from hiltest.run_record.run import Verdict
from hiltest.session.by_hand import ByHand

POSES = (Pose(0.0), Pose(90.0), Pose(180.0))
BENCH = {"firmware": "hiltest 1.2 abcd", "board": "00ff", "rig": "12"}
STOPPED = Verdict("interrupted", 2, "", complete=False)
PASSED = Verdict("pass", 0, "", complete=True)


class Runs:
    """Runs in one folder, one after the other, each with an operator who answers as he is told to."""

    def __init__(self, board: Board, folder: Path) -> None:
        self.board, self.folder = board, folder
        self.asked: list[str] = []
        self.tumbled = 0

    def __call__(
        self, *answers: str, ends: Verdict | None = None, bench: dict[str, str] = BENCH, reaches_poses: bool = True
    ) -> tuple[str, KnownAngles | None]:
        """Run; with `ends` the run comes to its end, and without it is killed there. Return what is said, and found."""
        self.asked, remainder = [], list(answers)
        recorder = Recorder(Journal(self.folder), suite="gate", poses="all")
        recorder.begin()
        by_hand = ByHand(recorder, bench)

        def hand(question: str) -> str:
            self.asked.append(question)
            if pose := re.search(r"heading (\S+), pitch (\S+), roll (\S+) and", question):
                assert self.board.stage is not None
                self.board.stage.turn_to(Pose(*map(float, pose.groups())))
            return remainder.pop(0) if remainder else ""

        result = None
        try:
            by_hand.tumble(self.board, self._collect)
            if reaches_poses:
                result = measure_known_angles(
                    self.board,
                    OperatorTurntable(prompt=hand, uncertainty_deg=1.0),
                    poses=POSES,
                    slots={"uncalibrated": 0},
                    mounting_yaw_deg=0.0,
                    readings=4,
                    journal=by_hand,
                )
        except KeyboardInterrupt:
            pass
        if ends is not None:
            recorder.finish(ends)
        recorder.release()  # of a killed one the kernel takes the lock back
        return by_hand.remark, result

    def _collect(self) -> Tumble:
        from hiltest.procedures import SimulatedTurntable

        self.tumbled += 1
        return collect_tumble(
            self.board, SimulatedTurntable(self.board.stage, uncertainty_deg=0.1), points=20, chunk=20
        )

    @property
    def poses(self) -> list[int]:
        return [int(match[1]) for request in self.asked if (match := re.search(r"pose (\d+): turn", request))]


@pytest.fixture
def runs(virtual_board: Board, tmp_path: Path) -> Runs:
    virtual_board.session.request(SetCalibration(0, np.eye(3), np.zeros(3)))
    return Runs(virtual_board, tmp_path)


@pytest.mark.parametrize("ends", [STOPPED, None], ids=["stopped", "killed"])
def test_a_run_goes_on_at_the_next_pose(runs: Runs, ends: Verdict | None) -> None:
    answer, _ = runs("1.5", "", "q", ends=ends)
    assert answer == ""
    assert runs.poses == [1, 2, 3]
    answer, result = runs(ends=PASSED)
    assert re.fullmatch(
        r"goes on with the run of \S+Z, which was cut short: the tumble, 2 known angles taken over", answer
    )
    assert runs.poses == [3]
    assert re.match(r"2 known angles of the run of \S+Z, taken over\.", runs.asked[0])
    assert runs.tumbled == 1
    assert result is not None
    assert result.poses == POSES
    assert result.reference_deg.tolist() == [1.5, 90.0, 180.0]
    assert result.heading_deg["uncalibrated"].shape == (3,)
    # It has come to its end: there is nothing to go on with.
    assert not (runs.folder / JOURNAL_FILE).exists()
    answer, _ = runs(ends=PASSED)
    assert (answer, runs.poses, runs.tumbled) == ("", [1, 2, 3], 2)


def test_what_is_taken_over_twice_is_what_the_board_answered(runs: Runs) -> None:
    _, whole = runs(ends=STOPPED)  # all poses, and stopped in a later test
    assert whole is not None
    # Two runs that are killed before they come to a known angle lose none.
    for _ in range(2):
        answer, _ = runs(reaches_poses=False)
        assert "3 known angles" in answer
    _, again = runs(ends=PASSED)
    assert again is not None
    assert runs.poses == []
    for name in ("magnetometer", "accelerometer", "reference_deg"):
        assert np.array_equal(getattr(again, name), getattr(whole, name))
    assert np.array_equal(again.heading_deg["uncalibrated"], whole.heading_deg["uncalibrated"])


@pytest.mark.parametrize("case", ["firmware", "board", "rig"])
def test_another_bench_begins_anew_and_says_what_is_another(runs: Runs, case: str) -> None:
    runs("", "q")
    answer, _ = runs(ends=PASSED, bench=BENCH | {case: "ee"})
    assert re.fullmatch(
        rf"begins anew, and does not go on with the run of \S+Z, which was cut short: another {case}", answer
    )
    assert runs.poses == [1, 2, 3]
    assert runs.tumbled == 2


def test_another_calibration_begins_the_poses_anew(runs: Runs) -> None:
    runs("", "q")
    runs.board.session.request(SetCalibration(0, 1.5 * np.eye(3), np.zeros(3)))
    runs(ends=PASSED)
    assert re.match(
        r"The known angles begin anew: the calibration uncalibrated is another than in the run of", runs.asked[0]
    )
    assert runs.poses == [1, 2, 3]
    assert runs.tumbled == 1


def test_the_six_faces_are_taken_over_with_their_fit(virtual_board: Board, tmp_path: Path) -> None:
    asked: list[str] = []

    def hand(question: str) -> str:
        asked.append(question)
        if face := re.search(r"put the board (.+), square on", question):
            assert virtual_board.stage is not None
            virtual_board.stage.turn_to(next(item.pose for item in FACES if FACE_WORDS[item] == face[1]))
        return ""

    def run() -> AccelerometerRun:
        recorder = Recorder(Journal(tmp_path), suite="gate", poses="all")
        recorder.begin()
        journal = ByHand(recorder, BENCH)
        table = OperatorTurntable(prompt=hand, uncertainty_deg=1.0)
        six_positions = measure_six_positions(virtual_board, table, uncertainty_deg=1.0, journal=journal)
        recorder.release()  # killed
        return six_positions

    first = run()
    assert sum("of 6: put" in request for request in asked) == 6
    asked.clear()
    again = run()
    assert not any("of 6: put" in request for request in asked)
    assert np.array_equal(again.fit.gain, first.fit.gain)
    assert np.array_equal(again.fit.offset, first.fit.offset)
    assert again.die_temperature_degc == first.die_temperature_degc


def test_a_tumble_that_covers_too_little_is_not_taken_over_nor_are_its_poses(
    virtual_board: Board, tmp_path: Path
) -> None:
    def journal() -> tuple[Recorder, ByHand]:
        recorder = Recorder(Journal(tmp_path), suite="gate", poses="all")
        recorder.begin()
        return recorder, ByHand(recorder, BENCH, lambda tumble: "it covers 0 %" if tumble.coverage < 0.5 else "")

    assert virtual_board.stage is not None
    virtual_board.stage.turn_to(Pose(0.0))
    recorder, first = journal()
    at_rest = collect_tumble(
        virtual_board, OperatorTurntable(prompt=lambda text: "", uncertainty_deg=1.0, tumble_s=1.0), points=20
    )
    first.tumble(virtual_board, lambda: at_rest)  # as a run before this rule kept it
    recorder.release()
    recorder, second = journal()
    assert second.remark == "the tumble begins anew: it covers 0 %"
    collected: list[Tumble] = []
    assert second.tumble(virtual_board, lambda: collected.append(at_rest) or at_rest) is at_rest  # type: ignore[func-returns-value]
    assert len(collected) == 1
    recorder.release()


def break_answer(entry: dict[str, object]) -> dict[str, object]:
    return entry | {"answer": {"n": 4}} if "pose" in entry else entry


def break_shape(entry: dict[str, object]) -> dict[str, object]:
    return entry | {"tumble": {**entry["tumble"], "points": [[1]]}} if "tumble" in entry else entry  # type: ignore[dict-item]


def break_axes(entry: dict[str, object]) -> dict[str, object]:
    if "pose" not in entry:
        return entry
    answer = entry["answer"]
    assert isinstance(answer, dict)
    return entry | {"answer": answer | {"magnetometer": {"mean": [1.0], "spread": None}}}


@pytest.mark.parametrize("damage", [break_answer, break_axes, break_shape])
def test_a_damaged_journal_begins_anew(runs: Runs, damage: Callable[[dict[str, object]], dict[str, object]]) -> None:
    runs("", "q")
    path = runs.folder / JOURNAL_FILE
    entries = [damage(json.loads(line)) for line in path.read_text(encoding="utf-8").splitlines()]
    path.write_text("".join(f"{json.dumps(entry)}\n" for entry in entries), encoding="utf-8")
    answer, _ = runs(ends=PASSED)
    assert re.fullmatch(r"begins anew: the journal of the run of \S+Z, which was cut short, is damaged", answer)
    assert runs.poses == [1, 2, 3]
