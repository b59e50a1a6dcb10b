"""Runs of the real command that have ended, and the one on the default bench that all tests share."""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

WALL_LIMIT_S = 300.0  # for what takes some 15 s on a machine of its own


@dataclass(frozen=True, slots=True)
class Finished:
    """A command that has ended, and the record it left."""

    code: int
    output: str
    errors: str
    folder: Path

    @property
    def record(self) -> dict[str, Any]:
        content: dict[str, Any] = json.loads((self.folder / "run.json").read_text(encoding="utf-8"))
        return content

    @property
    def measured(self) -> dict[str, dict[str, Any]]:
        return {measurement["name"]: measurement for measurement in self.record["measurements"]}

    def value(self, name: str) -> float:
        return float(self.measured[name]["value"])

    @property
    def sentence(self) -> str:
        """The verdict of the record; the output has it too, a failed run's as a list with the likely cause."""
        sentence: str = self.record["verdict"]["sentence"]
        output = " ".join(self.output.split())
        if self.code == 0:
            assert " ".join(sentence.split()) in output
        cause = sentence.partition("Likely cause: ")[2].partition(".")[0]
        assert f"likely cause: {cause}".lower() in output.lower() or not cause
        return sentence


def run_module(
    *words: str, folder: Path, environment: Mapping[str, str] | None = None
) -> subprocess.CompletedProcess[str]:
    """Run ``python -m`` with `words` in a folder, by default without the settings of this process."""
    return subprocess.run(
        [sys.executable, "-m", *words],
        cwd=folder,
        env=environment or {name: value for name, value in os.environ.items() if not name.startswith("HIL_")},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
        timeout=WALL_LIMIT_S,
    )


def run_hiltest(folder: Path, *arguments: str) -> Finished:
    """Run ``hiltest run`` in a folder, with no setting from outside."""
    done = run_module("hiltest", "run", *arguments, folder=folder)
    return Finished(done.returncode, done.stdout, done.stderr, folder / "hil-out")


def run_once(folder: Path) -> Finished:
    """Run the main job on the default bench, or read what the process that came first has kept of it."""
    folder.mkdir(exist_ok=True)
    stored = folder / "finished.json"
    with (folder / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not stored.exists():
            (folder / "bench").mkdir(exist_ok=True)
            done = run_hiltest(folder / "bench")
            stored.write_text(json.dumps([done.code, done.output, done.errors]), encoding="utf-8")
    code, output, errors = json.loads(stored.read_text(encoding="utf-8"))
    return Finished(code, output, errors, folder / "bench" / "hil-out")


def without_volatile(content: Mapping[str, Any]) -> dict[str, Any]:
    """Return a copy of a parsed ``run.json`` without the places that its ``volatile`` names."""
    copy: dict[str, Any] = json.loads(json.dumps(content))
    for pointer in content["volatile"]:
        *parents, last = pointer.lstrip("/").split("/")
        place: Any = copy
        for step in parents:
            place = place[int(step)] if isinstance(place, list) else place[step]
        with contextlib.suppress(KeyError):
            del place[last]
    return copy
