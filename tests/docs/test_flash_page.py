"""The page about flashing: its outputs are those of the commands, its options and exit codes theirs."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
from tests.command_files import run
from tests.flashing.bench import Bench

from hiltest.commands.flash import flash
from hiltest.commands.run import run as run_command
from hiltest.link.lock import Holder

PAGE = (Path(__file__).parents[2] / "docs" / "flash.md").read_text(encoding="utf-8")
COMMANDS = [line for block in re.findall(r"^```sh\n(.*?)^```", PAGE, re.M | re.S) for line in block.splitlines()]
FLASHED, FAILED, HELD = re.findall(r"^```text\n(.*?)^```", PAGE, re.M | re.S)


def test_every_exit_code_is_on_the_page() -> None:
    assert re.findall(r"^  (\d+) ", flash.epilog or "", re.M) == re.findall(r"^\| (\d+) \|", PAGE, re.M)


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_of_the_page_is_understood(command: str) -> None:
    _, name, *words = shlex.split(command)
    called = {"flash": flash, "run": run_command}[name]
    called.make_context(name, words)


@pytest.mark.slow
def test_the_outputs_are_the_commands(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with Bench(tmp_path) as bench:
        monkeypatch.setenv("HILTEST_ROOT", str(bench.root))
        assert run("flash") == 0
        assert capsys.readouterr().out == FLASHED
        bench.drive.refusal = "The hex file cannot be decoded. Checksum calculation failure occurred."
        assert run("flash") == 20
        assert capsys.readouterr().err.replace(str(bench.root), "") == FAILED


def test_who_has_a_board_is_told_in_these_words() -> None:
    holder = Holder(4711, "me", "hiltest run --rig frdm-k64f", "2026-11-26 12:31:05 UTC", "frdm-k64f")
    assert str(holder) in HELD
