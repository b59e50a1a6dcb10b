"""An operator at the known angles of firmware that reports by itself: the dialogue, and what is still."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from hiltest.boards import Board, open_board
from hiltest.interfaces.quantities import Quantity
from hiltest.orientation.angles import Pose
from hiltest.procedures import OperatorTurntable
from hiltest.procedures.questions import Question
from hiltest.procedures.reported_headings import ReportedAngles, measure_reported_angles
from hiltest.rig import Rig
from hiltest.rig.bench_files import shipped
from hiltest.rig.rig_file import load_rig, parse_rig
from hiltest.tape.tape_recorder import Recorder

pytestmark = pytest.mark.slow

SHIPPED = shipped() / "rigs" / "text-compass.toml"
TEXT = SHIPPED.read_text(encoding="utf-8").replace('kind = "text"', 'kind = "text"\nwindow_s = 0.5\nsettle_s = 3.0')
RIG = parse_rig(SHIPPED, TEXT.encode())
POSES = (Pose(0.0), Pose(90.0), Pose(180.0))
_BEGUN_S = 1.0  # a turn of the table begins and gathers way in this time


class Hand:
    """Turns a virtual board to what it is asked for, and answers as it is told to, Enter where nothing is left."""

    def __init__(
        self, board: Board, *answers: str, then: Callable[[int], object] = lambda asked: None, looks: int = 0
    ) -> None:
        assert board.stage is not None
        self.stage, self.answers, self.then, self.looks = board.stage, list(answers), then, looks
        self.asked: list[str] = []
        self.beside: list[str] = []

    def __call__(self, question: str) -> str:
        self.asked.append(re.sub(r"\s+", " ", question))
        if pose := re.search(r"heading (\S+), pitch (\S+), roll (\S+) and", question):
            self.stage.turn_to(Pose(*map(float, pose.groups())))
        if isinstance(question, Question) and question.live is not None:
            self.beside += [str(question.live()) for _ in range(self.looks)]
        self.then(len(self.asked))
        return self.answers.pop(0) if self.answers else ""

    @property
    def poses(self) -> list[int]:
        """Numbers of the poses that were asked for."""
        return [int(match[1]) for request in self.asked if (match := re.search(r"pose (\d+): turn", request))]


def opened(rig: Rig, **more: object) -> Board:
    return open_board(rig, **more)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def compass() -> Iterator[Board]:
    with opened(RIG) as board:
        yield board


def measured(board: Board, hand: Hand, poses: Sequence[Pose] = POSES) -> ReportedAngles:
    return measure_reported_angles(board, OperatorTurntable(prompt=hand, uncertainty_deg=1.0), poses)


def test_what_the_firmware_says_whether_it_moves_and_what_is_left_stand_beside_a_question(
    compass: Board,
) -> None:
    hand = Hand(compass, looks=3)
    result = measured(compass, hand)
    assert hand.poses == [1, 2, 3]
    assert (result.skipped, result.not_measured) == ((), "")
    assert result.reference_deg.tolist() == [1.7, 91.7, 181.7]  # the mounting is 1.7
    first, _, then = hand.beside[:3]
    assert re.fullmatch(r"board \d+\.\d deg, moving; 0 of 3", first)  # with nothing before it nothing is known
    assert re.fullmatch(r"board \d+\.\d deg, still; 0 of 3", then)
    assert re.fullmatch(r"board \d+\.\d deg, still; 2 of 3, \d+ s left", hand.beside[8])
    assert float(then.split()[1]) == pytest.approx(result.heading_deg["firmware"][0], abs=2.0)  # noise of three lines
    assert "A run that is stopped begins anew" in hand.asked[0]


def test_a_board_that_still_turns_is_not_taken_until_it_stands(compass: Board) -> None:
    stage = compass.stage
    assert stage is not None

    def let_go_late(asked: int) -> None:
        if asked == 1:
            stage.turn_round(90.0, rate_dps=36.0, after_s=0.0)  # lets go of the table 2 s after Enter
            compass.sleep(_BEGUN_S)

    hand = Hand(compass, then=let_go_late)
    result = measured(compass, hand, POSES[:1])
    assert len(hand.asked) == 2  # the pose, and the end
    target = compass.output.observe(1.0)[-1].values[Quantity.HEADING][0]
    assert 60.0 < target < 120.0, "it did turn"
    assert result.heading_deg["firmware"][0] == pytest.approx(target, abs=1.5)  # noise of one line


@pytest.mark.parametrize("says_vectors", [True, False])
def test_a_board_that_never_stands_is_asked_for_again_where_its_vectors_show_it(
    says_vectors: bool, compass: Board, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of firmware that says its heading alone, a heading that moves is what it says, and is counted as unsettled."""
    monkeypatch.setattr("hiltest.procedures.reported_headings.STILL_WITHIN_S", 1.0)
    text = re.sub(r"\n  '(RAW|hard)=.*", "", TEXT)
    board = compass if says_vectors else opened(parse_rig(SHIPPED, text.encode()))
    stage = board.stage
    assert stage is not None

    def turn_on(asked: int) -> None:
        if asked == 1:
            stage.turn_round(360.0, rate_dps=36.0, after_s=0.0)
            board.sleep(_BEGUN_S)

    hand = Hand(board, then=turn_on, looks=2)
    result = measured(board, hand, POSES[:1])
    if says_vectors:
        assert re.match(r"the board does not stand still: the field changed by \d+\.\d uT\. pose 1: ", hand.asked[1])
        assert result.unsettled == 0
    else:
        assert len(hand.asked) == 2
        assert result.unsettled == 1
        assert all(", moving; 1 of 1" in item for item in hand.beside[2:]), "by its heading"
        board.close()


def test_the_reported_gyroscope_tells_the_turn_since_the_last_pose_beside_that_of_the_scale() -> None:
    turns = [0.0, 58.0, -28.0]
    asked: list[str] = []
    beside: list[str] = []
    with opened(load_rig(shipped() / "rigs" / "stm32f411-disco.toml")) as board:
        stage = board.stage
        assert stage is not None
        stage.turn_to(Pose(0.0))

        def hand(question: str) -> str:
            assert isinstance(question, Question)
            assert question.live is not None
            asked.append(question)
            if turns and (turn_deg := turns.pop(0)):
                stage.turn_round(turn_deg, rate_dps=30.0, after_s=0.3)
            beside.extend(str(question.live()) for _ in range(10))  # 0.3 s each
            return ""

        poses = (Pose(0.0), Pose(30.0))
        measure_reported_angles(board, OperatorTurntable(prompt=hand, uncertainty_deg=1.0), poses)
    refusal = re.match(r"heading 30 is a turn of \+30 deg from pose 1, but its gyroscope shows \+(\d+)\. Set", asked[2])
    assert refusal
    assert int(refusal[1]) == pytest.approx(58, abs=2)  # ten lines in a second, the mean of two between them
    assert len(asked) == 4
    last = [re.search(r", turned ([+-]\d+), still; ", beside[10 * number + 9]) for number in range(1, 4)]
    assert [int(text[1]) for text in last if text] == pytest.approx([58, 30, 0], abs=2)


def test_nothing_is_heard_beside_a_question_while_a_run_is_recorded(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "run.jsonl", {})
    with opened(replace(RIG, cycles={}), tape=recorder) as board:
        hand = Hand(board, looks=1)
        result = measured(board, hand, POSES[:1])
        recorder.end()
    assert len(result.held) == 1
    assert hand.beside == []
