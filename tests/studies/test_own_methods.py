"""A method of one's own takes part in every study: by a package's entry point, or in firmware."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from tests.command_files import run
from tests.instances import instance
from tests.own_package import WRONG

from hiltest.boards.bench import default_firmware
from hiltest.calibration import reference
from hiltest.calibration.fit import FitStatus
from hiltest.calibration.sphere import fit_sphere
from hiltest.errors import ConfigError
from hiltest.run_record.reader import read_record
from hiltest.run_record.run import Table
from hiltest.studies import NAMES
from hiltest.studies.board_calibrators import board_calibrators
from hiltest.studies.estimators import draw
from hiltest.studies.instances import Model, draw_instances

#: Studies that compare cycles or precisions of firmware, and have no use for a method without both.
OF_FIRMWARE = {"budget", "float32"}


pytestmark = pytest.mark.usefixtures("own_package")


def counts() -> np.ndarray:
    return draw_instances(Model(1, 60, 0.3), 0, 1).counts(0)


@pytest.mark.parametrize(("name", "centre"), [("sphere-fit", fit_sphere), ("middle", None)])
def test_a_package_s_function_or_class_is_a_calibrator_whose_corrected_points_have_length_1(
    name: str, centre: object
) -> None:
    points = counts()
    fit = reference(name)(points)
    expected = fit_sphere(points).hard_iron if centre else (points.min(axis=0) + points.max(axis=0)) / 2.0
    assert fit.hard_iron == pytest.approx(expected, rel=1e-6)
    assert np.linalg.norm(fit.corrected(points), axis=1).mean() == pytest.approx(1.0)


def test_numbers_that_are_not_finite_are_not_blamed_on_the_points_alone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    np.savetxt(tmp_path / "points.csv", counts() / 10.0, delimiter=",", header="x,y,z", comments="")
    assert run("fit", str(tmp_path / "points.csv"), "--calibrator", "endless", "--on", "host") == 1
    assert "numbers that are not finite" in " ".join(capsys.readouterr().out.split())


def test_the_output_of_a_calibrator_is_no_part_of_the_document(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    np.savetxt(tmp_path / "points.csv", counts() / 10.0, delimiter=",", header="x,y,z", comments="")
    run("fit", str(tmp_path / "points.csv"), "--calibrator", "loud", "--json")
    output, errors = capsys.readouterr()
    assert json.loads(output)["best"] == "loud"
    assert "iteration 1" in errors


def test_a_prediction_that_no_angle_can_have_is_stated_by_its_bound(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    drawn = instance(0, 30, noise_ut=2.0, covered=(0.2, 0.2))  # linear propagation predicts 600 deg
    np.savetxt(tmp_path / "far.csv", drawn.points_counts / 10.0, delimiter=",", header="x_uT,y_uT,z_uT", comments="")
    words = "fit", str(tmp_path / "far.csv"), "--calibrator", "middle"
    run(*words, "--json")
    (calibrator,) = json.loads(capsys.readouterr().out)["calibrators"]
    assert calibrator["radius"] is not None
    assert [calibrator[f"direction_{part}_deg"] for part in ("error", "spread", "bias")] == [None] * 3
    (reason,) = (reason for reason in calibrator["reasons"] if reason["figure"] == "direction_error_deg")
    assert (reason["value"], reason["verdict"]) == (30.0, "refused")
    run(*words, "--html", str(tmp_path / "far.html"))
    text = capsys.readouterr().out
    assert "direction error > 30 deg is above 5 deg (refused)" in text
    assert "> 30" in next(line for line in text.splitlines() if "direction error [deg]" in line)
    assert "&gt; 30<" in (tmp_path / "far.html").read_text(encoding="utf-8")


def test_a_name_that_hiltest_and_a_package_have_is_refused_if_it_is_requested(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    np.savetxt(tmp_path / "points.csv", counts() / 10.0, delimiter=",", header="x,y,z", comments="")
    requests = ("fit", str(tmp_path / "points.csv")), ("study", "estimators", "--out", str(tmp_path / "out"))
    for words in requests:
        assert run(*words, "--calibrator", "direct") == 4
        assert "direct: hiltest and an installed package (spin_sphere:never) have one" in capsys.readouterr().err
    assert reference("direct")(counts()).status is FitStatus.ELLIPSOID


def test_the_study_of_estimators_names_draws_and_measures_what_was_requested(tmp_path: Path) -> None:
    words = ("study", "estimators", "--instances", "2", "--jobs", "1", "--out", str(tmp_path))
    assert run(*words, "--calibrator", "never", "--calibrator", "merayo") == 0
    record = read_record(tmp_path).run
    assert "never " in record.verdict.sentence
    assert "refuses 100 % of the instances" in record.verdict.sentence
    assert "study.estimators.never.median" in {measurement.name for measurement in record.measurements}
    names = {"never", "merayo", record.verdict.sentence.partition(" points, ")[2].split()[0]}
    (table,) = (table for table in record.tables if table.name == "study.estimators")
    drawn = draw(record, table)
    assert names <= {entry.text for entry in drawn.key}
    assert len({(entry.line, entry.mark) for entry in drawn.key}) == len(drawn.key) > 8


@pytest.mark.parametrize(("name", "status"), [("never", "refused"), ("mirrored", "mirrored"), ("endless", "singular")])
def test_a_refusal_a_reflection_and_numbers_without_an_end_are_told_apart(
    name: str, status: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    np.savetxt(tmp_path / "points.csv", counts() / 10.0, delimiter=",", header="x,y,z", comments="")
    assert run("fit", str(tmp_path / "points.csv"), "--calibrator", name, "--json") == 1
    (calibrator,) = json.loads(capsys.readouterr().out)["calibrators"]
    assert (calibrator["status"], calibrator["radius"]) == (status, None)


@pytest.mark.parametrize(
    ("name", "fault"),
    [
        ("broken", "raises LookupError: 'no table'|raises LookupError: no table"),
        ("shapeless", r"return hard_iron of shape \(3,\)"),
        ("absent", "cannot be loaded, AttributeError"),
        ("unimportable", "cannot be loaded, ModuleNotFoundError"),
        ("nothing", "is no function"),
    ],
)
def test_an_error_of_a_package_names_its_distribution(name: str, fault: str) -> None:
    place = WRONG.get(name, f"spin_sphere:{name}")
    with pytest.raises(ConfigError, match=rf"^the calibrator {name} of spin-sphere 1.2 \({place}\) .*({fault})"):
        reference(name)(counts())


def table_of(name: str, folder: Path, *words: str) -> Table:
    """Run a small study, and return its table."""
    assert run("study", name, "--instances", "2", "--jobs", "1", "--out", str(folder), *words) == 0
    table = read_record(folder).run.table(f"study.{name}")
    assert table is not None
    return table


def rows_of(table: Table, method: str) -> list[tuple[object, ...]]:
    """Return the rows of a method, without its name."""
    named = [row for row in table.rows if any(str(cell).partition(",")[0] == method for cell in row)]
    return [tuple(cell for cell in row if not isinstance(cell, str)) for row in named]


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] * (name in ("budget", "float32"))) for name in NAMES]
)
def test_every_study_has_rows_of_a_method_of_one_s_own(name: str, tmp_path: Path) -> None:
    elf = tmp_path / "mine.elf"
    elf.write_bytes(default_firmware().read_bytes())
    words = [] if name in OF_FIRMWARE else ["--calibrator", "sphere-fit"]
    table = table_of(name, tmp_path / "out", "--firmware", str(elf), *words)
    in_elf = f"{elf}:direct"
    assert rows_of(table, in_elf)
    if name in ("budget", "choose", "float32"):  # the packaged firmware is this file
        assert rows_of(table, in_elf) == rows_of(table, "direct")
    if name not in OF_FIRMWARE:
        assert rows_of(table, "sphere-fit")
        assert rows_of(table, "sphere-fit") != rows_of(table, in_elf)
    page = (tmp_path / "out" / "study.html").read_text(encoding="utf-8")
    assert "mine.elf:direct" in page


def test_a_sphere_errs_like_the_study_s_own_sphere(tmp_path: Path) -> None:
    table = table_of("estimators", tmp_path / "out", "--calibrator", "sphere-fit")
    for own_row, row in zip(rows_of(table, "sphere-fit"), rows_of(table, "sphere"), strict=True):
        assert own_row[4] == pytest.approx(row[4], rel=1e-5)


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["budget", "--calibrator", "sphere-fit"], "sphere-fit"),
        (["float32", "--calibrator", "sphere-fit"], "sphere-fit"),
        (["estimators", "--calibrator", "sphere-fi"], "did you mean 'sphere-fit'?"),
        (["estimators", "--calibrator", "broken"], "broken of spin-sphere 1.2"),
    ],
)
def test_a_method_that_a_study_cannot_run_is_named(
    words: list[str], named: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("study", *words, "--instances", "1", "--jobs", "1", "--out", str(tmp_path)) == 4
    assert named in capsys.readouterr().err


def test_firmware_without_calibrators_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    elf = default_firmware().with_name("compass-lines.elf")
    assert not board_calibrators(elf).names
    assert run("study", "choose", "--firmware", str(elf), "--instances", "1", "--out", str(tmp_path)) == 4
    assert f"{elf} has no table of calibrators" in capsys.readouterr().err
