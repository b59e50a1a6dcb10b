"""Firmware that speaks its own language: the part of it that makes a wrong heading is named."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from hiltest.angles import wrap_180, wrap_360
from hiltest.measurement import Limit, Measurement, check
from hiltest.record.run import Column, Table
from hiltest.verdict.causes import Cause
from hiltest.verdict.diagnosis import diagnose_run

REFERENCE = [heading + 1.7 for heading in range(0, 360, 30)]


def measured(**values: float) -> list[Measurement]:
    units = {"bias_error": "dps", "offset_error": "uT", "unsettled": ""}
    return [
        check(name.replace("__", "."), value, unit=units.get(name.rpartition("__")[2], "deg"),
              limit=Limit(max=2.0) if name == "heading__firmware__max" else None)
        for name, value in values.items()
    ]  # fmt: skip


def poses(answer: Callable[[float], float]) -> dict[str, Table]:
    rows = tuple((reference, wrap_360(answer(reference))) for reference in REFERENCE)
    columns = Column("reference", "deg"), Column("answered.firmware", "deg")
    return {"heading.poses": Table("heading.poses", columns, rows)}


def cause(answer: Callable[[float], float], **values: float) -> tuple[Cause, str]:
    worst = max(abs(wrap_180(answer(each) - each)) for each in REFERENCE)
    found = diagnose_run(
        ["firmware"], measured(heading__firmware__max=worst, **values), poses(answer), is_broken=False
    )
    return (found["firmware"].cause, found["firmware"].words) if found else (Cause.NONE, "")


def test_a_filter_that_lags_behind_a_right_calibration() -> None:
    found, words = cause(
        lambda reference: reference + 4.0, heading__calibrated__max=0.8, heading__ecompass__max=0.9,
        device__unsettled=0.0, gyroscope__firmware__bias_error=1.36,
    )
    assert found is Cause.FILTER
    assert words == "its filter (calibration right (0.80 deg), gyroscope offset wrong by 1.36 dps)"


def test_headings_that_still_move_are_not_settled_and_not_wrong() -> None:
    found, words = cause(lambda reference: reference + 4.0, heading__calibrated__max=0.8, device__unsettled=7.0)
    assert found is Cause.NOT_SETTLED
    assert words == "filter not settled (calibration right (0.80 deg), not settled at 7 known angles)"


def test_a_calibration_that_is_wrong_itself() -> None:
    found, words = cause(
        lambda reference: reference + 4.0, heading__calibrated__max=3.9, heading__ecompass__max=4.1,
        fit__firmware__offset_error=2.5, fit__firmware__rotation_left=0.2,
    )
    assert found is Cause.OWN_CALIBRATION
    assert "alone errs by 3.90 deg" in words
    assert "hard iron wrong by 2.50 uT" in words


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        (lambda reference: -reference, "counterclockwise from north"),
        (lambda reference: 90.0 - reference + 1.5, "counterclockwise from east"),
        (lambda reference: reference - 90.0, "clockwise from east"),
        (lambda reference: reference + 180.0, "clockwise from south"),
    ],
)
def test_a_frame_that_is_declared_wrong_is_named(answer: Callable[[float], float], words: str) -> None:
    found, said = cause(answer, heading__calibrated__max=0.8)
    assert found is Cause.FRAME
    assert f"grow {words}" in said


def test_an_error_that_no_frame_explains_is_no_frame() -> None:
    found, _ = cause(lambda reference: 45.0, heading__calibrated__max=0.8)
    assert found is Cause.FILTER


def test_a_heading_within_its_limit_has_no_cause() -> None:
    assert cause(lambda reference: reference + 1.0, heading__calibrated__max=5.0) == (Cause.NONE, "")
