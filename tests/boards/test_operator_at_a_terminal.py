"""The heading suite on a serial port: the real command asks, somebody turns the table and presses Enter."""

from __future__ import annotations

import json
import os
import re
import select
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from hiltest.angles import Pose
from hiltest.bench_files import shipped
from hiltest.boards.lines import PseudoTerminal
from hiltest.rig import Rig

StartPtyBoard = Callable[[Rig], Any]
SUITES = Path(__file__).parents[2] / "hil" / "suites"
WALL_LIMIT_S = 90.0  # it takes about 10 s; nothing may wait for ever

# The default bench as its operator would describe it: another kind of board, and no world.
REAL = {
    'kind = "virtual"': 'kind = "real"',
    'kind = "simulated"': 'kind = "operator"',
    "headings_deg = [0, 30, 60, 90, 120, 150, 180, 210, 240, 270, 300, 330]": "headings_deg = [0, 90, 180, 270]",
    "tumble_points = 300": "tumble_points = 100",
    # The paced board's own table turns it all round in this time.
    "uncertainty_deg = 0.1": "uncertainty_deg = 0.1\ntumble_s = 2.0",
    # That limit is of sixty poses; the rms of four, with another noise in every run, scatters up to their maximum.
    '"heading.direct.rms" = { max = 0.75': '"heading.direct.rms" = { max = 1.8',
}


@pytest.fixture
def rig_file(tmp_path: Path) -> Path:
    text = (shipped() / "rigs" / "virtual-k64f.toml").read_text(encoding="utf-8")
    for old, new in REAL.items():
        assert text.count(old) == 1
        text = text.replace(old, new)
    before, rest = text.split("\n[world]\n")
    path = tmp_path / "operator.toml"
    path.write_text(before + "\n" + rest[rest.index("\n[limits]\n") :], encoding="utf-8")
    return path


def command(rig_file: Path, port: str) -> list[str]:
    return [
        sys.executable, "-m", "pytest", str(SUITES / "test_heading.py"), "-p", "no:cacheprovider", "--color=no",
        f"--hil-rig={rig_file}", f"--hil-port={port}", "--hil-poses=level", f"--hil-out={rig_file.parent / 'out'}",
    ]  # fmt: skip


def measured(rig_file: Path) -> dict[str, Any]:
    record = json.loads((rig_file.parent / "out" / "run.json").read_text(encoding="utf-8"))
    return {each["name"]: each["value"] for each in record["measurements"]}


def test_an_operator_is_asked_at_the_terminal_and_the_headings_are_judged(
    pty_board: StartPtyBoard, rig: Rig, rig_file: Path
) -> None:
    paced = pty_board(rig)
    terminal = PseudoTerminal()
    far_end = os.open(terminal.path, os.O_RDWR)
    run = subprocess.Popen(
        command(rig_file, paced.path), stdin=far_end, stdout=far_end, stderr=far_end, cwd=rig_file.parent
    )
    shown, answered, ends_s = "", 0, time.monotonic() + WALL_LIMIT_S
    while run.poll() is None and time.monotonic() < ends_s:
        if select.select([terminal.board_end], [], [], 0.1)[0]:
            shown += os.read(terminal.board_end, 4096).decode()
        question = shown[answered:]
        if question.endswith(": ") and "Enter" in question:
            answered = len(shown)
            pose = re.search(r"heading (\S+), pitch (\S+), roll (\S+) and", question)
            if pose:
                paced.bench.turn_to(Pose(*(float(angle) for angle in pose.groups())))
            elif "all round" in question:
                paced.bench.tumble(2.0)
            os.write(terminal.board_end, b"\n")
    run.kill()
    run.wait()
    os.close(far_end)
    terminal.unplug()
    assert run.returncode == 0, shown
    assert "pose 4: turn to heading 270" in shown
    values = measured(rig_file)
    assert values["heading.direct.max"] < 1.8  # the rig's limit
    assert values["fit.direct.offset_error"] is None  # nobody knows the truth of a real board


def test_without_a_terminal_the_run_says_that_nobody_can_be_asked(
    pty_board: StartPtyBoard, rig: Rig, rig_file: Path
) -> None:
    done = subprocess.run(
        command(rig_file, pty_board(rig).path), stdin=subprocess.DEVNULL, capture_output=True, text=True,
        timeout=WALL_LIMIT_S, cwd=rig_file.parent, check=False,
    )
    assert done.returncode == 20, done.stdout
    assert "nobody answers at the terminal" in done.stdout
