"""Cycles of the calibration against gravity: at 300 pairs, per pair, and fixed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hiltest.boards.board import Board
from hiltest.calibration import FitStatus
from hiltest.calibration.dpi import PAIRS_MINIMUM
from hiltest.errors import CalibrationError
from hiltest.link.dpi import FitDpi
from hiltest.link.messages import CycleSource
from hiltest.procedures.calibrate import UNCALIBRATED_SLOT
from hiltest.procedures.clouds import golden_pairs
from hiltest.procedures.cycles import CycleCost, fit_line, instructions_of, no_cycle_counter, upload_pairs
from hiltest.procedures.dpi import DPI
from hiltest.procedures.progress import Progress, silent

# From the fewest pairs that are fitted to the most that a board's buffer has.
DPI_SIZES = (PAIRS_MINIMUM, 400, 500)


def measure_dpi_cycles(
    board: Board, *, clouds: int = 2, sizes: Sequence[int] = DPI_SIZES, progress: Progress | None = None
) -> CycleCost:
    """Count the cycles of FIT_DPI on golden pairs.

    Parameters
    ----------
    board : Board
        Its point buffer is replaced.
    clouds : int
        How many the spread is over, each at the first size; at least 1.
    sizes : sequence of int
        Numbers of pairs that the line is over; `total` is at the first.

    Raises
    ------
    CalibrationError
        When the board refuses to fit them.
    DeviceError
        When the board's core has no cycle counter.
    """
    if board.identity.cycle_source is CycleSource.NONE:
        raise no_cycle_counter()
    tell = progress or silent
    work = [(sizes[0], index) for index in range(clouds)] + [(size, 0) for size in sizes[1:]]
    cycles: dict[tuple[int, int], int] = {}
    instructions = band = None
    for done, (size, index) in enumerate(work):
        tell("cycles of dpi", done, len(work))
        upload_pairs(board, *golden_pairs(size, index=index))
        reply = board.timed(FitDpi(size, UNCALIBRATED_SLOT), DPI)
        cost = reply.cost
        if reply.fit is not FitStatus.ELLIPSOID:
            raise CalibrationError(
                f"the board refuses {size} golden pairs against gravity: {reply.fit.name}. What a refusal costs is no "
                "measure of the fit: does slot 0 hold a good calibration of the accelerometer?"
            )
        if cost is None:
            raise no_cycle_counter()
        cycles[size, index] = cost.cycles
        if not done:
            instructions, band = instructions_of(board, cost), board.cycle_band(cost)
    tell("cycles of dpi", len(work), len(work))
    over_sizes = [cycles[size, 0] for size in sizes]
    at_first = [cycles[sizes[0], index] for index in range(clouds)]
    line = fit_line(sizes, over_sizes)
    return CycleCost(
        calibrator=DPI, model=board.cycle_model, n=sizes[0], total=at_first[0], per_point=line.slope,
        fixed=line.intercept, regression_residual=line.residual, spread=max(at_first) - min(at_first),
        instructions=instructions, band=band, iterations=0, per_iteration=None, sizes=np.array(sizes),
        cycles=np.array(over_sizes), unchecked=board.unchecked(DPI),
    )
