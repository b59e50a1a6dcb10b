"""The heading suite on a serial port: the real command asks, somebody turns the table and presses Enter."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from hiltest.calibration.still_pose import FACES
from hiltest.orientation.angles import Pose
from hiltest.procedures.turntables import FACE_WORDS
from hiltest.rig import Rig

from .conftest import KILL

pytestmark = pytest.mark.slow

StartPtyBoard = Callable[[Rig], Any]
SUITES = Path(__file__).parents[2] / "hil" / "suites"


def command(rig_file: Path, port: str) -> list[str]:
    return [
        sys.executable,
        "-m",
        "pytest",
        str(SUITES / "test_heading.py"),
        "-p",
        "no:cacheprovider",
        "--color=no",
        f"--hil-rig={rig_file}",
        f"--hil-port={port}",
        "--hil-poses=level",
        f"--hil-out={rig_file.parent / 'out'}",
    ]


def measured(rig_file: Path) -> dict[str, Any]:
    record = json.loads((rig_file.parent / "out" / "run.json").read_text(encoding="utf-8"))
    return {measurement["name"]: measurement["value"] for measurement in record["measurements"]}


def test_an_operator_is_asked_again_for_each_slip_and_the_headings_are_judged(
    pty_board: StartPtyBoard, rig: Rig, operators_rig_file: Path, at_a_terminal: Callable[..., Any]
) -> None:
    paced = pty_board(rig)
    faces: list[str] = []
    poses: list[str] = []
    tumbles: list[bool] = []

    def answer(question: str) -> str:
        pose = re.search(r"heading (\S+), pitch (\S+), roll (\S+) and", question)
        if pose:
            poses.append(pose[1])
            if poses[-2:] != ["0", "90"]:  # the first time it is not turned on
                paced.bench.turn_to(Pose(*(float(angle) for angle in pose.groups())))
            return "\n\n\n" if pose[1] == "180" else "\n"  # keys ahead answer nothing
        elif face := re.search(r"put the board (.+), square on", question):
            faces.append(face[1])
            put = "level" if faces == ["nose down", "nose up"] else face[1]  # wrong the first time
            paced.bench.turn_to(next(face.pose for face in FACES if FACE_WORDS[face] == put))
        elif "all round" in question:
            tumbles.append("Enter to begin" in question)
            if len(tumbles) > 1:  # the first time it stays on the table
                paced.tumble_by_hand()
        return "\n"

    ended = at_a_terminal(command(operators_rig_file, paced.path), operators_rig_file.parent, answer)
    assert ended.code == 0, ended.shown
    assert len(tumbles) == 2
    assert "the tumble covers 0% of the sphere, at least 50% is needed: the points are no sphere" in ended.shown
    assert poses == ["0", "90", "90", "180", "270"]
    assert "you did not turn: field and gravity are those of pose 1, heading 0" in ended.shown
    # Each question begins a line of its own, and the first says where the axes point.
    assert re.search(
        r"[\r\n]Axes of the board: x points to its nose, .*z through it, down when it is level", ended.shown
    )
    assert "pose 4: turn to heading 270" in ended.shown
    # Beside each question, drawn in place.
    assert re.search(r"board \d+\.\d deg(, turned [+-]\d+)?, (still|moving); 3 of 4", ended.shown)
    assert faces == [
        "nose down",
        "nose up",
        "nose up",
        "right side down",
        "left side down",
        "level",
        "upside down",
    ]
    assert re.search(r"asked for nose up, .*: it lies level; .*\.\r?\nface 2 of 6: put the board nose up", ended.shown)
    values = measured(operators_rig_file)
    assert values["heading.direct.max"] < 1.8  # the rig's limit
    assert values["fit.direct.offset_error"] is None  # nobody knows the truth of a real board


@pytest.mark.ci  # beside tests/procedures/test_going_on_by_hand.py, which needs no command and no port
def test_a_run_that_is_stopped_and_one_that_is_killed_go_on_at_the_next_pose(
    pty_board: StartPtyBoard, rig: Rig, operators_rig_file: Path, at_a_terminal: Callable[..., Any]
) -> None:
    paced = pty_board(rig)
    folder = operators_rig_file.parent
    words = [*command(operators_rig_file, paced.path), "-k", "heading_at_known_angles"]
    asked: list[str] = []
    ends_with: dict[str, str] = {}

    def answer(question: str) -> str:
        if pose := re.search(r"(pose \d+): turn to heading (\S+), pitch (\S+), roll (\S+) and", question):
            asked.append(pose[1])
            paced.bench.turn_to(Pose(*map(float, pose.groups()[1:])))
            return ends_with.get(pose[1], "\n")
        if face := re.search(r"put the board (.+), square on", question):
            asked.append(face[1])
            paced.bench.turn_to(next(item.pose for item in FACES if FACE_WORDS[item] == face[1]))
        elif "all round" in question:
            asked.append("tumble")
            paced.tumble_by_hand()
        return "\n"

    ends_with = {"pose 2": "q\n"}
    stopped = at_a_terminal(words, folder, answer)
    assert stopped.code == 2, stopped.shown
    assert "the operator stops, with 1 of 4 known angles taken" in stopped.shown
    assert asked == [*FACE_WORDS.values(), "tumble", "pose 1", "pose 2"]

    asked.clear()
    ends_with = {"pose 3": KILL}
    killed = at_a_terminal(words, folder, answer)
    assert killed.code == -9
    assert re.search(
        r"goes on with the run of \S+Z, which was cut short: the six faces, the tumble, 1 known angle taken over",
        killed.shown,
    )
    assert asked == ["pose 2", "pose 3"]

    asked.clear()
    ends_with = {"pose 4": "s\n"}
    ended = at_a_terminal(words, folder, answer)
    assert asked == ["pose 3", "pose 4"]
    # All but the one that was skipped are in the record, and the limits, which are of all, are not evaluated.
    assert ended.code == 22, ended.shown
    assert "1 pose not measured: 4" in ended.shown
    record = json.loads((folder / "out" / "run.json").read_text(encoding="utf-8"))
    poses = next(table for table in record["tables"] if table["name"] == "heading.poses")
    assert [row[0] for row in poses["rows"]] == [0, 90, 180]
    assert "1 of 4 known angles not measured: heading 270, pitch +0, roll +0" in record["verdict"]["sentence"]
    assert not (folder / "out" / "journal.jsonl").exists()


@pytest.mark.ci
def test_with_fewest_poses_an_operator_is_asked_only_until_the_limits_are_decided(
    pty_board: StartPtyBoard, rig: Rig, operators_rig_file: Path, at_a_terminal: Callable[..., Any]
) -> None:
    paced = pty_board(rig)
    text = operators_rig_file.read_text(encoding="utf-8")
    operators_rig_file.write_text(text.replace('kind = "operator"', 'kind = "operator"\nfewest_poses = true'))
    asked: list[int] = []

    def answer(question: str) -> str:
        if pose := re.search(r"pose (\d+): turn to heading (\S+), pitch (\S+), roll (\S+) and", question):
            asked.append(int(pose[1]))
            paced.bench.turn_to(Pose(*map(float, pose.groups()[1:])))
        elif face := re.search(r"put the board (.+), square on", question):
            paced.bench.turn_to(next(item.pose for item in FACES if FACE_WORDS[item] == face[1]))
        elif "all round" in question:
            paced.tumble_by_hand()
        return "\n"

    words = [word for word in command(operators_rig_file, paced.path) if word != "--hil-poses=level"]
    ended = at_a_terminal([*words, "-k", "heading_at_known_angles"], operators_rig_file.parent, answer)
    assert ended.code == 0, ended.shown
    assert asked != sorted(asked)  # in the order of their information
    assert len(asked) == len(set(asked)) == measured(operators_rig_file)["heading.poses"] < 20
    assert f"{len(asked)} of 20 known angles prove that all limits of headings are met" in ended.shown
    assert f"{len(asked)} of 20 known angles are taken." in ended.shown
