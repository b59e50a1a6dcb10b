"""`iterative-stream`: its buffer is that of whole numbers, its calibrations are those of float64."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hiltest.calibration import FitStatus, MagnetometerFit
from hiltest.calibration.quality import direction_difference_rms_deg

from ..instances import instance
from .references.element_fits import fit_elements
from .references.iterative_stream import IterativeStream
from .references.magnetic_buffer import FULL
from .streams import BoardStream, Stream

MakeStream = Callable[[str], Stream]
Point = tuple[int, int, int]
CELLS, ROWS = 392, 14


def tumble(seed: int, count: int = 400, *, all_round: bool = True) -> list[Point]:
    drawn = instance(seed, count, stretch=0.2, covered=(1.0, 1.0) if all_round else (0.5, 1.0))
    return [(int(x), int(y), int(z)) for x, y, z in drawn.points_counts]


@pytest.fixture(scope="module")
def stream(stream: MakeStream) -> Stream:
    return stream("iterative-stream")


@pytest.fixture
def iterative(stream: Stream) -> Stream:
    stream.reset()
    return stream


_component = st.integers(-1500, 1500)


@settings(deadline=None)
@given(points=st.lists(st.tuples(_component, _component, _component), min_size=1, max_size=60))
def test_any_points_go_where_whole_numbers_say(stream: Stream, points: list[Point]) -> None:
    """Before there is a calibration, all is integers."""
    stream.reset()
    reference = IterativeStream()
    for point in points:
        stream.add(point)
        reference.add(point)
    assert stream.points() == reference.points


@pytest.mark.parametrize("all_round", [True, False])
def test_c_and_float64_go_the_same_way_point_by_point(host_stream: MakeStream, all_round: bool) -> None:
    """Held points, solvers, calibrations taken over: all the same; headings differ by what float32 makes of them.

    Points whose direction is a rounding away from the next cell's may part them; over these seeds none does.
    """
    result, seeds = host_stream("iterative-stream"), range(30)
    print(f"seeds {seeds}")
    differences: dict[int, list[float]] = {4: [], 7: [], 10: []}
    for seed in seeds:
        result.reset()
        reference = IterativeStream()
        before = 0
        for index, point in enumerate(tumble(seed, all_round=all_round)):
            result.add(point)
            reference.add(point)
            report = result.report()
            assert (report.held, report.elements, report.accepted) == (
                reference.held,
                reference.elements,
                reference.accepted,
            ), f"seed {seed}, point {index}"
            if report.accepted > before:
                before = report.accepted
                # float32 sums and rotations leave parts in 1e6 of the trace; the smallest eigenvalue, of which the fit
                # error is the root, is 1e-4 of it.
                assert report.fit_error_percent == pytest.approx(reference.fit_error_percent, rel=0.02)
                differences[report.elements].append(direction_difference_rms_deg(report.fit, reference.fit()))
        assert result.points() == reference.points, f"seed {seed}"
    for elements, difference in differences.items():
        median, p99, largest = np.percentile(difference, [50, 99, 100])
        print(f"{elements} elements: {len(difference)} calibrations, {median:.2g} / {p99:.2g} / {largest:.2g} deg")
        assert len(difference) >= 25
        # As for `iterative`: a fiftieth of what noise alone does to these fits.
        assert p99 <= 0.01


def test_a_full_buffer_frees_its_oldest_point(iterative: Stream) -> None:
    reference = IterativeStream()
    for index, point in enumerate(tumble(3, 900)):
        iterative.add(point)
        reference.add(point)
        assert iterative.report().held == reference.held, f"point {index}"
    assert reference.held == FULL
    assert iterative.points() == reference.points


@pytest.mark.parametrize(("held", "elements", "interval"), [(110, 4, 75), (160, 7, 250), (260, 10, 750)])
def test_each_solver_runs_again_after_its_interval(iterative: Stream, held: int, elements: int, interval: int) -> None:
    """One point over and over changes nothing in the buffer: a run takes the same fit over again, or ages it."""
    points = tumble(1)
    index = 0
    while iterative.report().held < held:
        iterative.add(points[index])
        index += 1
    runs: list[int] = []
    before = iterative.report()
    for loop in range(3 * interval):
        iterative.add(points[index - 1])
        report = iterative.report()
        if (report.accepted, report.fit_error_percent) != (before.accepted, before.fit_error_percent):
            runs.append(loop)
        before = report
    assert before.elements == elements
    assert set(np.diff(runs)) == {interval}


def test_more_elements_are_worth_a_worse_fit_but_not_any(host_stream: MakeStream) -> None:
    """Points get noisier on the way: a solver of more elements is taken over up to a fit error of 4 %."""
    fit_errors, refused, iterative = [], 0, host_stream("iterative-stream")
    for seed in range(40):
        noise_ut = 1.8 + 0.04 * seed
        noisy = instance(seed, 300, stretch=0.02, covered=(1.0, 1.0), noise_ut=noise_ut).points_counts.tolist()
        iterative.reset()
        reference = IterativeStream()
        before = iterative.report()
        first = instance(seed, 120, stretch=0.02, covered=(1.0, 1.0), noise_ut=0.1).points_counts.tolist()
        for point in [*first, *noisy]:
            iterative.add(point)
            reference.add(point)
            report = iterative.report()
            assert (report.held, report.elements, report.accepted) == (
                reference.held,
                reference.elements,
                reference.accepted,
            ), f"seed {seed}"
            if report.accepted > before.accepted > 0 and report.fit_error_percent > before.fit_error_percent:
                fit_errors.append(report.fit_error_percent)
            refused += report.held >= 250 and report.elements < 10
            before = report
    assert 3.8 < max(fit_errors) <= 4.0
    assert refused > 0


def test_the_calibration_finds_the_sensor(iterative: Stream) -> None:
    """Not only what the reference finds, but what is true."""
    drawn = instance(1, 400, stretch=0.2, covered=(1.0, 1.0))
    for point in drawn.points_counts:
        iterative.add(point)
    fit = iterative.report().fit
    # 10 elements of 250 points at 3 counts of noise: 3 * sqrt(3 / 250) = 0.3 counts of standard deviation an axis.
    assert np.abs(fit.hard_iron - 10.0 * drawn.hard_iron_ut).max() < 1.5
    soft_iron = np.linalg.inv(500.0 * drawn.soft_iron)
    truth = MagnetometerFit(FitStatus.ELLIPSOID, False, 0, soft_iron, 10.0 * drawn.hard_iron_ut)
    assert direction_difference_rms_deg(fit, truth) < 0.3


def test_a_field_that_is_not_the_earths_is_never_taken_over(iterative: Stream) -> None:
    strong = 95.0
    points = instance(5, 400, field_ut=strong, stretch=0.0, covered=(1.0, 1.0)).points_counts
    for point in points:
        iterative.add(point)
    report = iterative.report()
    assert (report.held > 250, report.accepted, report.fit.status) == (True, 0, FitStatus.SINGULAR)
    assert report.fit_error_percent == 1000.0
    assert np.array_equal(report.fit.soft_iron, np.eye(3))


def test_a_refused_calibration_lets_the_present_one_age(iterative: Stream) -> None:
    """After good points those of a noisy place: their fit is worse, and the good one is 30 s older."""
    noisy = instance(1, 1000, stretch=0.2, covered=(1.0, 1.0), noise_ut=2.0).points_counts.tolist()
    fit_errors = []
    for point in [*tumble(1), *noisy]:
        iterative.add(point)
        report = iterative.report()
        if report.elements == 10 and (not fit_errors or report.fit_error_percent != fit_errors[-1]):
            fit_errors.append(report.fit_error_percent)
    assert iterative.report().accepted == 3
    assert len(fit_errors) == 2
    # 750 loops at 25 Hz of a day; float32 rounds the ratio by at most 1e-7.
    assert fit_errors[1] / fit_errors[0] == pytest.approx(1.0 + 30.0 / 86400.0, abs=2e-7)


# Slices of a solver: the start, 14 rows or 392 cells, for 7 and 10 elements the matrix and, each sweep, its
# rotations and a look at the residue; then the calibration.
SLICES = {4: lambda sweeps: 16, 7: lambda sweeps: 395 + 22 * (sweeps + 1), 10: lambda sweeps: 395 + 46 * (sweeps + 1)}


def test_sliced_solvers_find_what_their_points_have_in_as_many_loops_as_slices(stream: Stream) -> None:
    stream.reset(sliced=True)
    began, accepted, was_solving = 0, 0, False
    snapshot: list[Point] = []
    observed = set()
    for index, point in enumerate(tumble(1, 2200)):
        stream.add(point)
        report = stream.report()
        if report.is_solving and not was_solving:
            began, snapshot = index, stream.points()
        if report.accepted > accepted:
            elements = fit_elements(snapshot, report.elements)
            assert elements is not None
            fit = MagnetometerFit(FitStatus.ELLIPSOID, False, 0, elements.soft_iron, elements.hard_iron)
            assert direction_difference_rms_deg(report.fit, fit) <= 0.01
            assert report.fit_error_percent == pytest.approx(elements.fit_error_percent, rel=0.02)
            assert index - began + 1 == SLICES[report.elements](report.fit.iterations)
            observed.add(report.elements)
        accepted, was_solving = report.accepted, report.is_solving
    assert observed == {4, 7, 10}


def test_while_sums_are_formed_the_buffer_takes_no_points(stream: Stream) -> None:
    stream.reset(sliced=True)
    points = tumble(2, 300)
    index = 0
    while not stream.report().is_solving:
        stream.add(points[index])
        index += 1
    held = stream.points()
    for point in points[index : index + 14]:
        stream.add(point)
        assert stream.points() == held
    stream.add(points[index + 14])
    assert stream.points() != held


def test_host_and_board_give_the_same_bits(host_stream: MakeStream, board_stream: Callable[[str], BoardStream]) -> None:
    """Point by point, so what the host shows over many seeds holds of the board."""
    for sliced, all_round in itertools.product((False, True), repeat=2):
        both = [host_stream("iterative-stream"), board_stream("iterative-stream")]
        for item in both:
            item.reset(sliced=sliced)
        for point in tumble(4, 500, all_round=all_round):
            for item in both:
                item.add(point)
            host, board = (item.report() for item in both)
            assert host.bits == board.bits
        assert both[0].points() == both[1].points()


@settings(deadline=None, max_examples=20)
@given(seed=st.integers(0, 10**6), scale=st.sampled_from([1, 40, 3000, 32767]), flat=st.booleans())
def test_no_points_whatever_end_in_nan_or_infinity(stream: Stream, seed: int, scale: int, flat: bool) -> None:
    points = np.random.default_rng(seed).integers(-scale, scale + 1, (400, 3))
    points[:, 1] *= not flat
    stream.reset()
    for point in points:
        stream.add(point)
    report = stream.report()
    assert np.isfinite(report.fit.soft_iron).all()
    assert np.isfinite(report.fit.hard_iron).all()
    assert math.isfinite(report.fit_error_percent)


@pytest.mark.parametrize("sliced", [False, True])
def test_points_at_the_ends_of_their_range_overflow_nothing(stream: Stream, sliced: bool) -> None:
    """The host's library stops at undefined behaviour. A calibration sees the far points too: it scales them up."""
    ends = np.random.default_rng(1).choice([-32768, -32767, -1, 0, 1, 32767], (3000, 3))
    stream.reset(sliced=sliced)
    for point in [*tumble(1, 200), *ends]:
        stream.add(point)
    report = stream.report()
    assert report.accepted
    assert np.isfinite(report.fit.soft_iron).all()


def _instructions(stream: BoardStream, *, sliced: bool) -> np.ndarray:
    stream.reset(sliced=sliced)
    counted = []
    for point in tumble(1, 4000):
        stream.add(point)
        assert stream.last is not None
        counted.append(stream.last.instructions)
    return np.array(counted)


@pytest.mark.parametrize(("sliced", "mean", "largest"), [(False, 1_459, 281_000), (True, 1_170, 22_600)])
def test_it_is_no_lame_horse(board_stream: Callable[[str], BoardStream], sliced: bool, mean: int, largest: int) -> None:
    """Of what the public releases 5.00 and 7 execute a point over their first 4 000, on average and at most."""
    counted = _instructions(board_stream("iterative-stream"), sliced=sliced)
    middle = np.median(counted)
    print(f"sliced {sliced}: mean {counted.mean():.0f}, median {middle:.0f}, max {counted.max()} instructions")
    assert counted.mean() <= mean
    assert counted.max() <= largest
