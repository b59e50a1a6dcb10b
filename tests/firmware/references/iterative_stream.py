"""`iterative-stream`: the public sensor-fusion libraries' calibration as it runs in life, in float64."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hiltest.calibration.fit import FitStatus, MagnetometerFit, no_fit
from hiltest.link.streams import StreamStatus

from .element_fits import Trial, fit_elements
from .magnetic_buffer import MagneticBuffer, cell_of

LOOPS_PER_SECOND = 25
AGEING_S = 86400.0
POWER_ON_FIT_ERROR_PERCENT = 1000.0
GOOD_FIT_ERROR_PERCENT = 4.0
SORTING_COUNTS = 500.0

# Elements: points held from which on the solver is used, and loops between two runs.
SOLVERS = {10: (250, 750), 7: (150, 250), 4: (100, 75)}


class IterativeStream:
    """The firmware's `iterative-stream`, not sliced: a point is a loop, and a solver runs within the one it is due in.

    Attributes
    ----------
    elements : int
        Of the present calibration's solver, 0 before the first.
    accepted : int
        Calibrations taken over so far.
    fit_error_percent : float
        Of the present calibration, aged.
    """

    def __init__(self) -> None:
        self.elements = 0
        self.accepted = 0
        self.fit_error_percent = POWER_ON_FIT_ERROR_PERCENT
        self._buffer = MagneticBuffer()
        self._calibration: Trial | None = None
        self._loops = self._started = self._highest = 0

    @property
    def held(self) -> int:
        """Points in the buffer."""
        return len(self._buffer.cells)

    @property
    def points(self) -> list[tuple[int, int, int]]:
        """Points in the buffer [counts], in the order of their cells."""
        return self._buffer.points

    def add(self, point: Sequence[int]) -> StreamStatus:
        """Sort a point into the buffer, and run the solver that is due."""
        self._loops += 1
        cell = cell_of(*self._calibrated(point))
        if cell is not None:
            self._buffer.store(cell, point, self._loops)
        elements = self._due()
        if elements:
            self._solve(elements)
        return StreamStatus.OK

    def fit(self) -> MagnetometerFit:
        """Return the present calibration."""
        if self._calibration is None:
            return no_fit(FitStatus.SINGULAR if self._highest else FitStatus.TOO_FEW_POINTS)
        return MagnetometerFit(
            FitStatus.ELLIPSOID, self.elements == 4, 0, self._calibration.soft_iron, self._calibration.hard_iron
        )

    def _calibrated(self, point: Sequence[int]) -> tuple[int, int, int]:
        if self._calibration is None:
            x, y, z = map(int, point)
            return x, y, z
        relative = np.asarray(point, dtype=np.float64) - self._calibration.hard_iron
        x, y, z = (int(c) for c in SORTING_COUNTS * (self._calibration.soft_iron @ relative))
        return x, y, z

    def _due(self) -> int:
        for elements, (minimum, interval) in SOLVERS.items():
            if self.held >= minimum:
                return elements if elements > self._highest or self._loops - self._started >= interval else 0
        return 0

    def _solve(self, elements: int) -> None:
        if self._calibration is not None:
            self.fit_error_percent *= 1.0 + (self._loops - self._started) / (LOOPS_PER_SECOND * AGEING_S)
        self._started = self._loops
        self._highest = elements
        trial = fit_elements(self.points, elements)
        if trial is None:
            return
        is_better = trial.fit_error_percent <= self.fit_error_percent
        has_more_elements = elements > self.elements and trial.fit_error_percent <= GOOD_FIT_ERROR_PERCENT
        if self._calibration is None or is_better or has_more_elements:
            self._calibration = trial
            self.fit_error_percent = trial.fit_error_percent
            self.elements = elements
            self.accepted += 1
