"""`ellipsoids`: frequency of least-squares quadrics that are not ellipsoids, against noise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.stats import beta

from hiltest.calibration.fit import FitStatus
from hiltest.calibration.quality import COUNTS_PER_UT
from hiltest.measurement import Measurement, check
from hiltest.report.marks import KeyEntry, series
from hiltest.report.svg import Figure
from hiltest.run_record.run import Column, Run, Table
from hiltest.studies.instances import Model, draw_instances, kernel, non_ellipsoids
from hiltest.studies.methods import calibrate
from hiltest.studies.study import Block, Conclusion, Numbers, Plan, PrintedFigure, Study
from hiltest.text import number

NOISE_UT = tuple(2.5 * step for step in range(1, 21))
_MILLION = 1_000_000
_PRINTED_PERCENT = 0.1  # the share of quadrics that are no ellipsoids in the thesis is smaller
_TOO_FEW = "too few instances"
_POINTS_UNKNOWN = "the thesis does not state the number of points of an instance"


def measure(plan: Plan, block: Block) -> Numbers:
    """Count the quadrics of a block that are not ellipsoids, in C if a compiler is available."""
    model = Model(plan.seed, plan.points, NOISE_UT[block.condition], stream=block.condition)
    in_c, _ = kernel()
    count = non_ellipsoids if in_c is None else in_c.non_ellipsoids
    if not plan.methods:
        return (count(model, block.first, block.count),)
    points = COUNTS_PER_UT * draw_instances(model, block.first, block.count).points_ut
    own = [sum(calibrate(plan, name, one)[0].status != FitStatus.ELLIPSOID for one in points) for name in plan.methods]
    return count(model, block.first, block.count), *own


def conclude(plan: Plan, by_noise: Sequence[Sequence[Numbers]]) -> Conclusion:
    """Add up the counts, and judge the thesis' statements."""
    by_method = np.array([np.sum(blocks, axis=0, dtype=int) for blocks in by_noise]).T.tolist()
    counts = by_method[0]
    total, instances = sum(counts), plan.instances * len(counts)
    table = Table(
        "study.ellipsoids",
        (
            Column("noise", "uT"),
            Column("instances"),
            Column("non_ellipsoids"),
            Column("per million"),
            Column("at least"),
            Column("at most"),
            *([Column("method")] if plan.methods else []),
        ),
        tuple(
            (*_row(noise_ut, count, plan.instances), *([method] if plan.methods else []))
            for method, row in zip(("direct", *plan.methods), by_method, strict=True)
            for noise_ut, count in zip(NOISE_UT, row, strict=True)
        ),
    )
    summary = f"{number(total)} of {number(instances)} quadrics are not ellipsoids at {number(plan.points)} points"
    return Conclusion(
        f"{summary}.",
        tuple(_measurements(plan, total, instances)),
        table,
        (_judge_always(plan, total, instances), _judge_nearly_always(plan, counts)),
    )


def _measurements(plan: Plan, total: int, instances: int) -> list[Measurement]:
    values = {"non_ellipsoids": total, "instances": instances, "points": plan.points}
    return [check(f"study.ellipsoids.{name}", value, unit="") for name, value in values.items()]


def _row(noise_ut: float, count: int, instances: int) -> tuple[float | int, ...]:
    low, high = interval(count, instances)
    return noise_ut, instances, count, _MILLION * count / instances, _MILLION * low, _MILLION * high


def interval(count: int, instances: int) -> tuple[float, float]:
    """Return the 95 % interval of a share (Clopper and Pearson, Biometrika 26, 1934)."""
    low = float(beta.ppf(0.025, count, instances - count + 1)) if count else 0.0
    return low, float(beta.ppf(0.975, count + 1, instances - count)) if count < instances else 1.0


def _judge_always(plan: Plan, total: int, instances: int) -> PrintedFigure:
    if total:
        why = (
            f"{_POINTS_UNKNOWN}; with {plan.points} the quadric is not always an ellipsoid, with more it more often is"
        )
    else:
        at_most = _MILLION * interval(0, instances)[1]
        why = f"{_POINTS_UNKNOWN}; with {plan.points} the 95 % interval of the share ends at {at_most:.3g} in a million"
    # Fewer instances than the thesis has do not exclude a share that it would have seen.
    reproduced = False if total else True if plan.instances >= _MILLION else None
    return PrintedFigure(
        "quadrics that are not ellipsoids, for 20 noise levels with 1 000 000 instances each",
        "Mucciaccia, 4.2.2",
        "0",
        f"{number(total)} of {number(instances)}",
        reproduced,
        f"{_TOO_FEW}: {why}" if reproduced is None else why,
    )


def _judge_nearly_always(plan: Plan, counts: Sequence[int]) -> PrintedFigure:
    count, noise_ut = max(zip(counts, NOISE_UT, strict=True))
    low, high = (100.0 - 100.0 * end for end in reversed(interval(count, plan.instances)))
    limit = 100.0 - _PRINTED_PERCENT
    reproduced = True if low > limit else False if high < limit else None
    why = f"the smallest share, at {noise_ut:g} uT, is {low:.4f} to {high:.4f} % at 95 % confidence; {_POINTS_UNKNOWN}"
    return PrintedFigure(
        "share of adequate results",
        "Mucciaccia, 5.1",
        "more than 99.9 %",
        f"{100.0 - 100.0 * count / plan.instances:.4f} %",
        reproduced,
        f"{_TOO_FEW}: {why}" if reproduced is None else why,
    )


def draw(run: Run, table: Table) -> Figure:
    """Draw the share of non-ellipsoids against noise."""
    cells = np.array([row[:6] for row in table.rows], dtype=float)
    cells[:, 3:] *= 100.0 / _MILLION
    noise = NOISE_UT
    figure = Figure(
        title="Quadrics that are not ellipsoids",
        description=run.verdict.sentence,
        x_label="noise [uT]",
        y_label="share of instances [%]",
        x_range=(0.0, noise[-1] + noise[0]),
        y_range=(0.0, 1.05 * max(_PRINTED_PERCENT, float(cells[:, 5].max()))),
        width=560.0,
        height=360.0,
    )
    figure.level(_PRINTED_PERCENT, "thesis")
    figure.key.append(KeyEntry(f"printed: at most {_PRINTED_PERCENT:g} %", "thesis"))
    for k, first in enumerate(range(0, len(cells), len(noise))):
        style, mark = series(k)
        of, *_ = (row[6:] for row in table.rows[first:])
        figure.bars(cells[first : first + len(noise), [0, 4, 5]].tolist(), style)
        figure.series(
            f"{of[0]}, with its 95 % interval" if of else "measured, with its 95 % interval",
            cells[first : first + len(noise), [0, 3]].tolist(),
            mark=mark,
            mark_style=f"{style} filled",
        )
    return figure


STUDY = Study(
    name="ellipsoids",
    question="How often is the quadric of the unconstrained direct fit not an ellipsoid, as noise grows?",
    conditions=len(NOISE_UT),
    instances=_MILLION,
    points=100,
    block=50_000,
    measure=measure,
    conclude=conclude,
    draw=draw,
)
