"""``hiltest run`` on the default bench: complete, within limits, and the same every time."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from hiltest.boards.bench import default_firmware
from hiltest.rig.bench_files import shipped
from hiltest.run_record.reader import read_record
from hiltest.verdict.summary import summarise

from ..finished_run import without_volatile

CALIBRATORS = ("direct", "direct-fast", "corrected", "iterative")
# Those that the full set has for comparison.
FURTHER = ("inverse-iteration", "li", "gauss-newton", "gradient-descent")
# Beside them, against gravity: the paper's method is in the full set.
DPI, JOINT = "dpi", "joint"
PER_CALIBRATOR = (
    "heading.{}.max",
    "heading.{}.rms",
    "heading.{}.bias",
    "heading.{}.max_centred",
    "heading.{}.worst_sector",
    "fit.{}.residual",
    "fit.{}.offset_error",
    "fit.{}.rotation_left",
    "cycles.{}.total",
    "cycles.{}.per_point",
    "cycles.{}.fixed",
    "cycles.{}.spread",
    "cycles.{}.instructions",
)
PER_STREAM = (
    "heading.{}.max",
    "stream.{}.cycles_mean",
    "stream.{}.cycles_median",
    "stream.{}.cycles_max",
    "stream.{}.held",
)
# Whole and sliced: without slices it is the same, and there once.
STREAMS = ("direct-stream", "iterative-stream", "iterative-stream-sliced")
ALWAYS = (
    "heading.uncalibrated.max_level",
    "heading.uncalibrated.max",
    "gyroscope.bias_error",
    "board.virtual_seconds",
    "board.wall_seconds",
    "fit.joint.n_used",
    "fit.joint.dip",
    "fit.joint.dip_declared",
    "fit.joint.strength",
    "fit.joint.strength_declared",
    "fit.joint.standard_error",
)


def test_the_fast_total_is_measured_by_the_test_that_measures_its_accuracy_and_what_storing_costs(good_run) -> None:
    """So that no choice of tests prints the one without the others."""
    names = ("total", "float64_distance", "store_per_point")
    total, distance, storing = (good_run.measured[f"cycles.direct-fast.{name}"] for name in names)
    assert total["test"] == distance["test"] == storing["test"] != ""
    assert distance["outcome"] == "pass"


def test_the_default_bench_passes(good_run) -> None:
    assert good_run.code == 0, good_run.output + good_run.errors
    assert good_run.sentence.startswith("PASS. direct: worst heading ")


def test_a_passing_run_is_read_on_one_screen(good_run) -> None:
    """Piped, and at 80 columns: what a terminal without a size has."""
    lines = good_run.output.rstrip().splitlines()
    # A slow machine says every half minute how far it is, and pytest's dots go on below.
    slow = re.compile(r".* \d+ of \d+(, \d+ s left)?|\.+")
    assert len([line for line in lines if not slow.fullmatch(line)]) <= 25
    assert max(map(len, lines)) <= 80
    close = summarise(read_record(good_run.folder).run).close
    assert [item.name for item in close] == ["cycles.direct-fast.total"]


def test_everything_that_was_promised_is_measured(good_run) -> None:
    wanted = {name.format(calibrator) for name in PER_CALIBRATOR for calibrator in (*CALIBRATORS, JOINT)}
    wanted |= {name.format(stream) for name in PER_STREAM for stream in STREAMS}
    assert wanted | set(ALWAYS) <= set(good_run.measured)
    # Judged where the rig has a limit, and said to be information where it has none.
    outcomes = {
        (measurement["outcome"], measurement["limit"] is not None)
        for measurement in good_run.measured.values()
        if measurement["outcome"]
        != "not offered"  # what a calibrator does not have, such as the coverage of `iterative`
    }
    assert outcomes == {("pass", True), ("information", False)}
    assert good_run.measured["board.wall_seconds"]["volatile"]


def test_the_folder_holds_the_record_and_its_reports(good_run) -> None:
    assert sorted(path.name for path in good_run.folder.iterdir()) == [
        "junit.xml",
        "report.html",
        "report.md",
        "run.json",
    ]
    read_record(good_run.folder / "run.json")


def test_the_header_names_board_firmware_and_rig(good_run) -> None:
    record = good_run.record
    board, rig, *_ = good_run.output.splitlines()
    assert record["board"]["description"] in board
    assert record["board"]["build_id"] in board
    assert record["board"]["cycle_model"] in rig
    assert rig.startswith("rig virtual-k64f ")


def test_the_means_at_each_known_angle_give_the_headings_that_the_board_answered(good_run) -> None:
    tables = {table["name"]: table for table in good_run.record["tables"]}
    answered = np.array(tables["heading.poses"]["rows"], dtype=float)
    column = [column["name"] for column in tables["heading.poses"]["columns"]].index("answered.uncalibrated")
    means = np.array(tables["heading.means"]["rows"])
    assert means.shape == (60, 6)
    level = answered[:, 3] == 1.0
    # On a level board, without a calibration, the horizontal field is the heading; 2 mg of tilt make 0.2 degrees.
    computed = np.degrees(np.arctan2(-means[level, 1], means[level, 0]))
    assert np.abs((computed - answered[level, column] + 180.0) % 360.0 - 180.0).max() < 0.5


@pytest.mark.ci
def test_the_full_set_measures_more_and_nothing_otherwise(good_run, full_run) -> None:
    assert (good_run.record["suite"], full_run.record["suite"]) == ("gate", "full")
    assert full_run.code == 0, full_run.output
    gate, full = good_run.measured, full_run.measured
    assert gate.keys() < full.keys()
    more = full.keys() - gate.keys()
    assert {item.split(".")[0] for item in more if item.split(".")[1] not in (DPI, "dpi-poses", *FURTHER)} == {
        "accelerometer",
        "budget",
        "cycles",
        "fusion",
        "gyroscope",
    }
    assert {"fit.dpi-poses.n_used", "heading.dpi-poses.max"} <= more
    assert {name.format(calibrator) for name in PER_CALIBRATOR for calibrator in (*FURTHER, DPI)} <= more
    of_what_ran = {"board.virtual_seconds", "firmware.stack_most"}
    same = {item for item in gate if not gate[item]["volatile"]} - of_what_ran
    # Gravity is of an instant that looks at the sensors bound, and when these come hangs on the bytes on the line:
    # 0.1 ms of a tumble of 560 deg/s are 0.06 degrees.
    of_an_instant = {item for item in same if item.startswith(("fit.joint.", "heading.joint."))}
    # Looks at the sensors belong to a request, and their number depends on the time of its bytes, like the reply.
    of_requests = {item for item in same if item.endswith((".request", ".collect.point", ".reply_time"))}
    for name in of_requests:
        assert full[name]["value"] == pytest.approx(gate[name]["value"], abs=500, rel=0.05)
    exact = same - of_an_instant - of_requests
    assert {name: full[name]["value"] for name in exact} == {name: gate[name]["value"] for name in exact}
    for name in ("heading.joint.max", "heading.joint.rms", "fit.joint.rotation_left", "fit.joint.dip"):
        assert full[name]["value"] == pytest.approx(gate[name]["value"], abs=0.15)


@pytest.mark.ci
def test_error_against_cycles_ends_where_the_calibrators_do(full_run) -> None:
    table = next(table for table in full_run.record["tables"] if table["name"] == "budget.curve")
    names = [column["name"] for column in table["columns"]]
    rows = [dict(zip(names, row, strict=True)) for row in table["rows"]]
    for calibrator in (*CALIBRATORS, *FURTHER):
        last = [row for row in rows if (row["calibrator"], row["points"]) == (calibrator, 100)][-1]
        # The same hundred points in another order: sums in float32 round otherwise.
        assert last["max_error"] == pytest.approx(full_run.value(f"heading.{calibrator}.max"), abs=0.01)
    # Within the thesis' own cycles for a hundred points `direct` uses them all, and `iterative` has not begun.
    assert full_run.value("budget.direct@100.effort") == 100
    assert full_run.measured["budget.iterative@100.effort"]["outcome"] == "not offered"


def test_stages_of_a_stream_end_at_what_the_board_answers(good_run) -> None:
    table = next(table for table in good_run.record["tables"] if table["name"] == "stream.stages")
    names = [column["name"] for column in table["columns"]]
    rows = [dict(zip(names, row, strict=True)) for row in table["rows"]]
    for stream in STREAMS:
        stages = [row for row in rows if row["calibrator"] == stream]
        assert [row["points"] for row in stages] == [100, 150, 250, 300]
        # On the host in float64, and on the board in float32: the same calibration and means.
        assert stages[-1]["max_error"] == pytest.approx(good_run.value(f"heading.{stream}.max"), abs=1e-3)


def test_slices_flatten_what_a_new_point_costs_at_most(good_run) -> None:
    whole, sliced = (good_run.value(f"stream.{stream}.cycles_max") for stream in STREAMS[1:])
    assert sliced < 0.5 * whole


def test_the_stack_stays_within_the_bound_of_the_build(good_run) -> None:
    manifest = json.loads(default_firmware().with_name("manifest.json").read_text(encoding="utf-8"))
    used = good_run.measured["firmware.stack_most"]["value"]
    # Half of the bound: it adds the deepest interrupt to the deepest chain of calls, which hardly ever meet.
    assert manifest["deepest_stack_bytes"] / 2 < used <= manifest["deepest_stack_bytes"]


@pytest.mark.parametrize("name", ["direct", "direct-fast", "corrected", "iterative", "joint"])
def test_a_calibrator_takes_no_more_stack_than_its_code_can(good_run, name: str) -> None:
    selected, bound = (good_run.value(f"firmware.{name}.{case}") for case in ("stack", "stack_bound"))
    # All but the way that the packed sums take for points that they cannot scale is walked by ordinary points.
    assert (bound - selected) in ((0, 68) if name in ("direct-fast", "corrected") else (0,))


def test_uncalibrated_headings_are_as_bad_as_the_thesis_measured(good_run) -> None:
    assert good_run.value("heading.uncalibrated.max_level") == pytest.approx(8.0, abs=1.0)


def test_the_gyroscope_would_fail_without_its_bias_taken_off(good_run) -> None:
    limit = good_run.measured["gyroscope.bias_error"]["limit"]["max"]
    assert good_run.value("gyroscope.uncorrected_error") > limit


def test_two_runs_are_byte_identical_outside_volatile_fields(good_run, run_in, tmp_path: Path) -> None:
    again = run_in(tmp_path)
    first, second = (json.dumps(without_volatile(item.record), indent=1) for item in (good_run, again))
    assert first == second


def test_another_seed_is_another_run(good_run, run_in, tmp_path: Path) -> None:
    other = run_in(tmp_path, "--seed", "2", "--poses", "level", "--", "-k", "heading or identity")
    assert other.code == 0, other.output
    assert other.record["seed"] == 2
    assert other.value("heading.direct.max") != good_run.value("heading.direct.max")
    assert " over 12 poses" in other.sentence


def test_a_part_of_the_suites_is_no_bare_pass(run_in, tmp_path: Path) -> None:
    run = run_in(tmp_path, "--", "-k", "identity")
    assert run.code == 0
    assert " limits of the rig were not checked, because no test measured them, e.g. heading.direct" in run.sentence
    assert run.record["chosen"]
    assert "This run is not complete" in (run.folder / "report.html").read_text(encoding="utf-8")


def test_a_first_argument_names_the_firmware(run_in, tmp_path: Path) -> None:
    shutil.copy(default_firmware().with_name("compass-lines.elf"), tmp_path / "mine")
    assert run_in(tmp_path, "mine", "--", "-k", "identity").code == 23
    assert (
        run_in(tmp_path, "mine", "--rig", "text-compass", "--poses", "level", "--", "-k", "without_calibration").code
        == 0
    )


def test_a_test_has_the_same_id_wherever_its_suites_are(good_run, run_in, tmp_path: Path) -> None:
    shutil.copytree(shipped() / "suites", tmp_path / "hil" / "suites")
    run = run_in(tmp_path, "--", "-k", "identity")
    ids = [test["id"] for test in run.record["tests"]]
    assert "test_identity.py::test_the_firmware_names_itself" in ids
    assert set(ids) < {test["id"] for test in good_run.record["tests"]}
