"""The main job, step by step: each suite takes what it needs from here, and each step is done once."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path

import pytest

from hiltest.boards import Board, open_board
from hiltest.calibration import FOR_COMPARISON
from hiltest.calibration.accelerometer import NOMINAL, AccelerometerFit
from hiltest.errors import ConfigError
from hiltest.link.gyroscope import Axis
from hiltest.procedures import (
    DPI,
    UNCALIBRATED,
    UNCALIBRATED_SLOT,
    AccelerometerRun,
    CalibratorRun,
    DpiRun,
    FittedTurns,
    KnownAngles,
    MeasuredTurn,
    Progress,
    RequestedAngles,
    StreamRun,
    Tumble,
    Turntable,
    collect_still_poses,
    collect_tumble,
    fit_on_board,
    fit_poses,
    fit_still_poses,
    fit_tumble,
    held_as_taken,
    measure_known_angles,
    measure_six_positions,
    measure_turn,
    run_calibrators,
    run_streams,
    see_axes,
    spread_poses,
    store_accelerometer,
    store_streams,
    store_untrimmed,
)
from hiltest.procedures.imu_calibration import ImuCalibration
from hiltest.procedures.imu_calibration.on_board import store_calibration
from hiltest.procedures.reported_headings import (
    FIRMWARE,
    ReportedAngles,
    SelfCalibration,
    measure_reported_angles,
    tumble_until_calibrated,
)
from hiltest.rig import Rig
from hiltest.rig.bench_files import DEFAULT_RIG, shipped
from hiltest.rig.rig_file import load_rig
from hiltest.session.bench_session import SESSION
from hiltest.session.settings import Settings, resolve
from hiltest.world import EarthField

# What a later suite's numbers rest on comes first; suites of your own come last. A test of any
# suite that needs the known angles waits for the heading suite: rest comes before they are taken. What disturbs a
# field has its time, right after the board is known.
ORDER = (
    "test_identity",
    "test_driving",
    "test_accelerometer",
    "test_gyroscope",
    "test_calibration_file",
    "test_heading",
    "test_reports",
    "test_dpi",
    "test_streams",
    "test_budget",
    "test_cycles",
    "test_fusion",
    "test_link",
    "test_commands",
    "test_sensors",
    "test_worst_case",
    "test_refusals",
    "test_hard_fits",
    "test_attitudes",
)

# The suites of firmware that answers requests, and that of firmware that reports its heading by itself; the heading
# suite is of both.
WITH_REQUESTS = frozenset(ORDER) - {"test_heading", "test_reports"}
WITHOUT_REQUESTS = frozenset({"test_reports"})
# Fixtures that need requests, by which the heading suite tells its tests apart.
REQUESTED = frozenset({"tumble", "calibrations"})

# As few as calibrate a magnetometer by gravity too, of 16 readings each.
STILL_POSES = 40


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Leave out suites that the interface to the firmware, the rig or the run has nothing for."""
    here = Path(__file__).parent
    if collection_path.parent == here and collection_path.stem in ORDER:
        with suppress(ConfigError):  # the session reports it
            answers_requests = config.stash[SESSION].rig.answers_requests
            if collection_path.stem in (WITHOUT_REQUESTS if answers_requests else WITH_REQUESTS):
                return True
    if collection_path == here / "test_driving.py":
        with suppress(ConfigError):
            world = config.stash[SESSION].rig.world
            return None if world is not None and world.disturbances else True
    of_a_file = collection_path == here / "test_calibration_file.py"
    return True if of_a_file and resolve(config).calibration is None else None


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Put the suites of this folder in their order, and leave all other tests where they are."""
    here = Path(__file__).parent
    with suppress(ConfigError):
        if not config.stash[SESSION].rig.answers_requests:
            items[:] = [item for item in items if item.path.parent != here or not REQUESTED & fixtures_of(item)]
    ours = [item for item in items if item.path.parent == here]
    ours.sort(key=_place)
    ordered = iter(ours)
    items[:] = [next(ordered) if item.path.parent == here else item for item in items]


def fixtures_of(item: pytest.Item) -> frozenset[str]:
    """Return the names of the fixtures that a test asks for, or one of its fixtures does."""
    return frozenset(getattr(item, "fixturenames", ()))


def _place(item: pytest.Item) -> int:
    place = ORDER.index(item.path.stem) if item.path.stem in ORDER else len(ORDER)
    waits = "known_angles" in fixtures_of(item)
    return max(place, ORDER.index("test_heading")) if waits else place


@pytest.fixture(scope="session")
def six_positions(
    board: Board, turntable: Turntable, rig: Rig, hil_progress: Progress, request: pytest.FixtureRequest
) -> AccelerometerRun | None:
    """Accelerometer calibration from the six faces; None where the rig does not ask for it."""
    if rig.procedure.accelerometer_calibration == "none" or rig.faces is None:
        return None
    run = measure_six_positions(
        board,
        turntable,
        uncertainty_deg=rig.faces.uncertainty_deg,
        limits=rig.limits,
        dip_deg=rig.field.dip_deg,
        progress=hil_progress,
        again=lambda error: turntable.again(str(error)),
        see_axes=lambda: see_axes(
            board,
            turntable,
            poses=rig.procedure.known_angle_poses("all")[::3],
            field_ned_ut=EarthField(rig.field.strength_ut, rig.field.dip_deg).ned_ut,
            mounting_yaw_deg=rig.mounting.yaw_deg if rig.mounting else 0.0,
        ),
        journal=request.config.stash[SESSION].hand_journal,
    )
    store_accelerometer(board, run.fit, [UNCALIBRATED_SLOT])
    return run


@pytest.fixture(scope="session")
def accelerometer_fit(six_positions: AccelerometerRun | None) -> AccelerometerFit:
    """Accelerometer calibration that headings are measured with; slot 0 holds it."""
    return NOMINAL if six_positions is None else six_positions.fit


@pytest.fixture(scope="session")
def still_poses(board: Board, turntable: Turntable, known_angles: KnownAngles, hil_progress: Progress) -> int:
    """Poses all round in the board's buffer, none of them a known angle; the die's temperature after them [degC].

    They come after all that the gate set takes too: what that measures is then the same in both sets.
    """
    return collect_still_poses(board, turntable, spread_poses(STILL_POSES), progress=hil_progress)


@pytest.fixture(scope="session")
def ellipsoid(board: Board, still_poses: int) -> AccelerometerRun:
    """Accelerometer calibration from gravity's ellipsoid over these poses."""
    return fit_poses(board, "ellipsoid", STILL_POSES, still_poses)


@pytest.fixture(scope="session")
def dpi_of_poses(board: Board, still_poses: int, rig: Rig) -> DpiRun | None:
    """Calibration against gravity from the same poses; None where the rig does not ask for it."""
    if rig.procedure.dpi == "none":
        return None
    return fit_still_poses(board, STILL_POSES, dip_deg=rig.field.dip_deg)


@pytest.fixture(scope="session")
def turn_about_z(board: Board, turntable: Turntable, rig: Rig, hil_progress: Progress) -> MeasuredTurn:
    """One turn of the level board, between two rests; the first has stored the gyroscope's bias."""
    return _turn(board, turntable, rig, Axis.Z, hil_progress)


@pytest.fixture(scope="session")
def gyroscope_turns(
    board: Board, turntable: Turntable, rig: Rig, turn_about_z: MeasuredTurn, hil_progress: Progress
) -> list[MeasuredTurn]:
    """One turn about each axis of the board."""
    return [turn_about_z, *(_turn(board, turntable, rig, axis, hil_progress) for axis in (Axis.X, Axis.Y))]


def _turn(board: Board, turntable: Turntable, rig: Rig, axis: Axis, progress: Progress) -> MeasuredTurn:
    return measure_turn(
        board,
        turntable,
        axis,
        rate_dps=rig.procedure.gyroscope_turn_dps,
        rest_s=rig.procedure.gyroscope_rest_s,
        progress=progress,
    )


@pytest.fixture(scope="session")
def gyroscope_calibration(board: Board, rig: Rig, gyroscope_turns: list[MeasuredTurn]) -> FittedTurns:
    """Calibration from these turns, which the board stores for its gyroscope."""
    return fit_on_board(board, gyroscope_turns, uncertainty_deg=rig.turntable.uncertainty_deg)


@pytest.fixture(scope="session")
def tumble(
    board: Board, turntable: Turntable, rig: Rig, hil_progress: Progress, request: pytest.FixtureRequest
) -> Tumble:
    """Magnetometer points that the board collected while it was turned all round."""
    by_hand = request.config.stash[SESSION].hand_journal
    collect = partial(collect_tumble, board, turntable, points=rig.procedure.tumble_points, progress=hil_progress)
    return by_hand.tumble(board, collect) if by_hand else collect()


@pytest.fixture(scope="session")
def judged(board: Board, hil_settings: Settings) -> list[str]:
    """Calibrators that are measured: in the gate set those that are there to be used."""
    for_comparison = FOR_COMPARISON if hil_settings.suite == "gate" else frozenset[str]()
    return [calibrator for calibrator in board.identity.calibrators if calibrator not in for_comparison]


@pytest.fixture(scope="session")
def calibrations(
    board: Board,
    judged: list[str],
    accelerometer_fit: AccelerometerFit,
    tumble: Tumble,
    rig: Rig,
    hil_progress: Progress,
) -> dict[str, CalibratorRun]:
    """Calibrations of every calibrator from the same first points, and the rig's further ones."""
    runs = run_calibrators(
        board,
        tumble,
        calibrators=[*judged, *rig.procedure.further_calibrations],
        n=rig.procedure.calibration_points,
        progress=hil_progress,
    )
    store_accelerometer(board, accelerometer_fit, [run.slot for run in runs.values()])
    return runs


@pytest.fixture(scope="session")
def dpi(board: Board, tumble: Tumble, calibrations: dict[str, CalibratorRun], rig: Rig) -> DpiRun | None:
    """Calibration against gravity from the pairs of the tumble; None where the rig does not ask for it."""
    if rig.procedure.dpi == "none":
        return None
    return fit_tumble(board, tumble, slot=1 + len(calibrations), dip_deg=rig.field.dip_deg)


@pytest.fixture(scope="session")
def streams(
    board: Board, tumble: Tumble, calibrations: dict[str, CalibratorRun], dpi: DpiRun | None, hil_progress: Progress
) -> dict[str, StreamRun]:
    """Results of the streaming calibrators over every point of the tumble, in the order of time."""
    with held_as_taken(board, tumble):
        return run_streams(board, len(tumble.points), progress=hil_progress)


@pytest.fixture(scope="session")
def known_angles(board: Board, request: pytest.FixtureRequest) -> KnownAngles:
    """Headings at known angles, as the firmware's interface offers them, after its calibration."""
    fixture = "requested_angles" if board.answers_requests else "reported_angles"
    angles: KnownAngles = request.getfixturevalue(fixture)
    return angles


@pytest.fixture(scope="session")
def uncalibrated_angles(board: Board, request: pytest.FixtureRequest) -> tuple[KnownAngles, str]:
    """Headings at known angles without calibration, and their source."""
    if board.answers_requests:
        return request.getfixturevalue("known_angles"), UNCALIBRATED
    return request.getfixturevalue("angles_before_calibration"), FIRMWARE


@pytest.fixture(scope="session")
def requested_angles(
    board: Board,
    turntable: Turntable,
    rig: Rig,
    calibrations: dict[str, CalibratorRun],
    dpi: DpiRun | None,
    streams: dict[str, StreamRun],
    accelerometer_fit: AccelerometerFit,
    hil_calibration: ImuCalibration | None,
    hil_settings: Settings,
    hil_progress: Progress,
    request: pytest.FixtureRequest,
) -> RequestedAngles:
    """The headings that the board answered at known angles, under every calibration."""
    slots = {UNCALIBRATED: UNCALIBRATED_SLOT}
    slots |= {name: run.slot for name, run in calibrations.items() if run.usable}
    if dpi is not None and dpi.run.usable:
        slots[DPI] = dpi.run.slot
    store_accelerometer(board, accelerometer_fit, list(slots.values()))
    slots |= store_untrimmed(
        board,
        {name: run for name, run in calibrations.items() if name in rig.procedure.untrimmed_calibrations},
        first_slot=1 + max(slots.values()),
    )
    if hil_calibration is not None:  # a file brings its own of the accelerometer
        slots |= store_calibration(board, hil_calibration, slot=1 + max(slots.values()))
    of_streams = store_streams(board, streams, first_slot=1 + max(slots.values()))  # the others are the rig's wish
    store_accelerometer(board, accelerometer_fit, list(of_streams.values()))
    return measure_known_angles(
        board,
        turntable,
        poses=rig.procedure.known_angle_poses(hil_settings.poses),
        slots=slots | of_streams,
        mounting_yaw_deg=rig.mounting.yaw_deg if rig.mounting else 0.0,
        readings=rig.procedure.readings_per_pose,
        progress=hil_progress,
        journal=request.config.stash[SESSION].hand_journal,
    )


@pytest.fixture(scope="session")
def angles_before_calibration(
    board: Board, turntable: Turntable, rig: Rig, hil_settings: Settings, hil_progress: Progress
) -> ReportedAngles:
    """Reported headings before the firmware has seen the board turned all round: not waited for long."""
    poses = rig.procedure.known_angle_poses(hil_settings.poses)
    longest_s = 2.0 * board.output.device.window_s
    return measure_reported_angles(board, turntable, poses, longest_s=longest_s, progress=hil_progress)


@pytest.fixture(scope="session")
def self_calibration(
    angles_before_calibration: ReportedAngles, board: Board, turntable: Turntable, hil_progress: Progress
) -> SelfCalibration:
    """The board turned all round, until the firmware has calibrated itself."""
    return tumble_until_calibrated(board, turntable, progress=hil_progress)


@pytest.fixture(scope="session")
def reported_angles(
    self_calibration: SelfCalibration,
    board: Board,
    turntable: Turntable,
    rig: Rig,
    hil_settings: Settings,
    hil_progress: Progress,
) -> ReportedAngles:
    """Reported headings at known angles afterwards."""
    poses = rig.procedure.known_angle_poses(hil_settings.poses)
    return measure_reported_angles(board, turntable, poses, progress=hil_progress)


@pytest.fixture(scope="session")
def our_board() -> Iterator[Board]:
    """hiltest's own firmware on a virtual board beside: its calibrators get the samples of the firmware under test."""
    with open_board(load_rig(shipped() / "rigs" / DEFAULT_RIG)) as board:
        yield board
