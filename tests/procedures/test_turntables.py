"""A turntable says where it stands; an operator is asked, and may say otherwise."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from hiltest.boards import Board
from hiltest.errors import OperatorAbsentError
from hiltest.link.gyroscope import Axis
from hiltest.orientation.angles import Pose
from hiltest.procedures import Achieved, OperatorTurntable, Turntable


def answers(*lines: str) -> tuple[list[str], Callable[[str], str]]:
    asked: list[str] = []
    waiting = list(lines)

    def prompt(question: str) -> str:
        asked.append(question)
        return waiting.pop(0)

    return asked, prompt


def test_enter_means_that_the_pose_was_reached() -> None:
    asked, prompt = answers("")
    table = OperatorTurntable(prompt=prompt, uncertainty_deg=0.5)
    assert table.turn_to(Pose(30.0, -20.0, 0.0), known_angle=4) == Achieved(30.0, -20.0, 0.0, 0.5)
    assert asked[0].startswith("pose 5: turn to heading 30, pitch -20, roll +0")


def test_an_operator_may_type_the_heading_that_was_reached() -> None:
    _, prompt = answers("31.25")
    assert OperatorTurntable(prompt=prompt, uncertainty_deg=0.5).turn_to(Pose(30.0)).heading_deg == 31.25


def test_nonsense_is_asked_again_and_then_given_up() -> None:
    asked, prompt = answers("north", "nan", "12")
    table = OperatorTurntable(prompt=prompt, uncertainty_deg=0.5)
    assert table.turn_to(Pose(10.0)).heading_deg == 12.0
    assert len(asked) == 3
    _, prompt = answers("north", "361", "inf")
    with pytest.raises(OperatorAbsentError, match="3 answers were no heading"):
        OperatorTurntable(prompt=prompt, uncertainty_deg=0.5).turn_to(Pose(10.0))


def test_a_terminal_that_has_been_closed_is_an_absent_operator() -> None:
    def closed(_: str) -> str:
        raise EOFError

    table = OperatorTurntable(prompt=closed, uncertainty_deg=0.5)
    for ask in (table.rest, table.sway, lambda: table.tumble(2.0), lambda: table.turn_to(Pose(30.0))):
        with pytest.raises(OperatorAbsentError, match=r"no operator answered at the terminal: \w+"):
            ask()


def test_only_a_hand_is_asked_to_do_something_again(simulated_turntable: Turntable) -> None:
    asked, prompt = answers("", "", "")
    table = OperatorTurntable(prompt=prompt, uncertainty_deg=0.5, remark="U is large.\n")
    table.rest()
    assert table.again("the board moved")
    table.rest()
    table.rest()
    request = asked[2]
    assert asked == [f"U is large.\n{request}", f"the board moved.\n{request}", request]
    assert not simulated_turntable.again("the board moved")


def test_an_operator_is_asked_to_rest_and_to_tumble() -> None:
    asked, prompt = answers("", "")
    table = OperatorTurntable(prompt=prompt, uncertainty_deg=0.5)
    table.rest()
    # A hand is slower than the sensor: 300 points at 80 Hz take 5.6 s, six sides and eight corners 45.
    assert table.tumble(5.6) == 45.0
    assert "still" in asked[0]
    assert "for 45 s" in asked[1]
    _, prompt = answers("")
    assert OperatorTurntable(prompt=prompt, uncertainty_deg=0.5, tumble_s=2.0).tumble(5.6) == 5.6


def test_an_operator_is_asked_to_turn_and_tilt_at_the_pace_of_a_hand() -> None:
    asked, prompt = answers("")
    assert OperatorTurntable(prompt=prompt, uncertainty_deg=0.5).sway() == 24.0
    assert "all within 24 s" in asked[0]


def test_the_simulated_table_sways_while_the_clock_goes_on(
    virtual_board: Board, simulated_turntable: Turntable
) -> None:
    simulated_turntable.rest()
    began_s = virtual_board.now_s()
    takes_s = simulated_turntable.sway()
    assert virtual_board.now_s() == began_s  # what the board sees of it is for it to say
    observations = [
        virtual_board.true_attitude(round(1e6 * (began_s + after_s))) for after_s in (0.0, 9.0, takes_s + 0.1)
    ]
    assert observations[0] == Pose(pytest.approx(1.7), 0.0, 0.0)
    assert observations[1] is not None
    assert max(abs(observations[1].pitch_deg), abs(observations[1].roll_deg)) > 5.0
    assert observations[2] == Pose(pytest.approx(181.7), pytest.approx(0.0, abs=1e-9), pytest.approx(0.0, abs=1e-9))
    virtual_board.sleep(takes_s + 0.1)
    simulated_turntable.rest()


def test_the_simulated_table_stands_when_it_comes_back(virtual_board: Board, simulated_turntable: Turntable) -> None:
    simulated_turntable.rest()
    before = virtual_board.now_s()
    achieved = simulated_turntable.turn_to(Pose(90.0, 20.0, 0.0))
    assert achieved == Achieved(90.0, 20.0, 0.0, simulated_turntable.uncertainty_deg)
    # At 120 deg/s a quarter turn takes 0.75 s.
    assert virtual_board.now_s() - before >= 0.75


def test_an_operator_is_asked_to_mount_an_axis_and_to_turn_it_once() -> None:
    asked, prompt = answers("", "", "")
    table = OperatorTurntable(prompt=prompt, uncertainty_deg=0.5)
    table.mount(Axis.X)
    assert table.turn(Axis.X, 360.0, rate_dps=60.0) == 16.0  # twice as long as it should take, and to begin and end
    table.turn(Axis.X, -360.0, rate_dps=60.0)
    assert "nose down, its x axis straight down" in asked[0]
    assert "turn the table clockwise (seen from above) by 360 deg" in asked[1]
    assert "in about 6 s" in asked[1]
    assert "anticlockwise" in asked[2]
