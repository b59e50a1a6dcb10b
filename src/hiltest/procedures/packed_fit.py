"""`direct-fast`: what its speed costs, in accuracy and when points are stored, beside its cycles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hiltest.boards.board import Board
from hiltest.calibration import reference
from hiltest.calibration.quality import direction_difference_rms_deg
from hiltest.errors import CalibrationError
from hiltest.link.messages import Calibrate
from hiltest.link.packing import PackPoints
from hiltest.link.replies import CalibrateReply
from hiltest.measurement import CycleBand
from hiltest.procedures.answered_fit import fit_of
from hiltest.procedures.clouds import golden_cloud
from hiltest.procedures.cycles import cycles_of, upload_cloud

FAST = "direct-fast"


@dataclass(frozen=True, slots=True)
class PackedFit:
    """What `direct-fast` takes and gives, on the points as they come and packed when they were stored.

    Attributes
    ----------
    packed_total : int or None
        Cycles of a fit of packed points; None when the board did not use them packed.
    packed_band : CycleBand or None
        Within what they lie by the cycle model's own uncertainty; None where nobody knows what ran.
    not_packed : str
        Why there is nothing of packed points; empty when there is.
    store_per_point, pack_per_point : float
        Cycles per point to keep their range as they are stored, which the first needs, and to pack them.
    distance_deg, packed_distance_deg : float
        Of directions under these fits from those under the float64 fit of the same points, rms over the sphere [deg].
        The second is None when there is no fit of packed points.
    """

    packed_total: int | None
    packed_band: CycleBand | None
    not_packed: str
    store_per_point: float
    pack_per_point: float
    distance_deg: float
    packed_distance_deg: float | None


def measure_packed_fit(board: Board, *, n: int = 100) -> PackedFit:
    """Calibrate by `direct-fast` twice, the second time with points packed about the centre that the first found.

    They are packed as they are stored, as on a board that was calibrated before; what that costs is counted apart.

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
    raw = board.session.request(Calibrate(n, FAST))
    centre = np.rint(fit_of(raw).hard_iron).astype(int).tolist()
    stored = board.session.request(PackPoints(n, centre))
    upload_cloud(board, cloud, centre)
    packed = board.session.request(Calibrate(n, FAST))
    band, packed_distance_deg = board.cycle_band(packed.cost), _distance_deg(packed, cloud)
    total, not_packed = cycles_of(packed.cost), _not_packed(raw, packed, n)
    return PackedFit(
        packed_total=None if not_packed else total, packed_band=None if not_packed else band, not_packed=not_packed,
        store_per_point=cycles_of(stored.range_cost) / n, pack_per_point=cycles_of(stored.packing_cost) / n,
        distance_deg=_distance_deg(raw, cloud), packed_distance_deg=None if not_packed else packed_distance_deg,
    )  # fmt: skip


def _not_packed(raw: CalibrateReply, packed: CalibrateReply, n: int) -> str:
    """Return why a fit is not of packed points; empty when it is.

    No reply says so, but its cycles do: a fit whose points are packed already saves 8 cycles a point and more. One that
    does not use them takes as many as without, and those of finding that out.
    """
    total, raw_total = cycles_of(packed.cost), cycles_of(raw.cost)
    if total < raw_total - n:
        return ""
    return f"its fit did not use the packed points: {total} cycles with them, {raw_total} without"


def _distance_deg(reply: CalibrateReply, cloud: NDArray[np.int16]) -> float:
    fit = fit_of(reply)
    if not fit.has_fit:
        raise CalibrationError(f"the board refuses a golden cloud: {fit.status.name}; its {FAST} is not what it was")
    return direction_difference_rms_deg(fit, reference(FAST)(cloud))
