"""The page about the virtual board: its examples run, and its table names what there is."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from hiltest.rig_file import load_rig

PAGE = (Path(__file__).parents[2] / "docs" / "virtual-board.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"^```python\n(.*?)^```", PAGE, re.M | re.S)


@pytest.mark.parametrize("example", EXAMPLES, ids=["call", "serial port"])
def test_every_example_runs(example: str) -> None:
    exec(compile(example, "docs/virtual-board.md", "exec"), {})


def test_a_wrong_answer_in_an_example_would_be_seen() -> None:
    broken = EXAMPLES[0].replace("0xCBF43926", "0xCBF43927")
    with pytest.raises(AssertionError):
        exec(compile(broken, "docs/virtual-board.md", "exec"), {})


def test_the_rig_keys_of_the_page_are_keys_of_a_rig(tmp_path: Path) -> None:
    (keys,) = re.findall(r"^```toml\n\[world\]\n(.*?)^```", PAGE, re.M | re.S)
    rig = (Path(__file__).parents[2] / "hil" / "rigs" / "virtual-k64f.toml").read_text(encoding="utf-8")
    assert rig.count("temperature_degc = 25.0\n") == 1
    (tmp_path / "warm.toml").write_text(rig.replace("temperature_degc = 25.0\n", keys), encoding="utf-8")
    world = load_rig(tmp_path / "warm.toml").world
    assert world is not None
    assert world.temperature_end_degc == 45.0
    assert world.drift.gyroscope_bias_dps_per_degc == (0.0, 0.2, 0.0)
