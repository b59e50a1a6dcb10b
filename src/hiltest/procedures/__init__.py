"""What a bench does with a board: rest, tumble, calibrate, known angles, cycles, link checks."""

from __future__ import annotations

from hiltest.angles import Pose
from hiltest.procedures.arithmetic import float32_error_deg
from hiltest.procedures.calibrate import UNCALIBRATED, UNCALIBRATED_SLOT, CalibratorRun, run_calibrators
from hiltest.procedures.cause import Cause, name_cause, predicted_residual_percent
from hiltest.procedures.clouds import golden_cloud
from hiltest.procedures.coverage import largest_hole_deg, sphere_coverage
from hiltest.procedures.cycles import CycleCost, measure_cycles
from hiltest.procedures.grbl_turntable import GrblTurntable, open_grbl_turntable
from hiltest.procedures.heading_statistics import HeadingSummary, summarise, tilt_to_heading
from hiltest.procedures.known_angles import KnownAngles, measure_known_angles
from hiltest.procedures.link_checks import LinkCheck, check_link
from hiltest.procedures.progress import Progress
from hiltest.procedures.rest import (
    AccelerometerRestResult,
    GyroscopeRestResult,
    measure_accelerometer_rest,
    measure_gyroscope_rest,
)
from hiltest.procedures.tumble import Tumble, collect_tumble
from hiltest.procedures.turntables import (
    Achieved,
    OperatorTurntable,
    SimulatedTurntable,
    Turntable,
    open_turntable,
)

__all__ = [
    "UNCALIBRATED",
    "UNCALIBRATED_SLOT",
    "AccelerometerRestResult",
    "Achieved",
    "CalibratorRun",
    "Cause",
    "CycleCost",
    "GrblTurntable",
    "GyroscopeRestResult",
    "HeadingSummary",
    "KnownAngles",
    "LinkCheck",
    "OperatorTurntable",
    "Pose",
    "Progress",
    "SimulatedTurntable",
    "Tumble",
    "Turntable",
    "check_link",
    "collect_tumble",
    "float32_error_deg",
    "golden_cloud",
    "largest_hole_deg",
    "measure_accelerometer_rest",
    "measure_cycles",
    "measure_gyroscope_rest",
    "measure_known_angles",
    "name_cause",
    "open_grbl_turntable",
    "open_turntable",
    "predicted_residual_percent",
    "run_calibrators",
    "sphere_coverage",
    "summarise",
    "tilt_to_heading",
]
