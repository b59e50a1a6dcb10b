"""Attitude of the filter during a motion, compared with each half alone: gyroscope; accelerometer and field.

The filter also follows the recorded motions that the rig names.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from statistics import fmean

import pytest

from hiltest.boards import Board
from hiltest.procedures import (
    AttitudeErrors,
    CalibratorRun,
    FittedTurns,
    FusionResult,
    Progress,
    Turntable,
    measure_fusion,
)
from hiltest.procedures.recorded_motion import Played, follow_recordings
from hiltest.rig import Rig
from hiltest.session.bench_session import SESSION
from hiltest.session.fixtures import Measure
from hiltest.session.settings import Settings

pytestmark = [pytest.mark.hil, pytest.mark.full]

# The first calibration of the heading suite.
CALIBRATOR = "direct"
# Parts of a recorded motion, whose total errors are measured.
PHASES = ("first seconds", "rest", "translation", "disturbed field")


@pytest.fixture(scope="module")
def motion(
    board: Board,
    turntable: Turntable,
    rig: Rig,
    calibrations: Mapping[str, CalibratorRun],
    gyroscope_calibration: FittedTurns,
    hil_progress: Progress,
) -> FusionResult:
    """Errors of the attitude filter during turns and tilts, with the stored gyroscope calibration."""
    return measure_fusion(
        board,
        turntable,
        slot=calibrations[CALIBRATOR].slot,
        readings=rig.procedure.readings_per_pose,
        bias_s=rig.procedure.gyroscope_rest_s,
        progress=hil_progress,
    )


@pytest.fixture(scope="module")
def recorded(
    board: Board, rig: Rig, hil_settings: Settings, hil_progress: Progress, request: pytest.FixtureRequest
) -> Mapping[str, Played]:
    """Errors of the attitude filter on the rig's recorded motions, each on a virtual board with the same firmware."""
    if rig.world is None or rig.world.motion_recordings is None:
        pytest.skip("the rig names no recordings: world.motion_recordings")
    if board.stage is None:
        pytest.skip("only a virtual board plays recordings")

    def follow() -> dict[str, Played]:
        return follow_recordings(rig, firmware=hil_settings.firmware, base=hil_settings.base, progress=hil_progress)

    results: dict[str, Played] = request.config.stash[SESSION].tape.ask(
        "recorded motions", {}, dict[str, Played], follow
    )
    return results


def test_attitude_during_a_motion(motion: FusionResult, measure: Measure) -> None:
    for name, errors in alternatives(motion).items():
        prefix = "fusion" if name == "fused" else f"fusion.{name}"
        measure(f"{prefix}.heading.rms", errors and errors.heading_rms_deg, "deg")
        measure(f"{prefix}.heading.max", errors and errors.heading_max_deg, "deg")
        measure(f"{prefix}.tilt.rms", errors and errors.tilt_rms_deg, "deg")


def test_every_sample_of_the_motion_is_used(motion: FusionResult, measure: Measure) -> None:
    measure("fusion.updates", motion.summary.costs.updates, "")
    measure("fusion.left_out", motion.summary.left_out, "")


def test_cycles_of_an_update(motion: FusionResult, measure: Measure) -> None:
    costs, model = motion.summary.costs, motion.cycle_model
    largest = costs.largest and costs.largest.cycles
    measure("cycles.fusion.update", largest, "cycle", cycle_model=model, band=motion.cycle_range)
    measure("cycles.fusion.update.mean", costs.mean_cycles, "cycle", cycle_model=model)


def test_errors_over_time(motion: FusionResult, measure: Measure) -> None:
    errors_by_name = alternatives(motion)
    if motion.truth is None or any(errors is None for errors in errors_by_name.values()):
        pytest.skip("the truth is not known here")
    measure.table(
        "fusion.motion",
        {"time": "s", "heading": "deg"} | dict.fromkeys(errors_by_name, "deg"),
        zip(
            motion.time_s.tolist(),
            (pose.heading_deg for pose in motion.truth),
            *(map(finite_or_none, errors.heading_deg.tolist()) for errors in errors_by_name.values() if errors),
            strict=True,
        ),
    )


def test_attitude_on_recorded_motion(recorded: Mapping[str, Played], measure: Measure) -> None:
    by_recording = {name: played.filter_errors() for name, played in recorded.items()}
    columns = [("motion", error) for error in ("total", "heading", "inclination")]
    columns += [(phase, "total") for phase in PHASES]
    rows = [
        [getattr(errors[phase], f"{error}_deg") if phase in errors else None for phase, error in columns]
        for errors in by_recording.values()
    ]
    for (phase, error), values in zip(columns, zip(*rows, strict=True), strict=True):
        present = [value for value in values if value is not None]
        measure(
            f"fusion.recorded.{phase.replace(' ', '_')}.{error}",
            fmean(present) if present else None,
            "deg",
            not_offered="no recording has this phase",
        )
    measure.table(
        "fusion.recordings",
        {"recording": ""} | {f"{phase}, {error}": "deg" for phase, error in columns},
        [[name, *row] for name, row in zip(by_recording, rows, strict=True)],
    )


def finite_or_none(value: float) -> float | None:
    return value if math.isfinite(value) else None


def alternatives(motion: FusionResult) -> dict[str, AttitudeErrors | None]:
    """Return the errors of the filter and of each half alone."""
    return {
        "fused": motion.fused,
        "accelerometer_magnetometer": motion.accelerometer_magnetometer,
        "gyroscope": motion.gyroscope,
    }
