"""Procedures of a bench: rest, tumble, calibrate, known angles, cycles, link checks."""

from __future__ import annotations

from hiltest.procedures.angle_errors import limits_out_of_reach
from hiltest.procedures.budget import Effort, EffortKind, effort_curve, largest_effort_within
from hiltest.procedures.calibrate import (
    UNCALIBRATED,
    UNCALIBRATED_SLOT,
    CalibratorRun,
    predicted_residual_percent,
    run_calibrators,
    store_untrimmed,
)
from hiltest.procedures.cycles import CycleCost, measure_cycles, upload_pairs, upload_points
from hiltest.procedures.dpi import DPI, JOINT, DpiRun, fit_still_poses, fit_tumble, measure_dpi_cycles
from hiltest.procedures.driven_calibrations import DrivenCalibrations, DrivenStage, calibrate_while_driving
from hiltest.procedures.driving import DrivingResult, measure_driving
from hiltest.procedures.fast_fit import FAST, FastFit, measure_fast_fit
from hiltest.procedures.float64_headings import float32_error_deg, heading_errors_deg
from hiltest.procedures.fusion import AttitudeErrors, FusionResult, measure_fusion
from hiltest.procedures.golden_points import golden_pairs, golden_points
from hiltest.procedures.grbl_turntable import GrblTurntable, open_grbl_turntable
from hiltest.procedures.gyroscope_log import GyroscopeLog, LogChunk, log_gyroscope
from hiltest.procedures.heading_statistics import HeadingSummary, summarise
from hiltest.procedures.known_angles import KnownAngles
from hiltest.procedures.link_checks import LinkCheck, check_link
from hiltest.procedures.open_table import open_table
from hiltest.procedures.progress import Progress
from hiltest.procedures.requested_headings import RequestedAngles, measure_known_angles
from hiltest.procedures.rest import AccelerometerRestResult, BoardMovedError, measure_accelerometer_rest, rest_gyroscope
from hiltest.procedures.seen_axes import see_axes
from hiltest.procedures.six_positions import (
    AccelerometerRun,
    fit_poses,
    measure_six_positions,
    store_accelerometer,
)
from hiltest.procedures.still_poses import collect_still_poses, spread_poses
from hiltest.procedures.streams import StreamRun, StreamStage, run_streams, store_streams
from hiltest.procedures.tumble import Tumble, collect_tumble, evenly_spread, held_as_taken
from hiltest.procedures.turns import FittedTurns, MeasuredTurn, TurnInvalidError, fit_on_board, measure_turn
from hiltest.procedures.turntables import (
    Achieved,
    OperatorTurntable,
    SimulatedTurntable,
    Turntable,
)

__all__ = [
    "DPI",
    "FAST",
    "JOINT",
    "UNCALIBRATED",
    "UNCALIBRATED_SLOT",
    "AccelerometerRestResult",
    "AccelerometerRun",
    "Achieved",
    "AttitudeErrors",
    "BoardMovedError",
    "CalibratorRun",
    "CycleCost",
    "DpiRun",
    "DrivenCalibrations",
    "DrivenStage",
    "DrivingResult",
    "Effort",
    "EffortKind",
    "FastFit",
    "FittedTurns",
    "FusionResult",
    "GrblTurntable",
    "GyroscopeLog",
    "HeadingSummary",
    "KnownAngles",
    "LinkCheck",
    "LogChunk",
    "MeasuredTurn",
    "OperatorTurntable",
    "Progress",
    "RequestedAngles",
    "SimulatedTurntable",
    "StreamRun",
    "StreamStage",
    "Tumble",
    "TurnInvalidError",
    "Turntable",
    "calibrate_while_driving",
    "check_link",
    "collect_still_poses",
    "collect_tumble",
    "effort_curve",
    "evenly_spread",
    "fit_on_board",
    "fit_poses",
    "fit_still_poses",
    "fit_tumble",
    "float32_error_deg",
    "golden_pairs",
    "golden_points",
    "heading_errors_deg",
    "held_as_taken",
    "largest_effort_within",
    "limits_out_of_reach",
    "log_gyroscope",
    "measure_accelerometer_rest",
    "measure_cycles",
    "measure_dpi_cycles",
    "measure_driving",
    "measure_fast_fit",
    "measure_fusion",
    "measure_known_angles",
    "measure_six_positions",
    "measure_turn",
    "open_grbl_turntable",
    "open_table",
    "predicted_residual_percent",
    "rest_gyroscope",
    "run_calibrators",
    "run_streams",
    "see_axes",
    "spread_poses",
    "store_accelerometer",
    "store_streams",
    "store_untrimmed",
    "summarise",
    "upload_pairs",
    "upload_points",
]
