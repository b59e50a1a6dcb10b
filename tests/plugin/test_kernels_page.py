"""docs/kernels.md: its table and its test count kernels of a project that has neither a rig nor a board."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import pytest

from hiltest.boards import default_firmware

PAGE = Path(__file__).parents[2] / "docs" / "kernels.md"


@pytest.fixture
def project(pytester: pytest.Pytester) -> pytest.Pytester:
    """Return a project with the files of the page; its ELF is the packaged firmware."""
    blocks = re.findall(r"```(?:toml|python)\n# (\S+)\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert [name for name, _ in blocks] == ["kernels.toml", "test_kernels.py"]
    for name, text in blocks:
        (pytester.path / name).write_text(text, encoding="utf-8")
    (pytester.path / "build").mkdir()
    shutil.copy(default_firmware(), pytester.path / "build" / "kernels.elf")
    return pytester


def measured(project: pytest.Pytester) -> dict[str, float]:
    record = json.loads((project.path / "hil-out" / "run.json").read_text(encoding="utf-8"))
    return {entry["name"]: entry["value"] for entry in record["measurements"]}


def test_kernels_are_counted_with_the_memories_of_a_part(project: pytest.Pytester) -> None:
    project.runpytest_subprocess().assert_outcomes(passed=1)
    assert measured(project) == {"cycles.crc32": 331, "stack.crc32": 24}


@pytest.mark.parametrize("limit", ["most_cycles = 340", "most_stack = 32"])
def test_a_kernel_beyond_a_limit_fails(project: pytest.Pytester, limit: str) -> None:
    table = project.path / "kernels.toml"
    table.write_text(table.read_text().replace(limit, limit.partition("=")[0] + "= 20"))
    project.runpytest_subprocess().assert_outcomes(failed=1)
