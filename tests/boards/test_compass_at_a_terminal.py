"""A compass that prints lines on a serial port, turned by hand: the real command asks, and judges with U."""

from __future__ import annotations

import json
import re
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from hiltest.orientation.angles import Pose
from hiltest.rig import Rig
from hiltest.rig.bench_files import shipped
from hiltest.rig.rig_file import load_rig

pytestmark = pytest.mark.slow

BY_HAND = Path(__file__).parents[2] / "fixtures" / "recordings" / "text-by-hand.toml"
TUMBLE_S = 20
LOOKS_S = 1.2  # in which the board is looked at twice beside a question, after what it said while it was turned
LIMIT = '[limits]\n"heading.firmware.max" = { max = 3.0, unit = "deg" }\n'
Turn = Callable[..., tuple[int, str]]


@pytest.fixture
def turn(pty_board: Callable[[Rig], Any], at_a_terminal: Callable[..., Any], tmp_path: Path) -> Turn:
    """Return what runs the compass suite, turns the board as it is asked to, and returns exit code and output."""
    paced = pty_board(load_rig(shipped() / "rigs" / "text-compass.toml"))
    text = BY_HAND.read_text(encoding="utf-8").replace('kind = "operator"', f'kind = "operator"\ntumble_s = {TUMBLE_S}')
    described = text.partition("[limits]")[0].replace("yaw_deg = 0.0", "yaw_deg = 1.7")
    (tmp_path / "compass.toml").write_text(described + LIMIT, encoding="utf-8")

    def run(*, stop_at: str = "", watch: str = "") -> tuple[int, str]:
        def answer(question: str) -> str:
            if pose := re.search(r"(pose \d+): turn to heading (\S+), pitch (\S+), roll (\S+) and", question):
                paced.bench.turn_to(Pose(*map(float, pose.groups()[1:])))
                time.sleep(LOOKS_S if pose[1] == watch else 0.0)
                return "q\n" if pose[1] == stop_at else "\n"
            if "all round" in question:
                paced.tumble_by_hand()
            return "\n"

        words = [sys.executable, "-m", "hiltest", "run", "--rig", "compass.toml", "--port", paced.path]
        ended = at_a_terminal(words, tmp_path, answer)
        return ended.code, ended.shown

    return run


def test_what_it_says_stands_beside_a_question_and_a_stop_says_what_becomes_of_the_run(turn: Turn) -> None:
    code, shown = turn(stop_at="pose 3", watch="pose 2")
    assert code == 2, shown
    assert re.search(r"board \d+\.\d deg, still; 1 of 4, \d+ s left\x1b\[K", shown), shown
    assert "with 2 of 4 known angles taken; the same command begins anew" in shown


@pytest.mark.ci  # beside tests/procedures/test_reported_by_hand.py, which needs no command and no port
def test_it_calibrates_itself_in_a_hand_and_its_headings_are_judged_with_u(turn: Turn, tmp_path: Path) -> None:
    code, shown = turn()
    record = json.loads((tmp_path / "hil-out" / "run.json").read_text(encoding="utf-8"))
    (result,) = (measurement for measurement in record["measurements"] if measurement["name"] == "heading.firmware.max")
    assert (code, result["outcome"]) == (0, "pass"), shown
    assert result["value"] < 1.0
    assert result["uncertainty"] == pytest.approx(0.7071, abs=1e-4)
    assert "(limit 3 with U 0.71)" in shown
    assert "Turn it all round for 20 s" in shown
    assert "How much of the sphere is seen" not in shown  # only hiltest's firmware shows its points
