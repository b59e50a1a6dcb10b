"""The calibrators of the packaged firmware, executed on the virtual board."""

from __future__ import annotations

import re
from functools import cache

import numpy as np

from hiltest.boards.bench import default_firmware
from hiltest.calibration.quality import COUNTS_PER_UT
from hiltest.json_files import read_json
from hiltest.judge.answers import Answer
from hiltest.judge.worlds import World
from hiltest.studies.board_calibrators import BoardCalibrators, board_calibrators


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

    def answer(self, world: World) -> Answer:
        """Calibrate from the samples of a world."""
        fit, cycles = self._board.calibrate(self.name, np.rint(COUNTS_PER_UT * world.samples_ut))
        return Answer(not fit.has_fit, fit.hard_iron / COUNTS_PER_UT, fit.soft_iron, cycles=cycles)


@cache
def packaged_compiler() -> str:
    """Return compiler and version of the packaged firmware, in the form of `hiltest.judge.build.Build`."""
    manifest = read_json(default_firmware().with_name("manifest.json"), otherwise="install hiltest again").content
    name, version = re.findall(r"^\S+|\d+\.\d+\.\d+", str(manifest["compiler"]))[:2]
    return f"{name} {version} -O2"


def own_calibrators() -> list[OwnCalibrator]:
    """Return the calibrators of the packaged firmware, in the order of its table."""
    return [OwnCalibrator(name) for name in board_calibrators().names]
