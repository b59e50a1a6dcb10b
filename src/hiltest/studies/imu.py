"""`imu`: errors of an IMU that remain after least squares and norm fits, and the effect of subtracting the mean."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import astuple
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from hiltest.calibration import REFERENCES
from hiltest.calibration.fit import Array, FitStatus
from hiltest.calibration.quality import COUNTS_PER_UT, residual_percent, sphere_directions
from hiltest.measurement import Measurement, check
from hiltest.measurement.estimates import Estimate, quantile
from hiltest.report.marks import KeyEntry, series
from hiltest.report.svg import Figure
from hiltest.run_record.run import Cell, Column, Run, Table
from hiltest.studies.dpi import COUNTS, draw_sensor
from hiltest.studies.instances import Model, draw_instances
from hiltest.studies.methods import calibrate
from hiltest.studies.quantiles import quantile_columns, quantile_measurement
from hiltest.studies.study import Block, Conclusion, Numbers, Plan, PrintedFigure, Study

UNCALIBRATED, LSTSQ = "uncalibrated", "lstsq"
CALIBRATORS = ("li", "merayo", "frosio")
METHODS = (UNCALIBRATED, *CALIBRATORS)
#: Ratios of the magnetometer's hard iron to the field; the next condition is that of the accelerometer.
OFFSETS = (0.0, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 5.0)
ACCELEROMETER = len(OFFSETS)
#: The paper's readings deviate from the norm by .626 of the norm, as with an offset as large as the field.
JUDGED = OFFSETS.index(1.0)
_NOISE = 0.04  # of the field: the deviation in Table 2 after a calibration
_PLACES = (
    *((method, "six faces") for method in (UNCALIBRATED, LSTSQ, "merayo", "frosio")),
    *((method, "60 attitudes") for method in ("merayo", "frosio")),
)
_FACES = np.concatenate([np.eye(3), -np.eye(3)])
_SAMPLES_A_FACE = 50
_ACCELEROMETER_NOISE = 0.005  # of gravity
_ASKEW_DEG = 0.3  # error of a face that is aligned by hand, about each axis
#: Rows of Table 1, by `_TABLE_1_PLACES`; of Table 2, by `METHODS`. None: no fit.
_TABLE_1 = {
    "x": (0.06343, 0.00640, 0.08447, 0.04743),
    "y": (0.03357, 0.00620, 0.03284, 0.08435),
    "z": (0.04977, 0.02745, 0.03312, 0.03339),
    "all axes": (0.08734, 0.02886, 0.09649, 0.10237),
}
_TABLE_1_PLACES = (0, 1, 4, 5)
_TABLE_2 = {"before": (0.62576, 0.05010, 0.04220, None), "less mean": (0.24736, 0.04122, 0.03997, 0.04372)}
#: Probability of refusing any row although all are from the model, shared by the rows (Bonferroni).
LEVEL = 0.05
_ROW_LEVEL = LEVEL / (len(_TABLE_1) + len(_TABLE_2))


def measure(plan: Plan, block: Block) -> Numbers:
    """Return the rms of each method for each instance, or 0 if it has no fit.

    Numbers of the magnetometer: by method, before and after subtracting the mean; then whether li's problem is the same
    in exact arithmetic. Numbers of the accelerometer: x, y and z, by place.
    """
    numbers: list[float | int] = []
    if block.condition == ACCELEROMETER:
        for instance in range(block.first, block.first + block.count):
            numbers += _accelerometer(np.random.Generator(np.random.Philox(key=[plan.seed, instance])))
        return numbers
    model = Model(plan.seed, plan.points, 50.0 * _NOISE, stream=block.condition, occluded=0.0, hard_iron_ut=1.0)
    drawn = draw_instances(model, block.first, block.count).set_hard_iron(OFFSETS[block.condition] * model.field_ut)
    for k in range(block.count):
        counts = drawn.counts(k)
        centred = counts - counts.mean(axis=0)
        for method in plan.names(METHODS):
            numbers += [_rms(plan, method, points, model.field_ut * COUNTS_PER_UT) for points in (counts, centred)]
        numbers.append(int(is_same_for_li(counts.astype(np.int64))))
    return numbers


def _rms(plan: Plan, method: str, counts: Array, field_counts: float) -> float:
    """Return the rms deviation of the norms from 1; 0 if there is no fit."""
    if method == UNCALIBRATED:
        return float(np.sqrt(np.mean((1.0 - np.linalg.norm(counts, axis=1) / field_counts) ** 2)))
    fit = REFERENCES[method](counts) if method in REFERENCES else calibrate(plan, method, counts)[0]
    return residual_percent(counts, fit) / 100.0 if fit.status is FitStatus.ELLIPSOID else 0.0


def is_same_for_li(counts: NDArray[np.int64]) -> bool:
    """Return whether li's eigenproblem is the same before and after subtracting the mean, in exact arithmetic."""
    scaled = len(counts) * counts  # the mean then consists of whole numbers
    return eliminated(scaled) == eliminated(scaled - counts.sum(axis=0))


def eliminated(points: NDArray[np.int64]) -> list[list[Fraction]]:
    """Return ``S11 - S12 S22^-1 S12'`` of points with integer coordinates, exactly.

    Notes
    -----
    S is the scatter matrix of the monomials: block 1 has the squares and products, block 2 the coordinates and the
    constant. The result and the constraint on block 1 determine the fit (Li and Griffiths, eq. 11 to 15).
    """
    first, second = np.triu_indices(3, 1)
    whole = points.astype(object)  # Python's integers, which do not overflow
    rows = np.column_stack([whole**2, whole[:, first] * whole[:, second], whole, np.ones(len(whole), dtype=object)])
    sums = [[Fraction(value) for value in row] for row in rows.T @ rows]
    for pivot in range(9, 5, -1):
        for row in range(pivot):
            part = sums[row][pivot] / sums[pivot][pivot]
            for column in range(pivot):
                sums[row][column] -= part * sums[pivot][column]
    return [row[:6] for row in sums[:6]]


def _accelerometer(random: np.random.Generator) -> list[float]:
    sensor = draw_sensor(random, 3.0, 0.02, 0.06)

    def read(gravity: Array) -> Array:
        noise = _ACCELEROMETER_NOISE * random.standard_normal(gravity.shape)
        return np.asarray(sensor.readings(gravity) + COUNTS * noise)

    askew = _FACES + np.cross(np.radians(_ASKEW_DEG) * random.standard_normal(_FACES.shape), _FACES)
    expected = np.repeat(_FACES, _SAMPLES_A_FACE, axis=0)
    faces = read(np.repeat(askew, _SAMPLES_A_FACE, axis=0))
    attitudes = read(sphere_directions(60))
    rms: list[float] = []
    for method, place in _PLACES:
        corrected = _correct_faces(method, faces if place == "six faces" else attitudes, faces, expected)
        off = np.zeros((1, 3)) if corrected is None else corrected - expected
        rms += np.sqrt((off * off).mean(axis=0)).tolist()
    return rms


def _correct_faces(method: str, samples: Array, faces: Array, expected: Array) -> Array | None:
    """Return the samples of the faces, corrected by a method; None if it has no fit."""
    if method == UNCALIBRATED:
        return np.asarray(faces / COUNTS)
    if method == LSTSQ:  # Puc, Podobnik and Munih, eq. 11 to 13
        rows = np.column_stack([faces, -np.ones(len(faces))])
        return np.asarray(rows @ np.linalg.lstsq(rows, expected, rcond=None)[0])
    fit = REFERENCES[method](samples)
    return fit.corrected(faces) if fit.status is FitStatus.ELLIPSOID else None


def conclude(plan: Plan, by_condition: Sequence[Sequence[Numbers]]) -> Conclusion:
    """Compute medians of the fits, count instances without a fit, and compare both with the paper's tables."""
    numbers_by_condition = [
        np.concatenate([np.asarray(block) for block in blocks]).reshape(plan.instances, -1) for blocks in by_condition
    ]
    methods = plan.names(METHODS)
    all_norms = np.array(
        [numbers[:, :-1].reshape(plan.instances, len(methods), 2) for numbers in numbers_by_condition[:ACCELEROMETER]]
    )
    norms = all_norms[:, :, : len(METHODS)]
    differing = int(sum((numbers[:, -1] == 0).sum() for numbers in numbers_by_condition[:ACCELEROMETER]))
    axes = numbers_by_condition[ACCELEROMETER].reshape(plan.instances, len(_PLACES), 3)
    all_axes = np.concatenate([axes, np.linalg.norm(axes, axis=-1, keepdims=True)], axis=-1)
    rows: list[tuple[Cell, ...]] = [
        (
            "magnetometer",
            offset,
            method,
            *_median_cells(rms[:, k, 0]),
            *_median_cells(rms[:, k, 1]),
            _percent_without_fit(rms[:, k, 0]),
            _percent_without_fit(rms[:, k, 1]),
        )
        for offset, rms in zip(OFFSETS, all_norms, strict=True)
        for k, method in enumerate(methods)
    ]
    rows += [
        (
            f"accelerometer, {place}",
            None,
            method,
            *_median_cells(all_axes[:, k, 3]),
            *(None,) * 3,
            _percent_without_fit(all_axes[:, k, 3]),
            None,
        )
        for k, (method, place) in enumerate(_PLACES)
    ]
    columns = (
        Column("sensor"),
        Column("offset / field"),
        Column("calibration"),
        *quantile_columns("rms"),
        *quantile_columns("rms less mean"),
        Column("without a fit", "%"),
        Column("without a fit less mean", "%"),
    )
    frosio = METHODS.index("frosio")
    lost, lost_less_mean = (
        _percent_without_fit(norms[JUDGED][:, frosio, 0]),
        _percent_without_fit(norms[JUDGED][:, frosio, 1]),
    )
    judged_rows = list(_judge_rows(all_axes, norms))
    sentence = (
        f"{sum(row.reproduced is True for row in judged_rows)} of {len(judged_rows)} rows of the paper's tables are "
        f"reproduced. With an offset as large as the field, frosio has no fit in {lost:.0f} % of {plan.instances} "
        f"instances, and in {lost_less_mean:.0f} % after the mean is subtracted; in exact arithmetic, the problem of "
        f"li differs in {differing} of {plan.instances * ACCELEROMETER} instances."
    )
    printed = (*judged_rows, _judge_convergence(norms), _judge_improvement(norms[JUDGED], differing))
    return Conclusion(
        sentence,
        tuple(_measurements(norms[JUDGED], all_axes, differing)),
        Table("study.imu", columns, tuple(rows)),
        printed,
    )


def _median(rms: Array) -> Estimate | None:
    fitted = rms[rms > 0.0]
    return quantile(fitted, 0.5) if len(fitted) else None


def _median_cells(rms: Array) -> tuple[Cell, ...]:
    median = _median(rms)
    return (None,) * 3 if median is None else astuple(median)


def _percent_without_fit(rms: Array) -> float:
    """Return the share of instances without a fit [%]."""
    return 100.0 * float((rms == 0.0).mean())


def _measurements(judged: Array, all_axes: Array, differing: int) -> list[Measurement]:
    measurements = [
        check("study.imu.li_differs", differing, unit=""),
        quantile_measurement("study.imu.lstsq_rms", quantile(all_axes[:, 1, 3], 0.5), "g"),
    ]
    for k, method in enumerate(CALIBRATORS, 1):
        measurements.append(check(f"study.imu.{method}.without_fit", _percent_without_fit(judged[:, k, 0]), unit="%"))
        name, median = f"study.imu.{method}.rms_less_mean", _median(judged[:, k, 1])
        measurements.append(check(name, None, unit="") if median is None else quantile_measurement(name, median, ""))
    return measurements


def row_probability(printed: Sequence[float | None], rms: Array) -> float | None:
    """Return the probability that an instance is at least as unusual as a printed row, all figures together.

    Parameters
    ----------
    printed
        The row, of k figures; None where it has no fit.
    rms : shape (n, k)
        The same of each instance; 0 where it has no fit. Instances whose fits are not those of the row are left out.

    Returns
    -------
    float or None
        None if the instances are too few for a probability below the level of a row.

    Notes
    -----
    Unusual is the Mahalanobis distance of the logarithms, with mean and covariance of row and instances together. If
    the row is one more instance, all orders of the distances have the same probability, so the rank of its distance
    is exact for every distribution (Vovk, Gammerman and Shafer, Algorithmic Learning in a Random World, 2005, 2.2).
    """
    has_fit = np.array([figure is not None for figure in printed])
    alike = rms[((rms > 0.0) == has_fit).all(axis=1)][:, has_fit]
    if (len(alike) + 1) * _ROW_LEVEL < 1.0:
        return None
    row = np.array([[figure for figure in printed if figure is not None]])
    logarithms = np.log(np.concatenate([row, alike]))
    off = logarithms - logarithms.mean(axis=0)
    distances = np.einsum("ij,jk,ik->i", off, np.linalg.pinv(off.T @ off), off)
    return float(np.mean(distances >= (1.0 - 1e-9) * distances[0]))


def _judge_row(
    row: str, paper: str, printed: Sequence[float | None], models: Sequence[Array], shown: int, why: str
) -> PrintedFigure:
    """Judge a row of a table by the model that suits it best; the medians are those of the model `shown`."""
    probabilities = [row_probability(printed, rms) for rms in models]
    probability = max((value for value in probabilities if value is not None), default=None)
    stated = (
        "too few instances have the fits of this row"
        if probability is None
        else f"{100.0 * probability:.2g} % of instances are as unusual as the row, all figures together; it is not "
        f"reproduced below {100.0 * _ROW_LEVEL:.2g} %"
    )
    return PrintedFigure(
        row,
        f"Puc, Podobnik and Munih, {paper}",
        ", ".join("no fit" if figure is None else f"{figure:.5f}" for figure in printed),
        ", ".join("no fit" if median is None else str(median) for median in map(_median, models[shown].T)),
        None if probability is None else probability >= _ROW_LEVEL,
        f"{stated}; {why}",
    )


def _judge_rows(all_axes: Array, norms: Array) -> Iterator[PrintedFigure]:
    for axis, (name, figures) in enumerate(_TABLE_1.items()):
        yield _judge_row(
            f"accelerometer, {name}: {UNCALIBRATED}, {LSTSQ}, merayo, frosio",
            "Table 1",
            figures,
            [all_axes[:, _TABLE_1_PLACES, axis]],
            0,
            "merayo and frosio are measured with 60 attitudes, because six faces do not determine their nine unknowns",
        )
    for when, (name, printed) in enumerate(_TABLE_2.items()):
        yield _judge_row(
            f"norm, {name}: {', '.join(METHODS)}",
            "Table 2",
            printed,
            list(norms[..., when]),
            JUDGED,
            "the offset is the one that suits the row best, and the noise was chosen by this table: the paper states "
            "neither",
        )


def _judge_convergence(norms: Array) -> PrintedFigure:
    lost = [_percent_without_fit(norm[:, METHODS.index("frosio"), 0]) for norm in norms]
    after = max(_percent_without_fit(norm[:, METHODS.index("frosio"), 1]) for norm in norms)
    shares = ", ".join(f"{share:.0f} % at {offset:g}" for offset, share in zip(OFFSETS, lost, strict=True))
    large = [share for offset, share in zip(OFFSETS, lost, strict=True) if offset > 1.0]
    return PrintedFigure(
        "convergence of frosio with large offsets",
        "Puc, Podobnik and Munih, 3.2",
        "none",
        f"without a fit: {shares} of the field; less mean at most {after:.0f} %",
        min(large) == 100.0,
        "it starts at an offset of 0, which is outside the sphere of the points if the offset is larger than the field",
    )


def _judge_improvement(judged: Array, differing: int) -> PrintedFigure:
    """Judge by the change of each instance; an effect of rounding is not an improvement."""
    better: dict[str, float] = {}
    for k, method in enumerate(CALIBRATORS, 1):
        before, after = judged[:, k, 0], judged[:, k, 1]
        both = (before > 0.0) & (after > 0.0)
        better[method] = float(np.median(before[both] / after[both]) - 1.0) if both.any() else 0.0
    moved = abs(better["li"])
    return PrintedFigure(
        "methods that subtracting the mean improves",
        "Puc, Podobnik and Munih, 3.2",
        "all methods",
        f"rms in the median li {100 * better['li']:.2g} %, merayo {100 * better['merayo']:.2g} %",
        differing > 0 or moved > 1e-9,
        "li eliminates the terms that depend on the origin: in exact arithmetic its problem does not change, so "
        "differences are due to rounding or other samples; merayo fixes the norm of all coefficients, and frosio "
        "starts at the origin",
    )


def draw(run: Run, table: Table) -> Figure:
    """Draw the share of instances without a fit by frosio against the offset."""
    figure = Figure(
        title="Instances without a fit by frosio",
        description=run.verdict.sentence,
        x_label="offset / field",
        y_label="share of instances [%]",
        x_range=(-0.1, OFFSETS[-1] + 0.1),
        y_range=(-3.0, 105.0),
        width=560.0,
        height=360.0,
    )
    rows = [row for row in table.rows if row[2] == "frosio" and isinstance(row[1], float)]
    figure.line([(1.0, 100.0), (OFFSETS[-1], 100.0)], "thesis")
    figure.key.append(KeyEntry("printed: no fit with a large offset", "thesis"))
    for index, (text, column) in enumerate((("as read", 9), ("less mean", 10))):
        style, mark = series(index)
        figure.series(text, [(float(row[1] or 0.0), float(row[column] or 0.0)) for row in rows], style, mark)
    return figure


STUDY = Study(
    name="imu",
    question="Which errors of an IMU remain after least squares and norm fits, and does subtracting the mean help?",
    conditions=len(OFFSETS) + 1,
    instances=200,
    points=200,
    block=20,
    measure=measure,
    conclude=conclude,
    draw=draw,
)
