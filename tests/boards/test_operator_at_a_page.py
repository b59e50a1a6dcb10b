"""The operator's page in a browser: the real command asks there, somebody turns the table and presses a key."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from hiltest.calibration.still_pose import FACES
from hiltest.orientation.angles import Pose
from hiltest.procedures.turntables import FACE_WORDS
from hiltest.rig import Rig

from ..report.browser.conftest import browser
from ..report.browser.test_pages import violations

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

__all__ = ["browser"]

pytestmark = [pytest.mark.slow, pytest.mark.ci]

StartPtyBoard = Callable[[Rig], Any]
WAIT_MS = 60_000  # a machine with other work may take seconds for a step of the suites
TURN_DPS = 60.0
ENDS_S = 30.0
MOST_QUESTIONS = 20


@contextmanager
def run_with_page(rig_file: Path, port: str, *options: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """Start the command without a terminal; yield it and the URL of its page."""
    command = [sys.executable, "-m", "hiltest", "bench", f"--rig={rig_file}", f"--port={port}"]
    command += ["--poses=level", f"--out={rig_file.parent / 'out'}", *options, "--", "-k", "heading_at_known_angles"]
    environment = {**os.environ, "PYTHONUNBUFFERED": "1"}
    with subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, text=True, cwd=rig_file.parent, env=environment
    ) as process:
        try:
            assert process.stdout is not None
            urls = (line.removeprefix("page: ").strip() for line in process.stdout if line.startswith("page: "))
            yield process, next(urls)
        finally:
            process.kill()


def next_question(page: Page, before: int) -> int:
    page.wait_for_function("before => news.ended || news.asks && shown > before", arg=before, timeout=WAIT_MS)
    return int(page.evaluate("shown"))


def test_an_operator_at_a_telephone_answers_the_questions_and_sees_the_board(
    pty_board: StartPtyBoard, rig: Rig, operators_rig_file: Path, browser: Browser
) -> None:
    paced = pty_board(rig)
    pictures = os.environ.get("HILTEST_PICTURES")
    asked: list[str] = []
    notes: list[str] = []
    seen: dict[str, Any] = {}
    complaints: list[str] = []
    with run_with_page(operators_rig_file, paced.path) as (process, url):
        page = browser.new_page(viewport={"width": 390, "height": 844})
        page.on("console", lambda message: complaints.append(message.text))
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.goto(url)
        question = 0
        for _ in range(MOST_QUESTIONS):
            question = next_question(page, question)
            if page.evaluate("!!news.ended"):
                break
            request = page.locator("#request").inner_text()
            asked.append(request)
            notes.append(page.locator("#notes").inner_text())
            if pictures:
                for width in (390, 1280):
                    page.set_viewport_size({"width": width, "height": 844})
                    page.wait_for_timeout(700)
                    page.screenshot(path=f"{pictures}/{len(asked):02}-{width}.png", full_page=True)
                page.set_viewport_size({"width": 390, "height": 844})
            if pose := re.search(r"pose (\d): turn to heading (\S+), pitch (\S+), roll (\S+) and", request):
                at = Pose(*map(float, pose.groups()[1:]))
                if pose[1] == "2" and len([text for text in asked if text.startswith("pose 2")]) == 1:
                    page.locator("#enter").click()  # the first time it is not turned
                elif pose[1] == "2":
                    paced.bench.turn_round(at.heading_deg, rate_dps=TURN_DPS, after_s=0.5)
                    page.wait_for_function("() => Math.abs(news.turned_deg - 90) < 2 && !news.moves", timeout=WAIT_MS)
                    seen["violations"] = violations(page)
                    seen["turned"] = page.locator("#turned").inner_text(), page.locator("#asked").inner_text()
                    if pictures:
                        page.screenshot(path=f"{pictures}/turned-390.png", full_page=True)
                    page.keyboard.press("Enter")
                elif pose[1] == "4":
                    paced.bench.turn_to(at)
                    page.get_by_role("button", name="skip").click()
                else:
                    paced.bench.turn_to(at)
                    page.keyboard.type("180" if pose[1] == "3" else "")
                    page.keyboard.press("Enter")
            elif face := re.search(r"put the board (.+), square on", request):
                paced.bench.turn_to(next(item.pose for item in FACES if FACE_WORDS[item] == face[1]))
                page.locator("#enter").click()
            elif "all round" in request:
                if sum("all round" in text for text in asked) > 1:  # the first time it stays on the table
                    paced.tumble_by_hand()
                page.locator("#enter").click()
            else:
                page.locator("#enter").click()
        seen["points"] = page.evaluate("news.sphere.points.length")
        seen["verdict"] = page.locator("#verdict").inner_text()
        if pictures:
            page.screenshot(path=f"{pictures}/ended-390.png", full_page=True)
        assert process.wait(ENDS_S) == 22
        page.close()
    assert complaints == []
    assert seen["violations"] == []
    begins = [re.match(r"(pose \d|face \d|take the board)", text) for text in asked]
    assert [begin[1] for begin in begins if begin] == [
        *(f"face {number}" for number in range(1, 7)),
        *("take the board", "take the board"),
        *("pose 1", "pose 2", "pose 2", "pose 3", "pose 4"),
    ]
    assert notes[-1] == "pose 4 is not measured.\n\n3 of 4 known angles are taken; 1 pose not measured: 4."
    record = json.loads((operators_rig_file.parent / "out" / "run.json").read_text(encoding="utf-8"))
    assert record["verdict"]["sentence"].partition(". ")[2] in seen["verdict"]
    assert notes[0].startswith("Axes of the board: x points to its nose")
    assert "you did not turn: field and gravity are those of pose 1, heading 0" in notes[-4]
    (refusal,) = [note for note in notes if "the tumble covers" in note]
    assert "covers 0% of the sphere, at least 50% is needed: the points are no sphere" in refusal
    turned, to_turn = seen["turned"]
    assert to_turn == "+90 deg"
    assert float(turned.removesuffix(" deg")) == pytest.approx(90.0, abs=3.0)  # gaps of a busy machine are bridged
    assert seen["points"] == 100
