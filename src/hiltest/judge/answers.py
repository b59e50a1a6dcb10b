"""Answers of a judged calibrator, and their errors against the truth of a world."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol

import numpy as np

from hiltest.calibration.fit import Array
from hiltest.judge.worlds import World
from hiltest.measurement import CycleRange

_LARGEST_CONDITION = 100.0  # of a soft iron; that of the worlds is at most 1.5


@dataclass(frozen=True, slots=True, eq=False)
class Answer:
    """Calibration that an entry returned for one world."""

    refused: bool
    """True if the entry says that its calibration must not be used."""
    hard_iron_ut: Array
    """Shape (3,), body frame [uT]."""
    soft_iron: Array
    """Shape (3, 3): ``soft_iron @ (sample - hard_iron)`` is along the field; its scale is free."""
    cycles: int | None = None
    band: CycleRange | None = None
    stack_bytes: int | None = None
    host_us: float | None = None
    """Time on the host [us]."""


class Cloud(Protocol):
    """Samples to calibrate from."""

    @property
    def samples_ut(self) -> Array:
        """Shape (n, 3) [uT]."""

    @property
    def accelerations_g(self) -> Array:
        """Shape (n, 3): gravity at each sample, positive down."""

    @property
    def where(self) -> str:
        """Name for messages, such as ``in world noise/17``."""


class Entry(Protocol):
    """A calibrator to judge."""

    @property
    def name(self) -> str:
        """Name in tables."""

    @property
    def built_by(self) -> str:
        """Compiler and flags; empty if none is known."""

    @property
    def cycle_model(self) -> str:
        """Cycle model of the counts; empty without counts."""

    @property
    def flash_bytes(self) -> int | None:
        """Size of its code and constants, if they are known."""

    def answer(self, cloud: Cloud) -> Answer:
        """Calibrate from samples."""


class Outcome(StrEnum):
    """Kind of an answer."""

    ACCEPTED = "accepted"
    REFUSED = "refused"
    NO_ELLIPSOID = "no ellipsoid"


@dataclass(frozen=True, slots=True)
class Rating:
    """Errors of one answer."""

    outcome: Outcome
    rms_deg: float | None
    """rms heading error over the poses, of readings without noise; None if the soft iron is singular."""
    over_bound: float | None
    """The same as a multiple of the Cramér-Rao bound."""
    worst_deg: float | None
    """Largest heading error over the poses, of readings that are the mean of 16 samples."""


def rate(answer: Answer, world: World) -> Rating:
    """Compare an answer with the truth."""
    if not _is_ellipsoid(answer):
        outcome = Outcome.REFUSED if answer.refused else Outcome.NO_ELLIPSOID
        return Rating(outcome, None, None, None)
    errors, noisy = (
        world.poses.heading_errors_deg(answer.soft_iron, answer.hard_iron_ut, readings)
        for readings in (world.clean_readings_ut, world.readings_ut)
    )
    rms_deg = float(np.sqrt(np.mean(errors**2)))
    outcome = Outcome.REFUSED if answer.refused else Outcome.ACCEPTED
    return Rating(outcome, rms_deg, rms_deg / world.bound_deg, float(np.abs(noisy).max()))


def _is_ellipsoid(answer: Answer) -> bool:
    """Return whether the calibration maps an ellipsoid onto a sphere without a mirror."""
    if not (np.isfinite(answer.soft_iron).all() and np.isfinite(answer.hard_iron_ut).all()):
        return False
    singular = np.linalg.svd(answer.soft_iron, compute_uv=False)
    return bool(singular[0] < _LARGEST_CONDITION * singular[-1] and np.linalg.det(answer.soft_iron) > 0.0)
