"""Small changes of the firmware that a limit does not see: caught and named by what they are judged against.

Each change is made to the project's own firmware, built with the cross compiler, and run by the real command on a
bench that measures a heading and a cost, and has no limits. The older firmware is the one that the package ships.
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from .firmware_edits import Edit, FirmwareCopy, calibrations_turned

REPOSITORY = Path(__file__).parents[2]
OLD = REPOSITORY / "src" / "hiltest" / "firmware" / "hiltest-frdm-k64f.elf"
SUITE = """
import pytest
from hiltest.procedures import collect_tumble, measure_cycles, measure_known_angles, run_calibrators

pytestmark = pytest.mark.hil


def test_cost(board, rig, measure):
    cost = measure_cycles(board, ["direct"], n=rig.procedure.calibration_points, point_sets=1)["direct"]
    measure("cycles.direct.total", cost.total, "cycle", cycle_model=cost.model)
    measure("cycles.direct.fixed", cost.fixed, "cycle", cycle_model=cost.model)


def test_heading(board, turntable, rig, measure):
    tumble = collect_tumble(board, turntable, points=rig.procedure.tumble_points)
    run = run_calibrators(board, tumble, calibrators=["direct"], n=rig.procedure.calibration_points)["direct"]
    angles = measure_known_angles(
        board, turntable, poses=rig.procedure.known_angle_poses("level"), slots={"direct": run.slot},
        mounting_yaw_deg=rig.mounting.yaw_deg, readings=rig.procedure.readings_per_pose,
    )
    errors = angles.summary("direct")
    measure("heading.direct.max", errors.max_deg, "deg")
    measure("heading.direct.rms", errors.rms_deg, "deg")
    measure("heading.direct.bias", errors.bias_deg, "deg")
"""
COST, HEADING = ("--", "-k", "cost"), ("--", "-k", "heading")

ONE_NOP_A_POINT = Edit(
    "calibration/moments.c",
    "        s_zzzz += zz * zz;\n",
    '        s_zzzz += zz * zz;\n        __asm__ volatile("nop");\n',
)
TURNED_ABOUT_A_HORIZONTAL_AXIS = calibrations_turned(1.0, about="x")
ONE_STEP_LESS = Edit("calibration/corrected.c", "#define NEWTON_STEPS 2", "#define NEWTON_STEPS 1")


@pytest.fixture
def bench(tmp_path: Path) -> Path:
    """A bench of one's own, with this suite and the default rig without limits."""
    return make_bench(tmp_path)


def make_bench(folder: Path) -> Path:
    rig = (REPOSITORY / "hil" / "rigs" / "virtual-k64f.toml").read_text(encoding="utf-8")
    for name in ("suites", "rigs"):
        (folder / "hil" / name).mkdir(parents=True)
    (folder / "hil" / "suites" / "test_compass.py").write_text(SUITE, encoding="utf-8")
    path = folder / "hil" / "rigs" / "virtual-k64f.toml"
    # No more points than the calibrator uses, and none for a calibration that this suite does not make.
    short = rig[: rig.index("[limits]")].replace("tumble_points = 300", 'dpi = "none"\ntumble_points = 100')
    path.write_text(short, encoding="utf-8")
    return folder


def changes(comparison: dict[str, Any]) -> dict[str, str]:
    return {row["name"]: row["change"] for row in comparison["differences"]}


def difference(comparison: dict[str, Any], name: str) -> dict[str, Any]:
    (result,) = [row for row in comparison["differences"] if row["name"] == name]
    return dict(result)


@pytest.fixture(scope="module")
def over_eight_seeds(run_in, copy_of_the_firmware: FirmwareCopy, tmp_path_factory: pytest.TempPathFactory):
    """A compass turned by a degree about a horizontal axis, against the one that is not, on the same eight seeds."""
    folder = make_bench(tmp_path_factory.mktemp("seeds"))
    new = copy_of_the_firmware.build(TURNED_ABOUT_A_HORIZONTAL_AXIS, folder / "new.elf")
    return run_in(folder, "--seeds", "1..8", "--firmware", str(new), "--against", str(OLD), *HEADING)


def test_one_nop_a_point_is_a_regression_that_says_how_many_cycles(
    run_in, copy_of_the_firmware: FirmwareCopy, bench: Path
) -> None:
    new = copy_of_the_firmware.build(ONE_NOP_A_POINT, bench / "new.elf")
    run = run_in(bench, "--firmware", str(new), "--against", str(OLD), *COST)
    assert run.code == 21, run.output + run.errors
    result = difference(run.record["comparison"], "cycles.direct.total")
    # Its own cycle for each of a hundred points, and what the compiler's order of instructions loses around it.
    assert result["change"] == "worse"
    assert 100 <= result["delta"] <= 300
    assert "worse: cycles.direct." in run.sentence
    assert f" {result['base']:,} -> {result['new']:,} cycles (+{result['delta']}, ".replace(",", " ", 2) in run.sentence
    assert run.sentence.startswith("Not to be merged (against ")
    assert "): REGRESSION: 1 worse: cycles.direct." in run.sentence


def test_the_same_firmware_is_no_regression_in_the_chosen_tests(run_in, bench: Path) -> None:
    run = run_in(bench, "--firmware", str(OLD), "--against", str(OLD), *COST)
    assert run.code == 0, run.output
    assert set(changes(run.record["comparison"]).values()) == {"unchanged"}
    assert "May be merged as far as the chosen tests show (against " in run.sentence


def test_a_degree_about_a_horizontal_axis_is_worse_in_max_and_rms_over_eight_seeds(over_eight_seeds) -> None:
    assert over_eight_seeds.code == 21, over_eight_seeds.output
    summary = json.loads((over_eight_seeds.folder / "seeds.json").read_text(encoding="utf-8"))
    comparison = summary["comparison"]
    assert comparison["obstacles"] == []
    for name in ("heading.direct.max", "heading.direct.rms"):
        result = difference(comparison, name)
        assert (result["change"], result["seeds"]) == ("worse", 8)
        assert result["interval"][0] > 0
    assert "worse (2)\n  heading.direct.max " in over_eight_seeds.output
    last = over_eight_seeds.output.rstrip().splitlines()[-1]
    assert last.startswith("Not to be merged (against ")
    assert last.endswith(": REGRESSION.")
    assert "heading.direct.max " in last
    assert "heading.direct.rms " in last


def test_a_step_less_is_better_and_what_a_step_costs_is_not_missed(
    run_in, copy_of_the_firmware: FirmwareCopy, bench: Path
) -> None:
    suites = bench / "hil" / "suites"
    (suites / "test_compass.py").unlink()
    for name in ("conftest.py", "test_cycles.py"):
        shutil.copy(REPOSITORY / "hil" / "suites" / name, suites)
    new = copy_of_the_firmware.build(ONE_STEP_LESS, bench / "new.elf")
    run = run_in(bench, "--firmware", str(new), "--against", str(OLD))
    assert run.code == 0, run.output
    result = difference(run.record["comparison"], "cycles.corrected.per_iteration")
    assert (result["change"], result["new"], result["note"]) == (
        "changed",
        None,
        "not offered: it took 1 iteration, but the cost of one needs two",
    )
    assert difference(run.record["comparison"], "cycles.corrected.total")["change"] == "better"


@pytest.mark.parametrize("seeds", [(), ("--seeds", "1..1")], ids=" ".join)
def test_an_older_firmware_that_is_not_there_is_a_usage_error(run_in, bench: Path, seeds: tuple[str, ...]) -> None:
    run = run_in(bench, *seeds, "--against", "no-such.elf")
    assert run.code == 4, run.output
    assert "no-such.elf" in run.output + run.errors
    assert not (run.folder / "run.json").exists()
