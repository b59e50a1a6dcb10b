"""The page about the virtual board: its examples run, and its table names what there is."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from hiltest.rig.rig_file import load_rig

PAGE = (Path(__file__).parents[2] / "docs" / "virtual-board.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"^```python\n(.*?)^```", PAGE, re.M | re.S)


@pytest.mark.parametrize(
    "example", EXAMPLES, ids=["call", "serial port", "watch", "snapshot", "sensor", "LEDs and buttons", "not modelled"]
)
def test_every_example_runs(example: str) -> None:
    exec(compile(example, "docs/virtual-board.md", "exec"), {})


def test_the_rig_keys_of_the_page_are_keys_of_a_rig(tmp_path: Path) -> None:
    (keys,) = re.findall(r"^```toml\n\[world\]\n(.*?)^```", PAGE, re.M | re.S)
    rig = (Path(__file__).parents[2] / "hil" / "rigs" / "virtual-k64f.toml").read_text(encoding="utf-8")
    course = re.findall(r"^temperature_\w+ = .*\n", rig, re.M)
    assert len(course) == 3
    (tmp_path / "warm.toml").write_text(rig.replace("".join(course), keys), encoding="utf-8")
    world = load_rig(tmp_path / "warm.toml").world
    assert world is not None
    assert world.temperature_end_degc == 45.0
    assert world.drift.gyroscope_bias_dps_per_degc == (0.0, 0.2, 0.0)


def test_the_functions_that_the_page_counts_are_a_table_of_a_rig(tmp_path: Path) -> None:
    (table,) = re.findall(r"^```toml\n(\[cycles\]\n.*?)^```", PAGE, re.M | re.S)
    rig = (Path(__file__).parents[2] / "hil" / "rigs" / "virtual-k64f.toml").read_text(encoding="utf-8")
    (tmp_path / "counted.toml").write_text(f"{rig}\n{table}", encoding="utf-8")
    counted = load_rig(tmp_path / "counted.toml").cycles
    assert counted["fusion"].functions == ("fRun_9DOF_GBY_KALMAN",)
    assert counted["fit"].ends == "sfg+0xa80"
