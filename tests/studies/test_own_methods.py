"""A method of one's own takes part in every study: by a package's entry point, in a file, or in firmware."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from tests.command_files import run
from tests.instances import instance
from tests.own_package import WRONG

from hiltest.boards.bench import default_firmware
from hiltest.calibration import reference
from hiltest.calibration.acceptance import Acceptance
from hiltest.calibration.fit import FitStatus
from hiltest.calibration.sphere import fit_sphere
from hiltest.errors import ConfigError
from hiltest.judge.build import header_folder
from hiltest.run_record.reader import read_record
from hiltest.run_record.run import Table
from hiltest.studies import NAMES, compensation
from hiltest.studies.board_calibrators import board_calibrators
from hiltest.studies.estimators import draw
from hiltest.studies.instances import Model, draw_instances

#: Studies that compare cycles or precisions of firmware, and have no use for a method without both.
OF_FIRMWARE = {"budget", "float32"}


PYTHON = """
import numpy as np


def sphere(samples):
    rows = np.column_stack([2.0 * samples, np.ones(len(samples))])
    return np.linalg.lstsq(rows, (samples**2).sum(axis=1), rcond=None)[0][:3], np.eye(3)


def pairs(samples, accelerations):
    return samples[0], np.eye(3)


def raises(samples):
    raise LookupError("no table")
"""


pytestmark = pytest.mark.usefixtures("own_package")


@pytest.fixture
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Change to a folder with Python functions, the template in C, and points."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text(PYTHON, encoding="utf-8")
    (tmp_path / "mine.c").write_text((header_folder() / "template.c").read_text(encoding="utf-8"), encoding="utf-8")
    np.savetxt(tmp_path / "points.csv", counts() / 10.0, delimiter=",", header="x_uT,y_uT,z_uT", comments="")
    return tmp_path


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
def test_every_study_has_rows_of_a_method_of_one_s_own(
    name: str, files: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    elf = tmp_path / "mine.elf"
    elf.write_bytes(default_firmware().read_bytes())
    words = [] if name in OF_FIRMWARE else ["--calibrator", "sphere-fit", "--calibrator", "mine.py:sphere"]
    table = table_of(name, tmp_path / "out", "--firmware", str(elf), *words)
    in_elf = f"{elf}:direct"
    if name == "choose":  # the packaged firmware is this file, and equal calibrators have one row
        in_elf = f"direct = {in_elf}"
    assert rows_of(table, in_elf)
    lines = capsys.readouterr().out.splitlines()
    assert len([line for line in lines if line.startswith((f"{in_elf}: ", f"{in_elf},"))]) == len(
        rows_of(table, in_elf)
    )
    if name in ("budget", "float32"):
        assert rows_of(table, in_elf) == rows_of(table, "direct")
    if name not in OF_FIRMWARE:
        assert [line for line in lines if line.startswith("sphere-fit")]
        assert rows_of(table, "sphere-fit")
        assert rows_of(table, "sphere-fit") != rows_of(table, in_elf)
        for row, other in zip(rows_of(table, "mine.py:sphere"), rows_of(table, "sphere-fit"), strict=True):
            # The function gets its samples as float32; a fit of noise alone multiplies this.
            numbers, expected = ([cell for cell in cells if cell is not None] for cells in (row, other))
            assert numbers == pytest.approx(expected, rel=1e-2, abs=1e-2)
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
        (["budget", "--calibrator", "mine.py:sphere"], "not mine.py:sphere"),
        (["estimators", "--calibrator", "mine.py"], "name its function, too: mine.py:calibrate"),
        (["estimators", "--calibrator", "mine.py:pairs"], "takes accelerations, too"),
        (["estimators", "--calibrator", "mine.py:raises"], "mine.py:raises fails with 100 samples: LookupError"),
        (["estimators", "--calibrator", "gone.py:sphere"], "gone.py: No such file"),
    ],
)
def test_a_method_that_a_study_cannot_run_is_named(
    words: list[str], named: str, files: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("study", *words, "--instances", "1", "--jobs", "1", "--out", "out") == 4
    assert named in capsys.readouterr().err


def test_a_function_in_c_has_cycles_that_can_be_chosen(files: Path, require_tool: Callable[[str], str]) -> None:
    require_tool("arm-none-eabi-gcc")
    table = table_of("choose", files / "out", "--calibrator", "mine.c:calibrate", "--calibrator", "mine.py:sphere")
    assert rows_of(table, "mine.c:calibrate")[0][-2] == pytest.approx(4875, rel=0.01), "as hiltest judge counts"
    assert rows_of(table, "mine.py:sphere")[0][-2] is None


def test_several_calibrators_of_a_log_have_a_line_each(
    files: Path, capsys: pytest.CaptureFixture[str], require_tool: Callable[[str], str]
) -> None:
    require_tool("arm-none-eabi-gcc")
    names = ["mine.c:calibrate", "corrected", "mine.py:sphere", "sphere-fit"]
    words = [word for name in [*names, "corrected"] for word in ("--calibrator", name)]
    assert run("fit", "points.csv", *words) == 0
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert [line[0] for line in lines if line[1:2] and line[1] in set(Acceptance)] == names
    run("fit", "points.csv", *words, "--json")
    fits = {fit["name"]: fit for fit in json.loads(capsys.readouterr().out)["calibrators"]}
    assert list(fits) == names
    assert fits["mine.py:sphere"]["hard_iron"] == pytest.approx(fits["sphere-fit"]["hard_iron"], rel=1e-4)
    assert fits["corrected"]["cycles"] > 0
    low, high = counts().min(axis=0), counts().max(axis=0)
    assert fits["mine.c:calibrate"]["hard_iron"] == pytest.approx((low + high) / 20.0, rel=1e-5), "the template's"


def test_a_function_on_the_core_gets_points_that_its_memory_holds(
    files: Path, capsys: pytest.CaptureFixture[str], require_tool: Callable[[str], str]
) -> None:
    require_tool("arm-none-eabi-gcc")
    many = draw_instances(Model(1, 20_000, 0.3), 0, 1).points_ut[0]
    np.savetxt(files / "many.csv", many, delimiter=",", header="x_uT,y_uT,z_uT", comments="")
    words = ["--calibrator", "mine.c:calibrate", "--calibrator", "mine.py:sphere", "--json"]
    run("fit", "many.csv", *words)
    fits = json.loads(capsys.readouterr().out)["calibrators"]
    assert [fit["n_used"] for fit in fits] == [1000, 20_000]


def test_equal_calibrators_are_not_the_next_best_of_each_other(tmp_path: Path) -> None:
    words = ["study", "choose", "--firmware", str(default_firmware()), "--instances", "72", "--points", "20"]
    assert run(*words, "--jobs", "2", "--out", str(tmp_path)) == 0
    record = read_record(tmp_path).run
    (table,) = (table for table in record.tables if table.name == "study.choose")
    assert len(table.rows) == len(board_calibrators().names)
    assert record.verdict.sentence.count(f"{default_firmware()}:") == 2, "of the recommended one and the next"


def test_the_axis_of_compensation_includes_a_method_that_makes_offsets_larger(tmp_path: Path, files: Path) -> None:
    (files / "far.py").write_text(
        "def far(samples):\n    return [400.0, 400.0, 400.0], [[1, 0, 0], [0, 1, 0], [0, 0, 1]]\n", encoding="utf-8"
    )
    table = table_of("compensation", tmp_path / "out", "--calibrator", "far.py:far")
    least = min(float(str(row[2])) for row in table.rows if row[7] == "far.py:far")
    assert least < 0.0
    assert compensation.draw(read_record(tmp_path / "out").run, table).y_range[0] <= least


def test_firmware_without_calibrators_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    elf = default_firmware().with_name("compass-lines.elf")
    assert not board_calibrators(elf).names
    assert run("study", "choose", "--firmware", str(elf), "--instances", "1", "--out", str(tmp_path)) == 4
    assert f"{elf} has no table of calibrators" in capsys.readouterr().err
