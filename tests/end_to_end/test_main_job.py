"""``hiltest run`` on the default bench: complete, within limits, and the same every time."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path

import pytest

from hiltest.report.record import without_volatile
from hiltest.report.schema import load_run

Run = Callable[..., object]

PER_CALIBRATOR = (
    "heading.{}.max", "heading.{}.rms", "heading.{}.bias", "heading.{}.max_centred", "heading.{}.worst_sector",
    "fit.{}.residual", "fit.{}.offset_error", "fit.{}.rotation_left", "cycles.{}.total", "cycles.{}.per_point",
    "cycles.{}.fixed", "cycles.{}.spread", "cycles.{}.instructions",
)
ALWAYS = (
    "heading.uncalibrated.max_level", "heading.uncalibrated.max", "gyroscope.bias_error", "board.virtual_seconds",
    "board.wall_seconds",
)


def test_the_default_bench_passes(good_run) -> None:
    assert good_run.code == 0, good_run.output + good_run.errors
    assert good_run.sentence.startswith("direct: worst heading ")
    assert ": PASS. " in good_run.sentence


def test_everything_that_was_promised_is_measured(good_run) -> None:
    wanted = {name.format(calibrator) for name in PER_CALIBRATOR for calibrator in ("direct", "iterative")}
    assert wanted | set(ALWAYS) <= set(good_run.measured)
    assert {good_run.measured[name]["outcome"] for name in wanted | set(ALWAYS)} == {"pass"}
    assert good_run.measured["board.wall_seconds"]["volatile"]


def test_the_folder_holds_the_record_and_its_reports(good_run) -> None:
    assert sorted(path.name for path in good_run.folder.iterdir()) == [
        "junit.xml", "report.html", "report.md", "run.json",
    ]
    load_run(good_run.folder / "run.json")


def test_the_header_names_board_firmware_and_rig(good_run) -> None:
    record = good_run.record
    header = [line for line in good_run.output.splitlines() if line.startswith(("hiltest: ", "cycle model "))]
    assert len(header) == 2
    assert record["board"]["build_id"] in header[0]
    assert record["board"]["cycle_model"] in header[1]
    assert "virtual-k64f" in header[1]


def test_cycles_carry_their_model(good_run) -> None:
    models = {each["cycle_model"] for each in good_run.measured.values() if each["unit"] == "cycle"}
    assert models == {good_run.record["board"]["cycle_model"]}
    assert "" not in models


def test_junit_holds_the_measurements(good_run) -> None:
    properties = {each.attrib["name"] for each in ET.parse(good_run.folder / "junit.xml").iter("property")}
    assert {"hil.heading.direct.max", "hil.cycles.iterative.total", "hil.gyroscope.bias_error"} <= properties


def test_uncalibrated_headings_are_as_bad_as_the_thesis_measured(good_run) -> None:
    assert good_run.value("heading.uncalibrated.max_level") == pytest.approx(8.0, abs=1.0)


def test_the_gyroscope_would_fail_without_its_bias_taken_off(good_run) -> None:
    limit = good_run.measured["gyroscope.bias_error"]["limit"]["max"]
    assert good_run.value("gyroscope.uncorrected_error") > limit


def test_two_runs_are_byte_identical_outside_volatile_fields(good_run, run_in, tmp_path: Path) -> None:
    again = run_in(tmp_path)
    first, second = (json.dumps(without_volatile(each.record), indent=1) for each in (good_run, again))
    assert first == second


def test_another_seed_is_another_run(good_run, run_in, tmp_path: Path) -> None:
    other = run_in(tmp_path, "--seed", "2", "--poses", "level", "--", "-k", "heading or identity")
    assert other.code == 0, other.output
    assert other.record["seed"] == 2
    assert other.value("heading.direct.max") != good_run.value("heading.direct.max")
    assert " over 12 poses" in other.sentence
