"""The page about the virtual board: its examples run, and its table names what there is."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

PAGE = (Path(__file__).parents[2] / "docs" / "virtual-board.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"^```python\n(.*?)^```", PAGE, re.M | re.S)


@pytest.mark.parametrize("example", EXAMPLES, ids=["call", "serial port"])
def test_every_example_runs(example: str) -> None:
    exec(compile(example, "docs/virtual-board.md", "exec"), {})


def test_a_wrong_answer_in_an_example_would_be_seen() -> None:
    broken = EXAMPLES[0].replace("0xCBF43926", "0xCBF43927")
    with pytest.raises(AssertionError):
        exec(compile(broken, "docs/virtual-board.md", "exec"), {})
