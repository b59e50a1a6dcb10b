"""firmware_stub/DESIGN.md says what the shipped firmware takes.

Headings and fusion are held to it in test_orientation_cost.py.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

import hiltest
from hiltest.link.messages import Calibrate, ClearPoints, TimeRange, Upload
from hiltest.link.replies import CalibrateReply, RunCost
from hiltest.link.request import Request, decode_reply
from hiltest.procedures.clouds import golden_cloud
from hiltest.profiling.image import ProfiledImage
from hiltest.virtual.buffers import Address, Structure
from hiltest.virtual.elf import load_image
from hiltest.virtual.k64f import VirtualK64F
from hiltest.virtual.profiling import CallProfile

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
    """What CALIBRATE and TIME_RANGE count on golden clouds."""

    def __init__(self) -> None:
        self._bench = Bench()
        self._cloud = np.empty((0, 3), dtype=np.int16)

    def _asked(self, request: Request[object]) -> object:
        return decode_reply(request, self._bench.request(request.code, request.payload()).payload)

    def store(self, n: int = 100) -> None:
        self._cloud = golden_cloud(n)
        self._asked(ClearPoints())
        self._asked(Upload(0, self._cloud.tolist()))

    def cycles(self, calibrator: str, *, iterations: int = 0) -> int:
        reply = self._asked(Calibrate(len(self._cloud), calibrator, iterations=iterations))
        assert isinstance(reply, CalibrateReply)
        assert reply.cost is not None
        return reply.cost.cycles

    def storing(self) -> float:
        cost = self._asked(TimeRange(len(self._cloud)))
        assert isinstance(cost, RunCost)
        return cost.cycles / len(self._cloud)


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


@pytest.fixture(scope="module")
def firmware() -> ProfiledImage:
    return ProfiledImage(SHIPPED_ELF)


def profiled(firmware: ProfiledImage, calibrator: str, n: int, *, iterations: int = 0) -> CallProfile:
    cloud = np.ascontiguousarray(golden_cloud(n), "<i2")
    spread = cloud.min(axis=0), cloud.max(axis=0)
    points = Structure(Address(cloud), np.array([n], "<u2"), *spread, np.array([iterations], "<u2"))
    return firmware.call(f"magnetometer_{calibrator}", points, bytearray(64))


def own_cycles(profile: CallProfile) -> dict[str, int]:
    return {each.name: each.self_cycles for each in profile.functions}


def test_what_direct_takes_whatever_the_number_of_points_is_the_sum_of_its_parts(
    calibrated: Calibrated, firmware: ProfiledImage
) -> None:
    calibrated.store()
    total = calibrated.cycles("direct")
    own = own_cycles(profiled(firmware, "direct", 100))
    call = sum(own.values()) - total
    of_points = 5 * (own["moments_sum"] - own_cycles(profiled(firmware, "direct", 80))["moments_sum"])
    passes = own["moments_sum"] - of_points
    middle, function = own["moments_anchor"], own["magnetometer_direct"] - call
    centre, root, fit = own["quadric_ellipsoid"], own["symmetric_square_root"], own["quadric_fit"]
    rest = passes + middle + function
    assert fit + centre + root + rest == total - of_points
    assert f"takes {spaced(total - of_points)}: `quadric_fit`, {centre} for centre" in PAGE
    assert f"{root} for the square root, and {rest} for the rest: {passes} to enter" in PAGE
    assert f"{middle} for the middle of the range, and {function} for the function itself" in PAGE
    assert f"itself without the {call} of an empty one" in PAGE
    assert f"| measured | {fit} |" in PAGE


def executed(profile: CallProfile) -> Counter[str]:
    """How often each kind of instruction ran; however many bytes it has."""
    counted: Counter[str] = Counter()
    for each in profile.addresses:
        counted[each.text.split()[0].removesuffix(".w")] += each.executions
    return counted


def test_the_lower_bounds_of_the_fit_and_of_a_step_are_the_sums_of_their_rows(firmware: ProfiledImage) -> None:
    (table,) = re.findall(r"a Newton step of `corrected` \|(.*?)\| measured", PAGE)
    rows = [tuple(map(int, each)) for each in re.findall(r"\| (\d+) \| (\d+) \|", table)]
    assert [sum(column) for column in zip(*rows[:-1], strict=True)] == list(rows[-1])
    one, two = (executed(profiled(firmware, "corrected", 100, iterations=each)) for each in (1, 2))
    floats = two["vcmpe.f32"] - one["vcmpe.f32"]
    compares = f"a compare with its branch: 3 of floats, {floats} in a step; 1 in the fit, where a division hides"
    assert f"| {compares} the compare | 1 | {3 * floats + 1} |" in PAGE


def test_what_of_iterative_sums_the_points(firmware: ProfiledImage) -> None:
    called = profiled(firmware, "iterative", 100)
    parts = (called.instructions, called.cycles, own_cycles(called)["moments_sum"])
    instructions, cycles, sums = (spaced(round(each, -2)) for each in parts)
    assert f"{instructions} instructions and {cycles} cycles for 100 points" in PAGE
    assert f"of which {sums} sum the points" in PAGE


def test_direct_fast(calibrated: Calibrated) -> None:
    calibrated.store()
    assert row("`direct-fast`") == spaced(calibrated.cycles("direct-fast"))
    assert row("to store a point") == f"{calibrated.storing():.0f}"


def test_moments_of_two_points_a_word() -> None:
    board, points, more = BoardPacked(SHIPPED_ELF), golden_cloud(100), golden_cloud(300)

    def cycles(method: str, points: np.ndarray, *arguments: int) -> int:
        getattr(board, method)(points, middle(points), *arguments)
        assert board.last is not None
        return board.last.cycles

    kernel, whole = cycles("block", points, 5), cycles("sum", points)
    slope = (kernel - cycles("block", points[:20], 5)) / 80
    assert row("kernel") == spaced(kernel)
    assert f"{slope:.1f} a point and {round(kernel - 100 * slope, -1):.0f}: entries" in PAGE
    assert row("moments") == spaced(whole)
    assert f"{whole / 100:.1f} a point, {cycles('sum', more) / 300:.1f} at n = 300 in three blocks" in PAGE


def of_a_pair(firmware: ProfiledImage) -> tuple[Counter[str], float]:
    """What the kernel executes for a pair of points, by instruction, and its cycles; entries cancel."""
    counts: list[Counter[str]] = []
    cycles = []
    for pairs in (10, 50):  # both leave out two bodies of the first round of four
        room, raw = np.zeros(9 * pairs, "<u4"), np.zeros(6 * pairs, "<i2")
        settings = np.array([2 * pairs, 0, 0, 0, 0x8005, 0xFFE0FFFF, 0x43000000], "<u4")
        called = firmware.call("packed_moments_block", Structure(Address(raw), Address(room), settings), bytearray(140))
        counts.append(executed(called))
        cycles.append(called.cycles)
    fewer, more = counts
    return Counter({name: (more[name] - fewer[name]) // 40 for name in more}), (cycles[1] - cycles[0]) / 40


def test_a_lower_bound_of_the_kernel_is_what_its_bodies_execute(firmware: ProfiledImage) -> None:
    pair, cycles = of_a_pair(firmware)
    sums, roundings = pair["smlad"] + pair["smladx"], pair["pkhtb"]
    products = sum(pair[f"smla{first}{second}"] for first in "bt" for second in "bt")
    # Each word once, in one group: the first load takes a cycle more.
    others = pair["lsl"] + pair["and"] + pair["ssub16"] + pair["pkhbt"] + 3 + 1
    bound = sums + products + roundings + others
    assert f"{sums} multiply-accumulates, {products} products, {roundings} roundings, 3 words loaded (4)" in PAGE
    assert f": {bound}, which is {bound / 2:g} a point" in PAGE
    assert (pair["ldr"], pair["str"]) == (3 + 14 + 3, 9)
    measured = bound + 6 + 23
    assert f"Measured {measured}, and {cycles - measured:g} for loops" in PAGE


def test_the_sizes_of_what_sums_packed_moments() -> None:
    symbols = load_image(SHIPPED_ELF).symbols

    def size(*names: str) -> str:
        return spaced(sum(symbols[name].size for name in names))

    assert f"The kernel is {size('packed_moments_block')} bytes of code." in PAGE
    assert f"`packed_moments_sum`, which cuts blocks and adds them, {size('packed_moments_sum')};" in PAGE
    others = ("sum_again", "magnetometer_direct_fast")
    assert ", ".join(f"`{name}` {size(name)}" for name in others) + "." in PAGE


def test_an_overflow() -> None:
    board, corners = BoardPacked(SHIPPED_ELF), np.full((100, 3), 760)
    corners[0] = -760
    board.sum(corners, [0, 0, 0])
    assert board.last is not None
    redone = board.last.cycles
    points = golden_cloud(100)
    board.sum(points, middle(points))
    assert board.last is not None
    assert f"{spaced(redone)} cycles where {spaced(board.last.cycles)} would do" in PAGE


def test_a_point_of_a_stream() -> None:
    board = VirtualK64F(SHIPPED_ELF)
    state, point = bytearray(4096), golden_cloud(1).astype("<i2").tobytes()
    board.call("direct_stream_reset", state, 0)
    for _ in range(2):  # the first is the anchor
        adding = board.call("direct_stream_add", state, point).cycles
    removing = board.call("direct_stream_remove", state, point).cycles
    empty = board.call("empty_stream_add", state, point).cycles
    reported = f"reports have {adding - empty} and {removing - empty}, for the firmware subtracts the {empty} of an"
    assert f"Measured: adding {adding}, taking away {removing}, with the call; {reported} empty" in PAGE
