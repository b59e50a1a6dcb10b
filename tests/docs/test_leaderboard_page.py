"""docs/leaderboard.md is what its results render to, its worlds are those of the code, and its adapters run."""

from __future__ import annotations

import ast
import importlib.util
import math
import sys
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from typing import Any

import pytest

from hiltest.calibration import REFERENCES
from hiltest.judge.answers import rate
from hiltest.judge.entries import open_entry, open_filter
from hiltest.judge.motions import simulated_motion
from hiltest.judge.own_calibrators import own_calibrators
from hiltest.judge.worlds import FAMILIES, draw_world

DOCS = Path(__file__).parents[2] / "docs"
AGAIN = "judge anew: python docs/leaderboard.py"
ADAPTERS = [
    (file, node.name, (ast.get_docstring(node) or "").split()[0])
    for file in sorted([*(DOCS / "leaderboard").glob("calibrators_*.py"), DOCS / "leaderboard" / "filters.py"])
    for node in ast.parse(file.read_text(encoding="utf-8")).body
    if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_")
]


@pytest.fixture(scope="module")
def script() -> Any:
    """The module of the script; its dataclasses are read by name."""
    described = importlib.util.spec_from_file_location("leaderboard", DOCS / "leaderboard.py")
    assert described is not None
    assert described.loader is not None
    module = sys.modules["leaderboard"] = importlib.util.module_from_spec(described)
    described.loader.exec_module(module)
    yield module
    del sys.modules["leaderboard"]


def test_the_page_is_what_its_results_render_to(script: Any) -> None:
    page = (DOCS / "leaderboard.md").read_text(encoding="utf-8")
    assert page == script.page(script.read_results()), "write it anew: python docs/leaderboard.py --page"


def test_the_worlds_are_those_of_the_code(script: Any) -> None:
    assert script.read_results().worlds == script.world_digests(), AGAIN


def test_every_calibrator_of_hiltest_has_a_row(script: Any) -> None:
    rows = {(row.source, row.name) for row in script.read_results().rows if row.calibrator}
    assert {(script.IN_PYTHON, name) for name in REFERENCES} <= rows, AGAIN
    assert {(script.IN_C, entry.name) for entry in own_calibrators()} <= rows, AGAIN


@pytest.mark.parametrize(("file", "name", "package"), ADAPTERS, ids=[name for _, name, _ in ADAPTERS])
def test_an_adapter_of_a_package_that_is_installed_runs(file: Path, name: str, package: str) -> None:
    try:
        distribution(package)
    except PackageNotFoundError:
        pytest.skip(f"{package} is not installed: pip install -r docs/leaderboard/requirements.txt")
    if file.stem == "filters":
        motion = simulated_motion()
        with open_filter(f"{file}:{name}") as judged:
            assert judged.follow(motion).quaternions is not None
        return
    world = draw_world(FAMILIES[0], 0)
    with open_entry(f"{file}:{name}", None) as entry:
        assert math.isfinite(rate(entry.answer(world), world).rms_deg or math.nan)
