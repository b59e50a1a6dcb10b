"""Progress: what it says, and that it leaves pytest's own output as it was."""

from __future__ import annotations

import pytest

from hiltest.progress_line import ProgressLine, progress_text


class Screen:
    """Keeps what is written."""

    def __init__(self) -> None:
        self.text = ""

    def write(self, msg: str, *, flush: bool = False) -> None:
        self.text += msg


@pytest.mark.parametrize(
    ("done", "elapsed_s", "text"),
    [
        (0, 0.0, "  known angles 0 of 60"),
        (15, 2.0, "  known angles 15 of 60, 6 s left"),
        (59, 118.0, "  known angles 59 of 60, 2 s left"),
    ],
)
def test_time_left_follows_from_the_steps_done(done: int, elapsed_s: float, text: str) -> None:
    assert progress_text("known angles", done, 60, elapsed_s=elapsed_s) == text


def test_every_drawing_puts_the_cursor_back_and_the_last_one_clears() -> None:
    screen = Screen()
    progress = ProgressLine(screen, shown=True)
    for done in range(4):
        progress("tumble", done, 3)
    drawings = screen.text.split("\x1b7")[1:]
    assert all(drawing.endswith("\x1b[K\x1b8") for drawing in drawings)
    assert drawings[0].startswith("  tumble 0 of 3")
    assert drawings[-1] == "\x1b[K\x1b8"


def test_steps_that_follow_at_once_are_not_all_drawn() -> None:
    screen = Screen()
    progress = ProgressLine(screen, shown=True)
    for done in range(1000):
        progress("points", done, 1001)
    # Five drawings a second at most: a thousand empty steps take far less than a second.
    assert 1 <= screen.text.count("\x1b7") <= 6


def test_nothing_is_drawn_where_nobody_looks() -> None:
    screen = Screen()
    ProgressLine(screen, shown=False)("tumble", 1, 3)
    assert screen.text == ""
