"""Calibrators of users, which installed packages name by entry points of the group ``hiltest.calibrators``."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Collection
from dataclasses import dataclass
from functools import cache
from importlib.metadata import entry_points
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from hiltest.calibration.fit import (
    LARGEST_DIRECTION_ERROR_DEG,
    SMALLEST_DETERMINANT,
    Array,
    FitStatus,
    MagnetometerFit,
    no_fit,
    points_array,
)
from hiltest.errors import ConfigError

GROUP = "hiltest.calibrators"
_COUNTS_PER_UT = 10.0


@dataclass(frozen=True, slots=True)
class OwnCalibrator:
    """A function of samples, shape (n, 3) [uT], that returns hard iron [uT] and soft iron, or None to refuse them.

    The scale of the soft iron is free: corrected samples get a mean length of 1.
    """

    origin: str
    """Name, distribution and place, for error messages."""
    calibrate: Callable[[Array], Any]

    def __call__(
        self, points_counts: ArrayLike, *, largest_error_deg: float = LARGEST_DIRECTION_ERROR_DEG
    ) -> MagnetometerFit:
        """Calibrate from points, shape (n, 3) [counts].

        Raises
        ------
        ConfigError
            If the function raises an exception, or returns other shapes.
        """
        points = points_array(points_counts)
        try:
            with contextlib.redirect_stdout(sys.stderr):  # standard output is the command's, which may be JSON
                answer = self.calibrate(points / _COUNTS_PER_UT)
        except Exception as error:  # a user's function may raise anything
            raise ConfigError(f"{self.origin} raises {type(error).__name__}: {error}") from error
        if answer is None:
            return no_fit(FitStatus.REFUSED)
        try:
            hard_iron, soft_iron = (np.array(part, np.float64) for part in answer)
        except (TypeError, ValueError):
            hard_iron = soft_iron = np.empty(0)
        if hard_iron.shape != (3,) or soft_iron.shape != (3, 3):
            raise ConfigError(
                f"{self.origin} returns {answer!r:.200}: return hard_iron of shape (3,) and soft_iron of shape (3, 3), "
                "or None"
            )
        length = float(np.linalg.norm((points / _COUNTS_PER_UT - hard_iron) @ soft_iron.T, axis=1).mean())
        determinant, smallest = np.linalg.det(soft_iron), SMALLEST_DETERMINANT * np.abs(soft_iron).max() ** 3
        if not (np.isfinite(length) and abs(determinant) > smallest):
            return no_fit(FitStatus.SINGULAR)
        if determinant < 0.0:
            return no_fit(FitStatus.MIRRORED)
        return MagnetometerFit(
            FitStatus.ELLIPSOID, False, 0, soft_iron / length / _COUNTS_PER_UT, hard_iron * _COUNTS_PER_UT
        )


class FileCalibrator(Protocol):
    """A calibrator in a file of the user, FILE:FUNCTION; `hiltest.judge.entries` opens it."""

    @property
    def name(self) -> str:
        """FILE:FUNCTION."""

    @property
    def most_points(self) -> int | None:
        """Number of points that it takes; None for any."""

    def calibrate(self, points_counts: ArrayLike) -> tuple[MagnetometerFit, int | None]:
        """Calibrate from points, shape (n, 3) [counts]; also return its cycles, or None without a comparable count.

        Raises
        ------
        ConfigError
            If the function fails.
        BoardFault
            If it faults or does not return on the emulated core.
        """


def check_own_name(name: str, taken: Collection[str]) -> None:
    """Refuse a requested name that one of hiltest's calibrators and one of a package have.

    Raises
    ------
    ConfigError
        If both have it.
    """
    if name in taken and (origin := next((point.value for point in entry_points(group=GROUP, name=name)), "")):
        raise ConfigError(
            f"calibrator {name}: hiltest and an installed package ({origin}) have one; give the package's entry point "
            "another name"
        )


def own_names() -> list[str]:
    """Return the names of the calibrators of installed packages."""
    return sorted(entry_points(group=GROUP).names)


@cache
def own_calibrator(name: str) -> OwnCalibrator | None:
    """Return the calibrator of an installed package by its name; None if no package has it.

    Raises
    ------
    ConfigError
        If it cannot be imported or is no function, and no class with ``__call__``.
    """
    for entry_point in entry_points(group=GROUP, name=name):
        package = entry_point.dist
        version = f"{package.name} {package.version}" if package else "an unknown distribution"
        origin = f"the calibrator {name} of {version} ({entry_point.value})"
        try:
            with contextlib.redirect_stdout(sys.stderr):
                loaded = entry_point.load()
                calibrate = loaded() if isinstance(loaded, type) else loaded
        except Exception as error:  # a user's module may raise anything
            raise ConfigError(f"{origin} cannot be loaded, {type(error).__name__}: {error}") from error
        if not callable(calibrate):
            raise ConfigError(f"{origin} is no function, and no class with __call__: correct the entry point")
        return OwnCalibrator(origin, calibrate)
    return None
