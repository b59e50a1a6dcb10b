"""Shared steps of the main job as fixtures: each step runs once, and any suite can request its result."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path

import pytest

from hiltest.boards import Board, open_board
from hiltest.calibration import FOR_COMPARISON
from hiltest.calibration.accelerometer import NOMINAL, AccelerometerFit
from hiltest.errors import ConfigError, DeviceTimeoutError, VersionMismatchError
from hiltest.interfaces.quantities import Quantity
from hiltest.link.gyroscope import Axis
from hiltest.link.replies import SensorInfo
from hiltest.measurement import Limit
from hiltest.procedures import (
    DPI,
    JOINT,
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
from hiltest.procedures.angle_errors import angle_errors_deg
from hiltest.procedures.fewest_poses import plan_fewest_poses
from hiltest.procedures.imu_calibration import ImuCalibration
from hiltest.procedures.imu_calibration.on_board import NAME as CALIBRATION_FILE
from hiltest.procedures.imu_calibration.on_board import store_calibration
from hiltest.procedures.reported_headings import (
    FIRMWARE,
    ReportedAngles,
    SelfCalibration,
    measure_reported_angles,
    tumble_until_calibrated,
)
from hiltest.procedures.tumble import poor_coverage
from hiltest.rig import Rig
from hiltest.rig.bench_files import DEFAULT_RIG, shipped
from hiltest.rig.rig_file import load_rig
from hiltest.session.bench_session import SESSION
from hiltest.session.fixtures import Measure
from hiltest.session.settings import Settings, resolve
from hiltest.world import EarthField

# A suite runs after the suites that its numbers depend on; suites of your own run last. Tests of any suite that use
# the known angles run with the heading suite, because the board must rest before it is turned to them. The driving
# suite runs second, because the disturbances begin at fixed times.
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

# Suites for firmware that answers requests, and suites for firmware that reports its heading by itself. The heading
# suite is for both.
WITH_REQUESTS = frozenset(ORDER) - {"test_heading", "test_reports"}
WITHOUT_REQUESTS = frozenset({"test_reports"})
# Fixtures that send requests: tests that use them are skipped for firmware that reports by itself.
REQUESTED = frozenset({"tumble", "calibrations"})

# Limit for calibrators without a limit in the rig: the thesis' goal for a compass heading. Measurements under
# [information] have no limit.
GOAL_DEG = 2.0
# Error allowed to the compass beyond the uncertainty of the mounting or of hand-set angles [deg], as in the shipped
# rigs. A bias up to this value is within the limit despite that uncertainty.
OWN_ERROR_DEG = 0.5

# Fewest poses (of 16 readings each) that the calibration against gravity accepts as well.
STILL_POSES = 40


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Ignore suites that do not apply to the firmware's interface, the rig or the run."""
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
    is_file_suite = collection_path == here / "test_calibration_file.py"
    return True if is_file_suite and resolve(config).calibration is None else None


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Sort the suites of this folder, and keep the places of all other tests."""
    here = Path(__file__).parent
    with suppress(ConfigError):
        if not config.stash[SESSION].rig.answers_requests:
            items[:] = [item for item in items if item.path.parent != here or not REQUESTED & fixture_names(item)]
    shipped_tests = [item for item in items if item.path.parent == here]
    shipped_tests.sort(key=_position)
    ordered = iter(shipped_tests)
    items[:] = [next(ordered) if item.path.parent == here else item for item in items]


def fixture_names(item: pytest.Item) -> frozenset[str]:
    """Return the names of the fixtures that a test uses, directly or through other fixtures."""
    return frozenset(getattr(item, "fixturenames", ()))


def _position(item: pytest.Item) -> int:
    position = ORDER.index(item.path.stem) if item.path.stem in ORDER else len(ORDER)
    needs_known_angles = "known_angles" in fixture_names(item)
    return max(position, ORDER.index("test_heading")) if needs_known_angles else position


@pytest.fixture(scope="session")
def six_positions(
    board: Board, turntable: Turntable, rig: Rig, hil_progress: Progress, request: pytest.FixtureRequest
) -> AccelerometerRun | None:
    """Accelerometer calibration from the six faces; None if the rig does not request it."""
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
    """Accelerometer calibration for all headings; slot 0 holds it."""
    return NOMINAL if six_positions is None else six_positions.fit


@pytest.fixture(scope="session")
def still_poses(board: Board, turntable: Turntable, known_angles: KnownAngles, hil_progress: Progress) -> int:
    """Die temperature [degC] after still poses in all directions, none a known angle, were put into the board's buffer.

    They are taken after all steps of the gate set, so that the gate set's measurements are the same in both sets.
    """
    return collect_still_poses(board, turntable, spread_poses(STILL_POSES), progress=hil_progress)


@pytest.fixture(scope="session")
def ellipsoid(board: Board, still_poses: int) -> AccelerometerRun:
    """Accelerometer calibration by the ellipsoid fit to the still poses."""
    return fit_poses(board, "ellipsoid", STILL_POSES, still_poses)


@pytest.fixture(scope="session")
def dpi_from_poses(board: Board, still_poses: int, rig: Rig) -> DpiRun | None:
    """Calibration against gravity from the still poses; None if the rig does not request it."""
    if rig.procedure.dpi == "none":
        return None
    return fit_still_poses(board, STILL_POSES, dip_deg=rig.field.dip_deg)


@pytest.fixture(scope="session")
def turn_about_z(board: Board, turntable: Turntable, rig: Rig, hil_progress: Progress) -> MeasuredTurn:
    """One turn of the level board between two rests; the first rest stores the gyroscope's bias."""
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
    """Gyroscope calibration that the board fits to the turns and stores."""
    return fit_on_board(board, gyroscope_turns, uncertainty_deg=rig.turntable.uncertainty_deg)


@pytest.fixture(scope="session")
def tumble(
    board: Board, turntable: Turntable, rig: Rig, hil_progress: Progress, request: pytest.FixtureRequest
) -> Tumble:
    """Magnetometer points that the board collected while it was turned in all directions."""
    by_hand = request.config.stash[SESSION].hand_journal
    collect = partial(
        collect_tumble,
        board,
        turntable,
        points=rig.procedure.tumble_points,
        refuse=partial(poor_coverage, rig=rig),
        progress=hil_progress,
    )
    return by_hand.tumble(board, collect) if by_hand else collect()


@pytest.fixture(scope="session")
def tested_calibrators(board: Board, hil_settings: Settings) -> list[str]:
    """Names of the calibrators to measure; the gate set leaves out those that exist for comparison only."""
    for_comparison = FOR_COMPARISON if hil_settings.suite == "gate" else frozenset[str]()
    return [calibrator for calibrator in board.identity.calibrators if calibrator not in for_comparison]


@pytest.fixture(scope="session")
def calibrations(
    board: Board,
    tested_calibrators: list[str],
    accelerometer_fit: AccelerometerFit,
    tumble: Tumble,
    rig: Rig,
    hil_progress: Progress,
) -> dict[str, CalibratorRun]:
    """Result of each calibrator on the first points of the tumble, and the rig's further calibrations."""
    runs = run_calibrators(
        board,
        tumble,
        calibrators=[*tested_calibrators, *rig.procedure.further_calibrations],
        n=rig.procedure.calibration_points,
        progress=hil_progress,
    )
    store_accelerometer(board, accelerometer_fit, [run.slot for run in runs.values()])
    return runs


@pytest.fixture(scope="session")
def joint(board: Board, tumble: Tumble, calibrations: dict[str, CalibratorRun], rig: Rig) -> DpiRun | None:
    """Calibration by norms and against gravity from the pairs of the tumble; None if the rig requests none."""
    if rig.procedure.dpi == "none":
        return None
    return fit_tumble(board, tumble, slot=1 + len(calibrations), dip_deg=rig.field.dip_deg, is_joint=True)


@pytest.fixture(scope="session")
def dpi(
    board: Board,
    tumble: Tumble,
    calibrations: dict[str, CalibratorRun],
    joint: DpiRun | None,
    rig: Rig,
    hil_settings: Settings,
) -> DpiRun | None:
    """Calibration against gravity alone, from the same pairs; None in the gate set, or if the rig requests none."""
    if joint is None or hil_settings.suite == "gate":
        return None
    return fit_tumble(board, tumble, slot=2 + len(calibrations), dip_deg=rig.field.dip_deg)


@pytest.fixture(scope="session")
def streams(
    board: Board,
    tumble: Tumble,
    calibrations: dict[str, CalibratorRun],
    joint: DpiRun | None,
    dpi: DpiRun | None,
    hil_progress: Progress,
) -> dict[str, StreamRun]:
    """Results of the streaming calibrators on all points of the tumble, in the order of their times."""
    with held_as_taken(board, tumble):
        return run_streams(board, len(tumble.points), progress=hil_progress)


@pytest.fixture(scope="session")
def known_angles(board: Board, request: pytest.FixtureRequest) -> KnownAngles:
    """Headings at known angles after calibration, requested or reported."""
    fixture = "requested_angles" if board.answers_requests else "reported_angles"
    angles: KnownAngles = request.getfixturevalue(fixture)
    return angles


@pytest.fixture(scope="session")
def uncalibrated_angles(board: Board, request: pytest.FixtureRequest) -> tuple[KnownAngles | None, str]:
    """Headings at known angles before calibration, or None, and the name of their source."""
    if board.answers_requests:
        return request.getfixturevalue("known_angles"), UNCALIBRATED
    return request.getfixturevalue("angles_before_calibration"), FIRMWARE


@pytest.fixture(scope="session")
def limits_of_calibration(
    board: Board, rig: Rig, hil_settings: Settings, request: pytest.FixtureRequest
) -> Callable[[str], dict[str, Limit]]:
    """Return a function that gives the default limits of a source of headings, by statistic.

    A streaming calibrator has none, because its accuracy depends on the points so far. Angles that are set by hand
    widen the goal if even a perfect compass could not meet it.
    """
    errors_deg = angle_errors_deg(rig, rig.procedure.known_angle_poses(hil_settings.poses))

    def goal(statistic: str) -> Limit:
        by_hand_deg = rig.guard_band_deg(f"heading.{JOINT}.{statistic}") or 0.0
        needed_deg = by_hand_deg + errors_deg.get(statistic, 0.0) + OWN_ERROR_DEG
        return Limit(max=max(GOAL_DEG, round(needed_deg, 1)))

    def limits(source: str) -> dict[str, Limit]:
        if not board.answers_requests:
            return {"max": goal("max")}
        if source not in request.getfixturevalue("calibrations") and source not in (DPI, JOINT, CALIBRATION_FILE):
            return {}
        by_hand_deg = rig.guard_band_deg(f"heading.{JOINT}.bias")
        mounting_deg = rig.mounting and rig.mounting.uncertainty_deg
        bias = Limit.within(round(by_hand_deg or mounting_deg or 0.0, 2) + OWN_ERROR_DEG)
        return {"max": goal("max"), "max_centred": goal("max_centred"), "bias": bias}

    return limits


@pytest.fixture(scope="session")
def requested_angles(
    board: Board,
    turntable: Turntable,
    rig: Rig,
    calibrations: dict[str, CalibratorRun],
    joint: DpiRun | None,
    dpi: DpiRun | None,
    streams: dict[str, StreamRun],
    accelerometer_fit: AccelerometerFit,
    hil_calibration: ImuCalibration | None,
    hil_settings: Settings,
    hil_progress: Progress,
    limits_of_calibration: Callable[[str], dict[str, Limit]],
    request: pytest.FixtureRequest,
) -> RequestedAngles:
    """Headings that the board answers at known angles with each calibration."""
    slots = {UNCALIBRATED: UNCALIBRATED_SLOT}
    slots |= {name: run.slot for name, run in calibrations.items() if run.usable}
    slots |= {name: fit.run.slot for name, fit in ((JOINT, joint), (DPI, dpi)) if fit is not None and fit.run.usable}
    store_accelerometer(board, accelerometer_fit, list(slots.values()))
    slots |= store_untrimmed(
        board,
        {name: run for name, run in calibrations.items() if name in rig.procedure.untrimmed_calibrations},
        first_slot=1 + max(slots.values()),
    )
    if hil_calibration is not None:  # the file has its own accelerometer calibration
        slots |= store_calibration(board, hil_calibration, slot=1 + max(slots.values()))
    stream_slots = store_streams(board, streams, first_slot=1 + max(slots.values()))
    store_accelerometer(board, accelerometer_fit, list(stream_slots.values()))
    poses = rig.procedure.known_angle_poses(hil_settings.poses)
    limits = {source: limits_of_calibration(source) for source in slots | stream_slots if source != UNCALIBRATED}
    return measure_known_angles(
        board,
        turntable,
        poses=poses,
        slots=slots | stream_slots,
        mounting_yaw_deg=rig.mounting.yaw_deg if rig.mounting else 0.0,
        readings=rig.procedure.readings_per_pose,
        progress=hil_progress,
        journal=request.config.stash[SESSION].hand_journal,
        fewest=plan_fewest_poses(board, rig, poses, limits),
    )


@pytest.fixture(scope="session")
def angles_before_calibration(
    board: Board, turntable: Turntable, rig: Rig, hil_settings: Settings, hil_progress: Progress
) -> ReportedAngles | None:
    """Headings that the firmware reports before its calibration; each pose waits for two windows at most.

    None if it reports none yet: it is judged from its calibration on.
    """
    poses = rig.procedure.known_angle_poses(hil_settings.poses)
    longest_s = 2.0 * board.output.device.window_s
    try:
        return measure_reported_angles(board, turntable, poses, longest_s=longest_s, progress=hil_progress)
    except (DeviceTimeoutError, VersionMismatchError):
        if Quantity.HEADING in board.output.latest:
            raise
        return None


@pytest.fixture(scope="session")
def compass_tumble(
    angles_before_calibration: ReportedAngles | None, board: Board, turntable: Turntable, hil_progress: Progress
) -> SelfCalibration:
    """Turns the board in all directions while the firmware calibrates itself; it may have failed to."""
    return tumble_until_calibrated(board, turntable, progress=hil_progress)


@pytest.fixture(scope="session")
def self_calibration(compass_tumble: SelfCalibration) -> SelfCalibration:
    """Turns the board in all directions until the firmware has calibrated itself."""
    if compass_tumble.refusal is not None:
        raise compass_tumble.refusal
    return compass_tumble


@pytest.fixture(scope="session")
def reported_angles(
    self_calibration: SelfCalibration,
    board: Board,
    turntable: Turntable,
    rig: Rig,
    hil_settings: Settings,
    hil_progress: Progress,
) -> ReportedAngles:
    """Headings that the firmware reports at known angles after its calibration."""
    poses = rig.procedure.known_angle_poses(hil_settings.poses)
    return measure_reported_angles(board, turntable, poses, progress=hil_progress)


@pytest.fixture(scope="session")
def named_settings(rig: Rig) -> set[str]:
    """Settings that are not modelled, and that the rig accepts or a test has already named."""
    return set(rig.sensors.accepted_settings)


@pytest.fixture
def record_settings(board: Board, measure: Measure, named_settings: set[str]) -> Callable[..., int | None]:
    """Function that records the registers of all parts at a moment, or only those of the parts of some sensors.

    It returns their number; None if the board does not show them.
    """

    def record(moment: str, *sensors: SensorInfo) -> int | None:
        parts = board.sensor_settings()
        if parts is None:
            return None
        places = {(sensor.bus, sensor.address) for sensor in sensors}
        settings = [
            setting
            for part in parts
            if not places or (part.bus, part.address) in places
            for setting in part.settings()
            if setting.is_compared or setting.value
        ]
        measure.table(
            f"sensors.{moment}",
            {"part": "", "register": "", "value": "", "remark": ""},
            [[setting.part, setting.register, f"0x{setting.value:02X}", setting.not_modelled] for setting in settings],
        )
        for setting in settings:
            not_checked = "" if str(setting) in named_settings else setting.not_modelled
            if setting.is_compared or not_checked:
                measure(
                    f"sensor.{setting.part}.{setting.register}.{moment}",
                    setting.value,
                    limit=Limit(min=setting.as_modelled, max=setting.as_modelled) if not_checked else None,
                    not_checked=not_checked,
                    note=f"0x{setting.value:02X}",
                )
                named_settings.add(str(setting))
        return len(settings)

    return record


@pytest.fixture(scope="session")
def reference_board() -> Iterator[Board]:
    """Virtual board with hiltest's own firmware, whose calibrators get the samples of the firmware under test."""
    with open_board(load_rig(shipped() / "rigs" / DEFAULT_RIG)) as board:
        yield board
