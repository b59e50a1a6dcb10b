"""Methods of one's own in a study, by name: a calibrator of an installed package, a reference, or one in firmware."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hiltest.calibration import REFERENCES, reference
from hiltest.calibration.fit import Array, MagnetometerFit
from hiltest.calibration.own import check_own_name
from hiltest.errors import ConfigError
from hiltest.studies.board_calibrators import BoardCalibrators, board_calibrators


def own_methods(firmware: Path | None, calibrators: Sequence[str]) -> tuple[str, ...]:
    """Return the names of methods: FILE:NAME for each calibrator of firmware, and calibrators by name.

    Raises
    ------
    ConfigError
        If the firmware has no table of calibrators, or there is no calibrator by a name.
    """
    for name in calibrators:
        check_own_name(name, REFERENCES)
        reference(name)
    of_file = [] if firmware is None else [f"{firmware}:{name}" for name in _opened(str(firmware)).names]
    return tuple(dict.fromkeys((*of_file, *calibrators)))


def calibrate(method: str, counts: Array) -> tuple[MagnetometerFit, int | None]:
    """Run a method on points, shape (n, 3) [counts]; return the fit and, for one in firmware, its cycles."""
    file, colon, name = method.rpartition(":")
    if colon:
        return _opened(file).calibrate(name, np.rint(counts))
    return reference(method)(counts, largest_error_deg=math.inf), None


def split_firmware_method(method: str, study: str) -> tuple[str, str]:
    """Return the file and the calibrator of a method that is in firmware; `study` needs such a method."""
    file, colon, name = method.rpartition(":")
    if not colon:
        raise ConfigError(f"the study {study} runs calibrators of firmware: name a file with --firmware, not {method}")
    return file, name


def _opened(file: str) -> BoardCalibrators:
    board = board_calibrators(Path(file))
    if not board.names:
        raise ConfigError(
            f"{file} has no table of calibrators: link one as firmware_stub/calibration/README.md shows, or judge a "
            f"single function with hiltest judge {file} --function NAME"
        )
    return board
