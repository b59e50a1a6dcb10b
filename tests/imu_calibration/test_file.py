"""A calibration file: what is written is read, and everything else is refused in a sentence."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hiltest.errors import ConfigError
from hiltest.procedures.imu_calibration import ImuCalibration
from hiltest.procedures.imu_calibration.calibration_file import load_calibration, to_json
from hiltest.procedures.imu_calibration.contents import MICROTESLA_PER_COUNT

COUNTS = st.floats(-32768.0, 32767.0)
Refusal = Callable[[str | bytes], str]


@pytest.fixture
def refusal(tmp_path: Path) -> Refusal:
    """Return a function that writes a file and returns why it is refused."""

    def refused(content: str | bytes) -> str:
        path = tmp_path / "calibration.json"
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        with pytest.raises(ConfigError) as caught:
            load_calibration(path)
        text = str(caught.value)
        assert text.startswith(f"{path}: ")
        assert "hiltest calibrate" in text  # every one says what to do
        return text.removeprefix(f"{path}: ")

    return refused


def changed(calibration: ImuCalibration, place: str, value: object) -> str:
    """Return the text of a file with another value at a dotted place."""
    content: dict[str, Any] = json.loads(to_json(calibration))
    *parents, last = place.split(".")
    target: Any = content
    for step in parents:
        target = target[int(step)] if isinstance(target, list) else target[step]
    target[int(last) if isinstance(target, list) else last] = value
    return json.dumps(content)


def test_what_is_written_is_read(calibration: ImuCalibration, tmp_path: Path) -> None:
    path = tmp_path / "calibration.json"
    path.write_text(to_json(calibration), encoding="utf-8")
    assert load_calibration(path).calibration == calibration


@given(hard_iron=st.tuples(COUNTS, COUNTS, COUNTS))
@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_every_digit_of_a_number_survives(
    calibration: ImuCalibration, tmp_path: Path, hard_iron: tuple[float, float, float]
) -> None:
    x, y, z = (MICROTESLA_PER_COUNT * item for item in hard_iron)
    other = replace(
        calibration, magnetometer=replace(calibration.magnetometer, hard_iron=hard_iron, hard_iron_ut=(x, y, z))
    )
    path = tmp_path / "calibration.json"
    path.write_text(to_json(other), encoding="utf-8")
    assert load_calibration(path).calibration == other


def test_a_sensor_that_was_not_calibrated_is_null(calibration: ImuCalibration, tmp_path: Path) -> None:
    path = tmp_path / "calibration.json"
    path.write_text(to_json(replace(calibration, accelerometer=None, gyroscope=None)), encoding="utf-8")
    assert load_calibration(path).calibration.accelerometer is None


@pytest.mark.parametrize(
    ("place", "other", "right"),
    [
        ("magnetometer.units.soft_iron", "1/uT", "1/count"),
        ("magnetometer.units.hard_iron", "uT", "count"),
        ("magnetometer.units.hard_iron_ut", "nT", "uT"),
        ("accelerometer.units.gain", "m/s^2/count", "g/count"),
        ("accelerometer.units.offset", "g", "count"),
        ("gyroscope.units.matrix", "rad/s/count", "dps/count"),
        ("gyroscope.units.bias", "dps", "count"),
        ("frame", "body: x forward, y left, z up; accelerometer counts are gravity-positive", "body: x forward, y ri"),
        ("magnetometer.formula", "unit_field = soft_iron * counts - hard_iron", "unit_field = soft_iron * (counts -"),
    ],
)
def test_another_unit_frame_or_formula_is_refused_and_nothing_is_converted(
    calibration: ImuCalibration, refusal: Refusal, place: str, other: str, right: str
) -> None:
    answer = refusal(changed(calibration, place, other))
    assert answer.startswith(f"{place}: input should be '{right}")
    assert json.dumps(other)[:50] in answer
    assert "nothing is converted" in answer


@pytest.mark.parametrize("unit", ["soft_iron", "hard_iron", "hard_iron_ut"])
def test_a_unit_that_is_not_said_is_not_assumed(calibration: ImuCalibration, refusal: Refusal, unit: str) -> None:
    content = json.loads(to_json(calibration))
    del content["magnetometer"]["units"][unit]
    assert refusal(json.dumps(content)).startswith(f"magnetometer.units.{unit} is missing")


def test_counts_and_microtesla_that_contradict_each_other_are_refused(
    calibration: ImuCalibration, refusal: Refusal
) -> None:
    answer = refusal(changed(calibration, "magnetometer.hard_iron", [2.4, -2.16, 3.99]))
    assert answer.startswith("magnetometer: hard_iron and hard_iron_ut contradict each other: 2.4 counts of 0.1 uT are")


@pytest.mark.parametrize(
    ("place", "matrix"),
    [
        ("magnetometer.soft_iron", [[2e-3, 0, 0], [0, 2e-3, 0], [0, 0, 0]]),
        ("magnetometer.soft_iron", [[2e-3, 0, 0], [2e-3, 0, 0], [0, 0, 2e-3]]),
        ("accelerometer.gain", [[1e-4, 1e-4, 0], [1e-4, 1e-4, 0], [0, 0, 1e-4]]),
        ("gyroscope.matrix", [[0, 0, 0], [0, 0, 0], [0, 0, 0]]),
    ],
)
def test_a_matrix_that_has_lost_an_axis_is_refused(
    calibration: ImuCalibration, refusal: Refusal, place: str, matrix: list[list[float]]
) -> None:
    part, name = place.split(".")
    assert refusal(changed(calibration, place, matrix)).startswith(f"{part}: {name} is singular")


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_what_is_no_number_is_refused(calibration: ImuCalibration, refusal: Refusal, value: float) -> None:
    assert "is not a number" in refusal(changed(calibration, "magnetometer.hard_iron.1", value))


@pytest.mark.parametrize("text", ["1e999", "-1e999", "1e39", "true", '"2.4"', "null", "[1]", "9" * 5000])
def test_what_is_no_float_of_the_board_is_refused(calibration: ImuCalibration, refusal: Refusal, text: str) -> None:
    written = changed(calibration, "gyroscope.bias.0", "HERE").replace('"HERE"', text)
    assert refusal(written)


@pytest.mark.parametrize(
    ("schema", "complaint"),
    [
        ("hiltest.imu-calibration/2", '"hiltest.imu-calibration/1"; use the version that wrote it'),
        ("hiltest.calibration/1", 'schema is "hiltest.calibration/1"'),
        (None, "schema is null"),
    ],
)
def test_another_schema_is_refused(
    calibration: ImuCalibration, refusal: Refusal, schema: str | None, complaint: str
) -> None:
    assert complaint in refusal(changed(calibration, "schema", schema))


def test_a_file_that_is_cut_short_is_refused_wherever_it_ends(calibration: ImuCalibration, refusal: Refusal) -> None:
    text = to_json(calibration).rstrip()
    for end in range(0, len(text), 37):
        assert refusal(text[:end]).startswith("not JSON")


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        (b"", "not JSON"),
        (b"\xff\xfe\x00", "not JSON"),
        (b"\x7fELF" + bytes(100), "not JSON"),
        (b"[]", "schema is null"),
        (b"3", "schema is null"),
        (b"[" * 100_000, "nested more than 32 levels deep, the budget of a calibration file"),
        (b'{"a":' * 100_000, "nested more than 32 levels deep"),
        (b" " * 1_000_001, "larger than 1000000 bytes"),
    ],
    ids=["empty", "not UTF-8", "binary", "list", "number", "deep list", "deep object", "large"],
)
def test_hostile_content_is_refused(refusal: Refusal, content: bytes, complaint: str) -> None:
    assert refusal(content).startswith(complaint)


def test_a_key_that_stands_twice_is_refused(calibration: ImuCalibration, refusal: Refusal) -> None:
    text = to_json(calibration).replace('"method": "direct"', '"method": "direct", "method": "iterative"')
    assert 'key "method" stands twice' in refusal(text)


def test_a_great_many_keys_are_refused_as_fast_as_they_are_read(refusal: Refusal) -> None:
    # 900 kB: were each key looked for among all others, it would take a minute and a half.
    text = "{" + ", ".join(f'"{key:x}": 0' for key in range(80_000)) + "}"
    assert refusal(text).startswith("schema is null")


def test_an_unknown_key_is_refused(calibration: ImuCalibration, refusal: Refusal) -> None:
    assert refusal(changed(calibration, "magnetometer.scale", 2.0)).startswith("unknown key magnetometer.scale")


@pytest.mark.parametrize(("place", "value"), [("made_utc", "yesterday"), ("made_on.unique_id", "K64F")])
def test_a_time_or_an_id_that_is_none_is_refused(
    calibration: ImuCalibration, refusal: Refusal, place: str, value: str
) -> None:
    assert repr(value) in refusal(changed(calibration, place, value))


def test_a_file_that_is_not_there_says_how_to_make_one(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"gone\.json: No such file.*hiltest calibrate"):
        load_calibration(tmp_path / "gone.json")
