"""A run on a board behind a port is recorded with the operator's words and the end of its cable, and replayed so."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from tests.finished_run import without_volatile

from hiltest.boards import VirtualBench
from hiltest.boards.paced import PacedBench
from hiltest.boards.served_lines import PseudoTerminal
from hiltest.rig.bench_files import shipped
from hiltest.rig.rig_file import load_rig

pytestmark = pytest.mark.slow

SUITE = """
from pathlib import Path

from hiltest.orientation.angles import Pose
from hiltest.link.messages import Average, LinkStatistics


def test_turned_by_hand(board, turntable, measure):
    began_s = board.now_s()
    reached = turntable.turn_to(Pose(30.0, 0.0, 0.0), known_angle=0)
    measure("bench.reached", reached.heading_deg, "deg")
    measure("bench.x", float(board.session.request(Average(16)).magnetometer.mean[0]), "")
    board.sleep(0.05)
    measure("bench.took", board.now_s() - began_s, "s")


def test_frames(board, measure):
    for count in range(1_000_000):
        measure("bench.frames", board.session.request(LinkStatistics()).frames, "")
        Path("frames").touch()
"""


def command(*options: str) -> list[str]:
    """Return the command that runs the suite."""
    return [sys.executable, "-m", "pytest", "-p", "hiltest", "-q", "test_bench.py", "--hil-rig=frdm-k64f", *options]


def environment() -> dict[str, str]:
    """Return an environment without settings of hiltest."""
    return {name: value for name, value in os.environ.items() if not name.startswith("HIL_")}


def record_in(folder: Path) -> dict[str, Any]:
    """Return the record that a run left in a folder."""
    content: dict[str, Any] = json.loads((folder / "hil-out" / "run.json").read_text(encoding="utf-8"))
    return content


def unplug_when(file: Path, bench: PacedBench, terminal: PseudoTerminal, running: subprocess.Popen[str]) -> None:
    """Pull the cable once a file is there."""
    ends_s = time.monotonic() + 60.0
    while not file.exists() and time.monotonic() < ends_s and running.poll() is None:
        time.sleep(0.02)
    bench.stop()
    terminal.unplug()


def test_a_lost_connection_and_the_operators_words_come_again(tmp_path: Path) -> None:
    bench, desk = tmp_path / "bench", tmp_path / "desk"
    for folder in (bench, desk):
        folder.mkdir()
        (folder / "test_bench.py").write_text(SUITE, encoding="utf-8")
    terminal = PseudoTerminal()
    with (
        PacedBench(VirtualBench(load_rig(shipped() / "rigs" / "virtual-k64f.toml")), terminal) as paced,
        subprocess.Popen(
            command(f"--hil-port={terminal.path}", "--hil-record=run.jsonl"),
            cwd=bench,
            env=environment(),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        ) as running,
    ):
        assert running.stdin is not None
        running.stdin.write("east\n31.5\n")
        running.stdin.flush()
        unplug_when(bench / "frames", paced, terminal, running)
        answer, _ = running.communicate(timeout=60.0)
    assert running.returncode == 20, answer
    first = record_in(bench)
    assert "lost /dev/pts/" in first["tests"][1]["reason"]

    (desk / "run.jsonl").write_bytes((bench / "run.jsonl").read_bytes())
    done = subprocess.run(
        command("--hil-replay=run.jsonl"), cwd=desk, env=environment(), capture_output=True, text=True, check=False
    )
    assert done.returncode == 20, done.stdout
    again = record_in(desk)
    measured = {measurement["name"]: measurement["value"] for measurement in again["measurements"]}
    assert measured["bench.reached"] == 31.5, "the second answer, since the first was no heading"
    assert measured["bench.took"] > 0.05
    volatile = sorted({*first["volatile"], *again["volatile"]})
    assert without_volatile(first | {"volatile": volatile}) == without_volatile(again | {"volatile": volatile})
