"""The C fit of turns against the float64 reference, compiled for this machine and on the virtual board."""

from __future__ import annotations

import ctypes
import struct
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from hiltest.boards import Board, open_board
from hiltest.calibration.gyroscope import MAX_TURNS, GyroscopeTurn, TurnsFit, TurnsStatus, fit_turns
from hiltest.link.gyroscope import FitGyroscope
from hiltest.rig.rig_file import load_rig

from .bench import COSTS_BY, ROOT

# gyroscope_turn_t and gyroscope_turns_fit_t.
TURN, FIT = struct.Struct("<3f3iHxxI3f3ff"), struct.Struct("<BBxx9ff")
Solve = Callable[[list[GyroscopeTurn]], TurnsFit]


def solver_of_this_machine(library: ctypes.CDLL) -> Solve:
    def solve(turns: list[GyroscopeTurn]) -> TurnsFit:
        packed = b"".join(
            TURN.pack(
                *turn.turned_deg,
                *map(int, turn.total),
                turn.n,
                round(1e6 * turn.duration_s),
                *turn.bias_before,
                *turn.bias_after,
                turn.share,
            )
            for turn in turns
        )
        stored = ctypes.create_string_buffer(packed, len(packed))
        fit = ctypes.create_string_buffer(FIT.size)
        library.gyroscope_turns_fit(struct.pack("PB7x", ctypes.addressof(stored), len(turns)), fit)
        status, at_fault, *matrix, residual_deg = FIT.unpack(fit.raw)
        named = at_fault if at_fault < MAX_TURNS else None
        return TurnsFit(TurnsStatus(status), named, np.array(matrix).reshape(3, 3), residual_deg)

    return solve


@pytest.fixture(scope="module")
def virtual_board() -> Board:
    rig = load_rig(ROOT / "hil" / "rigs" / "virtual-k64f.toml")
    return open_board(replace(rig, board=replace(rig.board, timing=COSTS_BY)))


@pytest.fixture(params=["host", "board"])
def solve(request: pytest.FixtureRequest) -> Solve:
    if request.param == "host":
        return solver_of_this_machine(request.getfixturevalue("host_library"))
    board: Board = request.getfixturevalue("virtual_board")
    return lambda turns: board.session.request(FitGyroscope(turns)).fit


def float32(values: np.ndarray) -> np.ndarray:
    """What the board is told: both sides then fit the same numbers."""
    return np.asarray(values, dtype=np.float32).astype(np.float64)


def random_turns(rng: np.random.Generator, count: int, *, spread: float = 1.0) -> list[GyroscopeTurn]:
    """Turns about axes as a table gives them; with a small `spread` they lie near a plane."""
    response = 16.0 * (np.eye(3) + rng.uniform(-0.1, 0.1, (3, 3)))
    axes = rng.normal(size=(count, 3)) * [1.0, 1.0, spread]
    axes /= np.linalg.norm(axes, axis=1)[:, None]
    turns = []
    for axis in axes:
        n, duration_us = int(rng.integers(400, 12_000)), int(rng.integers(2_000_000, 60_000_000))
        turned = float32(axis * rng.uniform(90.5, 1080.0))
        before, share = float32(rng.uniform(-60, 60, 3)), float(np.float32(rng.uniform()))
        after = float32(before + rng.normal(size=3))
        period_s = 1e-6 * duration_us / (n - 1)
        total = response @ turned / period_s + n * (before + share * (after - before)) + rng.normal(size=3) * 100.0
        turns.append(GyroscopeTurn(turned, np.round(total).astype(int), n, 1e-6 * duration_us, before, after, share))
    return turns


def tolerance(turns: list[GyroscopeTurn]) -> float:
    """Of the matrix, relative to its size: what float32 makes of the sums, of both inverses and of bias and time.

    A solution by normal equations loses the condition of the second moments; the closed-form inverse loses no more.
    Twenty roundings of 2^-24 a step, and sums that nearly cancel the bias lose its size beside what is left.
    """
    turned = np.array([turn.turned_deg for turn in turns])
    biases = [(turn.total, turn.n * turn.bias) for turn in turns]
    cancelled = max(float(np.abs(bias).max() / np.abs(total - bias).max()) for total, bias in biases)
    return 20.0 * 2.0**-24 * (np.linalg.cond(turned.T @ turned) + cancelled)


def test_random_turns_give_the_reference_s_matrix(solve: Solve) -> None:
    rng = np.random.default_rng(12)
    observed = 0
    for _ in range(300):
        turns = random_turns(rng, int(rng.integers(3, 9)))
        expected, result = fit_turns(turns), solve(turns)
        if near_a_limit(turns):
            continue
        assert (result.status, result.at_fault) == (expected.status, expected.at_fault)
        if expected.status is TurnsStatus.OK:
            observed += 1
            size = np.abs(expected.matrix).max()
            assert np.abs(result.matrix - expected.matrix).max() <= tolerance(turns) * size
            turned = max(float(np.linalg.norm(turn.turned_deg)) for turn in turns)
            assert result.residual_deg == pytest.approx(expected.residual_deg, abs=tolerance(turns) * turned)
    assert observed > 200


def near_a_limit(turns: list[GyroscopeTurn]) -> bool:
    """Whether float32 may fall on the other side of the bound on determinants: within 5 %."""
    turned = np.array([turn.turned_deg for turn in turns])
    moments = turned.T @ turned
    ratio = abs(np.linalg.det(moments)) / float(np.linalg.norm(moments, axis=1).max()) ** 3
    return bool(abs(ratio / 1e-3 - 1.0) < 0.05)


def test_turns_near_a_plane_are_refused_where_the_reference_refuses(solve: Solve) -> None:
    rng = np.random.default_rng(13)
    result = set()
    for _ in range(200):
        turns = random_turns(rng, int(rng.integers(3, 9)), spread=float(rng.choice([0.0, 0.02, 0.1, 0.3])))
        if not near_a_limit(turns):
            expected = fit_turns(turns).status
            assert solve(turns).status == expected
            result.add(expected)
    assert result == {TurnsStatus.OK, TurnsStatus.NOT_SPANNING}


def whole_turn(axis: int, **changes: object) -> GyroscopeTurn:
    turned, total = np.zeros(3), np.zeros(3, dtype=int)
    turned[axis], total[axis] = 360.0, 1_152_000  # 16 * 360 / 0.005
    given: dict[str, object] = {
        "turned_deg": turned,
        "total": total,
        "n": 1001,
        "duration_s": 5.0,
        "bias_before": np.zeros(3),
        "bias_after": np.zeros(3),
    }
    return GyroscopeTurn(**(given | changes))  # type: ignore[arg-type]


DEGENERATE = {
    "two turns": [whole_turn(0), whole_turn(1)],
    "a small turn": [whole_turn(0), whole_turn(1), whole_turn(2, turned_deg=np.array([0.0, 0, 89.9]))],
    "no turn": [whole_turn(0), whole_turn(1, turned_deg=np.zeros(3)), whole_turn(2)],
    "no samples": [whole_turn(0, n=0), whole_turn(1), whole_turn(2)],
    "one sample": [whole_turn(0), whole_turn(1, n=1), whole_turn(2)],
    "no time": [whole_turn(axis, duration_s=0.0) for axis in range(3)],
    "one axis": [whole_turn(2)] * 8,
    "a plane": [whole_turn(0), whole_turn(1), whole_turn(0, turned_deg=np.array([-360.0, 360.0, 0.0]))],
    "a dead axis": [whole_turn(0), whole_turn(1, total=np.zeros(3, dtype=int)), whole_turn(2)],
    "nothing felt": [whole_turn(axis, total=np.zeros(3, dtype=int)) for axis in range(3)],
    "largest sums": [whole_turn(axis, total=np.full(3, -(2**31))) for axis in range(3)],
    "largest counts": [whole_turn(axis, n=65_535, duration_s=4294.0) for axis in range(3)],
    "huge bias": [whole_turn(axis, bias_before=np.full(3, 3e38), bias_after=np.full(3, -3e38)) for axis in range(3)],
    "exact": [whole_turn(axis) for axis in range(3)],
}


@pytest.mark.parametrize("case", DEGENERATE)
def test_degenerate_turns_end_as_the_reference_s_do(solve: Solve, case: str) -> None:
    turns = DEGENERATE[case]
    expected, result = fit_turns(turns), solve(turns)
    if case == "huge bias":  # beyond float32: anything but a matrix
        assert result.status is TurnsStatus.SINGULAR
        return
    assert (result.status, result.at_fault) == (expected.status, expected.at_fault)
    assert np.allclose(result.matrix, expected.matrix, rtol=1e-5, atol=1e-9)


def test_the_fit_costs_what_it_did(virtual_board: Board) -> None:
    reply = virtual_board.session.request(FitGyroscope(DEGENERATE["exact"]))
    assert reply.cost is not None
    # In the cycle model from SRAM, three turns. A change of the kernel changes it, and is then stated here.
    assert reply.cost.cycles == 2830
