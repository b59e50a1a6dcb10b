"""Registers of the sensors in a run: recorded, compared, and refused if no model carries them out."""

from __future__ import annotations

import json
import shutil
from typing import Any

import pytest

from hiltest.rig.bench_files import shipped

# Another master sets the gyroscope's high-pass filter, in place of firmware that does.
SUITE = """
from hiltest.link.replies import SensorKind

def test_settings(board, record_settings):
    gyroscope = board.sensor(SensorKind.GYROSCOPE)
    for register, value in ((0x13, 0x00), (0x0D, {}), (0x13, 0x0A)):
        board.stage.write_sensor(gyroscope.bus, gyroscope.address, register, value)
    record_settings("set_up", gyroscope)
    record_settings("turn", gyroscope)
"""
NAME = "sensor.FXAS21002C.CTRL_REG0.set_up"


def run(pytester: pytest.Pytester, value: int, *options: str, accepted: str = "") -> tuple[int, dict[str, Any]]:
    rig = (shipped() / "rigs" / "virtual-k64f.toml").read_text(encoding="utf-8").partition("[limits]")[0]
    rig = rig.replace("[sensors]", f"[sensors]\naccepted_settings = [{accepted}]")
    (pytester.path / "rig.toml").write_text(rig, encoding="utf-8")
    shutil.copy(shipped() / "suites" / "conftest.py", pytester.path)
    pytester.makepyfile(SUITE.format(value))
    done = pytester.runpytest_inprocess("--hil-rig=rig.toml", f"--hil-out=out{value}", *options)
    record = json.loads((pytester.path / f"out{value}" / "run.json").read_text(encoding="utf-8"))
    return int(done.ret), record


def test_a_setting_that_no_model_carries_out_is_not_evaluated_and_named_once(pytester: pytest.Pytester) -> None:
    code, record = run(pytester, 4)
    assert code == 22
    named = "FXAS21002C CTRL_REG0 0x04: high-pass filter is set but not modelled"
    assert record["verdict"]["sentence"].startswith(f"NOT EVALUATED. {NAME} ({named})")
    assert {row["name"]: row["outcome"] for row in record["measurements"] if "CTRL_REG0" in row["name"]} == {
        NAME: "unset",
        NAME.replace("set_up", "turn"): "information",
    }
    (table,) = [table for table in record["tables"] if table["name"] == "sensors.set_up"]
    assert ["FXAS21002C", "CTRL_REG0", "0x04", named] in table["rows"]


def test_the_rig_accepts_a_setting_by_name(pytester: pytest.Pytester) -> None:
    code, record = run(pytester, 4, accepted='"FXAS21002C CTRL_REG0 0x04"')
    assert code == 0
    assert {row["value"] for row in record["measurements"] if row["name"] == NAME} == {4}
    code, _ = run(pytester, 12, accepted='"FXAS21002C CTRL_REG0 0x04"')
    assert code == 22


def test_another_setting_than_in_the_base_is_a_regression_that_names_it(pytester: pytest.Pytester) -> None:
    assert run(pytester, 0)[0] == 0
    code, record = run(pytester, 0x80, "--hil-baseline=out0")
    assert code == 21
    change = "FXAS21002C CTRL_REG0 0x80, was 0x00: low-pass filter"
    assert f"2 worse: {change} (after set-up), {change} (in a turn)" in record["comparison"]["sentence"]
