"""Debian's MicroPython on a micro:bit, calibrated as its display asks for, and judged at its prompt."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from ..finished_run import without_volatile

WALL_LIMIT_S = 300.0  # half a minute on a busy machine


@pytest.mark.ci
def test_its_headings_are_judged_and_a_replay_repeats_the_run(tmp_path: Path, micropython_hex: Path) -> None:
    command = [sys.executable, "-m", "hiltest", "run", "--rig", "microbit-v1"]
    recorded = [*command, "--firmware", str(micropython_hex), "--record", "run.jsonl.gz"]
    done = subprocess.run(recorded, capture_output=True, text=True, timeout=WALL_LIMIT_S, cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    record = json.loads((tmp_path / "hil-out" / "run.json").read_text(encoding="utf-8"))
    values = {measurement["name"]: measurement["value"] for measurement in record["measurements"]}
    assert values["device.unsettled"] == 0
    assert values["heading.firmware.bias"] == pytest.approx(-0.5, abs=0.3), "it cuts the fraction of a degree off"
    assert 2.0 < values["heading.firmware.max"] < 8.0, "it calibrates from 25 points on one side of the sphere"
    assert values["heading.firmware.tilt_sensitivity"] < 0.5, "it compensates for the tilt"
    replay = [*command, "--replay", "run.jsonl.gz", "--out", "again"]
    replayed = subprocess.run(replay, capture_output=True, text=True, timeout=WALL_LIMIT_S, cwd=tmp_path)
    assert replayed.returncode == done.returncode, replayed.stdout + replayed.stderr
    again = json.loads((tmp_path / "again" / "run.json").read_text(encoding="utf-8"))
    volatile = sorted({*record["volatile"], *again["volatile"]})
    assert without_volatile(again | {"volatile": volatile}) == without_volatile(record | {"volatile": volatile})
