"""Firmware that speaks its own language: its headings at known angles, and what it believes of its sensors."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hiltest.boards import Board
from hiltest.calibration.quality import offset_error_ut, rotation_left_deg
from hiltest.interfaces.quantities import StreamInterface
from hiltest.measurement import Limit
from hiltest.procedures import upload_points
from hiltest.procedures.calibrate import calibrate_once
from hiltest.procedures.compass import FIRMWARE, CompassHeadings, SelfCalibration, samples_of
from hiltest.rig import Rig
from hiltest.session.fixtures import Measure
from hiltest.text import join_words

pytestmark = pytest.mark.hil

# The thesis' goal for a compass heading, where the rig gives no limit.
GOAL = Limit(max=2.0)
# Of headings computed from what it says of its field and its calibration: farther off, these do not belong to the
# heading that it says. A field in whole uT is wrong by 2 degrees, exchanged numbers by more than 7.
TOGETHER = Limit(max=5.0)
# Mistaken units make a factor of ten and more, and steel in a building changes the field by less than half.
SAME_UNIT = 2.0
# Calibrators of hiltest's own firmware that are shown beside; with fewer samples there is no ellipsoid.
OURS = ("direct", "corrected", "iterative")
FEWEST_SAMPLES = 50


def test_heading_before_calibration(before: CompassHeadings, measure: Measure) -> None:
    missing = before.not_measured
    level_deg = before.max_level_deg(FIRMWARE)
    measure(
        "heading.uncalibrated.max_level",
        level_deg,
        "deg",
        not_checked=missing,
        not_offered="" if level_deg is not None else missing or "the rig has no level known angle",
    )
    measure("heading.uncalibrated.max", before.summary(FIRMWARE).max_deg, "deg", not_checked=missing)


def test_the_firmware_calibrates_itself(
    self_calibration: SelfCalibration, after: CompassHeadings, board: Board, rig: Rig, measure: Measure
) -> None:
    after_s = self_calibration.calibrated_after_s
    measure("device.calibrated_after", after_s, "s", not_offered=not_said(after_s))
    believed, truth = after.belief, board.truth
    same_unit = Limit(min=rig.field.strength_ut / SAME_UNIT, max=rig.field.strength_ut * SAME_UNIT)
    measure("fit.firmware.residual", believed.fit_error_percent, "%", not_offered=not_said(believed.fit_error_percent))
    measure(
        "fit.firmware.strength",
        believed.field_strength_ut,
        "uT",
        not_offered=not_said(believed.field_strength_ut),
        limit=None if believed.field_strength_ut is None else same_unit,
    )
    measure("fit.firmware.dip", believed.dip_deg, "deg", not_offered=not_said(believed.dip_deg))
    offset_ut = rotation_deg = None
    if believed.fit is not None and truth is not None:
        offset_ut = offset_error_ut(believed.fit, truth.hard_iron_ut)
        rotation_deg = rotation_left_deg(believed.fit, truth.soft_iron)
    measure("fit.firmware.offset_error", offset_ut, "uT", not_offered=not_said(believed.fit))
    measure("fit.firmware.rotation_left", rotation_deg, "deg", not_offered=not_said(believed.fit))
    bias_dps = None
    if believed.gyroscope_bias_dps is not None and truth is not None:
        bias_dps = float(np.linalg.norm(believed.gyroscope_bias_dps - truth.gyroscope_bias_dps))
    measure("gyroscope.firmware.bias_error", bias_dps, "dps", not_offered=not_said(believed.gyroscope_bias_dps))


def test_pitch_and_roll_at_known_angles(after: CompassHeadings, board: Board, measure: Measure) -> None:
    why = (
        not_said(after.tilt_error_deg)
        if board.output.device.frame == "ned"
        else "they are other angles in other frames"
    )
    measure(
        "accelerometer.tilt_error",
        after.tilt_error_deg,
        "deg",
        not_offered=why,
        note=after.contradictions.get("tilt", ""),
    )


def test_heading_at_known_angles(after: CompassHeadings, rig: Rig, measure: Measure) -> None:
    missing = after.not_measured
    not_checked = missing or ("" if rig.mounting else "the rig declares no mounting")
    for source in after.error_deg:
        errors = after.summary(source)
        limit = GOAL if source == FIRMWARE else TOGETHER
        measure(
            f"heading.{source}.max",
            errors.max_deg,
            "deg",
            not_checked=not_checked,
            limit=None if f"heading.{source}.max" in rig.information else limit,
        )
        measure(f"heading.{source}.rms", errors.rms_deg, "deg", not_checked=not_checked)
        measure(f"heading.{source}.bias", or_nan(errors.bias_deg), "deg", not_checked=not_checked)
        measure(f"heading.{source}.max_centred", or_nan(errors.max_centred_deg), "deg", not_checked=missing)
        measure(f"heading.{source}.worst_sector", errors.worst_sector.start_deg, "deg")
        measure(f"heading.{source}.tilt_sensitivity", errors.tilt_sensitivity_deg, "deg")
    measure.table(
        "heading.poses",
        {"heading": "deg", "pitch": "deg", "roll": "deg", "level": "", "reference": "deg", "settled": ""}
        | {f"answered.{source}": "deg" for source in after.heading_deg}
        | {f"error.{source}": "deg" for source in after.error_deg},
        [
            [
                each.pose.heading_deg,
                each.pose.pitch_deg,
                each.pose.roll_deg,
                bool(level),
                *numbers,
                each.settled.is_settled,
                *answers,
            ]
            for each, level, numbers, *answers in zip(
                after.held,
                after.level,
                ([float(each)] for each in after.reference_deg),
                *(headings.tolist() for headings in after.heading_deg.values()),
                *(errors.tolist() for errors in after.error_deg.values()),
                strict=True,
            )
        ],
    )

    measure.table("heading.contradictions", {"of": "", "said": ""}, map(list, after.contradictions.items()))


def test_the_firmware_reports_no_error(after: CompassHeadings, board: Board, rig: Rig, measure: Measure) -> None:
    reported = [
        f"{text!r}" + (f" {times} times" if times > 1 else "") for text, times in board.output.errors.most_common()
    ]
    limit = None if "device.errors" in rig.information else Limit(max=0)
    measure("device.errors", board.output.errors.total(), "", limit=limit, note=join_words(reported, 2))


def test_headings_settle(after: CompassHeadings, board: Board, measure: Measure) -> None:
    measure("device.settle_time", float(after.settle_s.max()), "s", note="; ".join(board.output.remarks()))
    measure("device.unsettled", after.unsettled, "")
    measure("device.unconfirmed", after.unconfirmed, "")
    streams = [decoder for decoder in board.output.decoders.values() if isinstance(decoder, StreamInterface)]
    if streams:
        measure("device.not_understood", min(stream.not_understood for stream in streams), "")


def test_cycles_of_the_functions_that_the_rig_names(
    after: CompassHeadings, board: Board, rig: Rig, measure: Measure
) -> None:
    if not rig.cycles:
        pytest.skip("the rig names no function under [cycles]")
    if board.costs is None:
        pytest.skip("this board does not execute the firmware where it could be seen")
    model = board.cycle_model
    for name, calls in board.costs.calls().items():
        why = calls.refusal or ("" if calls.calls else f"{calls.function} was not called")
        note = f"it ends in {', '.join(calls.ended_in)}" if calls.ended_in else ""
        measure(f"cycles.{name}.calls", calls.calls, "", note=note)
        for what, cycles in (("least", calls.least), ("median", calls.median), ("most", calls.most)):
            measure(f"cycles.{name}.{what}", cycles, "cycle", cycle_model=model, not_offered=why)
        share = None if calls.share is None else 100.0 * calls.share
        measure(f"cycles.{name}.share", share, "%", not_offered=why)
        measure(f"cycles.{name}.interrupted", calls.interrupted, "")
    for name, solved in board.costs.solutions().items():
        why = "" if solved.solutions else "no solution was begun and completed"
        measure(f"cycles.{name}.solutions", solved.solutions, "")
        for what, cycles in (
            ("solution_median", solved.median),
            ("solution_most", solved.most),
            ("slice_most", solved.longest_slice),
        ):
            measure(f"cycles.{name}.{what}", cycles, "cycle", cycle_model=model, not_offered=why)
        measure(f"cycles.{name}.slices", solved.most_slices, "", not_offered=why)
    if (latest := board.costs.latest_solution()) is not None:
        measure(
            "cycles.calibrated.total",
            latest.cycles,
            "cycle",
            cycle_model=model,
            note=f"{latest.name} in {latest.slices} slices",
        )
        flash = board.costs.from_flash()
        measure(
            "cycles.calibrated.from_flash",
            flash.cycles,
            "cycle",
            cycle_model=flash.cycle_model,
            band=flash.band,
            note="the same slices",
            not_offered=flash.refusal,
        )


def test_our_calibrators_on_the_same_samples(
    after: CompassHeadings, board: Board, ours: Board, measure: Measure
) -> None:
    points = samples_of(board)
    if len(points) < FEWEST_SAMPLES or board.costs is None:
        pytest.skip("the firmware does not show the samples that it calibrated itself from, or its cycles are not seen")
    upload_points(ours, points.astype(np.int16))
    for name in OURS:
        fit, cost = calibrate_once(ours, name, len(points))
        errors = after.under(fit) if fit.has_fit else None
        if errors is None or cost is None:
            continue
        measure(f"heading.{name}.max", errors.max_deg, "deg")
        measure(f"heading.{name}.rms", errors.rms_deg, "deg")
        measure(
            f"cycles.{name}.total",
            cost.cycles,
            "cycle",
            cycle_model=ours.cycle_model,
            band=ours.cycle_range(cost, name),
            note=f"the same {len(points)} samples",
        )


def not_said(believed: object) -> str:
    """Return why there is no number."""
    return "" if believed is not None else "the firmware does not say it"


def or_nan(value: float | None) -> float:
    """Errors that cancel all round have no mean: that is a failure, not something left out."""
    return math.nan if value is None else value
