"""``hiltest calibrate`` leads an operator: it says what to do, asks again for what was refused, and ends cleanly."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from hiltest.imu_calibration.file import load_calibration
from hiltest.rig import COUNTS_PER_UT, Rig, world_truth

StartPtyBoard = Callable[[Rig], Any]
CTRL_C = "\x03"


def command(rig_file: Path, port: str) -> list[str]:
    return [sys.executable, "-m", "hiltest", "calibrate", "--rig", str(rig_file), "--hil-port", port]


def test_an_operator_is_led_and_what_was_refused_is_done_again(
    pty_board: StartPtyBoard, rig: Rig, operators_rig_file: Path, at_a_terminal: Callable[..., Any]
) -> None:
    paced = pty_board(rig)
    tumbles = []

    def answer(question: str) -> str:
        if "all round" in question:
            tumbles.append(question)
            if len(tumbles) > 1:  # the first time the board is left where it lies
                paced.bench.tumble(2.0)
        return "\n"

    ended = at_a_terminal(command(operators_rig_file, paced.path), operators_rig_file.parent, answer)
    assert ended.code == 0, ended.shown
    assert len(tumbles) == 2
    assert re.search(r"magnetometer refused: .*Enter to do it again, Ctrl-C to end", ended.shown)
    # Progress with what is left, drawn in place.
    assert re.search(r"tumble, \d+ % of the sphere \d+ of 100, \d+ s left", ended.shown)
    made = load_calibration(operators_rig_file.parent / "imu_calibration.json").calibration
    truth = world_truth(rig)
    assert truth is not None
    # A hundred points of 0.4 uT: a hard iron within 0.3 uT on every axis, some five standard errors.
    errors_ut = (np.array(made.magnetometer.hard_iron) - truth.hard_iron_counts) / COUNTS_PER_UT
    assert np.abs(errors_ut).max() < 0.3
    assert made.made_on.kind == "real"  # as far as a port can tell
    assert made.made_on.world_sha256 is None


def test_ctrl_c_ends_it_and_leaves_no_file(
    pty_board: StartPtyBoard, rig: Rig, operators_rig_file: Path, at_a_terminal: Callable[..., Any]
) -> None:
    def answer(question: str) -> str:
        return CTRL_C if "all round" in question else "\n"

    folder = operators_rig_file.parent
    ended = at_a_terminal(command(operators_rig_file, pty_board(rig).path), folder, answer)
    assert ended.code == 2, ended.shown
    assert ended.shown.rstrip().endswith("interrupted")
    assert [path.name for path in folder.iterdir()] == [operators_rig_file.name]


def test_without_a_terminal_it_says_that_nobody_can_be_asked(
    pty_board: StartPtyBoard, rig: Rig, operators_rig_file: Path
) -> None:
    done = subprocess.run(
        command(operators_rig_file, pty_board(rig).path), stdin=subprocess.DEVNULL, capture_output=True, text=True,
        timeout=90, cwd=operators_rig_file.parent, check=False,
    )
    assert done.returncode == 20, done.stdout
    assert "nobody answers at the terminal" in done.stderr
    assert [path.name for path in operators_rig_file.parent.iterdir()] == [operators_rig_file.name]
