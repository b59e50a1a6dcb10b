"""The page about the structure names files and functions that are there; tests/test_arrows.py reads its table."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
STEPS = [" ".join(match.split()) for match in re.findall(r"^\d+\. (.*?)(?=\n\d+\. |\n\n)", PAGE, re.M | re.S)]
PLACES = [pair for step in STEPS for pair in re.findall(r"`([\w/.]+\.(?:py|c))`\s+`(\w+)`", step)]
PATHS = sorted(set(re.findall(r"`((?:src|firmware_stub|hil|tests)/[\w/.-]+)`", PAGE)))


def defines(path: Path, name: str) -> bool:
    text = path.read_text(encoding="utf-8")
    form = rf"^\s*(?:def|class) {name}\b" if path.suffix == ".py" else rf"^(?!\s|typedef).*\b{name}\([^;]*$"
    return re.search(form, text, re.M) is not None


def test_every_walk_has_steps_with_places() -> None:
    walks = [walk for walk in PAGE.split("\n## ") if re.search(r"^1\. ", walk, re.M)]
    assert len(walks) == 3
    assert len(PLACES) > len(STEPS)


def test_a_step_names_a_function_that_its_file_defines() -> None:
    assert [(path, name) for path, name in PLACES if not defines(ROOT / path, name)] == []


def test_a_file_or_folder_that_is_named_is_there() -> None:
    assert [path for path in PATHS if not (ROOT / path).exists()] == []


def test_every_package_has_a_line_that_says_what_lives_there() -> None:
    packages = {path.parent.name for path in (ROOT / "src" / "hiltest").glob("*/__init__.py")}
    names = {name for row in re.findall(r"^\| (`[^|]*`) \|", PAGE, re.M) for name in re.findall(r"`(\w+)`", row)}
    assert packages <= names | {"commands", "cycle_benchmarks"}
