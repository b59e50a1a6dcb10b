"""Cost of the speed of `direct-fast`: its accuracy, and the cycles to store a point."""

from __future__ import annotations

from dataclasses import dataclass

from hiltest.boards.board import Board
from hiltest.calibration import reference
from hiltest.calibration.quality import direction_difference_rms_deg
from hiltest.errors import CalibrationError
from hiltest.link.messages import TimeRange
from hiltest.procedures.calibrate import calibrate_once
from hiltest.procedures.cycles import cycles_of, upload_points
from hiltest.procedures.golden_points import golden_points

FAST = "direct-fast"


@dataclass(frozen=True, slots=True)
class FastFit:
    """Accuracy of `direct-fast`, and the cost to store its points."""

    store_per_point: float
    """Cycles per point to keep the range of the points as they are stored; the fit needs that range."""
    distance_deg: float
    """rms angle between directions under its fit and under the float64 fit of the same points [deg]."""


def measure_fast_fit(board: Board, *, n: int = 100) -> FastFit:
    """Calibrate by `direct-fast`, and count the cycles that keep the range of its points.

    Parameters
    ----------
    board
        Board whose point buffer is replaced.
    n
        Number of golden points.

    Raises
    ------
    CalibrationError
        When the board refuses to fit them.
    DeviceError
        When the board's core has no cycle counter.
    """
    points = golden_points(n)
    upload_points(board, points)
    fit, _ = calibrate_once(board, FAST, n)
    if not fit.has_fit:
        raise CalibrationError(f"the board refuses golden points: {fit.status.name}; its {FAST} is not what it was")
    return FastFit(
        store_per_point=cycles_of(board.session.request(TimeRange(n))) / n,
        distance_deg=direction_difference_rms_deg(fit, reference(FAST)(points)),
    )
