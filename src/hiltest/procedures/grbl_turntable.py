"""A motor table with Grbl: X is heading, Y pitch, Z roll, in degrees."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from hiltest.boards.real import SILICON
from hiltest.calibration.still_pose import Face
from hiltest.errors import HiltestError, TurntableError
from hiltest.link.grbl import GrblLine
from hiltest.link.gyroscope import Axis
from hiltest.link.ports import open_port
from hiltest.orientation.angles import Pose, sin_cos_deg, wrap_180
from hiltest.procedures.turntables import (
    AFTER_TURN_S,
    AXIS_DOWN,
    BEFORE_TURN_S,
    FACE_WORDS,
    LEVEL,
    SWAY_S,
    Achieved,
)
from hiltest.rig import Rig

# Settling time after Grbl reports that the axes stand, because the mounted parts swing a little longer [s].
_SETTLE_S = 0.25
# Angles between the field and the roll axis at which a tumble rolls the board once round [deg]:
# no direction of the sphere is further than 15 degrees from one of these circles.
_CIRCLES_DEG = (15.0, 45.0, 75.0, 105.0, 135.0, 165.0)
# Turn of the nose about the field from one circle to the next [deg], the golden angle. If the nose stayed in the plane
# of north and down, field and gravity would lie in one plane with the roll axis, and `dpi` could not see a rotation
# about it: its coverage would be 350 at a dip of 62 degrees, where 100 is the limit; with the golden angle it is 4, and
# 16 at 80 degrees.
_ROUND_FIELD_DEG = 137.5
# Largest distance from the straight path [deg]: a table that turns its axes one after the other exceeds it.
_OFF_THE_WAY_DEG = 1.0
# Longest gap between two moves [s].
_BETWEEN_MOVES_S = 0.1
# Corners of a sway: headings of half a turn to either side, so that no cable winds up, and repeated tilts. Grbl's
# planner holds the 14 moves between them.
_SWAY_HEADINGS_DEG = (0.0, 45.0, 90.0, 135.0, 180.0, 135.0, 90.0, 45.0, 0.0, -45.0, -90.0, -135.0, -90.0, -45.0, 0.0)
_SWAY_TILTS_DEG = ((0.0, 0.0), (20.0, 0.0), (0.0, 20.0), (-20.0, 0.0), (0.0, -20.0))
_BOARD = re.compile(r"\[VER:[^:]*:virtual \S+ (\S+)\]")


class GrblTurntable:
    """A table with three motors behind a Grbl 1.1 controller: on a bench, or of ``hiltest serve``.

    Parameters
    ----------
    line
        Line to the controller, which this object closes.
    uncertainty_deg
        Declared uncertainty of the table's angle.
    dip_deg
        Dip of the local field: a tumble turns the board about it.
    mounting_yaw_deg
        Mounting yaw of the board on the table.

    Attributes
    ----------
    board_model : str or None
        Cycle model of the virtual board on the table, if the controller reports one.

    Raises
    ------
    TurntableError
        When homing fails.
    """

    name = "grbl"

    def __init__(
        self, line: GrblLine, *, uncertainty_deg: float, dip_deg: float, mounting_yaw_deg: float = 0.0
    ) -> None:
        self._line = line
        self._dip_deg = dip_deg
        self._yaw_deg = mounting_yaw_deg
        self.uncertainty_deg = uncertainty_deg
        self._way: _TumblePath | None = None
        if line.status().state == "Alarm":
            line.ask("$H", moving=True)
        line.ask("G90")
        matches = (_BOARD.match(text) for text in line.ask("$I"))
        self.board_model = next((match[1] for match in matches if match), None)

    def turn_to(self, pose: Pose, *, known_angle: int | None = None) -> Achieved:
        """Turn, wait until the table stands, and return the position that it reports."""
        self._line.ask(_rapid(pose))
        self._line.ask(f"G4 P{_SETTLE_S:g}", moving=True)
        heading_deg, pitch_deg, roll_deg = self._line.status().position
        return Achieved(heading_deg, pitch_deg, roll_deg, self.uncertainty_deg)

    def turn_to_face(self, face: Face) -> None:
        """Tilt until the face is down.

        Raises
        ------
        TurntableError
            When the axes cannot reach it.
        """
        try:
            self.turn_to(face.pose)
        except TurntableError as error:
            raise TurntableError(
                f"the table cannot put the board {FACE_WORDS[face]} (pitch {face.pose.pitch_deg:+g}, roll "
                f'{face.pose.roll_deg:+g}): {error}. Write accelerometer_calibration = "none" under [procedure], or '
                "calibrate the accelerometer by hand, with a turntable of kind operator"
            ) from error

    def tumble(self, duration_s: float) -> float:
        """Go to the first pose of a tumble, start it, and return its duration, which the motors determine."""
        poses = tumble_poses(self._dip_deg, mounting_yaw_deg=self._yaw_deg)
        self._way = _TumblePath(poses)
        self.turn_to(poses[0])
        takes_s = self._seconds(poses)  # a table reports settings only at standstill
        for pose in poses[1:]:
            self._line.ask(_rapid(pose))
        return max(duration_s, takes_s)

    def tumbled(self) -> float | None:
        """Return the completed part of the tumble's path at the reported position."""
        return self._way.part_at(self._line.status().position) if self._way else None

    def sway(self) -> float:
        """Start to turn and tilt, and return the duration: `SWAY_S`, or longer if the motors need it."""
        poses = sway_poses()
        takes_s = max(SWAY_S, self._seconds(poses))
        for begin, end in pairwise(poses):
            travel_deg = math.dist(_angles(begin), _angles(end))
            self._line.ask(_feed(end, travel_deg * (len(poses) - 1) / takes_s))
        return takes_s + _BETWEEN_MOVES_S * len(poses)

    def rest(self) -> None:
        """Stand level, heading north."""
        self.turn_to(LEVEL)

    def mount(self, axis: Axis) -> None:
        """Tilt the board until the axis is down; refuse if the motors cannot reach it."""
        self.turn_to(AXIS_DOWN[axis])

    def again(self, why: str) -> bool:
        """Refuse: the motors would reach the same position."""
        return False

    def turn(self, axis: Axis, degrees: float, *, rate_dps: float) -> float:
        """Turn the heading axis further, at the rate or as fast as its motor can."""
        settings = self._line.settings()
        fastest_dps, faster_dps2 = settings.get(110, 0.0) / 60.0, settings.get(120, 0.0)
        if fastest_dps <= 0.0:
            raise TurntableError("the turntable names no rate of its heading axis ($110): check that it runs Grbl 1.1")
        reached_dps = min(rate_dps, fastest_dps)
        ramp_s = reached_dps / faster_dps2 if faster_dps2 > 0.0 else 0.0
        self._line.begin(f"G4 P{BEFORE_TURN_S:g}", "G91", f"G1 X{degrees:.3f} F{60.0 * reached_dps:.3f}", "G90")
        return BEFORE_TURN_S + abs(degrees) / reached_dps + ramp_s + _BETWEEN_MOVES_S + _SETTLE_S + AFTER_TURN_S

    def close(self) -> None:
        self._line.close()

    def _seconds(self, poses: Sequence[Pose]) -> float:
        """Estimate the duration of moves from pose to pose, from the controller's rates and accelerations."""
        settings = self._line.settings()
        if any(settings.get(110 + axis, 0.0) <= 0.0 for axis in range(3)):
            raise TurntableError("the turntable names no rates ($110 to $112): check that it runs Grbl 1.1")
        total_s = 0.0
        for begin, end in pairwise(poses):
            longest_s = 0.0
            for axis, (since, to) in enumerate(zip(_angles(begin), _angles(end), strict=True)):
                rate_dps = settings[110 + axis] / 60.0
                faster_dps2 = settings.get(120 + axis, 0.0)
                ramp_s = rate_dps / faster_dps2 if faster_dps2 > 0.0 else 0.0
                longest_s = max(longest_s, abs(to - since) / rate_dps + ramp_s)
            total_s += longest_s + _BETWEEN_MOVES_S
        return total_s


class _TumblePath:
    """Path of straight moves of a tumble, and the table's progress on it."""

    def __init__(self, poses: Sequence[Pose]) -> None:
        self._corners = [np.array(_angles(pose)) for pose in poses]
        lengths = [float(np.abs(end - begin).max()) for begin, end in pairwise(self._corners)]
        self._before = np.concatenate([[0.0], np.cumsum(lengths)]) / sum(lengths)
        self._leg = 0

    def part_at(self, position: Sequence[float]) -> float:
        """Return the part of the path before a position, which is on the latest leg or a later one."""
        for leg in range(self._leg, len(self._corners) - 1):
            begin, way = self._corners[leg], self._corners[leg + 1] - self._corners[leg]
            along = float(np.clip((position - begin) @ way / (way @ way), 0.0, 1.0))
            if np.abs(begin + along * way - position).max() < _OFF_THE_WAY_DEG:
                self._leg = leg
                return float(self._before[leg] + along * (self._before[leg + 1] - self._before[leg]))
        return float(self._before[self._leg])


def open_grbl_turntable(rig: Rig) -> GrblTurntable:
    """Open the port of a rig's motor table and wait for its controller.

    Parameters
    ----------
    rig
        Rig with a turntable of kind ``grbl``.

    Raises
    ------
    TurntableError
        When the port cannot be opened, no Grbl controller answers, or the controller contradicts the rig's declaration
        of the board.
    """
    try:
        port = open_port(rig.turntable.port or "")
    except HiltestError as error:
        raise TurntableError(f"turntable.port in {rig.path}: {error}") from error
    line = GrblLine(port)
    try:
        table = GrblTurntable(
            line,
            uncertainty_deg=rig.turntable.uncertainty_deg,
            dip_deg=rig.field.dip_deg,
            mounting_yaw_deg=rig.mounting.yaw_deg if rig.mounting else 0.0,
        )
        _refuse_contradiction(rig.board.cycle_model, table.board_model or SILICON, rig)
    except TurntableError:
        line.close()
        raise
    return table


def _refuse_contradiction(declared: str | None, reported: str, rig: Rig) -> None:
    """Refuse to record cycles under a model that the turntable contradicts."""
    if declared is not None and declared != reported:
        raise TurntableError(
            f"{rig.path} says that the cycle model of the board is {declared}, the turntable that it is {reported}. "
            f'Write cycle_model = "{reported}" under [board], or name the ports of the bench that is meant'
        )


def tumble_poses(dip_deg: float, *, mounting_yaw_deg: float = 0.0) -> list[Pose]:
    """Return the poses of a tumble by moves of all axes, none beyond half a turn.

    A full roll shows the field from a circle of directions about the nose; its radius is the angle between field and
    nose.
    """
    field_down, field_north = sin_cos_deg(dip_deg)
    poses = []
    for number, angle_deg in enumerate(_CIRCLES_DEG):
        across, along = sin_cos_deg(angle_deg)
        aside, above = sin_cos_deg(number * _ROUND_FIELD_DEG)
        north = along * field_north + across * above * field_down
        east = across * aside
        down = along * field_down - across * above * field_north
        heading_deg = math.degrees(math.atan2(east, north)) - mounting_yaw_deg
        pitch_deg = -math.degrees(math.atan2(down, math.hypot(north, east)))
        begin_deg = -180.0 if number % 2 == 0 else 180.0
        poses += [Pose(wrap_180(heading_deg), pitch_deg, roll) for roll in (begin_deg, -begin_deg)]
    return poses


def sway_poses() -> list[Pose]:
    """Return the corners of a sway, which starts and ends level, heading north, and tilts to all sides."""
    last = len(_SWAY_HEADINGS_DEG) - 1
    return [
        Pose(heading_deg, *_SWAY_TILTS_DEG[number % len(_SWAY_TILTS_DEG) if number < last else 0])
        for number, heading_deg in enumerate(_SWAY_HEADINGS_DEG)
    ]


def _feed(pose: Pose, speed_dps: float) -> str:
    return f"{_rapid(pose).replace('G0', 'G1')} F{60.0 * speed_dps:.0f}"


def _rapid(pose: Pose) -> str:
    return "G0 " + " ".join(f"{letter}{angle:.3f}" for letter, angle in zip("XYZ", _angles(pose), strict=True))


def _angles(pose: Pose) -> tuple[float, float, float]:
    return pose.heading_deg, pose.pitch_deg, pose.roll_deg
