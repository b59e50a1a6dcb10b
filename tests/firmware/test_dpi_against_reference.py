"""The firmware's `dpi`, on the host and on the virtual board, against float64."""

from __future__ import annotations

import ctypes
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from hiltest.calibration import FitStatus
from hiltest.calibration.dpi import DpiFit, fit_dpi
from hiltest.calibration.quality import direction_difference_rms_deg
from hiltest.virtual.board.k64f import VirtualK64F

from ..dpi_instances import DpiInstance, dpi_instance
from .conftest import SHIPPED_ELF
from .dpi_kernel import NOMINAL_GAIN, BoardDpi, DpiAnswer, DpiKernel, HostDpi

FOLDER = Path(__file__).parents[2] / "fixtures" / "dpi"
GOLDEN = sorted(FOLDER.glob("*.json"))


@pytest.fixture(scope="module")
def host_dpi(host_library: ctypes.CDLL) -> HostDpi:
    return HostDpi(host_library)


@pytest.fixture(scope="module")
def board_dpi() -> BoardDpi:
    return BoardDpi(VirtualK64F(SHIPPED_ELF))


@pytest.fixture(params=["host", "board"])
def kernel(request: pytest.FixtureRequest) -> DpiKernel:
    result: DpiKernel = request.getfixturevalue(f"{request.param}_dpi")
    return result


def answered(kernel: DpiKernel, drawn: DpiInstance, *, dip_deg: float | None = None, poses: bool = False) -> DpiAnswer:
    run = kernel.poses if poses else kernel.pairs
    return run(drawn.magnetometer, drawn.accelerometer, gain=drawn.gain, offset=drawn.offset, dip_deg=dip_deg)


def wanted(drawn: DpiInstance, *, dip_deg: float | None = None, poses: bool = False) -> DpiFit:
    return fit_dpi(drawn.magnetometer, drawn.gravity_g, dip_deg=dip_deg, readings=16 if poses else 1)


def test_host_and_board_give_the_same_bits(host_dpi: HostDpi, board_dpi: BoardDpi) -> None:
    for seed in range(10):  # rows are added 50 at a time, two a turn: of 351 pairs and of 51 poses, one is left
        for poses in (False, True):
            drawn = dpi_instance(seed, 38 + 13 * seed if poses else 300 + 17 * seed)
            host, board = (answered(item, drawn, poses=poses) for item in (host_dpi, board_dpi))
            assert np.array_equal(host.fit.soft_iron, board.fit.soft_iron), f"seed {seed}"
            assert np.array_equal(host.fit.hard_iron, board.fit.hard_iron), f"seed {seed}"
            assert (host.fit.status, host.used, host.sine) == (board.fit.status, board.used, board.sine)


@pytest.mark.parametrize(
    "kind",
    [{}, {"dip_deg": 5.0}, {"dip_deg": -80.0}, {"largest_hard_iron_ut": 500.0}, {"noise_ut": 0.0, "noise_mg": 0.0}],
)
@pytest.mark.parametrize("arguments", [False, True])
def test_c_and_float64_agree_over_random_pairs(host_dpi: HostDpi, kind: dict[str, float], arguments: bool) -> None:
    differences_deg, dips_deg, offsets, scales, errors = [], [], [], [], []
    for seed in range(200):
        drawn = dpi_instance(seed, **kind)  # type: ignore[arg-type]
        dip_deg = drawn.dip_deg if arguments else None
        ours, reference = answered(host_dpi, drawn, dip_deg=dip_deg), wanted(drawn, dip_deg=dip_deg)
        assert (ours.fit.status, ours.used) == (reference.status, 300), f"seed {seed}"
        differences_deg.append(direction_difference_rms_deg(ours.fit, reference.calibration))
        dips_deg.append(abs(ours.dip_deg - reference.dip_deg))
        offsets.append(np.linalg.norm(ours.fit.hard_iron - reference.calibration.hard_iron))
        ratio = np.linalg.det(ours.fit.soft_iron) / np.linalg.det(reference.calibration.soft_iron)
        scales.append(abs(ratio ** (1.0 / 3.0) - 1.0))
        errors.append(abs(ours.standard_error - reference.standard_error))
    print(
        f"directions {np.median(differences_deg):.2g}, worst {max(differences_deg):.2g} deg; "
        f"dip {max(dips_deg):.2g} deg; hard iron {max(offsets):.2g} counts; scale {max(scales):.2g}; "
        f"standard error {max(errors):.2g}"
    )
    # Sums of 300 terms carry 2e-6; the smallest pivots are 1 to 10 times smaller than those of attitudes all round at
    # 62 degrees, up to 50 at 80. 0.002 degrees are 3.5e-5, and a hundredth of what noise does to these fits.
    assert max(differences_deg) <= 0.002
    assert max(dips_deg) <= 0.002
    # 2e-6 of 500 counts, times the same.
    assert max(offsets) <= 0.005
    # The mean of what is fitted, and the root of a mean square, of numbers with 1e-6; nothing magnifies it, since
    # both are of the same solution.
    assert max(scales) <= 5e-6
    # The root of what is left of 1, which float32 has to 1e-6.
    assert max(errors) <= 1e-3


def test_c_and_float64_agree_over_still_poses(host_dpi: HostDpi) -> None:
    for seed in range(200):
        drawn = dpi_instance(seed, 60, readings=16)
        ours, reference = answered(host_dpi, drawn, poses=True), wanted(drawn, poses=True)
        assert (ours.fit.status, ours.used) == (reference.status, 60), f"seed {seed}"
        # As for pairs; 60 attitudes are less round than 300.
        assert direction_difference_rms_deg(ours.fit, reference.calibration) <= 0.003


@pytest.mark.parametrize("path", GOLDEN, ids=lambda path: path.stem)
def test_golden_vectors_are_met_by_all(kernel: DpiKernel, path: Path) -> None:
    golden = json.loads(path.read_text(encoding="utf-8"))
    gain, offset = np.array(golden["gain"]).reshape(3, 3), np.array(golden["offset"])
    points, accelerations = np.array(golden["magnetometer"]), np.array(golden["accelerometer"])
    ours = kernel.pairs(points, accelerations, gain=gain, offset=offset, dip_deg=golden["dip_deg"])
    reference = fit_dpi(points, (accelerations - offset) @ gain.T, dip_deg=golden["dip_deg"])
    answer = golden["answer"]
    assert ours.fit.status.name == reference.status.name == answer["status"]
    assert ours.used == reference.n_used == len(points)
    soft_iron = np.array(answer["soft_iron"]).reshape(3, 3)
    # float64 against exact rationals, then float32 with the margins of the random pairs.
    assert np.allclose(reference.calibration.soft_iron, soft_iron, rtol=0, atol=1e-9 * np.abs(soft_iron).max())
    assert np.allclose(reference.calibration.hard_iron, answer["hard_iron"], rtol=0, atol=1e-7)
    assert np.allclose(ours.fit.soft_iron, soft_iron, rtol=0, atol=1e-4 * np.abs(soft_iron).max())
    assert np.allclose(ours.fit.hard_iron, answer["hard_iron"], rtol=0, atol=0.005)


def test_golden_vectors_cover_every_way_a_fit_of_enough_pairs_ends() -> None:
    ends = {json.loads(path.read_text(encoding="utf-8"))["answer"]["status"] for path in GOLDEN}
    assert ends == {"ELLIPSOID", "HORIZONTAL_FIELD", "MIRRORED", "SINGULAR"}


def test_the_generator_writes_the_same_pairs_again_without_the_fits(tmp_path: Path) -> None:
    without_fits = "import runpy, sys; sys.modules['hiltest'] = None; runpy.run_path(sys.argv[2], None, '__main__')"
    subprocess.run([sys.executable, "-c", without_fits, str(tmp_path), str(FOLDER / "generate.py")], check=True)
    written = {path.name: path.read_text(encoding="utf-8") for path in tmp_path.glob("*.json")}
    assert written == {path.name: path.read_text(encoding="utf-8") for path in GOLDEN}


def test_refusals_are_those_of_the_reference(kernel: DpiKernel) -> None:
    observed: set[FitStatus] = set()
    level = Rotation.from_rotvec(np.outer(np.linspace(0, 12, 300), [0, 0, 1]))
    cases: list[tuple[DpiInstance, float | None]] = [
        (dpi_instance(1, 299), None),
        (dpi_instance(1, dip_deg=1.0), None),
        (dpi_instance(1, dip_deg=0.0), None),
        (dpi_instance(1, dip_deg=60.0), 1.0),
        (dpi_instance(1, dip_deg=60.0), -60.0),
        (dpi_instance(1), None),
        (dpi_instance(1, attitudes=level), None),
        (dpi_instance(1, attitudes=level, noise_ut=0.0, noise_mg=0.0), None),
        (dpi_instance(2, dip_deg=3.2), None),
    ]
    for drawn, dip_deg in cases:
        ours, reference = answered(kernel, drawn, dip_deg=dip_deg), wanted(drawn, dip_deg=dip_deg)
        assert ours.fit.status is reference.status
        assert ours.used == reference.n_used
        observed.add(ours.fit.status)
        if not ours.fit.has_fit:
            assert np.array_equal(ours.fit.soft_iron, np.eye(3))
    assert observed == {
        FitStatus.ELLIPSOID,
        FitStatus.TOO_FEW_POINTS,
        FitStatus.HORIZONTAL_FIELD,
        FitStatus.MIRRORED,
        FitStatus.SINGULAR,
    }


def test_poses_of_too_few_readings_are_not_used(kernel: DpiKernel) -> None:
    drawn = dpi_instance(1, 60, readings=16)
    few = kernel.poses(drawn.magnetometer, drawn.accelerometer, readings=15)
    assert (few.fit.status, few.used) == (FitStatus.TOO_FEW_POINTS, 0)
    fewer = kernel.poses(drawn.magnetometer[:37], drawn.accelerometer[:37])
    assert (fewer.fit.status, fewer.used) == (FitStatus.TOO_FEW_POINTS, 37)
    assert answered(kernel, dpi_instance(1, 38, readings=16), poses=True).fit.status is FitStatus.ELLIPSOID


@settings(max_examples=200, deadline=None)
@given(data=st.data())
def test_whatever_the_pairs_are_the_answer_is_a_number_and_a_status(host_dpi: HostDpi, data: st.DataObject) -> None:
    seed = data.draw(st.integers(0, 2**32 - 1))
    random = np.random.default_rng(seed)
    spans = st.sampled_from([0, 1, 3, 500, 32767])
    points, accelerations = (random.integers(-data.draw(spans), data.draw(spans) + 1, (300, 3)) for _ in range(2))
    if data.draw(st.booleans()):
        points = points // np.array([1, 1, 32768])  # a plane
    gain = data.draw(st.sampled_from([1.0, 1e-30, 1e30, 3e38, 0.0])) * NOMINAL_GAIN
    dip_deg = data.draw(st.sampled_from([None, 62.0, -5.0, 0.0]))
    answer = host_dpi.pairs(points, accelerations, gain=gain, dip_deg=dip_deg)
    assert np.isfinite(answer.fit.soft_iron).all()
    assert np.isfinite(answer.fit.hard_iron).all()
    assert np.isfinite([answer.fit.coverage, answer.sine, answer.standard_error]).all()
