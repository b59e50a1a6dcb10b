"""The shipped firmware takes what the table at the end of firmware_stub/DESIGN.md says.

Cycles of the virtual board are exact, so they are compared exactly. Headings and fusion: test_orientation_cost.py.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import hiltest
from hiltest.link.messages import Calibrate, ClearPoints, TimeRange, Upload
from hiltest.link.replies import CalibrateReply, RunCost
from hiltest.link.request import Request, decode_reply
from hiltest.procedures.golden_points import golden_points
from hiltest.virtual.board.k64f import VirtualK64F
from hiltest.virtual.calls.buffers import Address, Structure
from hiltest.virtual.counts.profiling import CallProfile
from hiltest.virtual.profiling.image import ProfiledImage
from hiltest.virtual.program.elf import load_image

from ..dpi_instances import dpi_instance
from .bench import COSTS_BY, Bench
from .dpi_kernel import RESULT
from .packed_kernel import BoardPacked

PAGE = (Path(__file__).parents[2] / "firmware_stub" / "DESIGN.md").read_text(encoding="utf-8")
TABLE = {
    case: float(number.replace(" ", ""))
    for case, number in re.findall(r"^\| (.+?) \| ([\d .]+) \|$", PAGE.split("\n## Measured costs\n")[1], re.M)
}
SHIPPED = Path(hiltest.__file__).parent / "firmware"
SHIPPED_ELF = SHIPPED / "hiltest-frdm-k64f.elf"

Costs = dict[str, float]


class Calibrated:
    """CALIBRATE and TIME_RANGE on golden points."""

    def __init__(self, n: int) -> None:
        self._bench = Bench()
        self._n = n
        self._asked(ClearPoints())
        self._asked(Upload(0, golden_points(n).tolist()))

    def _asked(self, request: Request[object]) -> object:
        return decode_reply(request, self._bench.request(request.code, request.payload()).payload)

    def cycles(self, calibrator: str, *, iterations: int = 0) -> int:
        reply = self._asked(Calibrate(self._n, calibrator, iterations=iterations))
        assert isinstance(reply, CalibrateReply)
        assert reply.cost is not None
        return reply.cost.cycles

    def storing(self) -> float:
        cost = self._asked(TimeRange(self._n))
        assert isinstance(cost, RunCost)
        return cost.cycles / self._n


calibrated = cache(Calibrated)


@cache
def firmware() -> ProfiledImage:
    return ProfiledImage(SHIPPED_ELF, timing=COSTS_BY)


def middle(points: np.ndarray) -> list[int]:
    return np.trunc((points.min(axis=0).astype(int) + points.max(axis=0)) / 2).astype(int).tolist()


def profiled(calibrator: str, n: int, *, iterations: int = 0) -> CallProfile:
    counts = np.ascontiguousarray(golden_points(n), "<i2")
    spread = counts.min(axis=0), counts.max(axis=0)
    points = Structure(Address(counts), np.array([n], "<u2"), *spread, np.array([iterations], "<u2"))
    return firmware().call(f"magnetometer_{calibrator}", points, bytearray(64))


def own_cycles(profile: CallProfile) -> dict[str, int]:
    return {function.name: function.self_cycles for function in profile.functions}


def executed(profile: CallProfile) -> Counter[str]:
    """How often each kind of instruction ran; however many bytes it has."""
    counted: Counter[str] = Counter()
    for address in profile.addresses:
        counted[address.text.split()[0].removesuffix(".w")] += address.executions
    return counted


def stack() -> Costs:
    return {"deepest stack [bytes]": json.loads((SHIPPED / "manifest.json").read_text())["deepest_stack_bytes"]}


def direct() -> Costs:
    """`direct`: its cost a point, and the parts of what it takes whatever the number of points."""
    total = calibrated(100).cycles("direct")
    own = own_cycles(profiled("direct", 100))
    call = sum(own.values()) - total
    around = ("magnetometer_direct", "fit_closed_form", "fit_calibration")
    of_points = 5 * (own["moments_sum"] - own_cycles(profiled("direct", 80))["moments_sum"])
    return {
        "`direct`, 100 points": total,
        "`direct`, a point": (total - calibrated(20).cycles("direct")) / 80,
        "`direct`, without its points": total - of_points,
        "`direct`: `quadric_fit`": own["quadric_fit"],
        "`direct`: centre and level": own["quadric_ellipsoid"],
        "`direct`: square root": own["symmetric_square_root"],
        "`direct`: to enter and leave two passes": own["moments_sum"] - of_points,
        "`direct`: middle of the range": own["moments_anchor"],
        "`direct`: predicted error": own["moments_residual"] + own["fit_is_accurate"] + own["fit_ellipsoid"],
        "`direct`: the functions around these": sum(own[name] for name in around) - call,
        "an empty calibrator": call,
    }


def corrected() -> Costs:
    one, two = (executed(profiled("corrected", 100, iterations=item)) for item in (1, 2))
    once, twice = (calibrated(100).cycles("corrected", iterations=item) for item in (1, 2))
    return {
        "`corrected`, a Newton step": twice - once,
        "`corrected`: compares of floats in a step": two["vcmpe.f32"] - one["vcmpe.f32"],
    }


def iterative() -> Costs:
    called = profiled("iterative", 100)
    return {
        "`iterative`, 100 points [instructions]": called.instructions,
        "`iterative`, 100 points": called.cycles,
        "`iterative`: sums of the points": own_cycles(called)["moments_sum"],
        "`iterative`: rotations": own_cycles(called)["jacobi_diagonalise"],
    }


def inverse_iteration() -> Costs:
    called = profiled("inverse_iteration", 100)
    own = own_cycles(called)
    return {
        "`inverse-iteration`, 100 points": called.cycles,
        "`inverse-iteration`: its eigenvector": own["magnetometer_inverse_iteration"] + own["replace"],
    }


def direct_fast() -> Costs:
    return {
        "`direct-fast`, 100 points": calibrated(100).cycles("direct-fast"),
        "to store a point": calibrated(100).storing(),
    }


def packed_moments() -> Costs:
    board, points = BoardPacked(SHIPPED_ELF), golden_points(100)

    def cycles(method: str, points: np.ndarray, *arguments: int) -> int:
        getattr(board, method)(points, middle(points), *arguments)
        assert board.last is not None
        return board.last.cycles

    kernel = cycles("block", points, 5)
    return {
        "kernel, 100 points": kernel,
        "kernel, a point": (kernel - cycles("block", points[:20], 5)) / 80,
        "moments, 100 points": cycles("sum", points),
        "moments, 300 points": cycles("sum", golden_points(300)),
    }


def of_a_pair() -> tuple[Counter[str], float]:
    """What the kernel executes for a pair of points, by instruction, and its cycles; entries cancel."""
    counts: list[Counter[str]] = []
    cycles = []
    for pairs in (10, 50):  # both leave out two bodies of the first round of four
        room, raw = np.zeros(9 * pairs, "<u4"), np.zeros(6 * pairs, "<i2")
        settings = np.array([2 * pairs, 0, 0, 0, 0x8005, 0xFFE0FFFF, 0x43000000], "<u4")
        called = firmware().call(
            "packed_moments_block", Structure(Address(raw), Address(room), settings), bytearray(140)
        )
        counts.append(executed(called))
        cycles.append(called.cycles)
    fewer, more = counts
    return Counter({name: (more[name] - fewer[name]) // 40 for name in more}), (cycles[1] - cycles[0]) / 40


def kernel_of_a_pair() -> Costs:
    pair, cycles = of_a_pair()
    return {
        "kernel, a pair": cycles,
        "kernel, a pair: multiply-accumulates": pair["smlad"] + pair["smladx"],
        "kernel, a pair: products": sum(pair[f"smla{first}{second}"] for first in "bt" for second in "bt"),
        "kernel, a pair: roundings": pair["pkhtb"],
        "kernel, a pair: differences, packings and shifts": sum(
            pair[name] for name in ("lsl", "and", "ssub16", "pkhbt")
        ),
        "kernel, a pair: loads": pair["ldr"],
        "kernel, a pair: stores": pair["str"],
    }


def sizes() -> Costs:
    symbols = load_image(SHIPPED_ELF).symbols
    names = ("packed_moments_block", "packed_moments_sum", "sum_again", "magnetometer_direct_fast")
    return {f"`{name}` [bytes]": symbols[name].size for name in names}


def overflow() -> Costs:
    board, corners = BoardPacked(SHIPPED_ELF), np.full((100, 3), 760)
    corners[0] = -760
    board.sum(corners, [0, 0, 0])
    assert board.last is not None
    return {"moments, 100 points, one block redone": board.last.cycles}


def paired(n: int, fit: str = "dpi") -> CallProfile:
    drawn = dpi_instance(1, n, turn_deg=8.0 if fit == "dpi" else 0.0)  # without a rotation `joint` takes one step
    points, accelerations = (np.ascontiguousarray(item, "<i2") for item in (drawn.magnetometer, drawn.accelerometer))
    spread = points.min(axis=0), points.max(axis=0)
    pairs = Structure(Address(points), Address(accelerations), np.array([n], "<u2"), *spread)
    reference = np.array([*drawn.gain.ravel(), *drawn.offset, 0.0, 0.0], "<f4")  # the dip is not given
    return firmware().call(f"{fit}_from_pairs", pairs, reference, bytearray(RESULT.size))


def dpi() -> Costs:
    """`dpi`: its parts by what 50 more pairs take, which is what its sums are kept in registers for."""
    fewer, more = paired(300), paired(350)
    own, own_of_more = own_cycles(fewer), own_cycles(more)

    def of_a_pair(function: str) -> float:
        return (own_of_more[function] - own[function]) / 50

    pair = (more.cycles - fewer.cycles) / 50
    return {
        "`dpi`, 300 pairs": fewer.cycles,
        "`dpi`, a pair": pair,
        "`dpi`, a pair: its row": of_a_pair("dpi_sum_pairs"),
        "`dpi`, a pair: its sums": of_a_pair("dpi_add_rows"),
        "`dpi`, without its pairs": fewer.cycles - 300 * pair,
        "`dpi`: the matrix factored, and the unknowns": sum(
            own[name] for name in ("gravity_reduce", "gravity_factor", "gravity_substitute")
        ),
    }


def joint() -> Costs:
    """`joint`: one step, and its parts by what 50 more pairs take."""
    hundred, fewer, more = (paired(n, "joint") for n in (100, 300, 350))
    own, own_of_more = own_cycles(fewer), own_cycles(more)

    def of_a_pair(function: str) -> float:
        return (own_of_more[function] - own[function]) / 50

    return {
        "`joint`, 100 pairs": hundred.cycles,
        "`joint`, a pair: its row": of_a_pair("joint_make_rows"),
        "`joint`, a pair: its sums": of_a_pair("joint_add_rows"),
        "`joint`: the matrix factored": own["gravity_reduce"] + own["gravity_factor"],
        "`joint`: the equations, the step and what it leaves": own["refine"] + own["gravity_substitute"],
    }


def stream() -> Costs:
    board = VirtualK64F(SHIPPED_ELF, profile=COSTS_BY)
    state, point = bytearray(4096), golden_points(1).astype("<i2").tobytes()
    board.call("direct_stream_reset", state, 0)
    for _ in range(2):  # the first is the anchor
        adding = board.call("direct_stream_add", state, point).cycles
    return {
        "`direct-stream`, adding a point, with the call": adding,
        "`direct-stream`, taking one away, with the call": board.call("direct_stream_remove", state, point).cycles,
        "an empty step of a stream": board.call("empty_stream_add", state, point).cycles,
    }


MEASURED = (
    stack,
    direct,
    corrected,
    iterative,
    inverse_iteration,
    direct_fast,
    packed_moments,
    kernel_of_a_pair,
    sizes,
    overflow,
    dpi,
    joint,
    stream,
)


@pytest.mark.parametrize("measured", MEASURED, ids=lambda item: item.__name__)
def test_the_shipped_firmware_takes_what_the_table_says(measured: Callable[[], Costs]) -> None:
    result = measured()
    assert result == {case: TABLE.get(case) for case in result}


def test_what_direct_takes_is_the_sum_of_its_parts() -> None:
    result = direct()
    parts = [cycles for case, cycles in result.items() if case.startswith("`direct`:")]
    assert sum(parts) == result["`direct`, without its points"]


def test_the_table_has_no_row_that_is_not_measured() -> None:
    assert set(TABLE) == {case for measured in MEASURED for case in measured()}
