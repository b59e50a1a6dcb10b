"""What a tilt-compensated heading costs on the virtual board.

Virtual cycles are exact, so they are asserted exactly: a change of the firmware's C or of its compiler changes them
here and in firmware_stub/DESIGN.md, which also counts the lower bounds.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

import hiltest
from hiltest.orientation import tilt_heading
from hiltest.orientation.angles import heading_error_deg
from hiltest.orientation.quaternions import normalised, rotation_ned_from_body
from hiltest.virtual.board.k64f import VirtualK64F

from ..orientation.filters import floats
from .bench import COSTS_BY

SHIPPED_ELF = Path(hiltest.__file__).parent / "firmware" / "hiltest-frdm-k64f.elf"
HEADING_BOUND = 310
DIP_RAD = math.radians(62.0)
FIELD_NED = 500.0 * np.array([math.cos(DIP_RAD), 0.0, math.sin(DIP_RAD)])
# Of no preferred direction, so some are steep.
ATTITUDES = [normalised(drawn) for drawn in np.random.default_rng(1).normal(size=(300, 4))]


@pytest.fixture(scope="module")
def board() -> VirtualK64F:
    return VirtualK64F(SHIPPED_ELF, profile=COSTS_BY)


def test_a_heading_costs_825_cycles_in_the_mean(board: VirtualK64F) -> None:
    cycles = []
    for attitude in ATTITUDES:
        to_body = rotation_ned_from_body(attitude).T
        gravity, field = 8192.0 * to_body[:, 2], to_body @ FIELD_NED
        heading = bytearray(4)
        vectors = [bytes(floats(vector)) for vector in (gravity, field)]
        answer = board.call("tilt_heading", *vectors, heading, bytearray(4), bytearray(4))
        assert answer.value == 0
        error = heading_error_deg(np.frombuffer(heading, dtype="<f4")[0], tilt_heading(gravity, field).heading_deg)
        assert abs(error) < 0.01  # it did its work
        cycles.append(answer.cycles)
    print(f"tilt heading: {min(cycles)} to {max(cycles)} cycles, mean {np.mean(cycles):.1f}; bound {HEADING_BOUND}")
    assert (min(cycles), round(np.mean(cycles)), max(cycles)) == (720, 825, 883)
    assert min(cycles) >= HEADING_BOUND
