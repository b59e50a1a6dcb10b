"""``hiltest calibrate`` makes a file, ``hiltest run --calibration`` judges it: a wrong number in it is a red run."""

from __future__ import annotations

import json
import re
import subprocess
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.finished_run import run_module

from hiltest.measurement import KINDS, Section, identify
from hiltest.rig.bench_files import rig_file
from hiltest.text import format_number

FILE = "imu_calibration.json"
TASKS_STACK = "firmware.{task}.stack_most"
Change = Callable[[dict[str, Any]], None]
# The suites that judge a file, on the level poses.
JUDGE = ("--poses", "level", "--", "-k", "calibration_file or heading_at_known_angles")
JUDGE_RATES = ("--", "-k", "rate_at_rest_under_the_file or test_turn_under_the_file or bias_is_gone")


def calibrate(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return run_module("hiltest", "calibrate", *arguments, folder=folder)


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the calibration of the virtual board, which asks nobody."""
    folder = tmp_path_factory.mktemp("calibrated")
    done = calibrate(folder)
    assert done.returncode == 0, done.stdout + done.stderr
    assert sorted(path.name for path in folder.iterdir()) == ["imu_calibration.h", "imu_calibration.html", FILE]
    return folder / FILE


def test_the_page_has_the_verdict_first_and_every_figure_of_the_file(calibrated: Path) -> None:
    page = calibrated.with_suffix(".html").read_text(encoding="utf-8").replace("\N{NO-BREAK SPACE}", " ")
    assert page.index("calibrated</strong></h1>") < page.index("<h2>")
    content = json.loads(calibrated.read_text(encoding="utf-8"))
    for sensor in ("magnetometer", "accelerometer", "gyroscope"):
        part = content[sensor]
        assert f"<h2>{part['sensor']}</h2>" in page
        assert f"By {part['method']}: " in page
        for figure in part["figures"]:
            assert f"<dt>{figure['name']}</dt><dd>{format_number(figure['value'])} {figure['unit']}</dd>" in page


@pytest.fixture(scope="module")
def judged(calibrated: Path, run_in, tmp_path_factory: pytest.TempPathFactory):
    """A run of the full set with the file: the run that measures every kind there is."""
    return run_in(tmp_path_factory.mktemp("judged"), "--suite", "full", "--calibration", str(calibrated))


@pytest.fixture(scope="module")
def listened_to(run_in, tmp_path_factory: pytest.TempPathFactory):
    """A run with firmware that is not asked, one of whose functions works in slices as far as the rig knows."""
    folder = tmp_path_factory.mktemp("listened-to")
    sliced = 'fit = { functions = ["magnetometer_direct"], ends = "background.changes", ends_bytes = 4 }'
    rig = rig_file(folder, "text-compass").read_text(encoding="utf-8")
    (folder / "mine.toml").write_text(rig.replace('fit = "magnetometer_direct"', sliced), encoding="utf-8")
    return run_in(folder, "--rig", "mine.toml", "--poses", "level")


def test_each_name_of_a_full_run_has_its_kind_and_each_kind_is_measured(judged, listened_to) -> None:
    measured = judged.measured | listened_to.measured
    kinds = {name: identify(name).kind for name in measured}
    assert [name for name, kind in kinds.items() if kind is None] == []
    # This firmware has no tasks; tests/virtual/test_stacks.py measures those of kernels. Nothing disturbs this bench's
    # field; tests/procedures/test_driving.py measures what does. The rig names no recorded motions;
    # test_recorded_motion.py measures their errors. Only fewest_poses counts its poses: test_fewest_poses.py.
    elsewhere = {Section.STUDIES, Section.DRIVING}
    of_runs = {name for name, kind in KINDS.items() if kind.section not in elsewhere} - {TASKS_STACK, "heading.poses"}
    of_runs -= {name for name in KINDS if name.startswith("fusion.recorded.")}
    assert of_runs - {kind.name for kind in kinds.values() if kind} == set()
    units = {name: item["unit"] for name, item in measured.items()}
    assert [name for name, kind in kinds.items() if kind and kind.unit not in (None, units[name])] == []


def test_the_file_is_judged_green_on_poses_that_it_is_not_made_of(judged, calibrated: Path) -> None:
    assert judged.code == 0, judged.output
    limits = {name: item["limit"] for name, item in judged.measured.items() if ".calibration." in name}
    assert {name for name, limit in limits.items() if limit} == {
        "heading.calibration.max",
        "heading.calibration.bias",
        "heading.calibration.max_centred",
        "accelerometer.calibration.norm_rms",
        "accelerometer.calibration.tilt_error",
        "gyroscope.calibration.bias_error",
        "gyroscope.calibration.turn_error",
        "gyroscope.calibration.largest_turn_error",
        "magnetometer.calibration.norm_rms",
    }
    assert re.search(r"^calibration +\d\.\d\d ", judged.output, re.MULTILINE)
    assert judged.record["calibration"]["file"] == str(calibrated)
    assert judged.record["calibration"]["sha256"] == sha256(calibrated.read_bytes()).hexdigest()


def test_without_the_option_nothing_is_said_of_a_file(good_run) -> None:
    assert good_run.record["calibration"] is None
    assert not any(".calibration." in name for name in good_run.measured)


def magnetometer(name: str, function: Callable[[np.ndarray], np.ndarray]) -> Change:
    """Change numbers of the magnetometer; microtesla follow the counts, or the file would contradict itself."""

    def change(content: dict[str, Any]) -> None:
        part = content["magnetometer"]
        part[name] = function(np.array(part[name])).tolist()
        part["hard_iron_ut"] = (0.1 * np.array(part["hard_iron"])).tolist()

    return change


def changed(part: str, name: str, function: Callable[[np.ndarray], np.ndarray]) -> Change:
    """Change numbers of a part."""

    def change(content: dict[str, Any]) -> None:
        content[part][name] = function(np.array(content[part][name])).tolist()

    return change


SWAPPED = [1, 0, 2]


@pytest.mark.parametrize(
    ("change", "red"),
    [
        (magnetometer("hard_iron", lambda counts: -counts), "heading.calibration.max"),
        (magnetometer("hard_iron", lambda counts: 0.1 * counts), "heading.calibration.max"),
        (magnetometer("hard_iron", lambda counts: counts[SWAPPED]), "heading.calibration.max"),
        (magnetometer("soft_iron", lambda matrix: -matrix), "heading.calibration.max"),
        (magnetometer("soft_iron", lambda matrix: matrix[SWAPPED]), "heading.calibration.max"),
        (magnetometer("soft_iron", lambda matrix: 10.0 * matrix), "magnetometer.calibration.norm_rms"),
        (changed("accelerometer", "offset", lambda counts: -counts), "accelerometer.calibration.norm_rms"),
        (changed("accelerometer", "gain", lambda matrix: -matrix), "heading.calibration.max"),
        (changed("accelerometer", "gain", lambda matrix: matrix[[2, 1, 0]]), "accelerometer.calibration.tilt_error"),
        (changed("accelerometer", "gain", lambda matrix: 9.81 * matrix), "accelerometer.calibration.norm_rms"),
        (changed("gyroscope", "matrix", lambda matrix: -matrix), "gyroscope.calibration.turn_error"),
        (changed("gyroscope", "matrix", lambda matrix: matrix[[2, 1, 0]]), "gyroscope.calibration.turn_error"),
        (changed("gyroscope", "matrix", lambda matrix: np.radians(matrix)), "gyroscope.calibration.turn_error"),
        (changed("gyroscope", "bias", lambda counts: -counts), "gyroscope.calibration.bias_error"),
        (changed("gyroscope", "bias", lambda counts: 0.0625 * counts), "gyroscope.calibration.bias_error"),
        (changed("gyroscope", "bias", lambda counts: counts[SWAPPED]), "gyroscope.calibration.bias_error"),
    ],
    ids=[
        "hard iron's sign",
        "hard iron in uT",
        "hard iron's axes",
        "soft iron's sign",
        "axes",
        "soft iron per uT",
        "offset's sign",
        "gravity's sign",
        "gravity's axes",
        "gravity in m/s2",
        "rate's sign",
        "rate's axes",
        "rate in rad/s",
        "bias' sign",
        "bias in deg per s",
        "bias' axes",
    ],
)
def test_a_wrong_sign_axis_or_unit_in_the_file_is_red(
    calibrated: Path, run_in, tmp_path: Path, change: Change, red: str
) -> None:
    content = json.loads(calibrated.read_text(encoding="utf-8"))
    change(content)
    (tmp_path / FILE).write_text(json.dumps(content), encoding="utf-8")
    of_rates = red.startswith("gyroscope")
    run = run_in(tmp_path, "--calibration", FILE, *(JUDGE_RATES if of_rates else JUDGE))
    assert run.code == 1, run.output
    assert run.measured[red]["outcome"] == "fail"
    # The board's own calibration is as good as ever: it is the file.
    assert run.measured["gyroscope.bias_error" if of_rates else "heading.direct.max"]["outcome"] == "pass"


@pytest.mark.parametrize(("calibrator", "outcome"), [("corrected", "fail"), ("dpi", "pass")])
def test_against_gravity_a_file_knows_the_rotation_that_norms_cannot_see(
    run_in, tmp_path: Path, calibrator: str, outcome: str
) -> None:
    rig = ("--rig", "virtual-k64f-rotated")
    result = calibrate(tmp_path, *rig, "--calibrator", calibrator)
    assert result.returncode == 0, result.stdout + result.stderr
    run = run_in(tmp_path, *rig, "--calibration", FILE, *JUDGE)
    # The bench's other calibrators are red there: it is for this that it ships.
    assert run.measured["heading.calibration.max"]["outcome"] == outcome


def test_a_gyroscope_whose_x_is_its_y_is_red_in_the_full_set(calibrated: Path, run_in, tmp_path: Path) -> None:
    content = json.loads(calibrated.read_text(encoding="utf-8"))
    changed("gyroscope", "matrix", lambda matrix: matrix[SWAPPED])(content)
    (tmp_path / FILE).write_text(json.dumps(content), encoding="utf-8")
    run = run_in(tmp_path, "--calibration", FILE, "--suite", "full", "--", "-k", "turn_under_the_file")
    assert run.code == 1, run.output
    assert run.measured["gyroscope.calibration.turn_error"]["outcome"] == "pass"
    assert run.measured["gyroscope.calibration.largest_turn_error"]["outcome"] == "fail"


def test_another_boards_file_ends_the_run_before_it_begins(calibrated: Path, run_in, tmp_path: Path) -> None:
    run = run_in(tmp_path, "--calibration", str(calibrated), "--rig", "virtual-k64f-rotated")
    assert run.code == 4
    assert "is not of this board: it was made in the world of rig 'virtual-k64f'" in run.errors
    assert not run.folder.exists() or not list(run.folder.iterdir())


def test_a_file_in_other_units_ends_the_run_before_it_begins(calibrated: Path, run_in, tmp_path: Path) -> None:
    text = calibrated.read_text(encoding="utf-8").replace('"hard_iron": "count"', '"hard_iron": "uT"')
    (tmp_path / FILE).write_text(text, encoding="utf-8")
    run = run_in(tmp_path, "--calibration", FILE)
    assert run.code == 4
    assert "magnetometer.units.hard_iron: input should be 'count', not \"uT\"; nothing is converted" in run.errors


@pytest.mark.parametrize(
    ("arguments", "code", "complaint"),
    [
        (["--calibrator", "perfect"], 4, "the firmware has no calibrator 'perfect'; it has "),
        (["--out", "gone/imu.json"], 4, "does not exist"),
        (["--out", "imu.h"], 4, "imu.h would be the C header or the page"),
        (["--rig", "virtual-k64f-harsh-cap"], 1, "magnetometer refused: "),
    ],
    ids=["calibrator", "folder", "header", "a fifth of the sphere"],
)
def test_what_supports_no_calibration_leaves_no_file(
    tmp_path: Path, arguments: list[str], code: int, complaint: str
) -> None:
    done = calibrate(tmp_path, *arguments)
    assert done.returncode == code, done.stdout + done.stderr
    assert complaint in done.stderr
    assert list(tmp_path.iterdir()) == []
