"""The page about calibration files: its commands run, its tables are the program's."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
from tests.finished_run import run_module

from hiltest.procedures.imu_calibration import AccelerometerPart, GyroscopePart, MagnetometerPart
from hiltest.procedures.imu_calibration.calibration_file import load_calibration
from hiltest.procedures.imu_calibration.contents import ACCELEROMETER_UNITS, GYROSCOPE_UNITS, MAGNETOMETER_UNITS, SCHEMA
from hiltest.run_record.reader import read_record

PAGE = (Path(__file__).parents[2] / "docs" / "calibrate.md").read_text(encoding="utf-8")
(COMMANDS,) = re.findall(r"^```sh\n(.*?)^```", PAGE, re.M | re.S)
PARTS = {
    "accelerometer": (AccelerometerPart, ACCELEROMETER_UNITS),
    "gyroscope": (GyroscopePart, GYROSCOPE_UNITS),
    "magnetometer": (MagnetometerPart, MAGNETOMETER_UNITS),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where a reader has run the page's commands."""
    path = tmp_path_factory.mktemp("reader")
    for command in COMMANDS.splitlines():
        done = run_module(*shlex.split(command), folder=path)
        assert done.returncode == 0, done.stdout + done.stderr
    return path


def test_the_commands_leave_what_the_page_says(folder: Path) -> None:
    assert (folder / "imu_calibration.h").is_file()
    file = load_calibration(folder / "imu_calibration.json")
    run = read_record(folder / "hil-out" / "run.json").run
    assert run.calibration is not None
    assert (run.calibration.sha256, run.calibration.made_utc) == (file.sha256, file.calibration.made_utc)


def test_every_measurement_of_the_table_is_made_and_judged(folder: Path) -> None:
    rows = re.findall(r"^\| (`\S+\.calibration\..*?) \| ", PAGE, re.M)
    assert len(rows) > 2
    run = read_record(folder / "hil-out" / "run.json").run
    for row in rows:
        first, *others = re.findall(r"`(\S+?)`", row)
        for name in (first, *(first.rpartition(".")[0] + other for other in others)):
            measured = run.measurement(name)
            assert measured is not None, name
            assert measured.limit is not None, name


def test_formulas_and_units_are_those_of_the_file() -> None:
    assert f"`{SCHEMA}`" in PAGE
    rows = dict(re.findall(r"^\| `(\w+)` \| (.*) \|$", PAGE, re.M))
    assert rows.keys() == PARTS.keys()
    for name, (part, units) in PARTS.items():
        formula, listed = rows[name].split(" | ")
        assert formula.strip("`") in str(part.__annotations__["formula"])
        matches = dict(re.findall(r"`(\w+)` (\S+?)(?:, |$)", listed))
        assert matches == {slot: getattr(units, slot) for slot in units.__slots__}
