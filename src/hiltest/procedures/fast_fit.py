"""`direct-fast`: what its speed costs, in accuracy and when points are stored, beside its cycles."""

from __future__ import annotations

from dataclasses import dataclass

from hiltest.boards.board import Board
from hiltest.calibration import reference
from hiltest.calibration.quality import direction_difference_rms_deg
from hiltest.errors import CalibrationError
from hiltest.link.messages import Calibrate, TimeRange
from hiltest.procedures.answered_fit import fit_of
from hiltest.procedures.clouds import golden_cloud
from hiltest.procedures.cycles import cycles_of, upload_cloud

FAST = "direct-fast"


@dataclass(frozen=True, slots=True)
class FastFit:
    """Accuracy of `direct-fast`, and the cost to store its points.

    Attributes
    ----------
    store_per_point : float
        Cycles per point to keep the range of the points as they are stored; the fit needs that range.
    distance_deg : float
        rms angle between directions under its fit and under the float64 fit of the same points [deg].
    """

    store_per_point: float
    distance_deg: float


def measure_fast_fit(board: Board, *, n: int = 100) -> FastFit:
    """Calibrate by `direct-fast`, and count what keeping the range of its points takes.

    Parameters
    ----------
    board : Board
        Its point buffer is replaced.
    n : int
        Points of a golden cloud.

    Raises
    ------
    CalibrationError
        When the board refuses to fit them.
    DeviceError
        When the board's core has no cycle counter.
    """
    cloud = golden_cloud(n)
    upload_cloud(board, cloud)
    fit = fit_of(board.timed(Calibrate(n, FAST), FAST))
    if not fit.has_fit:
        raise CalibrationError(f"the board refuses golden points: {fit.status.name}; its {FAST} is not what it was")
    return FastFit(
        store_per_point=cycles_of(board.session.request(TimeRange(n))) / n,
        distance_deg=direction_difference_rms_deg(fit, reference(FAST)(cloud)),
    )
