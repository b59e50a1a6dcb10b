"""The firmware's `joint`, on the host and on the virtual board, against float64."""

from __future__ import annotations

import ctypes
import importlib.util
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from hiltest.calibration import FitStatus
from hiltest.calibration.dpi import DpiFit
from hiltest.calibration.joint import fit_joint_pairs
from hiltest.calibration.quality import direction_difference_rms_deg
from hiltest.procedures.golden_points import golden_pairs
from hiltest.virtual.board.k64f import VirtualK64F

from ..dpi_instances import DpiInstance, dpi_instance
from .conftest import FIRMWARE, SHIPPED_ELF
from .dpi_kernel import NOMINAL_GAIN, BoardDpi, DpiAnswer, DpiKernel, HostDpi


@pytest.fixture(scope="module")
def host_joint(host_library: ctypes.CDLL) -> HostDpi:
    return HostDpi(host_library)


@pytest.fixture(scope="module")
def board_joint() -> BoardDpi:
    return BoardDpi(VirtualK64F(SHIPPED_ELF, profile="cortex-m4-trm/3"))


@pytest.fixture(params=["host", "board"])
def kernel(request: pytest.FixtureRequest) -> DpiKernel:
    result: DpiKernel = request.getfixturevalue(f"{request.param}_joint")
    return result


def answered(kernel: DpiKernel, drawn: DpiInstance, *, dip_deg: float | None = None) -> DpiAnswer:
    return kernel.pairs(
        drawn.magnetometer, drawn.accelerometer, gain=drawn.gain, offset=drawn.offset, dip_deg=dip_deg, joint=True
    )


def expected_fit(drawn: DpiInstance, *, dip_deg: float | None = None) -> DpiFit:
    return fit_joint_pairs(drawn.magnetometer, drawn.gravity_g, dip_deg=dip_deg)


def test_host_and_board_give_the_same_bits(host_joint: HostDpi, board_joint: BoardDpi) -> None:
    for seed in range(10):  # rows are added 50 at a time: one is left of 151, none of 300
        drawn = dpi_instance(seed, (100, 101, 149, 151, 300)[seed % 5], turn_deg=4.0 * seed)
        host, board = (answered(item, drawn) for item in (host_joint, board_joint))
        assert np.array_equal(host.fit.soft_iron, board.fit.soft_iron), f"seed {seed}"
        assert np.array_equal(host.fit.hard_iron, board.fit.hard_iron), f"seed {seed}"
        numbers = [(it.fit.status, it.fit.iterations, it.used, it.sine, it.standard_error) for it in (host, board)]
        assert numbers[0] == numbers[1]


@pytest.mark.parametrize(
    ("kind", "largest_deg"),
    # Noise of 0.8 % is squared twice: by |f| - 1 and 1 / |f| from the first orders of |f|^2, and by what is left out of
    # the sums because |u| = 1. With 2.5 uT that is 6 times as much, and the start differs as `direct-fast` does.
    # At 80 degrees the dot product determines the rotation by a sixth of the field.
    [
        ({}, 0.002),
        ({"noise_ut": 0.0, "noise_mg": 0.0}, 0.0002),
        ({"dip_deg": 80.0}, 0.004),
        ({"dip_deg": 0.0}, 0.0002),
        ({"largest_hard_iron_ut": 500.0}, 0.002),
        ({"noise_ut": 2.5}, 0.4),
    ],
)
@pytest.mark.parametrize("count", [100, 300])
def test_c_and_float64_agree_over_random_pairs(
    host_joint: HostDpi, kind: dict[str, float], largest_deg: float, count: int
) -> None:
    differences_deg, offsets, errors = [], [], []
    for seed in range(100):
        drawn = dpi_instance(seed, count, **kind)  # type: ignore[arg-type]
        ours, reference = answered(host_joint, drawn), expected_fit(drawn)
        steps = (ours.fit.iterations, reference.calibration.iterations)
        assert (ours.fit.status, ours.used, steps[0]) == (reference.status, count, steps[1]), f"seed {seed}"
        differences_deg.append(direction_difference_rms_deg(ours.fit, reference.calibration))
        offsets.append(float(np.abs(ours.fit.hard_iron - reference.calibration.hard_iron).max()))
        errors.append(abs(ours.standard_error - reference.standard_error))
    print(
        f"directions {np.median(differences_deg):.2g}, worst {max(differences_deg):.2g} deg; "
        f"hard iron {max(offsets):.2g} counts; standard error {max(errors):.2g}"
    )
    assert max(differences_deg) <= largest_deg
    # A direction's error times 500 counts, and twice that where it is all in one axis.
    assert max(offsets) <= 1000.0 * np.radians(largest_deg)
    # float32 has the mean square of sines of one block of 50 rows to 1e-7, of which the root is this.
    assert max(errors) <= 5e-4


def test_refusals_are_those_of_the_reference(kernel: DpiKernel) -> None:
    level = Rotation.from_rotvec(np.outer(np.linspace(0, 12, 300), [0, 0, 1]))
    cases: list[tuple[DpiInstance, float | None, FitStatus]] = [
        (dpi_instance(1, 99), None, FitStatus.TOO_FEW_POINTS),
        (dpi_instance(1, dip_deg=0.0), None, FitStatus.ELLIPSOID),
        (dpi_instance(1, dip_deg=60.0), 60.0, FitStatus.ELLIPSOID),
        (dpi_instance(1, dip_deg=60.0), -60.0, FitStatus.MIRRORED),
        (dpi_instance(1, dip_deg=89.5), None, FitStatus.POOR_COVERAGE),
        (dpi_instance(1, attitudes=level), None, FitStatus.SINGULAR),
        (dpi_instance(1, attitudes=level, noise_ut=0.0, noise_mg=0.0), None, FitStatus.SINGULAR),
    ]
    for drawn, dip_deg, status in cases:
        ours, reference = answered(kernel, drawn, dip_deg=dip_deg), expected_fit(drawn, dip_deg=dip_deg)
        assert ours.used == reference.n_used == len(drawn.magnetometer)
        if status is FitStatus.SINGULAR:  # near a plane, where rounding decides which of the refusals it is
            assert not ours.fit.has_fit
            assert not reference.calibration.has_fit
        else:
            assert ours.fit.status is reference.status is status
        if not ours.fit.has_fit:
            assert np.array_equal(ours.fit.soft_iron, np.eye(3))


@pytest.mark.parametrize("change", ["exchanged", "reversed"])
def test_axes_that_no_rotation_explains_are_refused(kernel: DpiKernel, change: str) -> None:
    drawn = dpi_instance(5, dip_deg=60.0)
    points = drawn.magnetometer[:, [1, 0, 2]] if change == "exchanged" else drawn.magnetometer * [1, -1, 1]
    answer = kernel.pairs(points, drawn.accelerometer, gain=drawn.gain, offset=drawn.offset, joint=True)
    assert answer.fit.status is FitStatus.MIRRORED


@pytest.mark.parametrize("index", range(5))
def test_a_step_from_100_golden_pairs_takes_at_most_50_000_cycles(board_joint: BoardDpi, index: int) -> None:
    points, accelerations = golden_pairs(100, index=index)
    answer = board_joint.pairs(points, accelerations, joint=True)
    assert board_joint.last is not None
    print(f"joint, 100 golden pairs: {board_joint.last.cycles} cycles")
    assert (answer.fit.status, answer.fit.iterations) == (FitStatus.ELLIPSOID, 1)
    assert board_joint.last.cycles <= 50_000


def test_kernels_in_assembly_take_the_stack_that_the_check_counts(board_joint: BoardDpi) -> None:
    specification = importlib.util.spec_from_file_location("stack_check", Path(FIRMWARE) / "stack_check.py")
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    board, pair = VirtualK64F(SHIPPED_ELF), np.ones((1, 3), "<i2")
    task, rows, sums = np.zeros(26, "<f4"), np.zeros((1, 12), "<f4"), np.zeros((3, 22), "<f4")
    used = {
        "joint_add_rows": board.call("joint_add_rows", rows, 1, sums).stack_bytes,
        "gravity_reduce": board.call("gravity_reduce", np.eye(13, 12, dtype="<f4"), task, 13, 0).stack_bytes,
        "joint_make_rows": board.call("joint_make_rows", task, pair, pair, 1, rows).stack_bytes,
    }
    assert used == {name: module.ASSEMBLY_FRAMES[name] for name in used}


@settings(max_examples=200, deadline=None)
@given(data=st.data())
def test_whatever_the_pairs_are_the_answer_is_a_number_and_a_status(host_joint: HostDpi, data: st.DataObject) -> None:
    random = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    spans = st.sampled_from([0, 1, 3, 500, 32767])
    points, accelerations = (random.integers(-data.draw(spans), data.draw(spans) + 1, (100, 3)) for _ in range(2))
    if data.draw(st.booleans()):  # an ellipsoid that `direct` accepts, beside any gravity
        points = dpi_instance(int(random.integers(1000)), 100).magnetometer
    gain = data.draw(st.sampled_from([1.0, 1e-30, 1e30, 3e38, 0.0])) * NOMINAL_GAIN
    answer = host_joint.pairs(
        points, accelerations, gain=gain, dip_deg=data.draw(st.sampled_from([None, 62.0, -5.0])), joint=True
    )
    assert np.isfinite(answer.fit.soft_iron).all()
    assert np.isfinite(answer.fit.hard_iron).all()
    assert np.isfinite([answer.fit.coverage, answer.sine, answer.standard_error]).all()
