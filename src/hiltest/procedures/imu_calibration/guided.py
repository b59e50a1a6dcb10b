"""Calibration of the complete IMU in one procedure: each step is announced, and a refused one can be repeated."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Protocol, TypeVar

import numpy as np

from hiltest import __version__
from hiltest.boards import Board
from hiltest.calibration import is_unbiased
from hiltest.calibration.accelerometer import axes_uncertainty_deg
from hiltest.calibration.acceptance import Acceptance, FitFigures, rate
from hiltest.calibration.conditioning import ellipsoid_condition
from hiltest.calibration.direction_error import predicted_direction_error
from hiltest.calibration.gyroscope import GyroscopeFit
from hiltest.errors import CalibrationError, ConfigError, SensorFaultError
from hiltest.link.gyroscope import Axis
from hiltest.link.replies import DPS_PER_COUNT, SensorKind
from hiltest.procedures import (
    DPI,
    UNCALIBRATED_SLOT,
    CalibratorRun,
    MeasuredTurn,
    Progress,
    Tumble,
    Turntable,
    collect_tumble,
    fit_on_board,
    fit_tumble,
    measure_six_positions,
    measure_turn,
    rest_gyroscope,
    run_calibrators,
    store_accelerometer,
)
from hiltest.procedures.imu_calibration.contents import (
    ACCELEROMETER_UNITS,
    FRAME,
    GYROSCOPE_UNITS,
    MAGNETOMETER_UNITS,
    MICROTESLA_PER_COUNT,
    SCHEMA,
    AccelerometerPart,
    FigureOfMerit,
    GyroscopePart,
    ImuCalibration,
    MagnetometerPart,
    matrix,
    triple,
)
from hiltest.procedures.imu_calibration.owner import made_on
from hiltest.rig import Rig

Done = TypeVar("Done")


class Guide(Protocol):
    """Interface to the person who is guided through the procedure."""

    def begin(self, step: int, of: int, task: str) -> None:
        """Announce a step."""

    def found(self, part: str, method: str, figures: tuple[FigureOfMerit, ...]) -> None:
        """Report the result of a step."""

    def again(self, why: str) -> bool:
        """Report why a step was refused; return whether to repeat it."""


def calibrate_imu(
    board: Board,
    turntable: Turntable,
    rig: Rig,
    *,
    guide: Guide,
    made_utc: str,
    calibrator: str,
    progress: Progress | None = None,
) -> ImuCalibration:
    """Calibrate every sensor of a board, in the order of their dependencies.

    Parameters
    ----------
    turntable
        Turntable: an operator is asked, motors turn automatically.
    rig
        Rig with the steps, the number of points and the durations.
    made_utc
        Time to record in the calibration, ISO 8601.
    calibrator
        Magnetometer calibrator of the firmware; `DPI` also uses gravity.

    Raises
    ------
    ConfigError
        When the calibrator is `dpi`, and the rig has no calibration of the accelerometer.
    CalibrationError
        When a step's data allows no calibration and it is not repeated; the message has the reason.
    SensorFaultError
        When a sensor returns values that no intact one does, as near a magnet, and the step is not repeated.
    SensorAbsentError
        When a sensor is missing.
    BoardResetError
        When a reset of the board has cleared the results of earlier steps.
    """
    led = _GuidedSteps(board, turntable, rig, guide, progress)
    if calibrator == DPI and not led.has_faces:
        raise ConfigError(
            f"{DPI} holds the magnetometer against a calibrated accelerometer, and {rig.path} asks for none: set "
            'accelerometer_calibration = "six-position" under [procedure], with [faces], or take another calibrator'
        )
    accelerometer = led.step("accelerometer", led.accelerometer) if led.has_faces else None
    gyroscope, degc = led.step("gyroscope", led.gyroscope)
    magnetometer = led.step("magnetometer", lambda: led.magnetometer(calibrator))
    return ImuCalibration(
        schema=SCHEMA,
        hiltest=__version__,
        made_utc=made_utc,
        frame=FRAME,
        temperature_degc=degc,
        made_on=made_on(board, rig),
        accelerometer=accelerometer,
        gyroscope=gyroscope,
        magnetometer=magnetometer,
    )


class _GuidedSteps:
    """Steps of the procedure on one board, table, rig and guide."""

    def __init__(self, board: Board, turntable: Turntable, rig: Rig, guide: Guide, progress: Progress | None) -> None:
        self._board, self._turntable, self._rig, self._guide, self._progress = board, turntable, rig, guide, progress
        self._step = 0

    @property
    def has_faces(self) -> bool:
        """True if the rig has the six faces and declares their uncertainty."""
        return self._rig.faces is not None and self._rig.procedure.accelerometer_calibration == "six-position"

    def step(self, part: str, do: Callable[[], Done]) -> Done:
        """Announce a step and perform it, repeatedly while its data is refused and the guide wants to repeat it."""
        self._step += 1
        self._guide.begin(self._step, 2 + self.has_faces, part)
        return self._until_good(do)

    def _until_good(self, do: Callable[[], Done]) -> Done:
        while True:
            try:
                done = do()
                self._board.session.refuse_reset()
                return done
            except (CalibrationError, SensorFaultError) as error:
                self._board.session.refuse_reset()  # because a reset may be the reason
                if not self._guide.again(str(error)):
                    raise

    def accelerometer(self) -> AccelerometerPart:
        """Put the board on its six faces, and repeat only refused ones."""
        faces = self._rig.faces
        assert faces is not None
        run = measure_six_positions(
            self._board,
            self._turntable,
            uncertainty_deg=faces.uncertainty_deg,
            progress=self._progress,
            again=lambda error: self._guide.again(str(error)),
        )
        store_accelerometer(self._board, run.fit, [UNCALIBRATED_SLOT])  # used by `dpi`
        part = AccelerometerPart(
            sensor=self._board.sensor(SensorKind.ACCELEROMETER).name,
            method=run.method,
            n=len(run.counts),
            formula="gravity_g = gain * (counts - offset)",
            gain=matrix(run.fit.gain),
            offset=triple(run.fit.offset),
            units=ACCELEROMETER_UNITS,
            figures=(
                FigureOfMerit("faces askew", run.solution.faces_askew_deg, "deg"),
                FigureOfMerit("uncertainty of axes", axes_uncertainty_deg(run.solution.faces_askew_deg), "deg"),
            ),
        )
        self._guide.found("accelerometer", part.method, part.figures)
        return part

    def gyroscope(self) -> tuple[GyroscopePart, float]:
        """Rest, and turn about each axis if the rig asks for it; return also the die's temperature [degC]."""
        turns = self._rig.procedure.gyroscope_calibration == "turns"
        part, degc = self._turns() if turns else self._rests()
        self._guide.found("gyroscope", part.method, part.figures)
        return part, degc

    def _rests(self) -> tuple[GyroscopePart, float]:
        self._turntable.rest()
        seconds = self._rig.procedure.gyroscope_rest_s
        bias = rest_gyroscope(self._board, seconds=seconds, store=True, progress=self._progress)
        after = rest_gyroscope(self._board, seconds=seconds, progress=self._progress)
        error_dps = DPS_PER_COUNT * float(np.abs(after.corrected_mean).max())
        figures = (FigureOfMerit("error of the second rest", error_dps, "dps"),)
        fit = GyroscopeFit(DPS_PER_COUNT * np.eye(3), bias.rate.mean)
        return self._gyroscope_part("rest", fit, bias.n, figures), float(after.die_temperature_degc)

    def _turns(self) -> tuple[GyroscopePart, float]:
        turns = [self._until_good(partial(self._turn, axis)) for axis in (Axis.Z, Axis.X, Axis.Y)]
        fit = fit_on_board(self._board, turns, uncertainty_deg=self._rig.turntable.uncertainty_deg)
        figures = (
            FigureOfMerit("error of the rests after", max(turn.bias_error_dps for turn in turns), "dps"),
            FigureOfMerit("uncertainty of scale", fit.scale_uncertainty_percent, "%"),
            FigureOfMerit("uncertainty of axes", fit.misalignment_uncertainty_deg, "deg"),
        )
        last = turns[-1].after
        part = self._gyroscope_part("rests and turns", fit.fit, last.n, figures)
        return part, float(last.die_temperature_degc)

    def _turn(self, axis: Axis) -> MeasuredTurn:
        procedure = self._rig.procedure
        return measure_turn(
            self._board,
            self._turntable,
            axis,
            rate_dps=procedure.gyroscope_turn_dps,
            rest_s=procedure.gyroscope_rest_s,
            progress=self._progress,
        )

    def _gyroscope_part(
        self, method: str, fit: GyroscopeFit, n: int, figures: tuple[FigureOfMerit, ...]
    ) -> GyroscopePart:
        return GyroscopePart(
            sensor=self._board.sensor(SensorKind.GYROSCOPE).name,
            method=method,
            n=n,
            formula="rate_dps = matrix * (counts - bias)",
            matrix=matrix(fit.matrix),
            bias=triple(fit.bias),
            units=GYROSCOPE_UNITS,
            figures=figures,
        )

    def magnetometer(self, calibrator: str) -> MagnetometerPart:
        """Tumble, and run a calibrator on all points."""
        tumble = collect_tumble(
            self._board, self._turntable, points=self._rig.procedure.tumble_points, progress=self._progress
        )
        n = len(tumble.points)
        if calibrator == DPI:
            run = fit_tumble(self._board, tumble, slot=1, dip_deg=self._rig.field.dip_deg).run
        else:
            runs = run_calibrators(self._board, tumble, calibrators=[calibrator], n=n, progress=self._progress)
            run = runs[calibrator]
        figures = _fit_figures(run, tumble)
        verdict, reasons = rate(figures)
        if verdict is Acceptance.REFUSED:
            coverage = f"{100 * tumble.coverage:.0f} % of the sphere was seen"
            raise CalibrationError(f"magnetometer refused: {reasons[0].meaning} ({coverage})")
        part = MagnetometerPart(
            sensor=self._board.sensor(SensorKind.MAGNETOMETER).name,
            method=run.calibrator,
            n=n,
            formula="unit_field = soft_iron * (counts - hard_iron)",
            soft_iron=matrix(run.soft_iron),
            hard_iron=triple(run.hard_iron),
            hard_iron_ut=triple(MICROTESLA_PER_COUNT * run.hard_iron),
            units=MAGNETOMETER_UNITS,
            figures=(
                FigureOfMerit("residual", run.residual_percent, "%"),
                FigureOfMerit("residual that noise predicts", run.residual_predicted_percent, "%"),
                FigureOfMerit("predicted direction error", figures.direction_error_deg or 0.0, "deg"),
                FigureOfMerit("field strength", figures.radius_ut or 0.0, "uT"),
                FigureOfMerit("coverage of the sphere", 100.0 * tumble.coverage, "%"),
            ),
        )
        self._guide.found("magnetometer", part.method, part.figures)
        return part


def _fit_figures(run: CalibratorRun, tumble: Tumble) -> FitFigures:
    """Return the figures that rate a calibration, as in `hiltest fit`."""
    points = tumble.points
    if not run.usable:
        return FitFigures(run.fit, ellipsoid_condition(points), n=len(points))
    unbiased = is_unbiased(run.calibrator, run.iterations)
    predicted = predicted_direction_error(points, run.result, unbiased=unbiased)
    return FitFigures(
        run.fit,
        ellipsoid_condition(points),
        n=len(points),
        residual_percent=run.residual_percent,
        axis_ratio=float(np.linalg.cond(run.soft_iron)),
        radius_ut=MICROTESLA_PER_COUNT * run.result.radius,
        direction_error_deg=None if predicted is None else predicted.rms_deg,
    )
