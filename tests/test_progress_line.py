"""Progress: what it says, and that it leaves pytest's own output as it was."""

from __future__ import annotations

import fcntl
import os
import pty
import re
import struct
import subprocess
import sys
import termios
import time
from contextlib import suppress
from pathlib import Path

import pytest

from hiltest.session.progress_line import ProgressLine, progress_text


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


def test_the_time_left_is_that_of_the_task_while_the_rest_of_its_label_changes(monkeypatch: pytest.MonkeyPatch) -> None:
    texts: list[str] = []
    progress = ProgressLine(Screen(), shown=False, also=texts.append)
    for second in range(3):
        monkeypatch.setattr(time, "monotonic", lambda second=second: 100.0 + second)
        progress(f"tumble, {30 * second} % of the sphere", 10 * second, 40)
    assert texts[-1] == "  tumble, 60 % of the sphere 20 of 40, 2 s left"


def test_nothing_is_drawn_where_nobody_looks() -> None:
    screen = Screen()
    ProgressLine(screen, shown=False)("tumble", 1, 3)
    assert screen.text == ""


NO_TERMINAL = ("COLUMNS", "NO_COLOR", "PY_COLORS", "CI")
LONG_WORK = """
import time
import pytest

@pytest.mark.parametrize("name", ["x" * 70, "y" * 30, "z"])
def test_it(hil_progress, name):
    for done in range(3):
        hil_progress("a long work of many steps", done, 60)
        time.sleep(0.25)
"""


def shown_in_a_terminal(folder: Path, *options: str) -> str:
    """Run pytest in a terminal of 80 columns and return every byte that it writes there."""
    master, slave = pty.openpty()
    fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 80, 0, 0))
    environment = {name: value for name, value in os.environ.items() if name not in NO_TERMINAL}
    process = subprocess.Popen(
        [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", *options],
        cwd=folder,
        stdout=slave,
        stderr=slave,
        stdin=subprocess.DEVNULL,
        env=environment | {"TERM": "xterm"},
    )
    os.close(slave)
    written = b""
    with suppress(OSError):  # EIO is the end of a terminal
        while part := os.read(master, 65536):
            written += part
    os.close(master)
    assert process.wait() == 0
    return written.decode()


@pytest.mark.parametrize("options", [(), ("-v",)], ids=["dots", "-v"])
def test_pytests_own_lines_are_as_they_were_in_a_terminal(pytester: pytest.Pytester, options: tuple[str, ...]) -> None:
    pytester.makepyfile(test_long=LONG_WORK)
    written = re.sub(r"\x1b\[[0-9;]*m", "", shown_in_a_terminal(pytester.path, *options))
    own, drawn, drawings = "", "", []
    for piece in re.split(r"(\x1b7.*?\x1b\[K\x1b8)", written):
        if piece.startswith("\x1b7"):
            drawn = piece[2:-5]
            drawings.append(drawn)
            assert not drawn or len(own.rpartition("\n")[2]) + len(drawn) < 80  # a line that wraps moves those above it
        elif piece:
            assert drawn == ""  # pytest writes where nothing is drawn
            own += piece
    assert any("a long work of many steps" in drawing for drawing in drawings)
    ends = [line for line in own.split("\r\n") if line.endswith("%]")]
    # pytest puts the percentage at the end of its 79 columns, unless a test's name is longer than that.
    assert [len(line) for line in ends if "xxx" not in line] == [79] * (2 if options else 1)


def test_a_run_into_a_file_says_how_far_it_is_in_a_line_now_and_then(monkeypatch: pytest.MonkeyPatch) -> None:
    now_s, messages = [100.0], []
    monkeypatch.setattr("time.monotonic", lambda: now_s[0])
    screen = Screen()
    progress = ProgressLine(screen, shown=False, say=messages.append)
    for done in range(25):
        progress("known angles", done, 60)
        now_s[0] += 3.0
    assert messages == ["known angles 10 of 60, 150 s left", "known angles 20 of 60, 120 s left"]
    assert screen.text == ""
