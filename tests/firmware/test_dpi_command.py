"""FIT_DPI over the line: which rows, which accelerometer calibration, and what is refused."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from hiltest.calibration import FitStatus
from hiltest.calibration.dpi import fit_dpi
from hiltest.calibration.joint import fit_joint_pairs
from hiltest.calibration.still_pose import Face, StillPose
from hiltest.link.accelerometer import SetAccelerometer
from hiltest.link.dpi import DpiReply, DpiSource, FitDpi
from hiltest.link.messages import ClearPoints, Points, Upload
from hiltest.link.poses import UploadPoses
from hiltest.link.replies import Status
from hiltest.link.request import Request, decode_reply

from ..dpi_instances import DpiInstance, dpi_instance
from .bench import UPLOAD, Bench


def asked(bench: Bench, request: Request[object]) -> object:
    return decode_reply(request, bench.request(request.code, request.payload()).payload)


def upload(bench: Bench, drawn: DpiInstance) -> None:
    asked(bench, ClearPoints())
    rows = np.column_stack([drawn.magnetometer, drawn.accelerometer]).tolist()
    for first in range(0, len(rows), 80):
        asked(bench, Upload(first, rows[first : first + 80]))


def fitted(bench: Bench, request: FitDpi) -> DpiReply:
    answer = asked(bench, request)
    assert isinstance(answer, DpiReply)
    return answer


@pytest.fixture(scope="module")
def bench() -> Bench:
    return Bench()


@pytest.fixture(scope="module")
def drawn() -> DpiInstance:
    return dpi_instance(4, 320, dip_deg=60.0)


@pytest.fixture(scope="module")
def loaded(bench: Bench, drawn: DpiInstance) -> Bench:
    upload(bench, drawn)
    asked(bench, SetAccelerometer(5, drawn.gain, drawn.offset))
    return bench


def test_pairs_are_uploaded_and_read_back(loaded: Bench, drawn: DpiInstance) -> None:
    back = asked(loaded, Points(300, 20))
    assert np.array_equal(back.magnetometer, drawn.magnetometer[300:])  # type: ignore[attr-defined]
    assert np.array_equal(back.accelerometer, drawn.accelerometer[300:])  # type: ignore[attr-defined]


@pytest.mark.parametrize("n", [300, 320])
@pytest.mark.parametrize("dip_deg", [None, 60.0])
def test_the_board_fits_the_first_pairs_with_the_slots_accelerometer(
    loaded: Bench, drawn: DpiInstance, n: int, dip_deg: float | None
) -> None:
    answer = fitted(loaded, FitDpi(n, 5, dip_deg=dip_deg))
    reference = fit_dpi(drawn.magnetometer[:n], drawn.gravity_g[:n], dip_deg=dip_deg)
    assert (answer.fit, answer.n_used) == (FitStatus.ELLIPSOID, n)
    # The margins of C against the reference; the strength is a cube root of three such numbers.
    assert np.allclose(answer.calibration.soft_iron, reference.calibration.soft_iron, rtol=0, atol=1e-7)
    assert answer.dip_deg == pytest.approx(reference.dip_deg, abs=0.002)
    assert answer.strength_counts == pytest.approx(reference.strength_counts, rel=1e-5)
    assert answer.standard_error == pytest.approx(reference.standard_error, abs=1e-3)
    assert answer.cost is not None


@pytest.mark.parametrize(("n", "dip_deg"), [(100, None), (320, None), (320, 60.0)])
def test_the_board_fits_norms_and_gravity_together(
    loaded: Bench, drawn: DpiInstance, n: int, dip_deg: float | None
) -> None:
    answer = fitted(loaded, FitDpi(n, 5, dip_deg=dip_deg, is_joint=True))
    reference = fit_joint_pairs(drawn.magnetometer[:n], drawn.gravity_g[:n], dip_deg=dip_deg)
    assert (answer.fit, answer.n_used) == (FitStatus.ELLIPSOID, n)
    assert answer.iterations == reference.calibration.iterations == 2  # the sensors are 8 degrees apart
    # The margins of C against the reference, of 0.002 counts^-1 and 62 degrees; a given dip scales nothing.
    assert np.allclose(answer.calibration.soft_iron, reference.calibration.soft_iron, rtol=0, atol=1e-7)
    assert answer.dip_deg == pytest.approx(reference.dip_deg, abs=0.002)
    assert answer.strength_counts == pytest.approx(reference.strength_counts, rel=1e-4)
    assert answer.cost is not None


def test_another_slots_accelerometer_makes_another_calibration(loaded: Bench, drawn: DpiInstance) -> None:
    right, nominal = fitted(loaded, FitDpi(300, 5)), fitted(loaded, FitDpi(300, 0))
    reference = fit_dpi(drawn.magnetometer[:300], drawn.accelerometer[:300] / 8192.0)
    assert nominal.dip_deg == pytest.approx(reference.dip_deg, abs=0.002)
    # Up to 2 % of wrong gains and cross axes are up to 1 degree each.
    assert np.abs(right.calibration.soft_iron - nominal.calibration.soft_iron).max() > 1e-5


def test_the_board_fits_its_still_poses(bench: Bench) -> None:
    drawn = dpi_instance(6, 40, dip_deg=60.0, readings=16)
    asked(bench, SetAccelerometer(7, drawn.gain, drawn.offset))
    poses = [
        StillPose(point.astype(float), None, gravity.astype(float), None, 16, Face.NONE)
        for point, gravity in zip(drawn.magnetometer, drawn.accelerometer, strict=True)
    ]
    for first in (0, 20):
        asked(bench, UploadPoses(first, poses[first : first + 20]))
    answer = fitted(bench, FitDpi(40, 7, source=DpiSource.POSES))
    reference = fit_dpi(drawn.magnetometer, drawn.gravity_g, readings=16)
    assert (answer.fit, answer.n_used) == (FitStatus.ELLIPSOID, 40)
    assert np.allclose(answer.calibration.soft_iron, reference.calibration.soft_iron, rtol=0, atol=1e-7)
    few = fitted(bench, FitDpi(37, 7, source=DpiSource.POSES))
    assert (few.fit, few.n_used) == (FitStatus.TOO_FEW_POINTS, 37)


def test_what_is_refused_says_why_and_how_many(bench: Bench) -> None:
    for dip_deg, given_deg, wanted in [
        (5.0, None, FitStatus.ELLIPSOID),
        (1.0, None, FitStatus.HORIZONTAL_FIELD),
        (0.0, None, FitStatus.HORIZONTAL_FIELD),
        (60.0, -60.0, FitStatus.MIRRORED),
    ]:
        drawn = dpi_instance(8, dip_deg=dip_deg)
        upload(bench, drawn)
        asked(bench, SetAccelerometer(3, drawn.gain, drawn.offset))
        answer = fitted(bench, FitDpi(300, 3, dip_deg=given_deg))
        assert (answer.fit, answer.n_used) == (wanted, 300), f"dip {dip_deg}"
    few = fitted(bench, FitDpi(299, 0))
    assert (few.fit, few.n_used, few.dip_deg) == (FitStatus.TOO_FEW_POINTS, 299, None)


@pytest.mark.parametrize("wrong", ["sign", "swapped", "unit"])
def test_an_accelerometer_of_a_wrong_sign_axis_or_unit_shows(bench: Bench, drawn: DpiInstance, wrong: str) -> None:
    upload(bench, drawn)
    gain = {"sign": -drawn.gain, "swapped": drawn.gain[[1, 0, 2]], "unit": 9.80665 * drawn.gain}[wrong]
    asked(bench, SetAccelerometer(9, gain, drawn.offset))
    answer = fitted(bench, FitDpi(300, 9, dip_deg=drawn.dip_deg))
    if wrong == "unit":
        # Gravity of 9.8 "g" makes a sine of 8.5: a dip of 90 where 60 was declared, which the suites hold against it.
        assert answer.dip_deg == pytest.approx(90.0)
        norms = np.linalg.norm(
            (drawn.magnetometer - answer.calibration.hard_iron) @ answer.calibration.soft_iron.T, axis=1
        )
        assert np.median(norms) == pytest.approx(1.0 / 9.80665, rel=0.01)
    else:
        assert answer.fit is FitStatus.MIRRORED


@pytest.mark.parametrize(
    ("payload", "status"),
    [
        (struct.pack("<BHBBf", 2, 300, 0, 0, 0.0), Status.BAD_ARGUMENT),
        (struct.pack("<BHBBf", 0, 0, 0, 0, 0.0), Status.BAD_ARGUMENT),
        (struct.pack("<BHBBf", 0, 300, 16, 0, 0.0), Status.BAD_ARGUMENT),
        (struct.pack("<BHBBf", 0, 300, 0, 4, 0.0), Status.BAD_ARGUMENT),
        (struct.pack("<BHBBf", 1, 38, 0, 2, 0.0), Status.BAD_ARGUMENT),  # `joint` of poses
        (struct.pack("<BHBBf", 0, 300, 0, 1, 91.0), Status.BAD_ARGUMENT),
        (struct.pack("<BHBBf", 0, 300, 0, 1, float("nan")), Status.BAD_ARGUMENT),
        (struct.pack("<BHBBf", 0, 513, 0, 0, 0.0), Status.TOO_FEW_POINTS),
        (struct.pack("<BHBBf", 1, 129, 0, 0, 0.0), Status.TOO_FEW_POINTS),
        (struct.pack("<BHBB", 0, 300, 0, 0), Status.BAD_LENGTH),
    ],
)
def test_requests_that_make_no_sense_are_refused(loaded: Bench, payload: bytes, status: Status) -> None:
    assert loaded.status(FitDpi.code, payload) == status


def test_an_upload_of_neither_form_is_refused(loaded: Bench) -> None:
    for size in (5, 7, 11, 13, 18):
        assert loaded.status(UPLOAD, struct.pack("<HB", 320, 1) + bytes(size)) == Status.BAD_LENGTH


def test_without_a_counter_the_fit_is_as_good_and_costs_nothing(drawn: DpiInstance) -> None:
    bench = Bench(cycle_counter=False)
    upload(bench, drawn)
    reply = bench.request(FitDpi.code, FitDpi(300, 0).payload())
    assert Status(reply.payload[0]) is Status.NO_CYCLE_COUNTER
    answer = decode_reply(FitDpi(300, 0), reply.payload)
    assert answer.fit is FitStatus.ELLIPSOID
    assert answer.cost is None
