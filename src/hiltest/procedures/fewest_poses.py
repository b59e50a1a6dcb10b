"""Known angles in the order of their information, until every limit of a heading is decided."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hiltest.boards.board import Board
from hiltest.calibration.heading_bound import heading_derivatives
from hiltest.calibration.residual_iron import RISK, STATISTICS, ResidualIron
from hiltest.measurement import Limit
from hiltest.orientation.angles import Pose, rotation_body_from_ned
from hiltest.procedures.calibrate import UNCALIBRATED
from hiltest.rig import Rig

Errors = Mapping[str, Mapping[int, float]]
"""Heading errors [deg] by calibration, and by the index of the pose."""


@dataclass(frozen=True, slots=True)
class FewestPoses:
    """Decision rule of ISO 14253-1 after each pose: go on, or all limits are met, or one is missed."""

    iron: ResidualIron
    limits: Mapping[str, Mapping[str, Limit]]
    """Limits by calibration and statistic."""
    mounting_deg: float
    """Expanded uncertainty that all poses share, which no number of poses reduces."""

    @property
    def order(self) -> Sequence[int]:
        """Indices of the poses in the order in which they are measured."""
        return self.iron.order

    def estimates(self, errors_deg: Errors) -> dict[str, dict[str, tuple[float, float]]]:
        """Return value and expanded uncertainty [deg] of each statistic over all poses, by calibration."""
        estimates = {}
        for name, errors in errors_deg.items():
            intervals = self.iron.intervals(errors) if name != UNCALIBRATED else {}
            estimates[name] = {
                statistic: (middle, half if statistic == "max_centred" else math.hypot(half, self.mounting_deg))
                for statistic, (middle, half) in intervals.items()
            }
        return estimates

    def decision(self, errors_deg: Errors) -> str:
        """Return why no further pose is needed; empty to go on."""
        estimates, verdicts = self.estimates(errors_deg), {}
        for name, limits in self.limits.items():
            for statistic, limit in limits.items():
                estimate = estimates.get(name, {}).get(statistic)
                verdicts[f"heading.{name}.{statistic}"] = limit.is_met(*estimate) if estimate else None
        poses = f"{max(map(len, errors_deg.values()), default=0)} of {len(self.order)} known angles"
        missed = [measurement for measurement, verdict in verdicts.items() if verdict is False]
        if missed:
            return f"{poses} prove that {missed[0]} is out of its limit (risk {RISK:.0%})"
        is_met = verdicts and all(verdicts.values())
        return f"{poses} prove that all limits of headings are met (risk {RISK:.0%} each)" if is_met else ""


def plan_fewest_poses(
    board: Board, rig: Rig, poses: Sequence[Pose], limits: Mapping[str, Mapping[str, Limit]]
) -> FewestPoses | None:
    """Return the plan of a rig with ``turntable.fewest_poses``; None for another rig.

    Parameters
    ----------
    limits
        Default limits by calibration and statistic; those of the rig take precedence.
    """
    if not rig.turntable.fewest_poses:
        return None
    yaw_deg = rig.mounting.yaw_deg if rig.mounting else 0.0
    turns = [rotation_body_from_ned(Pose(pose.heading_deg + yaw_deg, pose.pitch_deg, pose.roll_deg)) for pose in poses]
    field, gravity = np.array(turns) @ board.declared.field_ned_ut, np.array(turns)[:, :, 2]
    reading_ut = rig.sensors.magnetometer_noise_ut / math.sqrt(rig.procedure.readings_per_pose)
    slopes = np.linalg.norm(heading_derivatives(field / rig.field.strength_ut, gravity), axis=1)
    sigma_deg = np.hypot(np.degrees(slopes * reading_ut / rig.field.strength_ut), rig.turntable.uncertainty_deg / 2.0)
    by_hand = rig.turntable.kind == "operator" and rig.mounting is not None
    in_force = {
        name: {
            statistic: limit
            for statistic in STATISTICS
            if (limit := rig.limits.get(f"heading.{name}.{statistic}") or defaults.get(statistic))
        }
        for name, defaults in limits.items()
    }
    mounting_deg = rig.mounting.uncertainty_deg if rig.mounting and by_hand else 0.0
    return FewestPoses(ResidualIron(field, gravity, sigma_deg), in_force, mounting_deg)
