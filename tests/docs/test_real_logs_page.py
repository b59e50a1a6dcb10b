"""The page of recorded logs: what it says of each magnetometer is what the tool says."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from ..interfaces.conftest import shared_data  # noqa: F401  # a fixture
from ..log_fitting.real_logs import magnetometers

PAGE = (Path(__file__).parents[2] / "docs" / "real-logs.md").read_text(encoding="utf-8")


@pytest.mark.slow
def test_the_verdicts_are_those_of_today(shared_data: Callable[[str], Path]) -> None:  # noqa: F811
    assert shared_data("README.md").is_file()
    result, answer = (_verdicts(text) for text in ("\n".join(magnetometers()), PAGE))
    assert result.items() <= answer.items()
    assert len(result) == 4


def _verdicts(text: str) -> dict[str, tuple[str, str]]:
    """Return what was left out of each set, and its verdict with the best fit."""
    return {
        row[0]: (row[1], row[2])
        for row in re.findall(r"^\| ([^|]+) \| ([^|]+) \| ([^|]+) \|", text, re.M)
        if "`" in row[2] and row[1][0].isdigit() and ", " in row[1]
    }
