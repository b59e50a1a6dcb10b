"""``hiltest calibrate`` leads an operator: it says what to do, asks again for what was refused, and ends cleanly."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hiltest.calibration.still_pose import FACES as ALL_FACES
from hiltest.procedures.imu_calibration import ImuCalibration
from hiltest.procedures.imu_calibration.calibration_file import load_calibration
from hiltest.procedures.turntables import FACE_WORDS, LEVEL
from hiltest.rig import COUNTS_PER_UT, Rig, world_truth

pytestmark = pytest.mark.slow

StartPtyBoard = Callable[[Rig], Any]
CTRL_C = "\x03"
FACES = {FACE_WORDS[face]: face for face in ALL_FACES}


def command(rig_file: Path, port: str) -> list[str]:
    return [sys.executable, "-m", "hiltest", "calibrate", "--rig", str(rig_file), "--port", port]


@pytest.fixture
def led_rig_file(operators_rig_file: Path) -> Path:
    """The operator's rig, without the turns of a table: they have their own tests."""
    text = operators_rig_file.read_text(encoding="utf-8")
    text = text.replace("gyroscope_rest_s = 5.0", 'gyroscope_rest_s = 2.0\ngyroscope_calibration = "rest"')
    assert "gyroscope_calibration" in text
    operators_rig_file.write_text(text, encoding="utf-8")
    return operators_rig_file


class Hand:
    """Does with a paced board what the terminal asks for, and each thing wrong the first time."""

    def __init__(self, board: Any) -> None:
        self._board = board
        self.faces: list[str] = []
        self.tumbles = 0

    def __call__(self, question: str) -> str:
        asked = re.search(r"face \d of 6: put the board (.*?), square", question)
        if asked:
            self.faces.append(asked[1])
            wrong = self.faces == ["nose down", "nose up"]
            self._board.bench.turn_to(FACES["nose down" if wrong else asked[1]].pose)
        elif "put the board down level" in question:
            self._board.bench.turn_to(LEVEL)
        elif "all round" in question:
            self.tumbles += 1
            if self.tumbles > 1:  # the first time the board is left where it lies
                self._board.tumble_by_hand()
        return "\n"


def test_an_operator_is_led_and_only_what_was_refused_is_done_again(
    pty_board: StartPtyBoard, rig: Rig, led_rig_file: Path, at_a_terminal: Callable[..., Any]
) -> None:
    paced = pty_board(rig)
    hand = Hand(paced)
    ended = at_a_terminal(command(led_rig_file, paced.path), led_rig_file.parent, hand)
    assert ended.code == 0, ended.shown
    assert hand.faces == [
        "nose down",
        "nose up",
        "nose up",
        "right side down",
        "left side down",
        "level",
        "upside down",
    ]
    refusal = (
        r"asked for nose up, and the board reads .*: it lies nose down; .*\.\r?\nface 2 of 6: put the board nose up"
    )
    assert re.search(refusal, ended.shown)
    assert hand.tumbles == 2
    assert re.search(r"magnetometer refused: .*\.\r?\ntake the board in your hand", ended.shown)
    # Progress with what is left, drawn in place.
    assert re.search(r"tumble, \d+ % of the sphere \d+ of 100, \d+ s left", ended.shown)
    check_against_the_truth(load_calibration(led_rig_file.parent / "imu_calibration.json").calibration, rig)


def check_against_the_truth(calibration: ImuCalibration, rig: Rig) -> None:
    truth = world_truth(rig)
    assert truth is not None
    assert calibration.accelerometer is not None
    assert calibration.gyroscope is not None
    # A hundred points of 0.4 uT: a hard iron within 0.3 uT on every axis, some five standard errors.
    errors_ut = (np.array(calibration.magnetometer.hard_iron) - truth.hard_iron_counts) / COUNTS_PER_UT
    assert np.abs(errors_ut).max() < 0.3
    # 400 samples of 0.2 deg/s behind the part's filter: 0.05 is some four standard errors of their mean.
    bias_dps = 0.0625 * np.array(calibration.gyroscope.bias)
    assert np.abs(bias_dps - truth.gyroscope_bias_dps).max() < 0.05
    # The hand puts the board down exactly: what is left is noise, 0.2 mg on a face.
    assert calibration.accelerometer.figures[0].value < 1.0
    assert calibration.made_on.kind == "real"  # as far as a port can tell
    assert calibration.made_on.world_sha256 is None


def test_ctrl_c_ends_it_and_leaves_no_file(
    pty_board: StartPtyBoard, rig: Rig, operators_rig_file: Path, at_a_terminal: Callable[..., Any]
) -> None:
    def answer(question: str) -> str:
        return CTRL_C if "asked for nose down" in question else "\n"  # the board stays where it lies

    folder = operators_rig_file.parent
    ended = at_a_terminal(command(operators_rig_file, pty_board(rig).path), folder, answer)
    assert ended.code == 2, ended.shown
    assert ended.shown.rstrip().endswith("interrupted")
    assert [path.name for path in folder.iterdir()] == [operators_rig_file.name]
