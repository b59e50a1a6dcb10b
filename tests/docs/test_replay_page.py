"""The page about record and replay: its commands print what it shows."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
from tests.finished_run import run_hiltest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "replay.md").read_text(encoding="utf-8")
COMMANDS = re.findall(r"^```sh\nhiltest run (.*?)\n```", PAGE, re.M)
SHOWN = re.findall(r"^```text\n(.*?)^```", PAGE, re.M | re.S)


def as_on_any_day(text: str) -> str:
    """Return an output without what another build, or another machine, has otherwise, and without its line breaks."""
    text = re.sub(r"in [0-9.]+s|build [0-9a-f]+|:\d+, at [0-9.]+ s|\d+ (limits|deselected|passed)", "", text)
    return " ".join(re.sub(r"^[.L]+ ", "", text, flags=re.M).split())


def test_the_commands_print_what_the_page_shows(tmp_path: Path) -> None:
    assert len(COMMANDS) == len(SHOWN) == 5
    for command, shown, code in zip(COMMANDS, SHOWN, (0, 0, 20, 0, 0), strict=True):
        done = run_hiltest(tmp_path, *shlex.split(command))
        assert done.code == code, done.output + done.errors
        assert as_on_any_day(done.output) == as_on_any_day(shown)
