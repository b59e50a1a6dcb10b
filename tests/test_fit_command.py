"""The command ``hiltest fit``: what it prints, writes and ends with."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from hiltest.procedures.golden_points import golden_points

from .calibration.hand_turned import hand_turned
from .in_process import hiltest
from .instances import instance

pytestmark = pytest.mark.slow


def fit(*arguments: str, folder: Path) -> subprocess.CompletedProcess[str]:
    return hiltest("fit", *arguments, folder=folder)


def _write(path: Path, points_ut: np.ndarray, header: str = "mx_uT,my_uT,mz_uT") -> None:
    rows = (",".join(f"{value:.1f}" for value in point) for point in points_ut)
    path.write_text("\n".join([header, *rows]) + "\n", encoding="utf-8")


@pytest.fixture
def clouds(tmp_path: Path) -> Path:
    """A folder with a good, a fair, a poor and a refused cloud, two with a defect, and a turn in a plane."""
    _write(tmp_path / "good.csv", golden_points(400) / 10.0)
    _write(tmp_path / "poor.csv", instance(1, 400, noise_ut=2.0, stretch=0.03, covered=(1, 1)).points_counts / 10.0)
    for name, covered, noise_ut in (("cap.csv", 0.05, 0.3), ("half.csv", 0.5, 0.5)):
        drawn = instance(1, 400, noise_ut=noise_ut, stretch=0.03, covered=(covered, covered))
        _write(tmp_path / name, drawn.points_counts / 10.0)
    turn = np.linspace(0.0, 2.0 * np.pi, 200)
    _write(tmp_path / "turn.csv", np.column_stack([21.0 * np.cos(turn) + 5.0, 20.0 * np.sin(turn), 0.0 * turn + 40.0]))
    wild, step = golden_points(400) / 10.0, hand_turned(2, 1600)
    wild[7] = 30_000.0, 0.0, 0.0
    step[800:] += 4.0
    _write(tmp_path / "wild.csv", wild)
    _write(tmp_path / "step.csv", step)
    return tmp_path


@pytest.mark.parametrize(
    ("file", "options", "code", "verdict"),
    [
        ("good.csv", [], 0, "good"),
        ("good.csv", ["--at-least", "good"], 0, "good"),
        ("poor.csv", [], 0, "poor"),
        ("poor.csv", ["--at-least", "good"], 1, "poor"),
        ("half.csv", ["--at-least", "fair"], 0, "fair"),
        ("half.csv", ["--at-least", "good"], 1, "fair"),
        ("poor.csv", ["--at-least", "fair"], 1, "poor"),
        ("cap.csv", [], 1, "refused"),
        ("turn.csv", [], 0, "fair"),
        ("turn.csv", ["--shape", "ellipsoid"], 1, "refused"),
        ("cap.csv", ["--shape", "sphere"], 1, "refused"),
        ("wild.csv", ["--at-least", "good"], 0, "good"),
        ("wild.csv", ["--robust", "none"], 1, "refused"),
        ("step.csv", [], 1, "refused"),
        ("step.csv", ["--at-least", "good", "--steady"], 0, "good"),
        ("step.csv", ["--at-least", "good", "--to", "700"], 0, "good"),
        ("step.csv", ["--at-least", "good", "--from", "900"], 0, "good"),
    ],
)
def test_the_exit_code_is_that_of_the_best_verdict(
    clouds: Path, file: str, options: list[str], code: int, verdict: str
) -> None:
    done = fit(file, "--on", "host", "--json", *options, folder=clouds)
    assert done.returncode == code, done.stderr
    assert json.loads(done.stdout)["verdict"] == verdict


def test_the_firmware_s_calibrators_are_run_and_their_cycles_counted(clouds: Path) -> None:
    done = fit("good.csv", "--json", folder=clouds)
    assert (done.returncode, done.stderr) == (0, "")
    content = json.loads(done.stdout)
    assert (content["on"], content["firmware"]["cycle_model"]) == ("virtual", "cortex-m4-trm/3@sram")
    assert {"direct", "iterative"} <= {each["name"] for each in content["calibrators"]}
    assert all(each["cycles"] > 0 and each["n_used"] == 400 for each in content["calibrators"])
    assert all(each["cycle_band"]["low"] < each["cycles"] for each in content["calibrators"])
    assert all(each["cycle_band"]["high"] > each["cycles"] for each in content["calibrators"])
    assert content["n_in"] == 400
    # Two runs, to the last bit: virtual time and the model of the core depend on nothing else.
    assert fit("good.csv", "--json", folder=clouds).stdout == done.stdout


def test_in_a_pipe_every_sentence_is_on_one_line(clouds: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("COLUMNS", raising=False)
    lines = fit("cap.csv", "--on", "host", folder=clouds).stdout.splitlines()
    (condition,) = {line for line in lines if "is above 300 (refused)" in line}
    assert condition.endswith("turn the sensor in all directions.")
    _write(clouds / "large.csv", 1000.0 * golden_points(400) + 1e6, "mx,my,mz")
    cells = fit("large.csv", "--on", "host", folder=clouds).stdout.splitlines()
    (hard_iron,) = [line for line in cells if "hard iron [counts]" in line]
    found = json.loads(fit("large.csv", "--on", "host", "--json", folder=clouds).stdout)
    (best,) = (each["hard_iron"] for each in found["calibrators"] if each["name"] == found["best"])
    shown = [float(word) for word in hard_iron.partition("] ")[2].partition(";")[0].split()]
    assert shown == [round(value) for value in best], "a radius of 4.8e5 has no decimals"


def test_a_terminal_of_80_columns_shows_it_whole_and_each_reason_once(
    clouds: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    said = fit("cap.csv", folder=clouds).stdout
    assert [line for line in said.splitlines() if len(line.rstrip()) > 80] == []
    assert "…" not in said
    assert said.count("the points cover too little of") == 1


def test_too_few_points_are_told_once(clouds: Path) -> None:
    _write(clouds / "three.csv", golden_points(400)[:3] / 10.0)
    assert "number of points 3 is below 10 (refused): " in fit("three.csv", "--on", "host", folder=clouds).stdout


def test_a_cloud_can_come_from_standard_input(clouds: Path) -> None:
    with (clouds / "good.csv").open() as file:
        done = subprocess.run(
            [sys.executable, "-m", "hiltest", "fit", "-", "--on", "host", "--json"],
            stdin=file,
            capture_output=True,
            text=True,
            check=False,
            timeout=120,
        )
    assert (done.returncode, json.loads(done.stdout)["n_in"]) == (0, 400), done.stderr


def test_exports_are_written_for_what_is_not_refused(clouds: Path) -> None:
    options = ["--on", "host", "--export-json", "c.json", "--export-header", "c.h"]
    assert fit("good.csv", *options, folder=clouds).returncode == 0
    assert json.loads((clouds / "c.json").read_text(encoding="utf-8"))["verdict"] == "good"
    assert "magnetometer_soft_iron[3][3]" in (clouds / "c.h").read_text(encoding="utf-8")


def test_a_current_is_taken_out_and_the_field_compared_with_the_model(tmp_path: Path) -> None:
    current = np.repeat(np.arange(1.0, 17.0), 25)
    rows = np.column_stack([hand_turned(1, 400) + np.outer(current, (0.6, -0.4, 0.2)), current])
    np.savetxt(tmp_path / "motor.csv", rows, fmt="%.2f", delimiter=",", header="mx_uT,my_uT,mz_uT,amps_A", comments="")
    options = ("--on", "host", "--with", "amps_A", "--at", "48.1,11.6,2026-05-01", "--json", "--at-least", "good")
    done = fit("motor.csv", *options, folder=tmp_path)
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    assert document["following"]["columns"][0]["name"] == "amps_A"
    assert document["following"]["explained_percent"] > 50.0
    # The model's strength in Munich (WMM-2025): 48.8 uT.
    assert "has 48.80 uT and a dip of 64.4 deg there" in " ".join(document["notes"])
    assert fit("motor.csv", "--on", "host", "--at", "48,11", folder=tmp_path).returncode == 4


def test_a_refused_calibration_is_not_exported(clouds: Path) -> None:
    options = ("--shape", "sphere", "--export-json", "c.json", "--export-header", "c.h")
    done = fit("cap.csv", "--on", "host", *options, folder=clouds)
    assert done.returncode == 1
    assert "refused: the calibration was not exported" in done.stderr
    assert not {"c.json", "c.h"} & {path.name for path in clouds.iterdir()}


def test_force_exports_a_refused_calibration_and_marks_it(clouds: Path) -> None:
    options = ("--force", "--export-json", "c.json", "--export-header", "c.h")
    done = fit("cap.csv", "--on", "host", "--shape", "sphere", *options, folder=clouds)
    assert done.returncode == 1
    assert json.loads((clouds / "c.json").read_text(encoding="utf-8"))["verdict"] == "refused"
    assert "#warning" in (clouds / "c.h").read_text(encoding="utf-8")
    assert "refused: exported anyway" in done.stderr


def test_force_has_nothing_to_export_without_a_calibration(clouds: Path) -> None:
    _write(clouds / "few.csv", golden_points(5) / 10.0)
    done = fit("few.csv", "--on", "host", "--force", "--export-header", "c.h", folder=clouds)
    assert done.returncode == 1
    assert "refused: no calibration exists to export" in done.stderr
    assert not (clouds / "c.h").exists()


def test_a_turn_in_a_plane_is_told_as_one_and_exported_as_one(clouds: Path) -> None:
    done = fit("turn.csv", "--export-header", "c.h", folder=clouds)
    said = " ".join(done.stdout.split())
    assert "iterative: condition" in said
    assert "ellipse: fitted by 'ellipse', not by 'ellipsoid' (fair): it corrects headings" in said
    assert "turned about an axis 0 deg off its z, by 358 deg" in said
    assert "cycles" not in said
    assert "for headings of a turn about z only" in (clouds / "c.h").read_text(encoding="utf-8")
    named = json.loads(fit("turn.csv", "--shape", "ellipse", "--json", folder=clouds).stdout)
    assert [(each["name"], each["turn"]["axis"]) for each in named["calibrators"]] == [("ellipse", "z")]


def test_a_log_of_two_axes_is_told_as_one_and_has_no_calibrator_of_three(clouds: Path) -> None:
    turn = np.linspace(0.0, 6.0 * np.pi, 200)
    _write(clouds / "flat.csv", np.column_stack([21.0 * np.cos(turn) + 5.0, 20.0 * np.sin(turn)]), "mx_uT,my_uT")
    content = json.loads(fit("flat.csv", "--on", "host", "--json", folder=clouds).stdout)
    assert (content["best"], content["verdict"]) == ("ellipse", "fair")
    assert [note for note in content["notes"] if "only mx_uT and my_uT" in note and "two axes" in note]
    done = fit("flat.csv", "--on", "host", "--calibrator", "direct", folder=clouds)
    assert done.returncode == 4
    assert "--calibrator direct needs three axes, and flat.csv has only mx_uT and my_uT" in done.stderr


def test_a_folder_of_logs_gets_a_row_each_and_the_worst_decides(clouds: Path) -> None:
    done = fit(".", folder=clouds)
    rows = {cells[0]: cells[2] for line in done.stdout.splitlines() if len(cells := line.split()) == 7}
    assert {rows[name] for name in ("good.csv", "wild.csv")} == {"good"}
    assert (rows["cap.csv"], rows["turn.csv"]) == ("refused", "fair")
    assert " cases, above 2.5 in " in done.stdout
    assert done.returncode == 1
    (clouds / "cap.csv").unlink()
    (clouds / "step.csv").unlink()
    assert fit(".", folder=clouds).returncode == 0
    assert fit(".", "--at-least", "good", folder=clouds).returncode == 1
    done = fit(".", "--json", folder=clouds)
    assert (done.returncode, "--json is for a single log" in done.stderr) == (4, True)
    (clouds / "empty").mkdir()
    done = fit("empty", folder=clouds)
    assert (done.returncode, "has no log of a magnetometer" in done.stderr) == (4, True)
