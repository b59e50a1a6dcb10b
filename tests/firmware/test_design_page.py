"""firmware_stub/DESIGN.md says what the shipped firmware takes.

Headings and fusion are held to it in test_orientation_cost.py.
"""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

import hiltest
from hiltest.link.messages import Calibrate, ClearPoints, Upload
from hiltest.link.packing import PackingReply, PackPoints
from hiltest.link.replies import CalibrateReply
from hiltest.link.request import Request, decode_reply
from hiltest.procedures.clouds import golden_cloud
from hiltest.virtual.elf import load_image
from hiltest.virtual.k64f import VirtualK64F

from .bench import Bench
from .packed_kernel import BoardPacked

PAGE = " ".join((Path(__file__).parents[2] / "firmware_stub" / "DESIGN.md").read_text().split())
SHIPPED = Path(hiltest.__file__).parent / "firmware"
SHIPPED_ELF = SHIPPED / "hiltest-frdm-k64f.elf"


def spaced(number: int) -> str:
    """Thousands as the page writes them."""
    return f"{number:,}".replace(",", " ")


def row(label: str) -> str:
    """The number in the row of a table that begins with a label."""
    found = re.search(rf"\| {re.escape(label)} \| ([\d ]+) \|", PAGE)
    assert found is not None, f"no row {label!r}"
    return found[1]


def middle(points: np.ndarray) -> list[int]:
    return np.trunc((points.min(axis=0).astype(int) + points.max(axis=0)) / 2).astype(int).tolist()


class Calibrated:
    """What CALIBRATE and PACK_POINTS count on golden clouds."""

    def __init__(self) -> None:
        self._bench = Bench()
        self._cloud = np.empty((0, 3), dtype=np.int16)

    def _asked(self, request: Request[object]) -> object:
        return decode_reply(request, self._bench.request(request.code, request.payload()).payload)

    def store(self, n: int = 100, *, packed: bool = False) -> None:
        self._cloud = golden_cloud(n)
        self._asked(ClearPoints(middle(self._cloud) if packed else None))
        self._asked(Upload(0, self._cloud.tolist()))

    def cycles(self, calibrator: str, *, iterations: int = 0) -> int:
        reply = self._asked(Calibrate(len(self._cloud), calibrator, iterations=iterations))
        assert isinstance(reply, CalibrateReply)
        assert reply.cost is not None
        return reply.cost.cycles

    def storing(self) -> tuple[float, float]:
        reply = self._asked(PackPoints(100, middle(self._cloud)))
        assert isinstance(reply, PackingReply)
        assert reply.range_cost is not None
        assert reply.packing_cost is not None
        return reply.range_cost.cycles / 100, reply.packing_cost.cycles / 100


@pytest.fixture(scope="module")
def calibrated() -> Calibrated:
    return Calibrated()


def test_the_depth_of_the_stack() -> None:
    depth = json.loads((SHIPPED / "manifest.json").read_text())["deepest_stack_bytes"]
    assert f"the deepest frames ({depth / 1024:.1f} KiB with an interrupt on top" in PAGE


def test_direct_and_a_step_of_corrected(calibrated: Calibrated) -> None:
    calibrated.store(20)
    fifth = calibrated.cycles("direct")
    calibrated.store()
    assert f"Measured: {(calibrated.cycles('direct') - fifth) / 80:.2f}. 34 sums" in PAGE
    step = calibrated.cycles("corrected", iterations=2) - calibrated.cycles("corrected", iterations=1)
    assert f": {spaced(step)} cycles a step whatever the number of points" in PAGE
    assert re.search(rf"\| measured \| [\d ]+ \| {spaced(step)} \|", PAGE)


def test_direct_fast(calibrated: Calibrated) -> None:
    calibrated.store()
    assert row("`direct-fast`") == spaced(calibrated.cycles("direct-fast"))
    storing, packing = calibrated.storing()
    calibrated.store(packed=True)
    assert row("`direct-fast`, points packed") == spaced(calibrated.cycles("direct-fast"))
    assert (row("to store a point"), row("to pack a point as well")) == (f"{storing:.0f}", f"{packing:.0f}")


def test_moments_of_two_points_a_word() -> None:
    board, points, more = BoardPacked(SHIPPED_ELF), golden_cloud(100), golden_cloud(300)

    def cycles(method: str, points: np.ndarray, *arguments: int) -> int:
        getattr(board, method)(points, middle(points), *arguments)
        assert board.last is not None
        return board.last.cycles

    kernel, raw, packed = cycles("block", points, 5), cycles("sum", points), cycles("sum_packed", points)
    slope = (kernel - cycles("block", points[:20], 5)) / 80
    assert row("kernel") == spaced(kernel)
    assert f"{slope:.1f} a point and {round(kernel - 100 * slope, -1):.0f}: entries" in PAGE
    assert row("moments") == spaced(raw)
    assert f"{raw / 100:.1f} a point, {cycles('sum', more) / 300:.1f} at n = 300 in three blocks" in PAGE
    assert row("moments, points packed") == spaced(packed)
    assert f"{packed / 100:.1f} a point, all of it" in PAGE
    assert f"The code is {spaced(load_image(SHIPPED_ELF).symbols['packed_moments_block'].size)} bytes" in PAGE


def test_an_overflow() -> None:
    board, corners = BoardPacked(SHIPPED_ELF), np.full((100, 3), 760)
    corners[0] = -760
    board.sum(corners, [0, 0, 0])
    raw = board.last
    board.sum_packed(corners, [0, 0, 0])
    assert raw is not None
    assert board.last is not None
    assert board.again is not None
    packed = spaced(board.last.cycles + board.again.cycles)
    assert f"{packed} cycles where {spaced(board.last.cycles)} would do, {spaced(raw.cycles)} with points" in PAGE


def test_a_point_of_a_stream() -> None:
    board = VirtualK64F(SHIPPED_ELF)
    state, point = bytearray(4096), golden_cloud(1).astype("<i2").tobytes()
    board.call("direct_stream_reset", state, 0)
    for _ in range(2):  # the first is the anchor
        adding = board.call("direct_stream_add", state, point).cycles
    removing = board.call("direct_stream_remove", state, point).cycles
    assert f"Measured: adding {adding}, taking away {removing}." in PAGE
