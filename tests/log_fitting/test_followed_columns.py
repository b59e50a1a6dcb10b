"""Columns that the hard iron follows: read, taken out, stated and exported."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hiltest.errors import ConfigError
from hiltest.log_fitting import read_samples
from hiltest.log_fitting.fit_result import SampleFit
from hiltest.log_fitting.followed_columns import subtract_followed
from hiltest.log_fitting.sample_fit import fit_on_host
from hiltest.log_fitting.sample_fit_exports import export_ardupilot, export_json

from ..calibration.hand_turned import TRUTH, hand_turned, lasting

_VECTOR = np.array([0.6, -0.4, 0.2])


def _log(path: Path, *, first_c: float = 20.0) -> Path:
    """Write a log of a motor whose current's iron is as large as the field's noise is small."""
    current = np.repeat(np.abs(np.random.default_rng(1).normal(6.0, 5.0, 30)), 40)
    rows = np.column_stack(
        [hand_turned(3, 1200) + np.outer(current, _VECTOR), current, np.linspace(first_c, 40.0, 1200)]
    )
    np.savetxt(
        path, rows, fmt="%.3f", delimiter=",", header="mx_uT,my_uT,mz_uT,current_A,temperature (degC)", comments=""
    )
    return path


def _fit(path: Path, column: str = "current_A") -> SampleFit:
    rest, following = subtract_followed(read_samples(path), [column])
    return replace(fit_on_host(rest, "direct"), following=following)


@pytest.mark.parametrize("column", ["current_A", "4"])
def test_the_calibration_is_that_of_the_readings_without_the_current(tmp_path: Path, column: str) -> None:
    fit = _fit(_log(tmp_path / "log.csv"), column)
    assert fit.following is not None
    (current,) = fit.following.columns
    assert (current.name, current.unit, current.reference) == ("current_A", "A", 0.0)
    assert np.linalg.norm(np.array(current.vector) - _VECTOR) < 2.5 * current.error
    np.testing.assert_allclose(fit.best.hard_iron, TRUTH.hard_iron, atol=0.3)
    assert fit.best.residual_percent == pytest.approx(fit.following.after_percent, rel=0.1)


@pytest.mark.ci
@pytest.mark.parametrize("unit", ["A", "degC"])
def test_the_vector_is_within_twice_its_stated_error_in_95_percent_of_50_logs(tmp_path: Path, unit: str) -> None:
    within = 0
    for seed in range(50):
        random = np.random.default_rng(seed)
        steps = np.repeat(np.abs(random.normal(6.0, 5.0, 30)), 40)
        followed = steps if unit == "A" else np.linspace(20.0, 40.0, 1200) + lasting(random, 1200, 5.0)[:, 0]
        vector = random.normal(0.0, {"A": 0.5, "degC": 0.2}[unit], 3)
        path = tmp_path / "log.csv"
        rows = np.column_stack([hand_turned(seed, 1200) + np.outer(followed, vector), followed])
        np.savetxt(path, rows, fmt="%.4f", delimiter=",", header=f"mx_uT,my_uT,mz_uT,followed [{unit}]", comments="")
        _, following = subtract_followed(read_samples(path), [f"followed [{unit}]"])
        (column,) = following.columns
        within += bool(np.linalg.norm(np.array(column.vector) - vector) <= 2.0 * column.error)
    assert within >= 48


def test_the_hard_iron_is_stated_at_the_mean_of_a_column_that_is_never_near_zero(tmp_path: Path) -> None:
    path = _log(tmp_path / "log.csv")
    _, following = subtract_followed(read_samples(path), ["current_A", "temperature (degC)"])
    current, warming = following.columns
    assert (current.reference, warming.reference, warming.unit) == (0.0, pytest.approx(30.0, abs=1e-3), "degC")


def test_readings_without_a_number_in_the_column_are_left_out(tmp_path: Path) -> None:
    path = _log(tmp_path / "log.csv")
    lines = path.read_text(encoding="utf-8").splitlines()
    lines[1:11] = [",".join([*line.split(",")[:3], "nan", "20"]) for line in lines[1:11]]
    path.write_text("\n".join(lines), encoding="utf-8")
    rest, _ = subtract_followed(read_samples(path), ["current_A"])
    assert len(rest.points) == 1190


@pytest.mark.parametrize(
    ("column", "complaint"), [("voltage", "--with: no column 'voltage'"), ("5", "does not change")]
)
def test_a_column_that_is_missing_or_constant_is_named(tmp_path: Path, column: str, complaint: str) -> None:
    path = _log(tmp_path / "log.csv", first_c=40.0)
    with pytest.raises(ConfigError, match=complaint):
        subtract_followed(read_samples(path), [column])


def test_ardupilot_s_formula_corrects_as_the_exported_json_does(tmp_path: Path) -> None:
    fit = _fit(_log(tmp_path / "log.csv"))
    export_json(fit, tmp_path / "calibration.json")
    export_ardupilot(fit, tmp_path / "calibration.param")
    content = json.loads((tmp_path / "calibration.json").read_text(encoding="utf-8"))
    lines = (tmp_path / "calibration.param").read_text(encoding="utf-8").splitlines()
    values = {name: float(value) for name, value in (line.split() for line in lines if line.startswith("COMPASS_"))}
    offset, diagonal, other, motor = (
        [values[f"COMPASS_{name}_{axis}"] for axis in "XYZ"] for name in ("OFS", "DIA", "ODI", "MOT")
    )
    x, y, z = other
    matrix = np.diag(diagonal) + np.array([[0.0, x, y], [x, 0.0, z], [y, z, 0.0]])
    reading_ut, current_a = np.array([12.0, -7.0, 31.0]), 9.0
    by_ardupilot_mg = matrix @ (10.0 * reading_ut + offset) + np.array(motor) * current_a
    (column,) = content["following"]
    moved = reading_ut - content["hard_iron"] - np.array(column["vector"]) * (current_a - column["reference"])
    # Six decimals of a parameter.
    np.testing.assert_allclose(by_ardupilot_mg / 10.0, np.array(content["soft_iron"]) @ moved, atol=1e-4)
    assert values["COMPASS_MOTCT"] == 2.0


def test_ardupilot_s_parameters_have_no_temperature(tmp_path: Path) -> None:
    fit = _fit(_log(tmp_path / "log.csv"), "5")
    with pytest.raises(ConfigError, match=r"one current or throttle; temperature \(degC\) is another"):
        export_ardupilot(fit, tmp_path / "calibration.param")
