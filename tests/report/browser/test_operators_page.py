"""The operator's page in a browser: the parts in sight in a tumble, the button to stop, and the report at the end."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from hiltest.calibration.quality import sphere_directions
from hiltest.procedures.questions import Question
from hiltest.rig.bench_files import DEFAULT_RIG, shipped
from hiltest.rig.rig_file import load_rig
from hiltest.run_record.run import Verdict
from hiltest.session.bench_page import BenchPage

if TYPE_CHECKING:
    from playwright.sync_api import Browser

RIG = load_rig(shipped() / "rigs" / DEFAULT_RIG)
HEIGHT = 844


@pytest.fixture
def page() -> Iterator[BenchPage]:
    page = BenchPage("127.0.0.1")
    yield page
    page.close()


@pytest.mark.parametrize("width", [390, 1260])
def test_the_operator_sees_the_spheres_of_a_tumble_and_gets_the_report(
    browser: Browser, page: BenchPage, tmp_path: Path, width: int
) -> None:
    shown = browser.new_page(viewport={"width": width, "height": HEIGHT})
    shown.goto(page.url)
    page.ask("take the board in your hand. Enter to begin: ")
    page.answered()
    points = np.round(10.0 * RIG.field.strength_ut * sphere_directions(100)).astype(np.int16)
    page.show_points(RIG)(points, np.array([[0, 0, 8192]], np.int16))
    sphere, board = shown.locator("#sphere"), shown.locator("#view")
    sphere.wait_for()
    box, other = sphere.bounding_box(), board.bounding_box()
    assert box is not None
    assert other is not None
    assert box["y"] + box["height"] < HEIGHT
    assert box["y"] <= other["y"]
    assert width == 390 or box["y"] == other["y"]
    assert shown.locator("#stop").is_enabled()
    assert shown.locator("#enter").is_disabled()
    page.ask(Question("you did not turn.\npose 2: turn.\n  Enter or q: ", wishes=["skip", "quit"], takes_heading=True))
    with shown.expect_response("**/answer"):
        shown.get_by_role("button", name="skip").click()
    assert page.answer() == "skip"
    report = tmp_path / "report.html"
    report.write_text("<title>all numbers</title>", encoding="utf-8")
    page.end(Verdict("not evaluated", 22, "NOT EVALUATED. Cannot tell.", complete=True), report)
    page.close()
    assert shown.locator(".verdict.warn").inner_text().split("\n")[0] == "NOT EVALUATED"
    with shown.expect_popup() as opened:
        shown.locator("#report").click()
    assert opened.value.title() == "all numbers"
    shown.close()
