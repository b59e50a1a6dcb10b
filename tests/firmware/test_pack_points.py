"""Points packed as they are stored, about a centre known before, and PACK_POINTS, which tells what that costs.

Cycles tell whether CALIBRATE found them packed: `direct-fast` takes 800 fewer at 100 points.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from hiltest.calibration import FitStatus
from hiltest.link.messages import Calibrate, ClearPoints, Collect, Points, Upload
from hiltest.link.packing import PackingReply, PackPoints
from hiltest.link.replies import CalibrateReply, PointsReply, Status
from hiltest.link.request import Request, decode_reply
from hiltest.world.instances import instance

from .bench import Bench, bench_with

CLOUD = instance(7, 120, stretch=0.1, covered=(1.0, 1.0))
CENTRE = np.rint(10.0 * CLOUD.hard_iron_ut).astype(int).tolist()


def asked(bench: Bench, request: Request[object]) -> object:
    return decode_reply(request, bench.request(request.code, request.payload()).payload)


def calibrated(bench: Bench, n: int, calibrator: str = "direct-fast") -> CalibrateReply:
    answer = asked(bench, Calibrate(n, calibrator))
    assert isinstance(answer, CalibrateReply)
    assert answer.fit is FitStatus.ELLIPSOID
    return answer


def packed(bench: Bench, n: int) -> PackingReply:
    answer = asked(bench, PackPoints(n, CENTRE))
    assert isinstance(answer, PackingReply)
    return answer


def cycles(reply: CalibrateReply) -> int:
    assert reply.cost is not None
    return reply.cost.cycles


def stored(bench: Bench, points: np.ndarray, centre: Sequence[int] | None, *, at_once: int = 160) -> None:
    asked(bench, ClearPoints(centre))
    for first in range(0, len(points), at_once):
        asked(bench, Upload(first, points[first : first + at_once].tolist()))


@pytest.fixture(scope="module")
def shared() -> Bench:
    return Bench()


@pytest.fixture
def bench(shared: Bench) -> Bench:
    asked(shared, ClearPoints())
    asked(shared, Upload(0, CLOUD.points_counts.tolist()))
    return shared


def test_packed_points_make_the_same_calibration_in_fewer_cycles(bench: Bench) -> None:
    raw, direct = calibrated(bench, 100), calibrated(bench, 100, "direct")
    stored = packed(bench, 100)
    fast = calibrated(bench, 100)
    assert stored.range_cost is not None
    assert stored.packing_cost is not None
    print(
        f"{cycles(direct)} direct, {cycles(raw)} fast, {cycles(fast)} packed; to store a point "
        f"{stored.range_cost.cycles / 100:.1f} and {stored.packing_cost.cycles / 100:.1f}"
    )
    assert cycles(fast) + 800 < cycles(raw) < cycles(direct)
    assert 0 < stored.range_cost.cycles <= 40 * 100
    assert 0 < stored.packing_cost.cycles <= 80 * 100
    for reply in (raw, fast):
        assert np.allclose(reply.calibration.hard_iron, direct.calibration.hard_iron, atol=0.1)  # 0.01 uT
        assert np.allclose(reply.calibration.soft_iron * 500.0, direct.calibration.soft_iron * 500.0, atol=1e-3)


def test_other_points_than_those_are_not_taken_for_them(bench: Bench) -> None:
    raw = calibrated(bench, 90)
    packed(bench, 100)
    assert cycles(calibrated(bench, 90)) == cycles(raw)
    packed(bench, 90)
    assert cycles(calibrated(bench, 90)) < cycles(raw)
    asked(bench, ClearPoints())
    asked(bench, Upload(0, CLOUD.points_counts.tolist()))
    assert cycles(calibrated(bench, 90)) == cycles(raw)


def test_points_are_packed_as_they_are_stored(bench: Bench) -> None:
    """A calibration's centre is known: the next fit finds its points packed, and nothing was stored twice."""
    packed(bench, 120)
    wanted = calibrated(bench, 120)
    stored(bench, CLOUD.points_counts, None)
    assert cycles(calibrated(bench, 120)) > cycles(wanted) + 800
    for at_once in (120, 7):  # in odd parts too
        stored(bench, CLOUD.points_counts, CENTRE, at_once=at_once)
        got = calibrated(bench, 120)
        assert cycles(got) == cycles(wanted)
        assert np.array_equal(got.calibration.soft_iron, wanted.calibration.soft_iron)


def test_only_all_of_the_stored_points_are_found_packed(bench: Bench) -> None:
    raw = calibrated(bench, 100)
    stored(bench, CLOUD.points_counts, CENTRE)
    assert cycles(calibrated(bench, 100)) == cycles(raw)


def collected(bench: Bench, n: int, centre: Sequence[int] | None) -> np.ndarray:
    asked(bench, ClearPoints(centre))
    asked(bench, Collect(n))
    answer = asked(bench, Points(0, n))
    assert isinstance(answer, PointsReply)
    return answer.magnetometer


def test_collected_points_are_packed_as_well() -> None:
    """Of a board that lies still, about one of its readings: no fit, but `direct-fast` tries."""
    bench = bench_with("i2c1")
    centre = np.rint(collected(bench, 20, None).mean(axis=0)).astype(int).tolist()
    points = collected(bench, 80, centre)
    counted = []
    for again in (None, centre):
        answer = asked(bench, Calibrate(80, "direct-fast"))
        assert isinstance(answer, CalibrateReply)
        counted.append(cycles(answer))
        stored(bench, points, again)
    answer = asked(bench, Calibrate(80, "direct-fast"))
    assert isinstance(answer, CalibrateReply)
    as_collected, raw, as_uploaded = *counted, cycles(answer)
    assert as_collected == as_uploaded
    assert raw + 4000 < as_collected  # the packed points are tried, and then those as they are


def test_packing_ends_with_the_next_clear_points(bench: Bench) -> None:
    raw = calibrated(bench, 120)
    stored(bench, CLOUD.points_counts, CENTRE)
    stored(bench, CLOUD.points_counts, None)
    assert cycles(calibrated(bench, 120)) == cycles(raw)


def test_packing_ends_with_pack_points(bench: Bench) -> None:
    """What is stored later would be packed about another centre."""
    stored(bench, CLOUD.points_counts[:60], (0, 0, 0))
    packed(bench, 60)
    asked(bench, Upload(60, CLOUD.points_counts[60:].tolist()))
    stored_later = calibrated(bench, 120)
    stored(bench, CLOUD.points_counts, None)
    assert cycles(stored_later) == cycles(calibrated(bench, 120))


def test_a_point_too_far_away_ends_packing(bench: Bench) -> None:
    """It fits no 16 bits: the points are not all there, so `direct-fast` packs them by itself."""
    points = CLOUD.points_counts.astype(int).copy()
    points[50] = 32767
    stored(bench, points, None)
    raw = asked(bench, Calibrate(120, "direct-fast"))
    stored(bench, points, (-100, 0, 0))
    fit = asked(bench, Calibrate(120, "direct-fast"))
    assert isinstance(raw, CalibrateReply)
    assert isinstance(fit, CalibrateReply)
    assert cycles(fit) == cycles(raw)
    assert np.array_equal(fit.calibration.soft_iron, raw.calibration.soft_iron)


def test_a_centre_that_is_none_is_not_used(bench: Bench) -> None:
    """Any point of the surface, or one outside: rounding about it would count many times as much."""
    raw = calibrated(bench, 100)
    packed(bench, 100)
    by_packed_points = cycles(calibrated(bench, 100))
    outside = np.array(CENTRE) + 3 * (CLOUD.points_counts[:3].astype(int) - np.array(CENTRE))
    dearer = []
    for point in (*CLOUD.points_counts.tolist(), *outside.tolist()):
        asked(bench, PackPoints(100, point))
        fit = calibrated(bench, 100)
        dearer.append(cycles(fit) - cycles(raw))
        assert np.array_equal(fit.calibration.soft_iron, raw.calibration.soft_iron)
        assert np.array_equal(fit.calibration.hard_iron, raw.calibration.hard_iron)
    # Most are seen by the points' range; others, near a diagonal of the axes, by the centre that their fit finds.
    assert 0 < sorted(dearer)[len(dearer) // 2] < 100
    assert abs(max(dearer) - by_packed_points) < 100


def test_a_centre_is_used_to_a_quarter_of_the_field_away(bench: Bench) -> None:
    raw = calibrated(bench, 100)
    centre, soft_iron = raw.calibration.hard_iron, np.reshape(raw.calibration.soft_iron, (3, 3))
    for direction in np.vstack([np.eye(3), [[0.6, 0.0, -0.8]]]):
        for far, taken in ((0.24, True), (0.26, False)):
            place = np.rint(centre + far * np.linalg.solve(soft_iron, direction)).astype(int)
            asked(bench, PackPoints(100, place.tolist()))
            assert (cycles(calibrated(bench, 100)) < cycles(raw)) is taken


def test_what_is_refused(bench: Bench) -> None:
    for request, status in (
        (PackPoints(121, CENTRE), Status.TOO_FEW_POINTS), (PackPoints(65535, CENTRE), Status.TOO_FEW_POINTS),
    ):  # fmt: skip
        assert bench.status(request.code, request.payload()) is status
    for length in (1, 5):
        assert bench.status(ClearPoints.code, bytes(length)) is Status.BAD_LENGTH
    calibrated(bench, 120)  # and no point is lost by that
    assert bench.status(PackPoints.code, bytes(8)) is Status.BAD_ARGUMENT
    assert bench.status(PackPoints.code, bytes(7)) is Status.BAD_LENGTH
    with pytest.raises(ValueError, match="counts"):
        PackPoints(10, (0, 0, 32768)).payload()


def test_a_core_without_a_counter_packs_all_the_same() -> None:
    bench = Bench(cycle_counter=False)
    asked(bench, Upload(0, CLOUD.points_counts.tolist()))
    raw = calibrated(bench, 100)
    assert packed(bench, 100) == PackingReply(None, None)
    assert not np.array_equal(calibrated(bench, 100).calibration.hard_iron, raw.calibration.hard_iron)
