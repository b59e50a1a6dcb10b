"""`estimators`: direction error of each calibrator against noise, number of points, coverage and soft iron."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import astuple, dataclass

import numpy as np

from hiltest.calibration import BATCHES, FASTER, REFERENCES
from hiltest.calibration.fit import Array, FitStatus, MagnetometerFit, no_fit
from hiltest.calibration.quality import COUNTS_PER_UT
from hiltest.calibration.sphere import fit_sphere
from hiltest.measurement import Measurement
from hiltest.measurement.estimates import Estimate, quantile
from hiltest.report.marks import series
from hiltest.report.svg import Figure
from hiltest.run_record.run import Cell, Column, Run, Table
from hiltest.studies.instances import Instances, Model, counted_fit, draw_instances
from hiltest.studies.methods import calibrate
from hiltest.studies.quantiles import quantile_columns, quantile_measurement
from hiltest.studies.study import Block, Conclusion, Numbers, Plan, PrintedFigure, Study

UNCALIBRATED, SPHERE = "uncalibrated", "sphere"
NAMES = (UNCALIBRATED, SPHERE, *(name for name in REFERENCES if name not in FASTER))
# A selection of lines that a reader can distinguish; those that the sentence names are added.
_DRAWN = (SPHERE, "direct", "iterative", "li", "corrected", "taubin", "geometric")
_MEDIAN, _HIGH = 0.5, 0.95


@dataclass(frozen=True, slots=True)
class Condition:
    """Parameters of a group of instances; see `hiltest.studies.instances.Model`."""

    noise_ut: float
    points: int = 100
    occluded: float = 0.5
    stretch: float = 0.5


# Noise levels with few and many points; then variations of the number of points, the coverage or the soft iron.
CONDITIONS = (
    *(Condition(noise_ut, points) for points in (100, 1000) for noise_ut in (0.3, 1.0, 2.5, 5.0)),
    Condition(1.0, 30),
    Condition(1.0, 300),
    Condition(1.0, occluded=0.0),
    Condition(1.0, occluded=0.75),
    Condition(1.0, stretch=0.2),
    Condition(1.0, stretch=0.8),
)
JUDGED = CONDITIONS.index(Condition(2.5, 1000))


def measure(plan: Plan, block: Block) -> Numbers:
    """Return direction error [deg] and whether the fit is an ellipsoid, for each instance and calibrator."""
    condition = CONDITIONS[block.condition]
    model = Model(
        plan.seed,
        condition.points,
        condition.noise_ut,
        stream=block.condition,
        stretch=condition.stretch,
        occluded=condition.occluded,
    )
    drawn = draw_instances(model, block.first, block.count)
    numbers: list[float | int] = []
    for k in range(block.count):
        for fit in _fits(drawn, k, plan):
            numbers += [drawn.direction_error_deg(k, fit, model.field_ut), int(fit.status is FitStatus.ELLIPSOID)]
    return numbers


def _fits(drawn: Instances, k: int, plan: Plan) -> list[MagnetometerFit]:
    points = COUNTS_PER_UT * drawn.points_ut[k]
    names = plan.names(NAMES)[2:]
    fits = (estimate(name, points) if name in REFERENCES else calibrate(plan, name, points)[0] for name in names)
    return [no_fit(FitStatus.SINGULAR), fit_sphere(points), *(counted_fit(fit, points) for fit in fits)]


def estimate(name: str, points: Array) -> MagnetometerFit:
    """Return the fit of a reference that refuses nothing by its predicted error."""
    if name not in BATCHES:
        return REFERENCES[name](points, largest_error_deg=math.inf)
    batch = BATCHES[name](points)
    if not batch.is_ellipsoid:
        return no_fit(FitStatus.NOT_AN_ELLIPSOID)
    return MagnetometerFit(FitStatus.ELLIPSOID, False, 0, batch.soft_iron, batch.hard_iron)


def conclude(plan: Plan, by_condition: Sequence[Sequence[Numbers]]) -> Conclusion:
    """Compute medians and 95th percentiles, and judge the thesis' statements."""
    names = plan.names(NAMES)
    numbers_by_condition = [
        np.concatenate([np.reshape(block, (-1, len(names), 2)) for block in blocks]) for blocks in by_condition
    ]
    rows: list[tuple[Cell, ...]] = []
    for condition, numbers in zip(CONDITIONS, numbers_by_condition, strict=True):
        for index, name in enumerate(names):
            rows.append(
                (
                    name,
                    condition.noise_ut,
                    condition.points,
                    100.0 * condition.occluded,
                    condition.stretch,
                    *astuple(quantile(numbers[:, index, 0], _MEDIAN)),
                    *astuple(quantile(numbers[:, index, 0], _HIGH)),
                    100.0 * float(numbers[:, index, 1].mean()),
                )
            )
    columns = (
        Column("calibrator"),
        Column("noise", "uT"),
        Column("points"),
        Column("left out, up to", "%"),
        Column("stretch"),
        *quantile_columns("median", "deg"),
        *quantile_columns("p95", "deg"),
        Column("ellipsoids", "%"),
    )
    errors = numbers_by_condition[JUDGED][:, :, 0]
    medians = {name: quantile(errors[:, index], _MEDIAN) for index, name in enumerate(names)}
    best = min(medians, key=lambda name: medians[name].value)
    judged = CONDITIONS[JUDGED]
    refused = dict(zip(names, 1.0 - numbers_by_condition[JUDGED][:, :, 1].mean(axis=0), strict=True))
    named = [
        f"{name} {medians[name]}"
        + (
            f" and refuses {100.0 * refused[name]:.3g} % of the instances, which count as spheres"
            if refused[name]
            else ""
        )
        for name in dict.fromkeys(("direct", "corrected", *plan.methods))
    ]
    sentence = (
        f"With {judged.noise_ut:g} uT of noise and {judged.points} points, {best} has the smallest error, "
        f"{medians[best]} deg in the median of {plan.instances} instances, with the 95 % confidence interval; "
        f"{', '.join(named).replace(' ', ' has ', 1)}."
    )
    table = Table("study.estimators", columns, tuple(rows))
    measurements = tuple(_measurements(names, numbers_by_condition[JUDGED]))
    return Conclusion(sentence, measurements, table, tuple(_printed_figures(medians)))


def _measurements(names: Sequence[str], judged: Array) -> list[Measurement]:
    return [
        quantile_measurement(f"study.estimators.{name}.{text}", quantile(judged[:, index, 0], share), "deg")
        for index, name in enumerate(names)
        if name not in (UNCALIBRATED, SPHERE) and ":" not in name  # a file is no name of a measurement
        for text, share in (("median", _MEDIAN), ("p95", _HIGH))
    ]


def _printed_figures(medians: dict[str, Estimate]) -> list[PrintedFigure]:
    direct, geometric = medians["direct"], medians["geometric"]
    others = {name: medians[name] for name in ("iterative", "li", "taubin")}
    return [
        PrintedFigure(
            "the algebraic distance is statistically better than the Euclidean",
            "Mucciaccia, 2.1.3",
            "better",
            f"direct {direct} deg, least squares of the Euclidean distance {geometric} deg",
            direct.value < geometric.value,
            "noise that is added after the distortion is equal on all axes, so least squares of the Euclidean distance "
            "is the maximum likelihood estimate; the statement would hold for noise before the distortion",
        ),
        PrintedFigure(
            "any algorithm on the algebraic distance has the same result",
            "Mucciaccia, 3.3.1 and 4.2.2",
            "the same",
            f"direct {direct} deg, " + ", ".join(f"{name} {error}" for name, error in others.items()),
            all(abs(error.value - direct.value) < 0.01 * direct.value for error in others.values()),
            "only with the same normalisation: direct fixes the trace, iterative the norm of the coefficients, li "
            "4 J - I^2 and taubin the mean square of the gradient, and each has another minimum",
        ),
    ]


def draw(run: Run, table: Table) -> Figure:
    """Draw the median error against noise, for many points."""
    judged = CONDITIONS[JUDGED]
    words = set(run.verdict.sentence.replace(",", " ").split())
    rest = (str(row[0]) for row in table.rows if row[0] not in NAMES or row[0] in words)
    lines: dict[str, list[tuple[float, float]]] = {name: [] for name in (*_DRAWN, *rest)}
    for row in table.rows:
        name, noise, count, occluded, stretch, median = row[:6]
        is_judged = (count, occluded, stretch) == (judged.points, 100.0 * judged.occluded, judged.stretch)
        if is_judged and str(name) in lines:
            lines[str(name)].append((float(noise or 0), float(median or 0)))
    points = [point for line in lines.values() for point in line]
    figure = Figure(
        title=f"Direction error, {judged.points} points",
        description=run.verdict.sentence,
        x_label="noise [uT]",
        y_label="median of the rms over the sphere [deg]",
        x_range=(min(x for x, _ in points) / 1.1, max(x for x, _ in points) * 1.1),
        y_range=(min(y for _, y in points) / 1.2, max(y for _, y in points) * 1.2),
        x_ticks=sorted({x for x, _ in points}),
        width=560.0,
        height=360.0,
        log_x=True,
        log_y=True,
    )
    for index, (name, line) in enumerate(lines.items()):
        style, mark = series(index)
        figure.series(name, line, style, mark)
    return figure


STUDY = Study(
    name="estimators",
    question="How large are direction errors after each calibrator, as noise, points, coverage and soft iron change?",
    conditions=len(CONDITIONS),
    instances=200,
    points=0,
    block=20,
    measure=measure,
    conclude=conclude,
    draw=draw,
    unprinted="Mucciaccia prints statements on the calibrators (2.1.3, 3.3.1, 4.2.2), but neither a table nor a curve "
    "of direction errors.",
)
