"""Methods of one's own in a study, by name: a reference, a calibrator of a package or a file, or one in firmware."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from hiltest.calibration import REFERENCES, reference
from hiltest.calibration.fit import Array, MagnetometerFit
from hiltest.calibration.own import FileCalibrator, check_own_name
from hiltest.errors import ConfigError
from hiltest.studies.board_calibrators import BoardCalibrators, board_calibrators
from hiltest.studies.study import Plan


def add_methods(plan: Plan, firmware: Path | None, calibrators: Sequence[str | FileCalibrator]) -> Plan:
    """Return a plan with methods: FILE:NAME for each calibrator of firmware, and calibrators.

    Raises
    ------
    ConfigError
        If the firmware has no table of calibrators, or there is no calibrator by a name.
    """
    names = [f"{firmware}:{name}" for name in _opened(str(firmware)).names] if firmware else []
    for calibrator in calibrators:
        if isinstance(calibrator, str):
            check_own_name(calibrator, REFERENCES)
            reference(calibrator)
        names.append(calibrator if isinstance(calibrator, str) else calibrator.name)
    files = tuple(calibrator for calibrator in calibrators if not isinstance(calibrator, str))
    return replace(plan, methods=tuple(dict.fromkeys(names)), files=files)


def calibrate(plan: Plan, method: str, counts: Array) -> tuple[MagnetometerFit, int | None]:
    """Run a method on points, shape (n, 3) [counts]; return the fit and, if they are counted, its cycles."""
    for own in plan.files:
        if own.name == method:
            return own.calibrate(counts)
    file, colon, name = method.rpartition(":")
    if colon:
        return _opened(file).calibrate(name, np.rint(counts))
    return reference(method)(counts, largest_error_deg=math.inf), None


def split_firmware_method(plan: Plan, method: str) -> tuple[str, str]:
    """Return the file and the calibrator of a method that is in firmware; the study needs such a method."""
    file, colon, name = method.rpartition(":")
    if not colon or any(own.name == method for own in plan.files):
        raise ConfigError(
            f"the study {plan.study} runs calibrators of firmware: name a file with --firmware, not {method}"
        )
    return file, name


def _opened(file: str) -> BoardCalibrators:
    board = board_calibrators(Path(file))
    if not board.names:
        raise ConfigError(
            f"{file} has no table of calibrators: link one as firmware_stub/calibration/README.md shows, or judge a "
            f"single function with hiltest judge {file} --function NAME"
        )
    return board
