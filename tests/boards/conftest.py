"""Rigs, and a virtual board at the far end of a pseudo-terminal, where only bytes pass."""

from __future__ import annotations

import math
import os
import re
import select
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from hiltest.boards import VirtualBench
from hiltest.boards.paced import PacedBench
from hiltest.boards.served_lines import PseudoTerminal
from hiltest.rig import Rig
from hiltest.rig.bench_files import shipped
from hiltest.rig.rig_file import load_rig

# It takes some 10 s; nothing may wait for ever.
WALL_LIMIT_S = 90.0
# A hand that turns for longer than points are collected: where they are asked for late, on a machine that is busy, it
# must not lie still already.
HAND_GOES_ON_S = 8.0
CTRL_C = "\x03"
KILL = "kill -9"
# What is drawn behind a question, the cursor kept: until it is answered.
BESIDE = re.compile(r"\x1b7.*?\x1b\[K\x1b8")
# A signal that comes between the prompt and the read behind it waits for the read's end, as for every `input` of
# Python: who sees nothing happen presses Ctrl-C again.
PRESSED_AGAIN_S = 5.0

# The default bench as its operator would describe it: another kind of board, and no world.
OPERATORS = {
    'kind = "virtual"': 'kind = "real"',
    'kind = "simulated"': 'kind = "operator"',
    "[358.3, 58.3, 118.3, 178.3, 238.3, 298.3, 328.3, 268.3, 208.3, 148.3, 88.3, 28.3]": "[0, 90, 180, 270]",
    "tumble_points = 300": 'tumble_points = 100\ndpi = "none"',
    # The paced board's own table turns it all round in this time.
    # And its hand is exact, as is the mounting: what is not known of them need not be left to a limit.
    'kind = "operator"\nuncertainty_deg = 0.1': 'kind = "operator"\nuncertainty_deg = 0.01\ntumble_s = 2.0',
    "uncertainty_deg = 0.2": "uncertainty_deg = 0.02",
    # That limit is of sixty poses; the rms of four, with another noise in every run, scatters up to their maximum.
    '"heading.direct.rms" = { max = 0.75': '"heading.direct.rms" = { max = 1.8',
}


@pytest.fixture
def operators_rig_file(tmp_path: Path) -> Path:
    """A rig file whose board somebody turns."""
    text = (shipped() / "rigs" / "virtual-k64f.toml").read_text(encoding="utf-8")
    for old, new in OPERATORS.items():
        assert text.count(old) == 1
        text = text.replace(old, new)
    before, rest = text.split("\n[world]\n")
    path = tmp_path / "operator.toml"
    path.write_text(before + "\n" + rest[rest.index("\n[limits]\n") :], encoding="utf-8")
    return path


@dataclass(frozen=True)
class Ended:
    """A command that ran at a terminal."""

    code: int
    shown: str


@pytest.fixture
def at_a_terminal() -> Callable[..., Ended]:
    """Return a function that runs a command at a pseudo-terminal and answers each question that it asks."""

    def run(command: list[str], folder: Path, answer: Callable[[str], str]) -> Ended:
        terminal = PseudoTerminal()
        far_end = os.open(terminal.path, os.O_RDWR)
        process = subprocess.Popen(command, stdin=far_end, stdout=far_end, stderr=far_end, cwd=folder)
        shown, answered, ends_s = "", 0, time.monotonic() + WALL_LIMIT_S
        pressed_s = math.inf
        while process.poll() is None and time.monotonic() < ends_s:
            if time.monotonic() > pressed_s + PRESSED_AGAIN_S:
                pressed_s = time.monotonic()
                process.send_signal(signal.SIGINT)
            if select.select([terminal.board_end], [], [], 0.1)[0]:
                shown += os.read(terminal.board_end, 4096).decode()
            question = BESIDE.sub("", shown[answered:])
            # A write that Ctrl-C interrupts is repeated: its question is no second one.
            if math.isinf(pressed_s) and question.endswith(": ") and "Enter" in question:
                answered = len(shown)
                if (typed := answer(question)) == CTRL_C:
                    pressed_s = time.monotonic()
                    process.send_signal(signal.SIGINT)
                elif typed == KILL:
                    process.kill()
                else:
                    os.write(terminal.board_end, typed.encode())
        process.kill()
        process.wait()
        while select.select([terminal.board_end], [], [], 0.1)[0]:
            shown += os.read(terminal.board_end, 4096).decode()
        os.close(far_end)
        terminal.unplug()
        return Ended(process.returncode, shown)

    return run


@pytest.fixture(scope="session")
def rig() -> Rig:
    return load_rig(shipped() / "rigs" / "virtual-k64f.toml")


@pytest.fixture(scope="session")
def rig_without_shield(rig: Rig) -> Rig:
    assert rig.world is not None
    return replace(rig, world=replace(rig.world, fitted=("onboard-fxos8700cq",)))


@pytest.fixture(scope="session")
def real_rig() -> Rig:
    return load_rig(shipped() / "rigs" / "frdm-k64f.toml")


class PtyBoard:
    """A paced virtual board and its cable."""

    def __init__(self, rig: Rig, firmware: Path | None) -> None:
        self._terminal = PseudoTerminal()
        stepped = VirtualBench(rig, firmware=firmware)
        self.machine = stepped.machine
        self.bench = PacedBench(stepped, self._terminal)
        self.path = self._terminal.path
        self.bench.start()

    def tumble_by_hand(self) -> None:
        """Begin to turn the board all round, and go on after the host has its points."""
        self.bench.tumble(HAND_GOES_ON_S)

    def unplug(self) -> None:
        """Pull the cable."""
        self.bench.stop()
        self._terminal.unplug()


@pytest.fixture
def pty_board() -> Iterator[Callable[..., PtyBoard]]:
    """Return a function that puts the virtual board of a rig behind a pseudo-terminal."""
    with ExitStack() as stack:

        def start(rig: Rig, firmware: Path | None = None) -> PtyBoard:
            board = PtyBoard(rig, firmware)
            stack.callback(board.unplug)
            return board

        yield start
