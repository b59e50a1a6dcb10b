"""`dpi`: improvement of heading, pitch and roll by gravity, which determines the rotation that norm fits leave."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from hiltest.calibration.direct import fit_direct
from hiltest.calibration.dpi import fit_dpi
from hiltest.calibration.fit import Array
from hiltest.calibration.quality import rotation_left_deg
from hiltest.measurement import Measurement, check
from hiltest.orientation.angles import wrap_180
from hiltest.orientation.tilt_heading import tilt_heading
from hiltest.report.marks import Mark, series
from hiltest.report.svg import Figure
from hiltest.run_record.run import Cell, Column, Run, Table
from hiltest.studies.study import Block, Conclusion, Numbers, Plan, PrintedFigure, Study

# Dip of the field at the location of the paper, in the south of Brazil.
_DIP_DEG = -35.0
_SAMPLES = 1000
# Counts for a field of strength 1, and for gravity.
COUNTS = 1000.0
_NOISE = 1e-3
METHODS = ("uncalibrated", "ellipsoids", "dpi")
ANGLES = ("heading", "pitch", "roll")
# Numbers of an instance: the largest errors, the remaining rotation of the magnetometer, and that of the accelerometer.
_NUMBERS = len(METHODS) * len(ANGLES) + 2


@dataclass(frozen=True, slots=True, eq=False)
class Sensor:
    """A sensor whose readings are ``response @ vector + offset``, both of size 1."""

    response: Array
    offset: Array

    def readings(self, vectors: Array) -> Array:
        """Return readings without noise, shape (n, 3) [counts]."""
        return np.asarray(COUNTS * (vectors @ self.response.T + self.offset))


def measure(plan: Plan, block: Block) -> Numbers:
    """Return the largest errors of each instance by method, and two rotations [deg]."""
    numbers: list[float] = []
    for instance in range(block.first, block.first + block.count):
        numbers += _errors_deg(np.random.Generator(np.random.Philox(key=[plan.seed, instance])))
    return numbers


def _errors_deg(random: np.random.Generator) -> list[float]:
    magnetometer, accelerometer = draw_sensor(random, 8.0, 0.2, 0.5), draw_sensor(random, 0.5, 0.05, 0.1)
    down, field = _vectors(Rotation.random(_SAMPLES, rng=random))
    counts, gravity_counts = (
        sensor.readings(vectors) + COUNTS * _NOISE * random.standard_normal(vectors.shape)
        for sensor, vectors in ((magnetometer, field), (accelerometer, down))
    )
    gravity_fit, norm_fit = fit_direct(gravity_counts), fit_direct(counts)
    dpi_fit = fit_dpi(counts, gravity_fit.corrected(gravity_counts), dip_deg=_DIP_DEG).calibration
    judged_down, judged_field = _vectors(judged_attitudes())
    readings, readings_down = magnetometer.readings(judged_field), accelerometer.readings(judged_down)
    true_deg = attitudes_deg(judged_down, judged_field)
    errors: list[float] = []
    for corrected_down, corrected in (
        (readings_down, readings),
        (gravity_fit.corrected(readings_down), norm_fit.corrected(readings)),
        (gravity_fit.corrected(readings_down), dpi_fit.corrected(readings)),
    ):
        off_deg = (attitudes_deg(corrected_down, corrected) - true_deg + 180.0) % 360.0 - 180.0
        errors += np.abs(off_deg).max(axis=0).tolist()
    remaining_deg = rotation_left_deg(dpi_fit, magnetometer.response)
    return [*errors, remaining_deg, rotation_left_deg(gravity_fit, accelerometer.response)]


def draw_sensor(random: np.random.Generator, turned_deg: float, stretched: float, offset: float) -> Sensor:
    """Draw a sensor: rotations about z, y and x, symmetric soft iron and offset, each uniform within its bound."""
    axes = Rotation.random(rng=random).as_matrix()
    stretch = (axes * random.uniform(1.0 - stretched, 1.0 + stretched, 3)) @ axes.T
    turned = Rotation.from_euler("ZYX", random.uniform(-turned_deg, turned_deg, 3), degrees=True).as_matrix()
    return Sensor(turned @ stretch, random.uniform(-offset, offset, 3))


def judged_attitudes() -> Rotation:
    """Return rotations from body to earth: headings all round, level and tilted by 20 degrees to each side."""
    tilts = ((0.0, 0.0), (20.0, 0.0), (-20.0, 0.0), (0.0, 20.0), (0.0, -20.0))
    return Rotation.from_euler(
        "ZYX", [(heading, *tilt) for tilt in tilts for heading in range(0, 360, 15)], degrees=True
    )


def _vectors(attitudes: Rotation) -> tuple[Array, Array]:
    """Return down, and the field with strength 1, in the body frame, shape (n, 3) each."""
    dip = np.radians(_DIP_DEG)
    to_body = attitudes.inv()
    return to_body.apply([0.0, 0.0, 1.0]), to_body.apply([np.cos(dip), 0.0, np.sin(dip)])


def attitudes_deg(down: Array, field: Array) -> Array:
    """Return heading from -180 to 180, pitch and roll, shape (n, 3) [deg]."""
    poses = map(tilt_heading, down, field)
    return np.array([(wrap_180(pose.heading_deg), pose.pitch_deg, pose.roll_deg) for pose in poses])


def conclude(plan: Plan, by_condition: Sequence[Sequence[Numbers]]) -> Conclusion:
    """Compute medians and 95th percentiles of the largest errors."""
    instances = np.concatenate([np.reshape(block, (-1, _NUMBERS)) for block in by_condition[0]])
    errors = instances[:, :-2].reshape(-1, len(METHODS), len(ANGLES))
    median, high = np.median(errors, axis=0), np.quantile(errors, 0.95, axis=0)
    rows: tuple[tuple[Cell, ...], ...] = tuple(
        (method, *(float(value) for pair in zip(median[k], high[k], strict=True) for value in pair))
        for k, method in enumerate(METHODS)
    )
    columns = (Column("calibration"), *(Column(f"{angle}{of}", "deg") for angle in ANGLES for of in ("", ", p95")))
    heading = dict(zip(METHODS, median[:, 0].tolist(), strict=True))
    sentence = (
        f"The largest heading error is {heading['uncalibrated']:.0f} deg uncalibrated, {heading['ellipsoids']:.1f} by "
        f"ellipsoid fits and {heading['dpi']:.2f} by dpi, in the median of {len(instances)} instances."
    )
    measurements = tuple(_measurements(median))
    return Conclusion(sentence, measurements, Table("study.dpi", columns, rows), (_remaining_rotation(instances),))


def _measurements(median: Array) -> list[Measurement]:
    return [
        check(f"study.dpi.{method}.{angle}", float(median[k, j]), unit="deg")
        for k, method in enumerate(METHODS)
        for j, angle in enumerate(ANGLES)
    ]


def _remaining_rotation(instances: Array) -> PrintedFigure:
    remaining, own = instances[:, -2], instances[:, -1]
    apart = float(np.median(np.abs(remaining - own)))
    # Noise turns a calibration by its deviation divided by the root of the number of samples.
    noise_deg = float(np.degrees(_NOISE)) / np.sqrt(_SAMPLES)
    return PrintedFigure(
        "rotation that dpi leaves",
        "Coelho and Hemerly, 6",
        "that of the accelerometer's axes",
        f"{np.median(remaining):.3f} deg, {np.median(own):.3f} of the accelerometer, {apart:.3f} apart in the median",
        bool(apart < 10.0 * noise_deg),
        f"an ellipsoid fit does not determine the rotation of the accelerometer, and dpi turns the magnetometer to it; "
        f"noise alone contributes {noise_deg:.3f} deg per axis",
    )


def draw(run: Run, table: Table) -> Figure:
    """Draw the medians, and the 95th percentiles above them."""
    values = [[float(cell or 0) for cell in row[1:]] for row in table.rows]
    all_values = [value for row in values for value in row]
    figure = Figure(
        title="Largest errors: heading, pitch, roll",
        description=run.verdict.sentence,
        x_label="1 heading, 2 pitch, 3 roll",
        y_label="largest error [deg]",
        x_range=(0.5, 3.5),
        y_range=(0.7 * min(all_values), 1.4 * max(all_values)),
        x_ticks=(1.0, 2.0, 3.0),
        width=560.0,
        height=360.0,
        log_y=True,
    )
    for k, method in enumerate(METHODS):
        style, mark = series(k)
        places = [j + 1.0 + 0.15 * (k - 1) for j in range(len(ANGLES))]
        figure.bars(zip(places, values[k][::2], values[k][1::2], strict=True), style)
        figure.series(
            method, list(zip(places, values[k][::2], strict=True)), mark=mark or Mark.DOT, mark_style=f"{style} filled"
        )
    return figure


STUDY = Study(
    name="dpi",
    question="Norm fits leave a rotation between the sensors: how much of it remains if gravity is used, too?",
    conditions=1,
    instances=400,
    points=0,
    block=20,
    measure=measure,
    conclude=conclude,
    draw=draw,
)
