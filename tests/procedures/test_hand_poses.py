"""An operator at the known angles: what is beside a question, when a pose is taken, and the way there and back."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hiltest.boards import Board, open_board
from hiltest.errors import OperatorAbsentError, TurntableError
from hiltest.link.messages import Average, SetCalibration
from hiltest.link.replies import AverageReply
from hiltest.orientation.angles import Pose
from hiltest.procedures import KnownAngles, OperatorTurntable, measure_known_angles
from hiltest.procedures.hand_poses import PoseWalk, Wish, wish_of
from hiltest.procedures.questions import Glance, Question
from hiltest.procedures.requested_headings import movement
from hiltest.rig import Rig

POSES = (Pose(0.0), Pose(90.0), Pose(180.0))
_BEGUN_S = 1.0  # a turn of the table begins and gathers way in this time


def test_a_walk_goes_on_to_what_is_open_and_back_to_what_was_taken() -> None:
    walk = PoseWalk(4)
    walk.take()
    walk.skip()
    assert (walk.at, walk.taken, walk.skipped, walk.left) == (2, [0], {1}, 2)
    walk.redo()
    assert walk.at == 0
    walk.take()
    assert (walk.at, walk.taken) == (2, [0])
    walk.back()
    assert walk.at == 1
    walk.take()
    assert (walk.at, walk.taken, walk.skipped) == (2, [0, 1], set())
    walk.back()
    walk.skip()  # one that was taken stays as it was
    assert (walk.at, walk.taken, walk.skipped) == (2, [0, 1], set())
    walk.take()
    walk.take()
    assert walk.at is None
    walk.back()
    assert walk.at == 3


@given(of=st.integers(1, 6), steps=st.lists(st.sampled_from(["take", "skip", "back", "redo"]), max_size=30))
def test_no_step_loses_a_pose_and_the_open_ones_end_every_walk(of: int, steps: list[str]) -> None:
    walk = PoseWalk(of)
    for step in steps:
        selected = set(walk.taken)
        getattr(walk, step)()
        assert selected <= set(walk.taken)
        assert not set(walk.taken) & walk.skipped
        assert walk.at is None or 0 <= walk.at < of
    for _ in range(2 * of + 1):
        walk.take()
    assert (walk.at, walk.left) == (None, 0)


def test_a_wish_is_a_word_or_its_first_letter() -> None:
    assert [wish_of(text) for text in ("r", "SKIP", " b ", "q", "quit")] == [
        Wish.REDO,
        Wish.SKIP,
        Wish.BACK,
        Wish.STOP,
        Wish.STOP,
    ]
    assert [wish_of(text) for text in ("", "87.5", "rest", "-")] == [None] * 4


class Hand:
    """Turns a virtual board to what it is asked for, and answers as it is told to, Enter where nothing is left."""

    def __init__(self, board: Board, *answers: str) -> None:
        assert board.stage is not None
        self.stage, self.answers = board.stage, list(answers)
        self.asked: list[str] = []
        self.beside: list[str] = []

    def __call__(self, question: str) -> str:
        assert isinstance(question, Question)
        self.asked.append(re.sub(r"\s+", " ", question))
        if pose := re.search(r"heading (\S+), pitch (\S+), roll (\S+) and", question):
            self.stage.turn_to(Pose(*map(float, pose.groups())))
        self.beside += [str(question.live()), str(question.live())]
        return self.answers.pop(0) if self.answers else ""

    @property
    def poses(self) -> list[int]:
        """Numbers of the poses that were asked for."""
        return [int(match[1]) for request in self.asked if (match := re.search(r"pose (\d+): turn", request))]


@pytest.fixture
def by_hand(virtual_board: Board) -> Callable[..., tuple[KnownAngles, Hand]]:
    def measure(*answers: str) -> tuple[KnownAngles, Hand]:
        hand = Hand(virtual_board, *answers)
        known_angles = measure_known_angles(
            virtual_board,
            OperatorTurntable(prompt=hand, uncertainty_deg=1.0),
            poses=POSES,
            slots={"uncalibrated": 0},
            mounting_yaw_deg=0.0,
            readings=4,
        )
        return known_angles, hand

    virtual_board.session.request(SetCalibration(0, np.eye(3), np.zeros(3)))
    return measure


def test_what_the_board_says_whether_it_moves_and_what_is_left_stand_beside_a_question(
    by_hand: Callable[..., tuple[KnownAngles, Hand]],
) -> None:
    result, hand = by_hand()
    assert hand.poses == [1, 2, 3]
    assert result.poses == POSES
    assert result.skipped == ()
    assert result.not_measured == ""
    first, then = hand.beside[:2]
    assert re.fullmatch(r"board \d+\.\d deg, moving; 0 of 3", first)  # with nothing before it nothing is known
    assert re.fullmatch(r"board \d+\.\d deg, still; 0 of 3", then)
    assert re.fullmatch(r"board \d+\.\d deg, still; 2 of 3, \d+ s left", hand.beside[5])
    heading_deg = float(then.split()[1])
    assert heading_deg == pytest.approx(result.heading_deg["uncalibrated"][0] % 360.0, abs=3.0)  # noise of 8 readings


def test_a_pose_is_taken_again_skipped_and_gone_back_to(by_hand: Callable[..., tuple[KnownAngles, Hand]]) -> None:
    result, hand = by_hand("", "r", "1.5", "s", "b", "s", "", "b", "s", "")
    assert hand.poses == [1, 2, 1, 2, 3, 2, 3, 3]
    assert result.poses == (POSES[0], POSES[2])
    assert result.reference_deg.tolist() == [1.5, 180.0]  # the second time the operator said what was reached
    assert result.skipped == (POSES[1],)
    assert result.not_measured == "1 of 3 known angles not measured: heading 90, pitch +0, roll +0"
    assert "pose 2 is not measured." in hand.asked[4]
    assert "2 of 3 known angles are taken; 1 pose not measured: 2." in hand.asked[-1]


def test_an_operator_who_skips_everything_or_is_not_there_ends_it_with_the_reason(
    by_hand: Callable[..., tuple[KnownAngles, Hand]],
) -> None:
    with pytest.raises(TurntableError, match="every known angle was skipped"):
        by_hand("s", "s", "s")
    with pytest.raises(OperatorAbsentError, match="3 answers were no heading"):
        by_hand("", "north", "nan", "361")
    with pytest.raises(KeyboardInterrupt, match="the operator stops, with 1 of 3 known angles taken"):
        by_hand("", "q")


class WrongHand(Hand):
    """Errs by angles [deg] at the first requests of a pose, by its number; None leaves the board as it is."""

    def __init__(self, board: Board, errors: dict[int, list[float | None]], *answers: str) -> None:
        super().__init__(board, *answers)
        self.errors = errors

    def __call__(self, question: str) -> str:
        self.asked.append(question)
        if pose := re.search(r"pose (\d+): turn to heading (\S+), pitch (\S+), roll (\S+) and", question):
            errors = self.errors.get(int(pose[1]), [])
            error_deg = errors.pop(0) if errors else 0.0
            if error_deg is not None:
                heading_deg, pitch_deg, roll_deg = map(float, pose.groups()[1:])
                self.stage.turn_to(Pose(heading_deg + error_deg, pitch_deg, roll_deg))
        return self.answers.pop(0) if self.answers else ""


CIRCLE = tuple(Pose(heading, *tilt) for tilt in ((0.0, 0.0), (20.0, 15.0)) for heading in range(0, 360, 60))


def walked(board: Board, hand: Hand, poses: tuple[Pose, ...] = CIRCLE) -> KnownAngles:
    board.session.request(SetCalibration(0, np.eye(3), np.zeros(3)))
    table = OperatorTurntable(prompt=hand, uncertainty_deg=1.0)
    return measure_known_angles(board, table, poses=poses, slots={"uncalibrated": 0}, mounting_yaw_deg=0.0, readings=16)


def test_a_board_that_was_not_turned_is_asked_for_again_until_it_was(virtual_board: Board) -> None:
    hand = WrongHand(virtual_board, {3: [None, None]})
    result = walked(virtual_board, hand, CIRCLE[:4])
    assert hand.poses == [1, 2, 3, 3, 3, 4]
    refused = "you did not turn: field and gravity are those of pose 2, heading 60, pitch +0, roll +0"
    assert [request.startswith(refused) for request in hand.asked] == [index in (3, 4) for index in range(7)]
    assert result.unset == {}


def test_an_operator_who_only_presses_enter_ends_the_run_at_the_second_pose(virtual_board: Board) -> None:
    hand = WrongHand(virtual_board, {number: [None] * 9 for number in range(2, 13)})
    with pytest.raises(OperatorAbsentError, match=r"3 times in a row you did not turn: .*is an operator there"):
        walked(virtual_board, hand)
    assert hand.poses == [1, 2, 2, 2]


def test_a_turn_by_another_angle_than_the_scale_says_is_named(virtual_board: Board) -> None:
    hand = WrongHand(virtual_board, {2: [28.0], 4: [None, 0.0]}, "", "30", "", "", "30.5")
    walked(virtual_board, hand, tuple(Pose(30.0 * index) for index in range(4)))
    said = re.match(
        r"heading 30 is a turn of \+30 deg from pose 1, but its magnetometer shows (\d+)\. Set the board to heading 30",
        hand.asked[2],
    )
    assert said
    assert 50 < int(said[1]) < 66  # iron is not calibrated yet
    assert hand.poses[:4] == [1, 2, 2, 3]


class WatchedHand(Hand):
    """Turns the table by the given angles [deg], one for each question, while the board is looked at."""

    def __init__(self, board: Board, turns: list[float], *answers: str) -> None:
        super().__init__(board, *answers)
        self.turns = turns
        self.glances: list[Glance] = []

    def __call__(self, question: str) -> str:
        assert isinstance(question, Question)
        assert question.live is not None
        self.asked.append(question)
        turn_deg = self.turns.pop(0) if self.turns else 0.0
        question.live()
        if turn_deg:
            self.stage.turn_round(turn_deg, rate_dps=60.0, after_s=0.2)
        for _ in range(20):  # 0.1 s of the board's clock each
            seen = question.live()
            self.beside.append(str(seen))
            assert isinstance(seen, Glance)
            self.glances.append(seen)
        return self.answers.pop(0) if self.answers else ""


def test_the_gyroscope_tells_the_turn_since_the_last_pose_beside_that_of_the_scale(virtual_board: Board) -> None:
    assert virtual_board.stage is not None
    virtual_board.stage.turn_to(Pose(0.0))
    hand = WatchedHand(virtual_board, [0.0, 58.0, -28.0, 30.0])
    walked(virtual_board, hand, tuple(Pose(30.0 * index) for index in range(3)))
    assert hand.poses == [1, 2, 2, 3]
    told = r"heading 30 is a turn of \+30 deg from pose 1, but its magnetometer .* and its gyroscope shows \+(\d+)\."
    assert (refusal := re.match(told, hand.asked[2]))
    assert int(refusal[1]) == pytest.approx(58, abs=1)  # rounded, and the bias of 0.3 s
    assert all(", turned " not in text for text in hand.beside[:20])  # there is no pose before the first
    last = [re.search(r", turned ([+-]\d+), still; ", hand.beside[20 * asked + 19]) for asked in range(1, 4)]
    assert [int(text[1]) for text in last if text] == pytest.approx([58, 30, 30], abs=1)
    glances = hand.glances
    assert [glances[20 * asked + 19].is_wrong_turn for asked in range(4)] == [False, True, False, False]
    assert not any(glance.is_wrong_turn for glance in glances if glance.moves)
    assert any(", moving; " in text for text in hand.beside[20:40])


def test_a_table_whose_board_may_not_be_looked_at_asks_without_a_live_text(virtual_board: Board) -> None:
    asked: list[object] = []
    virtual_board.session.request(SetCalibration(0, np.eye(3), np.zeros(3)))
    table = OperatorTurntable(prompt=lambda text: asked.append(text) or "", uncertainty_deg=1.0, may_look=False)
    measure_known_angles(
        virtual_board, table, poses=POSES[:1], slots={"uncalibrated": 0}, mounting_yaw_deg=0.0, readings=4
    )
    assert [isinstance(question, Question) and question.live for question in asked] == [None, None]


def test_a_kept_reading_stands_in_the_record_as_not_turned(virtual_board: Board) -> None:
    hand = WrongHand(virtual_board, {3: [None]}, "k", "", "", "", "k")
    result = walked(virtual_board, hand, CIRCLE[:4])
    assert hand.asked[1].startswith("no reading of this pose was doubted: there is none to keep.")
    assert hand.poses == [1, 1, 2, 3, 3, 4]  # and what was kept is not offered again
    assert result.unset == {3: "the readings of poses 2 and 3 are equal"}


@pytest.mark.parametrize("keeps", [False, True])
def test_at_the_end_exactly_the_poses_that_stick_out_are_offered_again(bench_rig: Rig, keeps: bool) -> None:
    # A board of its own has the same noise whichever tests ran before: with twelve poses a good one can stick out.
    with open_board(bench_rig) as board:
        wrong = WrongHand(board, {5: [9.0], 9: [-12.0]}, *[""] * 12, *(["s", "s"] if keeps else []))
        result = walked(board, wrong)
    assert wrong.poses == [*range(1, 13), 9, 5]
    found = dict(re.findall(r"pose (\d+) sticks out: the scale says \d+, the field (\d+)\.", wrong.asked[12]))
    assert list(found) == ["9", "5"]
    # Twelve parameters are fitted to ten poses, each known to 0.25 degrees.
    assert [int(angle) for angle in found.values()] == pytest.approx([108, 249], abs=4)
    assert "s (keeps the earlier result)" in wrong.asked[12]
    assert sorted(result.unset) == ([5, 9] if keeps else [])


def test_a_wrong_answer_is_told_why(virtual_board: Board) -> None:
    hand = WrongHand(virtual_board, {}, "north", "", "", "", "", "x")
    walked(virtual_board, hand, CIRCLE[:4])
    told = "{!r} is neither a heading between -360 and 360 nor one of the letters."
    assert hand.asked[1].startswith(told.format("north"))
    assert hand.asked[6].startswith(told.format("x"))
    assert "z through it, down when it is level" in hand.asked[0]


def test_a_board_that_still_turns_is_not_taken_until_it_stands(virtual_board: Board) -> None:
    stage, session = virtual_board.stage, virtual_board.session
    assert stage is not None
    virtual_board.session.request(SetCalibration(0, np.eye(3), np.zeros(3)))
    asked: list[str] = []

    def hand(question: str) -> str:
        asked.append(question)
        if len(asked) == 1:
            stage.turn_to(Pose(0.0))
            stage.turn_round(90.0, rate_dps=36.0, after_s=0.0)  # lets go of the table 2 s after Enter
            virtual_board.sleep(_BEGUN_S)
        return ""

    known_angles = measure_known_angles(
        virtual_board,
        OperatorTurntable(prompt=hand, uncertainty_deg=1.0),
        poses=POSES[:1],
        slots={"uncalibrated": 0},
        mounting_yaw_deg=0.0,
        readings=8,
    )
    assert len(asked) == 2  # the pose, and the end
    after = session.request(Average(8, 1)).headings[0].attitude
    assert after is not None
    assert after.heading_deg > 60.0  # it did turn
    assert known_angles.heading_deg["uncalibrated"][0] == pytest.approx(
        after.heading_deg, abs=3.0
    )  # noise of 8 readings


def test_a_board_that_never_stands_still_is_asked_for_again(
    virtual_board: Board, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hiltest.procedures.requested_headings.STILL_WITHIN_S", 1.0)
    stage = virtual_board.stage
    assert stage is not None
    virtual_board.session.request(SetCalibration(0, np.eye(3), np.zeros(3)))
    asked: list[str] = []

    def hand(question: str) -> str:
        asked.append(question)
        stage.turn_to(Pose(0.0))
        if len(asked) == 1:
            stage.turn_round(180.0, rate_dps=36.0, after_s=0.0)
            virtual_board.sleep(_BEGUN_S)
        return ""

    measure_known_angles(
        virtual_board,
        OperatorTurntable(prompt=hand, uncertainty_deg=1.0),
        poses=POSES[:1],
        slots={"uncalibrated": 0},
        mounting_yaw_deg=0.0,
        readings=8,
    )
    assert re.match(r"the board does not stand still: the field changed by \d+\.\d uT\.\npose 1: ", asked[1])


def test_noise_is_no_movement_and_a_degree_of_tilt_is_one(virtual_board: Board) -> None:
    assert virtual_board.stage is not None
    virtual_board.stage.turn_to(Pose(30.0))
    replies: list[AverageReply] = [virtual_board.session.request(Average(16)) for _ in range(8)]
    sigma_ut = virtual_board.declared.magnetometer_sigma_ut
    assert [movement(*pair, sigma_ut) for pair in pairwise(replies)] == [""] * 7
    virtual_board.stage.turn_to(Pose(30.0, 1.0))
    tilted = virtual_board.session.request(Average(16))
    assert movement(replies[-1], tilted, sigma_ut).startswith("gravity changed by 1")  # 17.5 mg
    shaken = replace(tilted.accelerometer, spread=np.array([0.0, 82.0, 0.0]))  # 10 mg
    assert "spreads by" in movement(tilted, replace(tilted, accelerometer=shaken), sigma_ut)
