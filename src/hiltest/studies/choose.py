"""`choose`: which calibrator of the board for one's own noise, number of points, coverage and budget of cycles?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hiltest.calibration.fit import Array, FitStatus
from hiltest.measurement import Measurement, check
from hiltest.record.run import Column, Run, Table
from hiltest.report.marks import Mark, series
from hiltest.report.svg import Figure
from hiltest.studies.board_calibrators import MOST_POINTS, board_calibrators
from hiltest.studies.estimators import quantile_and_interval
from hiltest.studies.instances import Model, draw_instances
from hiltest.studies.study import Block, Conclusion, Given, Numbers, Plan, Study
from hiltest.text import hundredths, readable

_HIGH = 0.95
_NUMBERS = 3
RECOMMENDED, RUNNER_UP, TOO_DEAR = "recommended", "runner-up", "over budget"


@dataclass(frozen=True, slots=True)
class Candidate:
    """A calibrator of the board under the conditions."""

    name: str
    median_deg: float
    """Of the direction's rms error over instances [deg]."""
    high_deg: float
    at_least_deg: float
    at_most_deg: float
    """Its 95th percentile, and the ends of what so many instances say of that [deg]."""
    ellipsoids_percent: float
    """Instances with an ellipsoid [%]; the sphere counts for the others."""
    cycles: int
    most_cycles: int
    """In the median of instances, and the most of any."""

    def __str__(self) -> str:
        """Return name and numbers."""
        at_most = f", at most {readable(self.most_cycles)}" if self.most_cycles > self.cycles else ""
        return (
            f"{self.name} ({hundredths(self.median_deg)} deg in the median, {hundredths(self.high_deg)} or less in "
            f"{100 * _HIGH:g} %, {readable(self.cycles)} cycles{at_most})"
        )


def measure(plan: Plan, block: Block) -> Numbers:
    """Return of each instance and calibrator the direction's error [deg], whether it is an ellipsoid, and cycles."""
    given, board = plan.given or Given(), board_calibrators()
    model = Model(plan.seed, plan.points, given.noise_ut, occluded=1.0 - given.coverage_percent / 100.0,
                  field_ut=given.field_ut)  # fmt: skip
    drawn = draw_instances(model, block.first, block.count)
    numbers: list[float | int] = []
    for k in range(block.count):
        for name in board.names:
            fit, cycles = board.calibrate(name, drawn.counts(k))
            error_deg = drawn.direction_error_deg(k, fit, model.field_ut)
            numbers += [error_deg, int(fit.status is FitStatus.ELLIPSOID), cycles]
    return numbers


def conclude(plan: Plan, by_condition: Sequence[Sequence[Numbers]]) -> Conclusion:
    """Take one calibrator, and the next."""
    given, board = plan.given or Given(), board_calibrators()
    numbers = np.concatenate([np.reshape(block, (-1, len(board.names), _NUMBERS)) for block in by_condition[0]])
    candidates = [_candidate(name, numbers[:, index]) for index, name in enumerate(board.names)]
    affordable = [each for each in candidates if given.cycles is None or each.most_cycles <= given.cycles]
    best = chosen(affordable)
    second = chosen([each for each in affordable if each is not best])
    too_dear = [candidate for candidate in candidates if candidate not in affordable]
    marks = dict.fromkeys((each.name for each in too_dear), TOO_DEAR)
    for each, mark in ((best, RECOMMENDED), (second, RUNNER_UP)):
        if each is not None:
            marks[each.name] = mark
    columns = (
        Column("calibrator"), Column("median", "deg"), Column("p95", "deg"), Column("p95, at least", "deg"),
        Column("p95, at most", "deg"), Column("ellipsoids", "%"), Column("cycles", "cycle"),
        Column("cycles, at most", "cycle"),
        Column("choice"),
    )  # fmt: skip
    rows = tuple(
        (each.name, each.median_deg, each.high_deg, each.at_least_deg, each.at_most_deg, each.ellipsoids_percent,
         each.cycles, each.most_cycles, marks.get(each.name, ""))
        for each in candidates
    )  # fmt: skip
    sentence = f"{_conditions(plan, given)}: {_advice(best, second, too_dear)}."
    measurements = tuple(_measurements(candidates, board.cycle_model))
    return Conclusion(sentence, measurements, Table("study.choose", columns, rows), ())


def _candidate(name: str, numbers: Array) -> Candidate:
    errors_deg, ellipsoids, cycles = numbers.T
    high, low_end, high_end = quantile_and_interval(errors_deg, _HIGH)
    # So few instances that an end is not known: the end of all of them.
    at_least = float(errors_deg.min()) if low_end is None else low_end
    at_most = float(errors_deg.max()) if high_end is None else high_end
    return Candidate(name, float(np.median(errors_deg)), high, at_least, at_most, 100.0 * float(ellipsoids.mean()),
                     int(np.quantile(cycles, 0.5, method="lower")), int(cycles.max()))  # fmt: skip


def chosen(candidates: Sequence[Candidate]) -> Candidate | None:
    """Return the cheapest of those that err as little as the best, as far as the instances can tell.

    Notes
    -----
    That is those whose 95th percentile lies within the interval of the smallest one. None of no candidates.
    """
    if not candidates:
        return None
    best = min(candidates, key=lambda candidate: candidate.high_deg)
    return min((each for each in candidates if each.high_deg <= best.at_most_deg), key=lambda each: each.cycles)


def _conditions(plan: Plan, given: Given) -> str:
    budget = "any number of" if given.cycles is None else f"at most {readable(given.cycles)}"
    return (
        f"For {given.noise_ut:g} uT of noise in {given.field_ut:g} uT, {plan.points} points over at least "
        f"{given.coverage_percent:g} % of the sphere and {budget} cycles"
    )


def _advice(best: Candidate | None, second: Candidate | None, too_dear: Sequence[Candidate]) -> str:
    if best is None:
        return f"none; the cheapest is {min(too_dear, key=lambda each: each.most_cycles)}"
    more = chosen([each for each in too_dear if each.high_deg < best.at_least_deg])
    return (
        f"take {best}; {f'next is {second}' if second else 'no other is within the budget'}"
        + (f"; for more cycles {more}" if more else "")
    )


def _measurements(candidates: Sequence[Candidate], cycle_model: str) -> list[Measurement]:
    return [
        measurement for each in candidates for measurement in (
            check(f"study.choose.{each.name}.p95", each.high_deg, unit="deg"),
            check(f"study.choose.{each.name}.cycles", each.most_cycles, unit="cycle", cycle_model=cycle_model),
        )
    ]  # fmt: skip


def draw(run: Run) -> Figure:
    """Draw error against cycles, each calibrator's median and 95th percentile."""
    table = run.table("study.choose")
    assert table is not None
    found = [(str(row[0]), float(row[6] or 0.0), float(row[1] or 0.0), float(row[2] or 0.0), str(row[8]))
             for row in table.rows]  # fmt: skip
    cycles = [each[1] for each in found]
    figure = Figure(
        title="Error against cycles", description=run.verdict.sentence, x_label="cycles of one calibration, median",
        y_label="direction error, median to p95 [deg]", x_range=(min(cycles) / 1.5, max(cycles) * 1.5),
        y_range=(min(each[2] for each in found) / 1.3, max(each[3] for each in found) * 1.3), width=560.0, height=360.0,
        log_x=True, log_y=True,
    )  # fmt: skip
    for index, (name, x, median, high, choice) in enumerate(found):
        style, mark = series(index)
        figure.bars([(x, median, high)], style)
        figure.series(f"{name}, {choice}" if choice else name, [(x, median)], mark=mark or Mark.DOT,
                      mark_style=f"{style} filled")  # fmt: skip
    return figure


STUDY = Study(
    name="choose",
    question="Which calibrator of the board for my noise, my number of points, my coverage and my cycles?",
    conditions=1, instances=400, points=100, block=20, measure=measure, conclude=conclude, draw=draw,
    most_points=MOST_POINTS,
)  # fmt: skip
