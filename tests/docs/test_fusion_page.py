"""The page about fusion: its command measures what its table says."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

from tests.finished_run import run_module

PAGE = (Path(__file__).parents[2] / "docs" / "fusion.md").read_text(encoding="utf-8")
(COMMAND,) = re.findall(r"^```sh\n(.*?)^```", PAGE, re.M | re.S)
ROWS = re.findall(r"^\| `(fusion[a-z._]*)`" + r" \| ([0-9.]+)" * 4 + r" \|$", PAGE, re.M)


def test_the_command_measures_what_the_page_says(tmp_path: Path) -> None:
    done = run_module(*shlex.split(COMMAND), folder=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    measurements = json.loads((tmp_path / "hil-out" / "run.json").read_text(encoding="utf-8"))["measurements"]
    measured = {measurement["name"]: measurement["value"] for measurement in measurements}
    assert len(ROWS) == 3
    for name, *row in ROWS:
        heading, heading_99, tilt, tilt_99 = map(float, row)
        # One seed of 1000: below the 99th percentile, and not far below the median.
        assert heading / 4.0 < measured[f"{name}.heading.rms"] < heading_99
        assert tilt / 4.0 < measured[f"{name}.tilt.rms"] < tilt_99
