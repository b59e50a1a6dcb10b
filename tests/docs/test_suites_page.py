"""The page about the two sets of tests: its suite and its limits do what it says."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

import pytest
from tests.finished_run import run_module

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "suites.md").read_text(encoding="utf-8")
(SUITE,) = re.findall(r"^```python\n(.*?)^```", PAGE, re.M | re.S)
(LIMITS,) = re.findall(r"^```toml\n(.*?)^```", PAGE, re.M | re.S)
(COMMANDS,) = re.findall(r"^```sh\n(.*?)^```", PAGE, re.M | re.S)
GATE, FULL = (shlex.split(line) for line in COMMANDS.splitlines())


@pytest.fixture
def bench(tmp_path: Path) -> Path:
    """A bench of one's own with the page's suite and limits."""
    rig = (ROOT / "hil" / "rigs" / "virtual-k64f.toml").read_text(encoding="utf-8")
    for folder in ("suites", "rigs"):
        (tmp_path / "hil" / folder).mkdir(parents=True)
    (tmp_path / "hil" / "suites" / "test_compass.py").write_text(SUITE, encoding="utf-8")
    path = tmp_path / "hil" / "rigs" / "virtual-k64f.toml"
    path.write_text(rig[: rig.index("[limits]")] + LIMITS, encoding="utf-8")
    return tmp_path


def run(bench: Path, command: list[str]) -> tuple[int, set[str], str]:
    """Return the exit code, the names that were measured under a limit, and the output."""
    done = run_module(*command, folder=bench)
    file = bench / "hil-out" / "run.json"
    measured = json.loads(file.read_text(encoding="utf-8"))["measurements"] if file.exists() else []
    return done.returncode, {item["name"] for item in measured if item["limit"]}, done.stdout + done.stderr


def test_each_set_judges_its_limits(bench: Path) -> None:
    code, judged, output = run(bench, GATE)
    assert (code, judged) == (0, {"compass.slots"}), output
    assert "1 test of the full set left out; --suite full runs them" in " ".join(output.split())
    code, judged, output = run(bench, FULL)
    assert (code, judged) == (0, {"compass.slots", "compass.calibrators"}), output


def test_a_limit_that_does_not_say_its_set_must_be_met_by_both(bench: Path) -> None:
    path = bench / "hil" / "rigs" / "virtual-k64f.toml"
    path.write_text(path.read_text(encoding="utf-8").replace(', suite = "full"', ""), encoding="utf-8")
    code, judged, output = run(bench, GATE)
    assert (code, judged) == (22, {"compass.slots", "compass.calibrators"})
    (match,) = re.findall(r"`(compass\.calibrators \(.*\))`", PAGE)
    assert match in " ".join(output.split())


def test_the_full_set_by_name_is_refused_without_the_option(bench: Path) -> None:
    code, _, output = run(bench, [*GATE, "--", "-k", "all_night"])
    assert code == 4
    assert "--suite full" in output
