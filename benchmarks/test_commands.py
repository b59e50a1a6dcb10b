"""How much processor time a command takes before it does anything."""

from __future__ import annotations

import resource
import subprocess
import sys
from pathlib import Path

from .conftest import Report

ROUNDS = 10


def _user_s(command: list[str]) -> float:
    """Return the user time of the fastest of several processes."""
    times: list[float] = []
    for _ in range(ROUNDS):
        began = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL, timeout=60)
        times.append(resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - began)
    return min(times)


def test_help(report: Report) -> None:
    hiltest = Path(sys.executable).with_name("hiltest")
    ratio = _user_s([str(hiltest), "--help"]) / _user_s([sys.executable, "-c", "import click"])
    report("hiltest --help against import click", ratio, "x user time", "at most 5")
