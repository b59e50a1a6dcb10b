"""The page about the worst case: its commands print what it shows, and its numbers are those that are kept."""

from __future__ import annotations

import re
import shlex
import tomllib
from pathlib import Path

import pytest
from tests.command_files import run

from hiltest.rig.rig_file import load_rig
from hiltest.studies.worst_case import load_worst_case
from hiltest.verdict.baseline_file import read_baseline

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "worst.md").read_text(encoding="utf-8")
KEPT = {path.stem: load_worst_case(path) for path in (ROOT / "hil" / "suites" / "worst").glob("*.json")}
_SEARCH, *COMMANDS = re.findall(r"^```sh\nhiltest (.*?)\n```", PAGE, re.M | re.S)
SHOWN = re.findall(r"^```text\n(.*?)^```", PAGE, re.M | re.S)
ROWS = re.findall(r"^\| `([a-z-]+)` \| ([0-9 ]+) \| ([0-9 ]+) \| ([0-9.]+) \|", PAGE, re.M)


@pytest.mark.parametrize(("command", "shown"), [*zip(COMMANDS, SHOWN, strict=True)], ids=["atan2f", "replay"])
def test_a_command_prints_what_the_page_shows(
    command: str, shown: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "hil").symlink_to(ROOT / "hil")
    assert run(*shlex.split(command)) == 0
    without_seconds = [re.sub(r", \d+ s,", ", 3 s,", text) for text in (capsys.readouterr().out, shown)]
    assert without_seconds[0] == without_seconds[1]


def test_the_table_has_what_is_kept_beside_the_baseline() -> None:
    assert {name for name, *_ in ROWS} == KEPT.keys()
    baseline = read_baseline(ROOT / "hil" / "baselines" / "virtual-k64f.json")
    typical = {row.name: row.values[0] for row in baseline.measurements}
    for name, golden, result, times in ROWS:
        numbers = int(golden.replace(" ", "")), int(result.replace(" ", ""))
        assert numbers[1] == KEPT[name].cycles
        assert float(times) == pytest.approx(numbers[1] / numbers[0], abs=0.05)  # one decimal
        if (total := typical.get(f"cycles.{name}.total")) is not None:
            assert (numbers[0], typical[f"cycles.{name}.worst_found"]) == (total, numbers[1])


def test_the_limit_on_the_page_is_the_default_rig_s() -> None:
    (text,) = re.findall(r"^```toml\n(.*?)^```", PAGE, re.M | re.S)
    ((name, limit),) = tomllib.loads(text)["limits"].items()
    assert load_rig(ROOT / "hil" / "rigs" / "virtual-k64f.toml").limits[name].max == limit["max"]
