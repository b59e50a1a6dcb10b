"""The page about rigs: it names every one that ships, its tables are a rig's, its program prints what it shows."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from dataclasses import fields
from pathlib import Path

from hiltest.rig.faults import Faults
from hiltest.rig.rig_file import load_rig

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


def test_the_faults_shown_are_read_and_every_key_of_theirs_is_named(tmp_path: Path) -> None:
    (shown,) = (table for table in TABLES if "[faults]" in table)
    rig = tmp_path / "rig.toml"
    rig.write_text(RIGS["virtual-k64f"].read_text(encoding="utf-8") + shown, encoding="utf-8")
    assert str(load_rig(rig).faults) == "0.0002 of bytes lost, a stall after 20 s for 1.5 s; both ways, seed 1"
    section = PAGE.partition("## Faults")[2].partition("\n## ")[0]
    assert {field.name for field in fields(Faults)} - set(re.findall(r"`faults\.([a-z_]+)`", section)) <= {"seed"}


def test_the_tables_shown_are_those_of_the_harsh_rig() -> None:
    harsh = tomllib.loads(RIGS["virtual-k64f-harsh"].read_text(encoding="utf-8"))
    tables = [table for table in TABLES if "[faults]" not in table]
    assert len(tables) == 2
    for shown in tables:
        for table, values in tomllib.loads(shown).items():
            assert values.items() <= harsh[table].items()


def test_the_program_prints_what_the_page_shows(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], cwd=tmp_path, capture_output=True, text=True, check=False, timeout=120
    )
    assert done.returncode == 0, done.stderr
    # Virtual cycles are exact.
    assert done.stdout == SHOWN
