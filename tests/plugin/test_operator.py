"""The prompts of a real board: the real command, somebody at a terminal, a board at a port."""

from __future__ import annotations

import os
import select
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from hiltest.boards import VirtualBench
from hiltest.boards.paced import PacedBench
from hiltest.boards.served_lines import PseudoTerminal
from hiltest.rig.bench_files import shipped
from hiltest.rig.rig_file import load_rig

pytestmark = pytest.mark.slow

PROMPT = "Enter when it is:"
DEADLINE_S = 60.0


@contextmanager
def board_at_a_port() -> Iterator[str]:
    """Run the default rig's virtual board behind a pseudo-terminal; only bytes pass."""
    terminal = PseudoTerminal()
    bench = PacedBench(VirtualBench(load_rig(shipped() / "rigs" / "virtual-k64f.toml")), terminal)
    try:
        with bench:
            yield terminal.path
    finally:
        terminal.unplug()


def command(port: str, *options: str) -> list[str]:
    """Return a command whose rig, without a name, is that of a real board."""
    return [
        sys.executable,
        "-m",
        "hiltest",
        "run",
        "--hil-port",
        port,
        *options,
        "--",
        "-k",
        "accelerometer and rest",
    ]


def read_until(end: int, expected: str) -> str:
    """Return what a terminal showed until it showed `wanted` or was closed."""
    shown, deadline_s = "", time.monotonic() + DEADLINE_S
    while expected not in shown and time.monotonic() < deadline_s:
        if select.select([end], [], [], 0.2)[0]:
            try:
                data = os.read(end, 4096)
            except OSError:  # how a terminal says that nobody has it open any more
                break
            shown += data.decode()
    return shown


def test_an_operator_at_a_terminal_answers_a_prompt_with_enter(tmp_path: Path) -> None:
    ours, theirs = os.openpty()
    with board_at_a_port() as port:
        with subprocess.Popen(command(port), cwd=tmp_path, stdin=theirs, stdout=theirs, stderr=theirs) as running:
            os.close(theirs)
            shown = read_until(ours, PROMPT)
            assert PROMPT in shown, shown
            os.write(ours, b"\n")
            shown += read_until(ours, "no line has this")
        os.close(ours)
    assert running.returncode == 0, shown
    assert "1 passed" in shown


@pytest.mark.parametrize("closed", [False, True], ids=["end of file", "closed"])
def test_nobody_at_the_terminal_is_a_bench_error_with_the_next_step(tmp_path: Path, closed: bool) -> None:
    protractor = tmp_path / "protractor.toml"
    text = (shipped() / "rigs" / "frdm-k64f.toml").read_text(encoding="utf-8")
    protractor.write_text(
        text.replace("uncertainty_deg = 0.5                     # divided", "uncertainty_deg = 1.0 # divided")
    )
    with board_at_a_port() as port:
        words = command(port, *([] if closed else ["--rig", str(protractor)]))
        done = subprocess.run(
            ["sh", "-c", 'exec "$0" "$@" <&-', *words] if closed else words,
            cwd=tmp_path,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=DEADLINE_S,
            check=False,
        )
    assert done.returncode == 20, done.stdout + done.stderr
    shown = " ".join(done.stdout.split())  # the sentence is broken into lines
    assert "no operator answered at the terminal: put the board down level" in shown
    assert ("heading.direct.rms at most 1.5 deg with U 1.1: raise it above" in shown) is not closed
    assert "Run the command at a terminal" in shown
