"""Firmware that reports by itself: the part of it that makes a wrong heading is named."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TypeAlias

import numpy as np
import pytest

from hiltest.measurement import Limit, Measurement, check
from hiltest.orientation.angles import Pose, rotation_body_from_ned, wrap_360
from hiltest.run_record.run import Column, Findings, Table
from hiltest.verdict.calibrators import calibrator_results
from hiltest.verdict.causes import Cause
from hiltest.verdict.diagnosis import NOTHING, Diagnosis, diagnose_run
from hiltest.verdict.reported_headings import costs_in_words, next_step
from hiltest.verdict.summary import summarise

Tables: TypeAlias = Mapping[str, Table]

LIMITS = {"heading.firmware.max": 2.0, "heading.ecompass.max": 5.0, "heading.calibrated.max": 5.0}


def measured(**values: float) -> list[Measurement]:
    units = {"bias_error": "dps", "offset_error": "uT", "unsettled": "", "unconfirmed": ""}
    limited = {name.replace("__", "."): value for name, value in values.items()}
    return [
        check(
            name,
            value,
            unit=units.get(name.rpartition(".")[2], "deg"),
            limit=Limit(max=LIMITS[name]) if name in LIMITS else None,
        )
        for name, value in limited.items()
    ]


def contradictions(**message: str) -> dict[str, Table]:
    name = "heading.contradictions"
    return {name: Table(name, (Column("of"), Column("said")), tuple(message.items()))}


def answers(error: Callable[[float], float], hard_iron_ut: Sequence[float] = (), *, has_vectors: bool = True) -> Tables:
    """Return the tables of level poses and poses with 20 degrees of roll, at which the heading has an error."""
    poses = [Pose(heading, 0.0, roll) for roll in (0.0, 20.0) for heading in np.arange(1.7, 360.0, 30.0).tolist()]
    rotations = np.array([rotation_body_from_ned(pose) for pose in poses])
    vectors = np.hstack([rotations @ np.array([22.8, 0.0, 42.8]), rotations @ np.array([0.0, 0.0, 1.0])])
    rows = [(pose.heading_deg, wrap_360(pose.heading_deg + error(pose.heading_deg))) for pose in poses]
    columns = [f"{vector}_{axis}" for vector in ("field", "gravity") for axis in "xyz"]
    return {
        "heading.poses": _table("heading.poses", ("reference", "answered.firmware"), rows),
        "heading.hard_iron": _table("heading.hard_iron", "xyz", [hard_iron_ut] if hard_iron_ut else []),
    } | ({"heading.known": _table("heading.known", columns, vectors.tolist())} if has_vectors else {})


def _table(name: str, columns: Sequence[str], rows: Sequence[Sequence[float | str]]) -> Table:
    return Table(name, tuple(map(Column, columns)), tuple(map(tuple, rows)))


def diagnosis(
    of: str = "firmware", said: dict[str, str] | None = None, tables: Tables | None = None, **values: float
) -> Diagnosis:
    measurements = measured(**values)
    names = [measurement.name.split(".")[1] for measurement in measurements if measurement.name.endswith(".max")]
    result = diagnose_run(names, measurements, contradictions(**(said or {})) | dict(tables or {}), is_broken=False)
    return result.get(of, NOTHING)


def cause(
    of: str = "firmware", said: dict[str, str] | None = None, tables: Tables | None = None, **values: float
) -> tuple[Cause, str]:
    result = diagnosis(of, said, tables, **values)
    return result.cause, result.words


def test_a_filter_that_lags_behind_a_right_calibration() -> None:
    result, words = cause(
        heading__firmware__max=4.0,
        heading__firmware__max_centred=0.3,
        heading__calibrated__max=0.8,
        heading__ecompass__max=0.9,
        device__unsettled=0.0,
        gyroscope__firmware__bias_error=1.36,
    )
    assert result is Cause.FILTER
    assert words == "its filter (calibration right (0.80 deg), gyroscope offset wrong by 1.36 dps)"


def test_headings_that_stick_out_of_those_beside_them_are_corrupt() -> None:
    values = {"heading__firmware__max": 14.0, "heading__calibrated__max": 0.8, "device__unconfirmed": 5.0}
    assert cause(**values)[0] is Cause.ISOLATED
    assert cause(**values | {"device__unconfirmed": 0.0})[0] is Cause.FILTER


def test_headings_in_radians_follow_the_board() -> None:
    tables = answers(lambda heading: np.radians(heading) - heading)
    result, words = cause("firmware", {"still": "they cover 5.2 deg"}, tables, heading__firmware__max=179.0)
    assert (result, words) == (Cause.KNOWN_BUG, "headings in radians")


def test_headings_that_still_move_are_not_settled_and_not_wrong() -> None:
    result, words = cause(
        heading__firmware__max=4.0,
        heading__firmware__max_centred=0.3,
        heading__ecompass__max=4.1,
        heading__calibrated__max=0.8,
        device__unsettled=7.0,
    )
    assert result is Cause.NOT_SETTLED
    assert words == "filter not settled (calibration right (0.80 deg), not settled at 7 known angles)"


def test_a_calibration_that_is_wrong_itself() -> None:
    result, words = cause(
        heading__firmware__max=4.0,
        heading__firmware__max_centred=3.9,
        heading__calibrated__max=3.9,
        heading__ecompass__max=4.1,
        fit__firmware__offset_error=2.5,
        fit__firmware__rotation_left=0.2,
    )
    assert result is Cause.OWN_CALIBRATION
    assert "alone errs by 3.90 deg" in words
    assert "hard iron wrong by 2.50 uT" in words


@pytest.mark.parametrize("has_vectors", [True, False])
@pytest.mark.parametrize(
    ("others", "details"),
    [
        ({}, ""),
        ({"heading__calibrated__max": 8.7}, "; its calibration alone errs by 8.70 deg"),
        ({"heading__calibrated__max": 0.4}, "; calibration right (0.40 deg)"),
    ],
)
def test_an_error_that_is_the_same_everywhere_is_an_offset(
    others: dict[str, float], details: str, has_vectors: bool
) -> None:
    tables = answers(lambda heading: -8.3, has_vectors=has_vectors)
    result = diagnosis(tables=tables, heading__firmware__max=8.7, **others)
    assert (result.cause, result.words) == (Cause.KNOWN_BUG, f"constant offset (-8.30 deg){details}")
    assert "declination" in result.advice


def test_bugs_behind_vectors_that_are_right_come_first() -> None:
    tables, level = answers(lambda heading: -2.0 * heading), slice(12)
    tables = {name: replace(table, rows=table.rows[level]) for name, table in tables.items()}
    assert "axes of the magnetometer" in cause(tables=tables, heading__firmware__max=170.0)[1]
    words = cause(tables=tables, heading__firmware__max=170.0, heading__calibrated__max=0.4)[1]
    assert words == "headings counted the other way; calibration right (0.40 deg)"


def test_the_hard_iron_that_the_firmware_reports_shows_how_often_it_was_subtracted() -> None:
    iron_ut = (2.4, -2.2, 4.0)

    def error(heading_deg: float) -> float:
        turn = np.radians(heading_deg)
        x, y = 22.8 * np.cos(turn) - iron_ut[0], -22.8 * np.sin(turn) - iron_ut[1]
        return float(np.degrees(np.arctan2(-y, x))) - heading_deg

    tables = answers(error, iron_ut)
    level = {name: replace(table, rows=table.rows[:12]) for name, table in tables.items()}
    words = cause(tables=level, heading__firmware__max=9.0)[1]
    assert words.startswith("hard iron subtracted twice")


def test_wrong_samples_come_before_every_bug_behind_them() -> None:
    samples = {"device.samples": _table("device.samples", ("words", "place"), [("the y axis stays", "the driver")])}
    tables = answers(lambda heading: -8.3) | samples
    result = diagnosis(tables=tables, heading__firmware__max=8.7)
    assert (result.cause, result.words, result.advice) == (Cause.SAMPLES, "the y axis stays", "Check the driver.")
    assert diagnose_run((), (), samples, is_broken=True)[""] == result
    frame = {"vectors": "in frame enu"}
    assert cause(said=frame, tables=tables, heading__firmware__max=8.7)[0] is Cause.FRAME


@pytest.mark.parametrize(
    ("iron_ut", "words"),
    [
        ((0.0, 0.0, 0.0), "it is 0: x 0.0 in place of 2.4"),
        ((2.4, 2.2, 4.0), "it has lost its sign"),
        ((-2.4, 2.2, -4.0), "it has the opposite sign"),
        ((48.9, 47.8, 48.2), "it is half of the difference"),
        ((4.8, -4.4, 8.0), "it is the sum of maximum and minimum"),
        ((-2.2, 2.4, 4.0), "its axes are exchanged"),
        ((2.5, -2.3, 4.2), ""),
        ((12.0, 8.0, -3.0), ""),
    ],
)
def test_a_wrong_hard_iron_is_described_by_the_readings_of_the_tumble(iron_ut: Sequence[float], words: str) -> None:
    centre, reach = np.array([2.4, -2.2, 4.0]), np.array([48.5, 47.5, 48.0])
    rows = [("minimum", *(centre - reach)), ("maximum", *(centre + reach)), ("centre", *centre)]
    tables = answers(lambda heading: 9.0 * np.sin(np.radians(heading)), iron_ut)
    field = {"device.tumble_field": _table("device.tumble_field", ("of", *"xyz"), rows)}
    result, found = cause(tables=tables | field, heading__firmware__max=9.0, heading__calibrated__max=9.0)
    assert (result is Cause.HARD_IRON) == bool(words)
    assert words in found


def test_a_filter_that_may_lag_hides_further_bugs() -> None:
    values = {"heading__firmware__max": 8.7, "heading__calibrated__max": 0.4}
    tables = answers(lambda heading: -8.3)
    assert cause(tables=tables, device__unsettled=3.0, **values)[0] is Cause.NOT_SETTLED
    assert cause(tables=tables, gyroscope__firmware__bias_error=1.4, **values)[0] is Cause.FILTER


def test_a_convention_that_is_declared_wrong_is_named() -> None:
    result, words = cause(
        said={"heading": "they grow the other way"}, heading__firmware__max=177.0, heading__calibrated__max=0.8
    )
    assert (result, words) == (Cause.FRAME, "another frame than the declared one (they grow the other way)")


def test_a_frame_of_vectors_and_of_headings_is_one_cause() -> None:
    values = {"heading__firmware__max": 177.0, "heading__ecompass__max": 153.0, "heading__calibrated__max": 153.0}
    messages = {"heading": "they grow the other way", "vectors": "in frame ned"}
    assert {cause(of, messages, **values) for of in ("firmware", "ecompass", "calibrated")} == {
        (Cause.FRAME, "another frame than the declared one (in frame ned)")
    }


def test_vectors_in_another_frame_are_named_beside_a_right_heading() -> None:
    values = {"heading__firmware__max": 0.4, "heading__ecompass__max": 153.0}
    assert cause("ecompass", {"vectors": "in frame ned"}, **values)[0] is Cause.FRAME
    assert cause("ecompass", {}, **values)[0] is Cause.NOT_TOGETHER
    assert cause("firmware", {}, **values)[0] is Cause.NONE


def test_a_heading_that_does_not_follow_the_board_is_named_before_all_else() -> None:
    result, words = cause(said={"still": "they cover 0.0 deg"}, heading__firmware__max=178.0, device__unsettled=3.0)
    assert (result, words) == (Cause.STILL, "a heading that does not follow the board (they cover 0.0 deg)")


def test_a_heading_within_its_limit_has_no_cause() -> None:
    assert cause(heading__firmware__max=1.0, heading__calibrated__max=4.9) == (Cause.NONE, "")


def test_angles_that_are_exchanged_are_no_matter_of_the_accelerometer(findings: Callable[..., Findings]) -> None:
    wrong = check("accelerometer.tilt_error", 20.1, unit="deg", limit=Limit(max=0.5))
    assert "accelerometer" in next_step(wrong, {})
    assert next_step(wrong, contradictions(heading="they grow the other way")) == next_step(wrong, {})
    step = next_step(wrong, contradictions(tilt="right within 0.1 deg with pitch and roll exchanged"))
    assert step.startswith("Declare pitch and roll so under [device] in the rig")
    run = findings(wrong)
    run.tables.update(contradictions(tilt="right within 0.1 deg with pitch and roll exchanged"))
    assert summarise(run).advice == (step,)


def costs(*counted: Measurement) -> str:
    headings = measured(
        heading__firmware__max=0.8, heading__calibrated__max=0.7, heading__direct__max=0.4, heading__iterative__max=0.4
    )
    return costs_in_words(calibrator_results((*headings, *counted)))


def total(name: str, cycles: int, note: str, case: str = "total") -> Measurement:
    return check(f"cycles.{name}.{case}", cycles, unit="cycle", cycle_model="m", note=note)


def test_the_firmwares_own_fit_stands_beside_the_cheapest_of_the_same_samples() -> None:
    own, direct = total("calibrated", 510_956, "fit-10 in 688 slices"), total("direct", 34_953, "the same 360 samples")
    iterative = total("iterative", 96_260, "the same 360 samples")
    flash = total("calibrated", 633_000, "the same slices", "from_flash")
    assert costs(own, iterative, direct, flash) == (
        "Its fit takes 510 956 cycles without memory waits, 633 000 from flash (fit-10 in 688 slices); direct 34 953 "
        "(the same 360 samples)."
    )
    assert costs(own) == "Its fit takes 510 956 cycles (fit-10 in 688 slices)."


def test_no_cost_is_told_of_a_fit_that_was_not_counted() -> None:
    assert costs(total("direct", 34_953, "the same 360 samples")) == ""
    assert costs() == ""
