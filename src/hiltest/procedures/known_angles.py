"""Known-angle procedure: the board's heading against the turntable's angle, by any interface to the firmware."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hiltest.orientation.angles import Pose, heading_error_deg, rotation_body_from_ned
from hiltest.procedures.hand_poses import PoseReader, StoredPoses, Taken, TakenAngles, missing_in_words, take_by_hand
from hiltest.procedures.heading_statistics import HeadingSummary, summarise
from hiltest.procedures.progress import Progress, silent
from hiltest.procedures.turntables import Achieved, OperatorTurntable, Turntable

Reals = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class KnownAngles:
    """Headings at known angles, by source: a calibration on the board, or a way to compute the firmware's heading."""

    poses: tuple[Pose, ...]
    """Requested poses of the turntable."""
    attitudes: tuple[Pose, ...]
    """Attitudes of the board: reached poses with the declared mounting yaw; nothing else was subtracted."""
    heading_deg: dict[str, Reals]
    """Shape (n,). Headings, by source."""
    skipped: tuple[Pose, ...]
    """Known angles that an operator skipped; the other fields exclude them."""
    unset: Mapping[int, str]
    """Poses, by their number from 1, at which the board was not set as the operator says, each with a description."""
    decision: str
    """Reason why the other poses were not measured; empty if all were requested."""
    estimates: Mapping[str, Mapping[str, tuple[float, float]]]
    """Value and expanded uncertainty [deg] of statistics over all requested poses, by source, if decided."""

    @property
    def reference_deg(self) -> Reals:
        """Headings of the attitudes, shape (n,)."""
        return np.array([attitude.heading_deg for attitude in self.attitudes])

    @property
    def error_deg(self) -> dict[str, Reals]:
        """Heading minus reference in (-180, 180], shape (n,), by source."""
        return {source: self._errors_deg(source) for source in self.heading_deg}

    def _errors_deg(self, source: str) -> Reals:
        pairs = zip(self.heading_deg[source].tolist(), self.reference_deg.tolist(), strict=True)
        return np.array([heading_error_deg(*pair) for pair in pairs])

    @property
    def not_measured(self) -> str:
        """Missing known angles, in words; empty without any. A limit applies to the complete set."""
        return self.decision or missing_in_words(self.skipped, len(self.poses))

    def rotate_to_body(self, vector_ned: Sequence[float]) -> Reals:
        """Return a vector of the earth frame in the board's axes at each pose, shape (n, 3)."""
        return np.array([rotation_body_from_ned(attitude) @ np.array(vector_ned) for attitude in self.attitudes])

    @property
    def level(self) -> NDArray[np.bool_]:
        """Mask of the level poses, shape (n,)."""
        return np.array([pose.pitch_deg == 0.0 and pose.roll_deg == 0.0 for pose in self.poses])

    def summary(self, source: str) -> HeadingSummary:
        """Return the statistics of one source."""
        return summarise(self._errors_deg(source), self.reference_deg, level=self.level)

    def max_level_deg(self, source: str) -> float | None:
        """Return the largest error of a source over the level poses; None if none was taken."""
        level = self.level
        return summarise(self._errors_deg(source)[level], self.reference_deg[level]).max_deg if level.any() else None


def take_known_angles(
    reader: PoseReader[Taken],
    turntable: Turntable,
    poses: Sequence[Pose],
    *,
    progress: Progress | None = None,
    stored: StoredPoses[Taken] | None = None,
    order: Sequence[int] = (),
    decide: Callable[[Mapping[int, tuple[Achieved, Taken]]], str] = lambda readings: "",
) -> TakenAngles[Taken]:
    """Turn to each pose and read the board there.

    Parameters
    ----------
    reader
        Reads the board.
    turntable
        Turntable whose angle is the reference, independent of the sensors under test.
    poses
        Poses, at least one.
    stored
        Poses that an operator captured in an earlier run.
    order
        Indices of the poses in the order in which they are measured; their own by default.
    decide
        Returns why no pose beside those measured is needed; empty to go on.
    """
    if isinstance(turntable, OperatorTurntable):
        return take_by_hand(reader, turntable, poses, stored, order, decide)
    tell, decision = progress or silent, ""
    readings: dict[int, tuple[Achieved, Taken]] = {}
    for index in order or range(len(poses)):
        tell("known angles", len(readings), len(poses))
        achieved = turntable.turn_to(poses[index], known_angle=index)
        readings[index] = achieved, reader.read(poses[index])
        if decision := decide(readings):
            break
    tell("known angles", len(poses), len(poses))
    return TakenAngles(dict(sorted(readings.items())), decision=decision)
