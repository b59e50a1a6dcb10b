"""Help and shell completion import nothing that takes long: they answer at once."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from tests.heavy_imports import HEAVY

from hiltest.commands.cli import every_command

NOT_IMPORTED = {*HEAVY, "pytest", "_pytest"} - {"click"}
# The command ends its process: what it imported is told as it does.
TELLING = f"""
import atexit, sys
atexit.register(lambda: print("imported:", *sorted({NOT_IMPORTED!r} & sys.modules.keys()), file=sys.stderr))
"""
ALL_HELP = f"""
{TELLING}
from hiltest.commands.cli import commands, every_command
for name, _ in [("", None), *every_command()]:
    commands([*name.split(), "--help"], standalone_mode=False)
"""


def started(folder: Path, program: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", program],
        cwd=folder,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=True,
    )


def test_the_help_of_every_command_imports_nothing_heavy(tmp_path: Path) -> None:
    result = started(tmp_path, ALL_HELP)
    assert result.stderr == "imported:\n"
    assert result.stdout.count("Usage: ") == 1 + len(list(every_command()))


@pytest.mark.parametrize(
    ("words", "completed"), [("hiltest tim", "timing"), ("hiltest fit --sh", "--shape"), ("hiltest study bu", "budget")]
)
def test_shell_completion_imports_nothing_heavy(tmp_path: Path, words: str, completed: str) -> None:
    program = f"{TELLING}\nfrom hiltest.commands.cli import main\nmain()"
    last = str(len(words.split()) - 1)
    result = started(tmp_path, program, _HILTEST_COMPLETE="bash_complete", COMP_WORDS=words, COMP_CWORD=last)
    assert result.stdout.split(",")[-1].strip() == completed
    assert result.stderr == "imported:\n"


def test_what_a_run_does_without_texts_of_instructions_does_not_import_their_decoder(tmp_path: Path) -> None:
    program = """
import sys
from hiltest.boards import default_firmware
from hiltest.virtual import VirtualK64F
import hiltest.virtual.coverage, hiltest.session, hiltest.virtual.counts.profiling
board = VirtualK64F(default_firmware())
board.run_until(0.01)
assert board.stack_bounds(["crc32"])["crc32"] >= 0
print(sorted({"capstone", "unicorn"} & sys.modules.keys()))
"""
    assert started(tmp_path, program).stdout == "[]\n"
