"""The firmware's calibrators, compiled for the host, against float64 and exact arithmetic."""

from __future__ import annotations

import ctypes
import json
import subprocess
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import ArrayLike

from hiltest.calibration import FitStatus, MagnetometerFit, reference
from hiltest.calibration.quality import direction_difference_rms_deg
from hiltest.world.instances import Instance, instance

ROOT = Path(__file__).parents[2]
CALIBRATION = ROOT / "firmware_stub" / "calibration"
CLOUDS = sorted((ROOT / "fixtures" / "clouds").glob("*.json"))
CALIBRATORS = ("direct", "iterative")
GOOD_SEEDS = range(1000, 1570)
CAP_SEEDS = range(2000, 2030)  # 30 of 600: 5 %
FLOAT32_EPSILON = 2.0**-23


class Runner(Protocol):
    """Something that runs the firmware's C: a host library, or a board."""

    def calibrate(self, name: str, points: ArrayLike) -> MagnetometerFit: ...

    def moments(self, points: ArrayLike, anchor: ArrayLike) -> list[float]: ...


class _Points(ctypes.Structure):
    _fields_ = [
        ("points", ctypes.c_void_p),
        ("count", ctypes.c_uint16),
        ("minimum", ctypes.c_int16 * 3),
        ("maximum", ctypes.c_int16 * 3),
    ]


class _Fit(ctypes.Structure):
    _fields_ = [
        ("status", ctypes.c_uint8),  # -fshort-enums, as on the target
        ("is_sphere", ctypes.c_uint8),
        ("iterations", ctypes.c_uint16),
        ("soft_iron", ctypes.c_float * 9),
        ("hard_iron", ctypes.c_float * 3),
        ("coverage", ctypes.c_float),
    ]


@dataclass(frozen=True)
class HostLibrary:
    """The calibration sources as a shared library of this machine."""

    library: ctypes.CDLL

    def calibrate(self, name: str, points: ArrayLike) -> MagnetometerFit:
        fit = _Fit()
        held, counts = _pass_points(points)
        getattr(self.library, f"magnetometer_{name}")(ctypes.byref(held), ctypes.byref(fit))
        del counts
        soft_iron = np.array(fit.soft_iron, dtype=np.float64).reshape(3, 3)
        hard_iron = np.array(fit.hard_iron, dtype=np.float64)
        return MagnetometerFit(
            FitStatus(fit.status), bool(fit.is_sphere), fit.iterations, soft_iron, hard_iron, fit.coverage
        )

    def moments(self, points: ArrayLike, anchor: ArrayLike) -> list[float]:
        sums = (ctypes.c_float * 35)()
        held, counts = _pass_points(points)
        self.library.moments_sum(ctypes.byref(held), (ctypes.c_int32 * 3)(*anchor), sums)
        del counts
        return list(sums)


def _pass_points(points: ArrayLike) -> tuple[_Points, np.ndarray]:
    counts = np.ascontiguousarray(points, dtype=np.int16)
    ends = [(ctypes.c_int16 * 3)(*(int(c) for c in pick)) for pick in (counts.min(axis=0), counts.max(axis=0))]
    return _Points(counts.ctypes.data, len(counts), *ends), counts


@pytest.fixture(scope="module", params=["host"])
def runner(require_tool: Callable[[str], str], tmp_path_factory: pytest.TempPathFactory) -> Runner:
    library = tmp_path_factory.mktemp("calibrators") / "calibrators.so"
    options = ["-std=c11", "-O2", "-ffp-contract=off", "-fno-math-errno", "-fshort-enums", "-shared", "-fPIC"]
    warnings = ["-Wall", "-Wextra", "-Wconversion", "-Wdouble-promotion", "-Werror"]
    sources = sorted(str(path) for path in CALIBRATION.glob("*.c"))
    command = [require_tool("gcc"), *options, *warnings, *sources, "-o", str(library), "-lm"]
    subprocess.run(command, check=True)
    return HostLibrary(ctypes.CDLL(str(library)))


def _instances() -> list[Instance]:
    return [instance(seed) for seed in GOOD_SEEDS] + [instance(seed, covered=(0.05, 0.2)) for seed in CAP_SEEDS]


@pytest.mark.parametrize("name", CALIBRATORS)
def test_c_and_float64_agree_over_the_thesis_generator(runner: Runner, name: str) -> None:
    print(f"seeds {GOOD_SEEDS} and, for caps, {CAP_SEEDS}")
    fit_reference = reference(name)
    differences: list[float] = []
    caps: dict[str, Counter[str]] = {"firmware": Counter(), "reference": Counter()}
    for drawn in _instances():
        ours, wanted = runner.calibrate(name, drawn.points_counts), fit_reference(drawn.points_counts)
        assert ours.status == wanted.status, f"seed {drawn.seed}"
        if drawn.seed in CAP_SEEDS:
            caps["firmware"][ours.status.name] += 1
            caps["reference"][wanted.status.name] += 1
        elif ours.status is FitStatus.ELLIPSOID:
            differences.append(direction_difference_rms_deg(ours, wanted))
    median, p99, largest = np.percentile(differences, [50, 99, 100])
    print(f"{name}: {len(differences)} accepted, {median:.2g} / {p99:.2g} / {largest:.2g} deg; caps {caps}")
    assert len(differences) >= 500
    assert p99 <= 0.01  # a fiftieth of what noise alone does to these fits
    assert caps["firmware"] == caps["reference"]


def test_direct_refuses_caps_that_cannot_carry_an_ellipsoid(runner: Runner) -> None:
    fits = [runner.calibrate("direct", instance(seed, covered=(0.05, 0.2)).points_counts) for seed in CAP_SEEDS]
    refused = [fit for fit in fits if fit.status is FitStatus.POOR_COVERAGE and fit.is_sphere]
    # A thin ellipsoid seen end-on may show most of its surface in 20 % of the directions.
    assert len(refused) >= 0.95 * len(fits)


@pytest.mark.parametrize("cloud", CLOUDS, ids=lambda path: path.stem)
def test_moments_match_integer_arithmetic(runner: Runner, cloud: Path) -> None:
    golden = json.loads(cloud.read_text())
    points = np.array(golden["points"])
    sums = runner.moments(points, golden["anchor"])
    assert sums[0] == len(points)
    anchored = np.abs(points - golden["anchor"]).astype(float)
    for value, (name, exact) in zip(sums[1:], golden["moments"].items(), strict=True):
        terms = np.prod([anchored[:, "xyz".index(axis)] for axis in name], axis=0)
        # Each addition and multiplication rounds once: at most n + 3 half epsilons of the sum of |terms|.
        assert abs(value - exact) <= (len(points) + 3) * FLOAT32_EPSILON / 2 * terms.sum(), name


@pytest.mark.parametrize("cloud", CLOUDS, ids=lambda path: path.stem)
def test_direct_matches_exact_arithmetic(runner: Runner, cloud: Path) -> None:
    golden = json.loads(cloud.read_text())
    fit, wanted = runner.calibrate("direct", golden["points"]), golden["direct"]
    assert fit.status.name == wanted["status"]
    assert fit.is_sphere == wanted["is_sphere"]
    soft_iron = np.array(wanted["soft_iron"]).reshape(3, 3)
    # float32 sums of 300 points carry 2e-6; the condition of the normal equations (below 100 here) multiplies it.
    assert np.allclose(fit.soft_iron, soft_iron, rtol=0, atol=2e-4 * soft_iron.max())
    radius = 1.0 / soft_iron[0, 0]
    assert np.allclose(fit.hard_iron, wanted["hard_iron"], rtol=0, atol=2e-4 * radius)
    if wanted["coverage"] is not None:
        assert fit.coverage == pytest.approx(wanted["coverage"], rel=2e-3)


@pytest.mark.parametrize("name", CALIBRATORS)
@pytest.mark.parametrize(
    ("points", "status"),
    [
        ([(1, 2, 3)] * 8, FitStatus.TOO_FEW_POINTS),
        ([(100, -200, 300)] * 50, FitStatus.SINGULAR),
        ([(10 * i, -7 * i, 3 * i) for i in range(-20, 20)], FitStatus.SINGULAR),
        ([(40 * i, 25 * j, 40 * i - 25 * j) for i in range(-4, 5) for j in range(-4, 5)], FitStatus.SINGULAR),
        ([(32767, 32767, 32767)] * 10 + [(-32767, -32767, -32767)] * 10, FitStatus.SINGULAR),
    ],
    ids=["eight points", "one spot", "a line", "a plane", "two corners"],
)
def test_points_that_determine_nothing_end_in_a_status_and_the_identity(
    runner: Runner, name: str, points: list[tuple[int, int, int]], status: FitStatus
) -> None:
    fit = runner.calibrate(name, points)
    assert fit.status is status
    assert not fit.is_sphere
    assert np.array_equal(fit.soft_iron, np.eye(3))
    assert np.array_equal(fit.hard_iron, np.zeros(3))
    assert reference(name)(points).status is status


_int16 = st.integers(-32767, 32767)
_small = st.integers(-3, 3)


@pytest.mark.parametrize("name", CALIBRATORS)
@given(
    points=st.one_of(
        st.lists(st.tuples(_int16, _int16, _int16), min_size=1, max_size=40),
        st.lists(st.tuples(_small, _small, _small), min_size=9, max_size=40),
        st.lists(st.tuples(_int16, _small, _small), min_size=9, max_size=40),
    )
)
def test_no_points_whatever_end_in_nan_or_infinity(
    runner: Runner, name: str, points: list[tuple[int, int, int]]
) -> None:
    fit = runner.calibrate(name, points)
    assert np.isfinite(fit.soft_iron).all()
    assert np.isfinite(fit.hard_iron).all()
    assert np.isfinite(fit.coverage)
    if fit.status is FitStatus.ELLIPSOID:
        assert np.linalg.eigvalsh(fit.soft_iron)[0] > 0.0
