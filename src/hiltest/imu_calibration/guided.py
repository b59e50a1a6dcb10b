"""The whole IMU in one procedure: what is done next is said, and what was refused can be done again."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, TypeVar

import numpy as np

from hiltest import __version__
from hiltest.boards import Board
from hiltest.calibration import UNBIASED
from hiltest.calibration.acceptance import Acceptance, FitFigures, judge
from hiltest.calibration.conditioning import ellipsoid_condition
from hiltest.calibration.direction_error import predicted_direction_error
from hiltest.errors import CalibrationError
from hiltest.imu_calibration.contents import (
    FRAME,
    GYROSCOPE_UNITS,
    MAGNETOMETER_UNITS,
    MICROTESLA_PER_COUNT,
    SCHEMA,
    Figure,
    GyroscopePart,
    ImuCalibration,
    MagnetometerPart,
    matrix,
    triple,
)
from hiltest.imu_calibration.owner import made_on
from hiltest.link.messages import SensorKind
from hiltest.link.replies import DPS_PER_COUNT
from hiltest.procedures import (
    CalibratorRun,
    GyroscopeRestResult,
    Progress,
    Turntable,
    collect_tumble,
    measure_gyroscope_rest,
    run_calibrators,
)
from hiltest.rig import Rig

Done = TypeVar("Done")


class Guide(Protocol):
    """Whoever leads through the procedure, at a terminal or nowhere."""

    def begin(self, step: int, of: int, what: str) -> None:
        """Say what comes next."""

    def found(self, part: str, method: str, figures: tuple[Figure, ...]) -> None:
        """Say what came of a step."""

    def again(self, why: str) -> bool:
        """Say what was wrong with a step, and whether it is done once more."""


def calibrate_imu(
    board: Board, turntable: Turntable, rig: Rig, *, guide: Guide, made_utc: str, calibrator: str,
    progress: Progress | None = None,
) -> ImuCalibration:
    """Calibrate every sensor of a board, in the order in which they need each other.

    Parameters
    ----------
    board : Board
    turntable : Turntable
        An operator is asked; one that turns by itself asks nobody.
    rig : Rig
        Says how many points and seconds.
    guide : Guide
    made_utc : str
        The time that the calibration gets, ISO 8601.
    calibrator : str
        Of the firmware, for the magnetometer.

    Raises
    ------
    CalibrationError
        When a step's data supports no calibration and it is not done again; says why.
    SensorAbsentError
        When a sensor is missing.
    """
    guide.begin(1, 2, "gyroscope")
    turntable.rest()
    rest = _until_good(guide, lambda: measure_gyroscope_rest(
        board, seconds=rig.procedure.gyroscope_rest_s, progress=progress
    ))
    gyroscope = _gyroscope_part(board, rest)
    guide.found("gyroscope", gyroscope.method, gyroscope.figures)
    guide.begin(2, 2, "magnetometer")
    magnetometer = _until_good(guide, lambda: _magnetometer(board, turntable, rig, calibrator, progress))
    guide.found("magnetometer", magnetometer.method, magnetometer.figures)
    return ImuCalibration(
        schema=SCHEMA, hiltest=__version__, made_utc=made_utc, frame=FRAME,
        temperature_degc=float(rest.die_temperature_degc), made_on=made_on(board, rig), accelerometer=None,
        gyroscope=gyroscope, magnetometer=magnetometer,
    )


def _until_good(guide: Guide, do: Callable[[], Done]) -> Done:
    """Do a step, and again as long as its data is refused and the guide wants it once more."""
    while True:
        try:
            return do()
        except CalibrationError as error:
            if not guide.again(str(error)):
                raise


def _gyroscope_part(board: Board, rest: GyroscopeRestResult) -> GyroscopePart:
    figures = [Figure("error of the second rest", rest.bias_error_dps, "dps")]
    if rest.spread_dps is not None:
        figures.append(Figure("noise of a reading, worst axis", float(rest.spread_dps.max()), "dps"))
    return GyroscopePart(
        sensor=board.sensor(SensorKind.GYROSCOPE).name, method="rest", n=rest.n,
        formula="rate_dps = matrix * (counts - bias)", matrix=matrix(np.eye(3) * DPS_PER_COUNT),
        bias=triple(rest.bias_dps / DPS_PER_COUNT), units=GYROSCOPE_UNITS, figures=tuple(figures),
    )


def _magnetometer(
    board: Board, turntable: Turntable, rig: Rig, calibrator: str, progress: Progress | None
) -> MagnetometerPart:
    """Tumble, and run a calibrator on all points."""
    tumble = collect_tumble(board, turntable, points=rig.procedure.tumble_points, progress=progress)
    n = len(tumble.points)
    run = run_calibrators(board, tumble, calibrators=[calibrator], n=n, progress=progress)[calibrator]
    figures = _figures_of(run, tumble.points)
    verdict, reasons = judge(figures)
    if verdict is Acceptance.REFUSED:
        raise CalibrationError(f"magnetometer refused: {reasons[0].meaning} ({100 * tumble.coverage:.0f} % of the "
                               "sphere was seen)")
    return MagnetometerPart(
        sensor=board.sensor(SensorKind.MAGNETOMETER).name, method=run.calibrator, n=n,
        formula="unit_field = soft_iron * (counts - hard_iron)", soft_iron=matrix(run.soft_iron),
        hard_iron=triple(run.hard_iron), hard_iron_ut=triple(MICROTESLA_PER_COUNT * run.hard_iron),
        units=MAGNETOMETER_UNITS, figures=(
            Figure("residual", run.residual_percent, "%"),
            Figure("residual that noise predicts", run.residual_predicted_percent, "%"),
            Figure("predicted direction error", figures.direction_error_deg or 0.0, "deg"),
            Figure("field strength", figures.radius_ut or 0.0, "uT"),
            Figure("coverage of the sphere", 100.0 * tumble.coverage, "%"),
        ),
    )


def _figures_of(run: CalibratorRun, points: np.ndarray) -> FitFigures:
    """Return what a calibration is judged by, as `hiltest fit` judges one."""
    if not run.usable:
        return FitFigures(run.fit, ellipsoid_condition(points), n=len(points))
    unbiased = run.calibrator in UNBIASED and run.iterations > 0
    predicted = predicted_direction_error(points, run.result, unbiased=unbiased)
    return FitFigures(
        run.fit, ellipsoid_condition(points), n=len(points), residual_percent=run.residual_percent,
        axis_ratio=float(np.linalg.cond(run.soft_iron)),
        radius_ut=MICROTESLA_PER_COUNT * abs(float(np.linalg.det(run.soft_iron))) ** (-1.0 / 3.0),
        direction_error_deg=None if predicted is None else predicted.rms_deg,
    )
