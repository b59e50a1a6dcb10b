"""Identification of a calibration's board, and the refusal of every other one."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import asdict
from hashlib import sha256

from hiltest.boards import Board
from hiltest.errors import ConfigError
from hiltest.link.replies import SensorKind
from hiltest.procedures.imu_calibration.calibration_file import CalibrationFile
from hiltest.procedures.imu_calibration.contents import ImuCalibration, MadeOn
from hiltest.rig import Rig
from hiltest.virtual.part.unique_id import VIRTUAL_UNIQUE_ID


def made_on(board: Board, rig: Rig) -> MadeOn:
    """Return the identification of a board for a calibration file."""
    identity = board.identity
    return MadeOn(
        kind="virtual" if board.origin == "virtual" else "real",
        firmware=identity.name,
        version=identity.version,
        build_id=identity.build_id,
        unique_id=identity.unique_id.hex(),
        rig=rig.name,
        world_sha256=world_sha256(rig),
    )


def world_sha256(rig: Rig) -> str | None:
    """Return a hash of a virtual board's sensors and their world; None if unknown.

    The field is included, because the hard iron depends on the place. The seed is not, because it only changes noise.
    """
    if rig.world is None:
        return None
    return sha256(json.dumps([asdict(rig.world), asdict(rig.field)], sort_keys=True).encode()).hexdigest()


def refuse_another_board(file: CalibrationFile, board: Board, rig: Rig) -> None:
    """Check that a calibration is of this board and of the sensors that it uses.

    Raises
    ------
    ConfigError
        If it is not; the message has the differences, and a remedy.
    """
    if not board.answers_requests:
        raise ConfigError(
            f"{file.path}: a calibration is stored by hiltest's protocol, and the firmware of rig "
            f"{rig.name} answers no requests: leave the calibration out"
        )
    other = next(_differences(file.calibration, board, rig), None)
    if other is not None:
        raise ConfigError(
            f"{file.path} is not of this board: {other}. Name the board's own file, or make one: hiltest calibrate"
        )


def _differences(calibration: ImuCalibration, board: Board, rig: Rig) -> Iterator[str]:
    original, present = calibration.made_on, made_on(board, rig)
    if original.firmware != present.firmware:
        yield f"it was made with firmware {original.firmware!r}, whose counts are its own; here is {present.firmware!r}"
    if original.unique_id != present.unique_id:
        yield f"it was made on the chip with unique id {original.unique_id}, this one has {present.unique_id}"
    if present.unique_id == VIRTUAL_UNIQUE_ID.hex():
        yield from _world_differences(original, present)
    parts = {
        SensorKind.ACCELEROMETER: calibration.accelerometer,
        SensorKind.GYROSCOPE: calibration.gyroscope,
        SensorKind.MAGNETOMETER: calibration.magnetometer,
    }
    for kind, part in parts.items():
        if part is not None and part.sensor != (used := board.sensor(kind).name):
            yield f"it calibrates the {kind.name.lower()} {part.sensor!r}, this rig uses {used!r}"


def _world_differences(original: MadeOn, present: MadeOn) -> Iterator[str]:
    """Yield differences of virtual boards, whose chips are equal: by their worlds, or else by the rigs' names."""
    if original.world_sha256 and present.world_sha256:
        if original.world_sha256 != present.world_sha256:
            yield (
                f"it was made in the world of rig {original.rig!r} as that was then; that of {present.rig!r} is another"
            )
    elif original.rig != present.rig:
        yield f"it was made on the virtual board of rig {original.rig!r}, this one is of {present.rig!r}"
