"""The page about rigs: it names every one that ships, its tables are a rig's, its program prints what it shows."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "rigs.md").read_text(encoding="utf-8")
RIGS = {path.stem: path for path in (ROOT / "hil" / "rigs").glob("*.toml")}
TABLES = re.findall(r"^```toml\n(.*?)^```", PAGE, re.M | re.S)
(PROGRAM,) = re.findall(r"^```python\n(.*?)^```", PAGE, re.M | re.S)
(SHOWN,) = re.findall(r"^```text\n(.*?)^```", PAGE, re.M | re.S)


def test_every_rig_that_ships_is_in_the_table_and_no_other() -> None:
    assert re.findall(r"^\| `([a-z0-9-]+)` \|", PAGE, re.M) != []
    assert set(re.findall(r"^\| `([a-z0-9-]+)` \|", PAGE, re.M)) == set(RIGS)


def test_the_rigs_that_commands_name_are_there() -> None:
    named = re.findall(r"hiltest run\b[^`\n]*--rig ([a-z0-9-]+)", PAGE)
    assert named
    assert set(named) <= set(RIGS)


def test_the_tables_shown_are_those_of_the_harsh_rig() -> None:
    harsh = tomllib.loads(RIGS["virtual-k64f-harsh"].read_text(encoding="utf-8"))
    assert len(TABLES) == 2
    for shown in TABLES:
        for table, values in tomllib.loads(shown).items():
            assert values.items() <= harsh[table].items()


def test_the_program_prints_what_the_page_shows(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], cwd=tmp_path, capture_output=True, text=True, check=False, timeout=120
    )
    assert done.returncode == 0, done.stderr
    # Virtual cycles are exact.
    assert done.stdout == SHOWN
