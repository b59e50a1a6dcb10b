"""The calibrators of the packaged firmware, executed on the virtual board."""

from __future__ import annotations

import re
import struct
from functools import cache

import numpy as np

from hiltest.boards.bench import default_firmware
from hiltest.calibration.fit import MagnetometerFit
from hiltest.calibration.quality import COUNTS_PER_UT
from hiltest.json_files import read_json
from hiltest.judge.answers import Answer, Cloud, Entry
from hiltest.studies.board_calibrators import BoardCalibrators, board_calibrators, parse_fit
from hiltest.virtual.board.k64f import VirtualK64F
from hiltest.virtual.calls.buffers import Address, Structure

_COUNTS_PER_G = 8192.0
# dpi_known_t: gain [g/count] and offset of the accelerometer, sine of the dip, and whether it is given.
_KNOWN = struct.Struct("<9f3ffB3x")
_PAIR_FIT_BYTES = struct.calcsize("<BBH13fH2xff")  # dpi_fit_t, which begins with magnetometer_fit_t


class OwnCalibrator:
    """A calibrator of the packaged firmware.

    Parameters
    ----------
    name
        Its name in the firmware.
    """

    flash_bytes: int | None = None

    def __init__(self, name: str) -> None:
        self.name = name
        self._board: BoardCalibrators = board_calibrators()
        self.cycle_model = self._board.cycle_model
        self.built_by = packaged_compiler()

    def answer(self, cloud: Cloud) -> Answer:
        """Calibrate from samples."""
        return _answer(*self._board.calibrate(self.name, np.rint(COUNTS_PER_UT * cloud.samples_ut)))


class OwnJoint:
    """The packaged calibrator `joint`, which takes pairs of both sensors."""

    name = "joint"
    flash_bytes: int | None = None

    def __init__(self) -> None:
        self._board = VirtualK64F(default_firmware())
        self.cycle_model = board_calibrators().cycle_model
        self.built_by = packaged_compiler()

    def answer(self, cloud: Cloud) -> Answer:
        """Calibrate from pairs."""
        counts = np.rint(COUNTS_PER_UT * cloud.samples_ut).astype("<i2")
        gravity = np.rint(_COUNTS_PER_G * cloud.accelerations_g).astype("<i2")
        ends = np.concatenate([counts.min(axis=0), counts.max(axis=0)])
        pairs = Structure(Address(counts), Address(gravity), np.array([len(counts)], "<u2"), ends)
        known = _KNOWN.pack(*(np.eye(3) / _COUNTS_PER_G).ravel(), 0.0, 0.0, 0.0, 0.0, 0)
        result = bytearray(_PAIR_FIT_BYTES)
        cycles = self._board.call("joint_from_pairs", pairs, known, result).cycles
        return _answer(parse_fit(result), cycles)


def _answer(fit: MagnetometerFit, cycles: int) -> Answer:
    return Answer(not fit.has_fit, fit.hard_iron / COUNTS_PER_UT, fit.soft_iron, cycles=cycles)


@cache
def packaged_compiler() -> str:
    """Return compiler and version of the packaged firmware, in the form of `hiltest.judge.build.Build`."""
    manifest = read_json(default_firmware().with_name("manifest.json"), otherwise="install hiltest again").content
    name, version = re.findall(r"^\S+|\d+\.\d+\.\d+", str(manifest["compiler"]))[:2]
    return f"{name} {version} -O2"


def own_calibrators() -> list[Entry]:
    """Return the calibrators of the packaged firmware: those of its table, and `joint`."""
    return [*(OwnCalibrator(name) for name in board_calibrators().names), OwnJoint()]
