"""Does the stored bias take the gyroscope's offset away? Two rests: one stores, one judges."""

from __future__ import annotations

import pytest

from hiltest.boards import Board
from hiltest.fixtures import Measure
from hiltest.procedures import Progress, Turntable, measure_gyroscope_rest
from hiltest.rig import Rig

pytestmark = pytest.mark.hil


def test_bias_is_gone_in_the_second_rest(
    board: Board, turntable: Turntable, rig: Rig, measure: Measure, hil_progress: Progress
) -> None:
    turntable.rest()
    rest = measure_gyroscope_rest(board, seconds=rig.procedure.gyroscope_rest_s, progress=hil_progress)
    measure("gyroscope.bias_error", rest.bias_error_dps, "dps")
    measure("gyroscope.uncorrected_error", rest.uncorrected_error_dps, "dps")
