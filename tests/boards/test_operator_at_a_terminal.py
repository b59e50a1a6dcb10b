"""The heading suite on a serial port: the real command asks, somebody turns the table and presses Enter."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from hiltest.angles import Pose
from hiltest.calibration.still_pose import FACES
from hiltest.procedures.turntables import FACE_WORDS
from hiltest.rig import Rig

pytestmark = pytest.mark.slow

StartPtyBoard = Callable[[Rig], Any]
SUITES = Path(__file__).parents[2] / "hil" / "suites"


def command(rig_file: Path, port: str) -> list[str]:
    return [
        sys.executable, "-m", "pytest", str(SUITES / "test_heading.py"), "-p", "no:cacheprovider", "--color=no",
        f"--hil-rig={rig_file}", f"--hil-port={port}", "--hil-poses=level", f"--hil-out={rig_file.parent / 'out'}",
    ]  # fmt: skip


def measured(rig_file: Path) -> dict[str, Any]:
    record = json.loads((rig_file.parent / "out" / "run.json").read_text(encoding="utf-8"))
    return {each["name"]: each["value"] for each in record["measurements"]}


def test_an_operator_is_asked_again_for_a_wrong_face_and_the_headings_are_judged(
    pty_board: StartPtyBoard, rig: Rig, operators_rig_file: Path, at_a_terminal: Callable[..., Any]
) -> None:
    paced = pty_board(rig)
    faces: list[str] = []

    def answer(question: str) -> str:
        pose = re.search(r"heading (\S+), pitch (\S+), roll (\S+) and", question)
        if pose:
            paced.bench.turn_to(Pose(*(float(angle) for angle in pose.groups())))
        elif face := re.search(r"put the board (.+), square on", question):
            faces.append(face[1])
            put = "level" if faces == ["nose down", "nose up"] else face[1]  # wrong the first time
            paced.bench.turn_to(next(each.pose for each in FACES if FACE_WORDS[each] == put))
        elif "all round" in question:
            paced.tumble_by_hand()
        return "\n"

    ended = at_a_terminal(command(operators_rig_file, paced.path), operators_rig_file.parent, answer)
    assert ended.code == 0, ended.shown
    assert "pose 4: turn to heading 270" in ended.shown
    # Beside each question, drawn in place.
    assert re.search(r"board \d+\.\d deg, (still|moving); 3 of 4, \d+ s left\x1b\[K", ended.shown)
    assert faces == [
        "nose down", "nose up", "nose up", "right side down", "left side down", "level", "upside down",
    ]
    assert re.search(r"asked for nose up, .*: it lies level; .*\. Enter to do it again, Ctrl-C to end", ended.shown)
    values = measured(operators_rig_file)
    assert values["heading.direct.max"] < 1.8  # the rig's limit
    assert values["fit.direct.offset_error"] is None  # nobody knows the truth of a real board


def test_without_a_terminal_the_run_says_that_nobody_can_be_asked(
    pty_board: StartPtyBoard, rig: Rig, operators_rig_file: Path
) -> None:
    done = subprocess.run(
        command(operators_rig_file, pty_board(rig).path), stdin=subprocess.DEVNULL, capture_output=True, text=True,
        timeout=90, cwd=operators_rig_file.parent, check=False,
    )
    assert done.returncode == 20, done.stdout
    assert "no one answers at the terminal" in done.stdout
