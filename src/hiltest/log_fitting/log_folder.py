"""A folder of logs: the fit of each, and the agreement of its parts compared with the prediction."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hiltest.calibration import REFERENCES, is_unbiased, reference
from hiltest.calibration.acceptance import BOUNDS, Acceptance
from hiltest.calibration.conditioning import ellipsoid_condition
from hiltest.calibration.direction_error import predicted_direction_error
from hiltest.calibration.fit import FitStatus
from hiltest.calibration.quality import direction_difference_rms_deg
from hiltest.errors import ConfigError
from hiltest.log_fitting.fit_result import SampleFit
from hiltest.log_fitting.left_out import left_out
from hiltest.log_fitting.sample_fit import fit_on_host
from hiltest.log_fitting.samples import Samples, read_samples
from hiltest.measurement.units import FieldUnit

# Divisions of a log: first and second half, or odd and even pieces.
CUTS = {"halves": 2, "tenths": 10}
# Minimum number of readings: five in each of the 8 blocks of a part, whose spread gives its error.
_FEWEST = 40
_LARGEST_CONDITION = next(
    bound.limit for bound in BOUNDS if bound.figure == "condition" and bound.verdict is Acceptance.REFUSED
)


@dataclass(frozen=True, slots=True)
class Agreement:
    """Calibrations of two parts of a log."""

    cut: str
    """Name of the division in `CUTS`."""
    difference_deg: float
    """Angle between the same readings under both calibrations, rms over the sphere."""
    predicted_deg: float
    """Predicted angle from the spread of each. Bias is equal in both."""

    @property
    def ratio(self) -> float:
        """Measured over predicted angle: above 1 the prediction is too optimistic."""
        return self.difference_deg / self.predicted_deg if self.predicted_deg > 0.0 else math.inf


@dataclass(frozen=True, slots=True)
class LogFit:
    """A file of a folder."""

    name: str
    """Path relative to the folder."""
    fit: SampleFit | None = None
    agreements: tuple[Agreement, ...] = ()
    """Agreement of each division whose parts determine ellipsoids."""
    unread: str = ""
    """Reason why it could not be read; empty if it was."""


def fit_folder(
    folder: Path,
    *,
    columns: str | None = None,
    unit: FieldUnit | None = None,
    robust: bool = True,
    progress: Callable[[str, int, int], None] | None = None,
) -> Iterator[LogFit]:
    """Fit the logs below a folder on the host, in the order of their names; see `read_samples` and `fit_on_host`."""
    paths = sorted(path for path in folder.rglob("*") if path.is_file())
    for done, path in enumerate(paths):
        if progress is not None:
            progress("logs", done, len(paths))
        name = str(path.relative_to(folder))
        try:
            samples = read_samples(path, columns=columns, unit=unit)
            # For calibrations against gravity, parts would show less than the held-out dip.
            fit = fit_on_host(replace(samples, acceleration=None), robust=robust)
            yield LogFit(name, fit, agreements(samples, fit.best.name, robust=robust))
        except ConfigError as error:
            yield LogFit(name, unread=str(error).removeprefix(f"{path}: "))


def agreements(samples: Samples, calibrator: str, *, robust: bool = True) -> tuple[Agreement, ...]:
    """Return the difference between a calibrator's results on two parts of the samples, for each division."""
    if calibrator not in REFERENCES:
        return ()
    points = left_out(samples, robust=robust).rest.points
    results = (_agreement(points, calibrator, cut) for cut in CUTS)
    return tuple(result for result in results if result is not None)


def _agreement(points: NDArray[np.float64], name: str, cut: str) -> Agreement | None:
    piece = np.arange(len(points)) * CUTS[cut] // max(1, len(points))
    parts = [points[piece % 2 == odd] for odd in (0, 1)]
    if any(len(part) < _FEWEST or ellipsoid_condition(part) > _LARGEST_CONDITION for part in parts):
        return None
    fits = [reference(name)(part) for part in parts]
    if any(fit.status is not FitStatus.ELLIPSOID for fit in fits):
        return None
    predicted = [
        predicted_direction_error(part, fit, unbiased=is_unbiased(name, fit.iterations))
        for part, fit in zip(parts, fits, strict=True)
    ]
    first, second = predicted
    if first is None or second is None:
        return None
    expected_deg = math.hypot(first.spread_deg, second.spread_deg)
    return Agreement(cut, direction_difference_rms_deg(*fits), expected_deg)
