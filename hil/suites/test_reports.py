"""Firmware that reports its heading by itself: its reports about sensors, errors and calibration."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from hiltest.boards import Board
from hiltest.calibration.quality import offset_error_ut, rotation_left_deg
from hiltest.interfaces.quantities import StreamInterface
from hiltest.measurement import Limit
from hiltest.procedures import upload_points
from hiltest.procedures.calibrate import calibrate_once
from hiltest.procedures.reported_headings import FIRMWARE, ReportedAngles, SelfCalibration, sample_faults, samples_of
from hiltest.procedures.reported_samples import SampleFault
from hiltest.rig import Rig
from hiltest.session.fixtures import Measure
from hiltest.text import join_words

pytestmark = pytest.mark.hil

# A wrong unit changes the field by a factor of ten or more, steel in a building by less than half.
SAME_UNIT = 2.0
# Calibrators of hiltest's own firmware for comparison, and the fewest samples for an ellipsoid.
REFERENCE_CALIBRATORS = ("direct", "corrected", "iterative")
FEWEST_SAMPLES = 50

# As in test_heading.py, for a rig without a limit.
GOAL = Limit(max=2.0)
# Two decimals of g round by 5 mg, the noise of a window by 1; a scale that is wrong by 2 % is beyond it.
ACCELERATION_ERROR = Limit(max=20.0)
# Ten readings of 0.4 uT in a window have a mean within 0.6 uT of that of all samples at the pose, at five sigma.
SAMPLE_ERROR = Limit(max=1.0)


def test_the_firmware_calibrates_itself(
    self_calibration: SelfCalibration, known_angles: ReportedAngles, board: Board, rig: Rig, measure: Measure
) -> None:
    after_s = self_calibration.calibrated_after_s
    measure("device.calibrated_after", after_s, "s", not_offered=not_reported(after_s))
    belief, truth = known_angles.belief, board.truth
    same_unit = Limit(min=rig.field.strength_ut / SAME_UNIT, max=rig.field.strength_ut * SAME_UNIT)
    measure("fit.firmware.residual", belief.fit_error_percent, "%", not_offered=not_reported(belief.fit_error_percent))
    measure(
        "fit.firmware.strength",
        belief.field_strength_ut,
        "uT",
        not_offered=not_reported(belief.field_strength_ut),
        limit=None if belief.field_strength_ut is None else same_unit,
    )
    measure("fit.firmware.dip", belief.dip_deg, "deg", not_offered=not_reported(belief.dip_deg))
    offset_ut = rotation_deg = None
    if belief.fit is not None and truth is not None:
        offset_ut = offset_error_ut(belief.fit, truth.hard_iron_ut)
        rotation_deg = rotation_left_deg(belief.fit, truth.soft_iron)
    measure("fit.firmware.offset_error", offset_ut, "uT", not_offered=not_reported(belief.fit))
    measure("fit.firmware.rotation_left", rotation_deg, "deg", not_offered=not_reported(belief.fit))
    bias_dps = None
    if belief.gyroscope_bias_dps is not None and truth is not None:
        bias_dps = float(np.linalg.norm(belief.gyroscope_bias_dps - truth.gyroscope_bias_dps))
    measure("gyroscope.firmware.bias_error", bias_dps, "dps", not_offered=not_reported(belief.gyroscope_bias_dps))
    if rows := self_calibration.field_rows():
        measure.table("device.tumble_field", {"of": "", **dict.fromkeys("xyz", "uT")}, rows)


def test_the_samples_of_the_tumble_are_right(compass_tumble: SelfCalibration, measure: Measure) -> None:
    if faults := compass_tumble.sample_faults:
        measure.table(*table_of_sample_faults(faults))
        pytest.fail("; ".join(fault.words for fault in faults), pytrace=False)


def test_the_reported_field_is_that_of_the_samples(
    known_angles: ReportedAngles, board: Board, measure: Measure
) -> None:
    error_ut, error_g = known_angles.sample_error_ut(), known_angles.acceleration_error_g()
    heading = measure.limit("heading.firmware.max") or GOAL
    values = [
        (heading, known_angles.summary(FIRMWARE).max_deg),
        (SAMPLE_ERROR, error_ut),
        (ACCELERATION_ERROR, error_g and 1000.0 * error_g),
    ]
    if any(value is not None and not limit.holds(value) for limit, value in values):
        observations = [row for pose in known_angles.held for row in pose.settled.window]
        if (faults := sample_faults(board, observations, is_moving=False)) is not None:
            measure.table(*table_of_sample_faults(faults))
    measure(
        "device.sample_error",
        error_ut,
        "uT",
        limit=SAMPLE_ERROR if error_ut is not None else None,
        not_offered=""
        if error_ut is not None
        else "the board observes no samples, or the firmware reports no raw field",
    )


def test_the_reported_acceleration_is_that_of_the_samples(known_angles: ReportedAngles, measure: Measure) -> None:
    error_g = known_angles.acceleration_error_g()
    if error_g is None:
        pytest.skip("the board observes no samples, or the firmware reports no raw acceleration")
    measure("device.acceleration_error", 1000.0 * error_g, "mg", limit=ACCELERATION_ERROR)


def test_pitch_and_roll_at_known_angles(known_angles: ReportedAngles, board: Board, measure: Measure) -> None:
    reason = (
        not_reported(known_angles.tilt_error_deg)
        if board.output.device.frame == "ned"
        else "they are other angles in other frames"
    )
    measure(
        "accelerometer.tilt_error",
        known_angles.tilt_error_deg,
        "deg",
        not_offered=reason,
        note=known_angles.contradictions.get("tilt", ""),
    )


def test_the_firmware_reports_no_error(known_angles: ReportedAngles, board: Board, rig: Rig, measure: Measure) -> None:
    reported = [
        f"{text!r}" + (f" {times} times" if times > 1 else "") for text, times in board.output.errors.most_common()
    ]
    limit = None if "device.errors" in rig.information else Limit(max=0)
    measure("device.errors", board.output.errors.total(), "", limit=limit, note=join_words(reported, 2))


def test_headings_settle(known_angles: ReportedAngles, board: Board, measure: Measure) -> None:
    measure("device.settle_time", float(known_angles.settle_s.max()), "s", note="; ".join(board.output.remarks()))
    measure("device.unsettled", known_angles.unsettled, "")
    measure("device.unconfirmed", known_angles.unconfirmed, "")
    streams = [decoder for decoder in board.output.decoders.values() if isinstance(decoder, StreamInterface)]
    if streams:
        measure("device.not_understood", min(stream.not_understood for stream in streams), "")


def test_cycles_of_the_firmware_and_of_the_functions_that_the_rig_names(
    known_angles: ReportedAngles, board: Board, measure: Measure
) -> None:
    if board.costs is None:
        pytest.skip("this board does not execute the firmware where it could be seen")
    measure("cycles.awake.share", 100.0 * board.costs.awake_share(), "%")
    model = board.cycle_model
    for name, calls in board.costs.calls().items():
        reason = calls.refusal or ("" if calls.calls else f"{calls.function} was not called")
        note = f"it ends in {', '.join(calls.ended_in)}" if calls.ended_in else ""
        measure(f"cycles.{name}.calls", calls.calls, "", note=note)
        for statistic, cycles in (("least", calls.least), ("median", calls.median), ("most", calls.most)):
            measure(f"cycles.{name}.{statistic}", cycles, "cycle", cycle_model=model, not_offered=reason)
        share = None if calls.share is None else 100.0 * calls.share
        measure(f"cycles.{name}.share", share, "%", not_offered=reason)
        measure(f"cycles.{name}.interrupted", calls.interrupted, "")
    for name, solved in board.costs.solutions().items():
        reason = "" if solved.solutions else "no solution was begun and completed"
        measure(f"cycles.{name}.solutions", solved.solutions, "")
        for statistic, cycles in (
            ("solution_median", solved.median),
            ("solution_most", solved.most),
            ("slice_most", solved.longest_slice),
        ):
            measure(f"cycles.{name}.{statistic}", cycles, "cycle", cycle_model=model, not_offered=reason)
        measure(f"cycles.{name}.slices", solved.most_slices, "", not_offered=reason)
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
    known_angles: ReportedAngles, board: Board, reference_board: Board, measure: Measure
) -> None:
    points = samples_of(board)
    if len(points) < FEWEST_SAMPLES or board.costs is None:
        pytest.skip("the firmware does not show the samples that it calibrated itself from, or its cycles are not seen")
    upload_points(reference_board, points.astype(np.int16))
    for name in REFERENCE_CALIBRATORS:
        fit, cost = calibrate_once(reference_board, name, len(points))
        errors = known_angles.under(fit) if fit.has_fit else None
        if errors is None or cost is None:
            continue
        measure(f"heading.{name}.max", errors.max_deg, "deg")
        measure(f"heading.{name}.rms", errors.rms_deg, "deg")
        measure(
            f"cycles.{name}.total",
            cost.cycles,
            "cycle",
            cycle_model=reference_board.cycle_model,
            band=reference_board.cycle_range(cost, name),
            note=f"the same {len(points)} samples",
        )


def table_of_sample_faults(faults: Sequence[SampleFault]) -> tuple[str, dict[str, str], list[list[str]]]:
    """Return the table of what is wrong with samples: name, units of the columns, and rows."""
    return "device.samples", {"words": "", "place": ""}, [[fault.words, fault.place] for fault in faults]


def not_reported(value: object) -> str:
    """Return the reason for a missing value."""
    return "" if value is not None else "the firmware does not say it"
