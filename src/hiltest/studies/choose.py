"""`choose`: best calibrator of the board for an engineer's noise, number of points, coverage and budget of cycles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass

import numpy as np

from hiltest.calibration.fit import Array, FitStatus
from hiltest.measurement import Measurement, check
from hiltest.measurement.estimates import Estimate, fewest_for_upper_end, quantile
from hiltest.report.marks import Mark, series
from hiltest.report.svg import Figure
from hiltest.run_record.run import Column, Run, Table
from hiltest.studies.board_calibrators import MOST_POINTS, board_calibrators
from hiltest.studies.instances import Model, counted_fit, draw_instances
from hiltest.studies.methods import calibrate
from hiltest.studies.quantiles import quantile_columns, quantile_measurement
from hiltest.studies.study import EQUAL, Block, Conclusion, Conditions, Numbers, Plan, Study
from hiltest.text import format_number

_HIGH = 0.95
_NUMBERS = 3
RECOMMENDED, RUNNER_UP, TOO_DEAR, NOT_COUNTED = "recommended", "runner-up", "over budget", "cycles not counted"


@dataclass(frozen=True, slots=True)
class Candidate:
    """A calibrator of the board under the plan's conditions."""

    name: str
    median: Estimate
    """Median over instances of the direction's rms error [deg]."""
    high: Estimate
    """95th percentile of that error [deg]."""
    ellipsoids_percent: float
    """Instances with an ellipsoid as the result [%]; the others have a sphere."""
    cycles: int
    most_cycles: int
    """Median over instances, and maximum; 0 if they are not counted."""

    def __str__(self) -> str:
        """Return name, errors and cycles."""
        at_most = f", at most {format_number(self.most_cycles)}" if self.most_cycles > self.cycles else ""
        return (
            f"{self.name}, {self.median} deg in the median, {self.high} in {100 * _HIGH:g} %, "
            f"{format_number(self.cycles)} cycles{at_most}"
        )


def measure(plan: Plan, block: Block) -> Numbers:
    """Return direction error [deg], whether the fit is an ellipsoid, and cycles, for each instance and calibrator."""
    conditions, board = plan.conditions or Conditions(), board_calibrators()
    model = Model(
        plan.seed,
        plan.points,
        conditions.noise_ut,
        occluded=1.0 - conditions.coverage_percent / 100.0,
        field_ut=conditions.field_ut,
    )
    drawn = draw_instances(model, block.first, block.count)
    numbers: list[float | int] = []
    for k in range(block.count):
        for name in plan.names(board.names):
            counts = drawn.counts(k)
            in_board = name in board.names
            fit, cycles = board.calibrate(name, counts) if in_board else calibrate(plan, name, counts)
            error_deg = drawn.direction_error_deg(k, counted_fit(fit, counts), model.field_ut)
            numbers += [error_deg, int(fit.status is FitStatus.ELLIPSOID), cycles or 0]
    return numbers


def conclude(plan: Plan, by_condition: Sequence[Sequence[Numbers]]) -> Conclusion:
    """Select the recommended calibrator and the runner-up."""
    conditions, board = plan.conditions or Conditions(), board_calibrators()
    names = plan.names(board.names)
    numbers = np.concatenate([np.reshape(block, (-1, len(names), _NUMBERS)) for block in by_condition[0]])
    equal_names: dict[bytes, list[str]] = {}
    for index, name in enumerate(names):
        equal_names.setdefault(numbers[:, index].tobytes(), []).append(name)
    candidates = [_candidate(EQUAL.join(equal), numbers[:, names.index(equal[0])]) for equal in equal_names.values()]
    counted = [candidate for candidate in candidates if candidate.most_cycles]
    affordable = [
        candidate for candidate in counted if conditions.cycles is None or candidate.most_cycles <= conditions.cycles
    ]
    best = choose_calibrator(affordable)
    second = choose_calibrator([candidate for candidate in affordable if candidate is not best])
    too_dear = [candidate for candidate in counted if candidate not in affordable]
    marks = {candidate.name: NOT_COUNTED for candidate in candidates} | dict.fromkeys(
        (candidate.name for candidate in counted), ""
    )
    marks |= dict.fromkeys((candidate.name for candidate in too_dear), TOO_DEAR)
    for choice, mark in ((best, RECOMMENDED), (second, RUNNER_UP)):
        if choice is not None:
            marks[choice.name] = mark
    columns = (
        Column("calibrator"),
        *quantile_columns("median", "deg"),
        *quantile_columns("p95", "deg"),
        Column("ellipsoids", "%"),
        Column("cycles", "cycle"),
        Column("cycles, at most", "cycle"),
        Column("choice"),
    )
    rows = tuple(
        (
            candidate.name,
            *astuple(candidate.median),
            *astuple(candidate.high),
            candidate.ellipsoids_percent,
            candidate.cycles or None,
            candidate.most_cycles or None,
            marks[candidate.name],
        )
        for candidate in candidates
    )
    advice = (
        f"{format_number(plan.instances)} instances are too few to choose; repeat with at least "
        f"{fewest_for_upper_end(_HIGH)} (--instances)"
        if best is None and affordable
        else _advice(best, second, too_dear)
    )
    sentence = f"{_conditions(plan, conditions)}: {advice}."
    packaged = {name: candidate for candidate in candidates for name in candidate.name.split(EQUAL)}
    measurements = tuple(_measurements({name: packaged[name] for name in board.names}, board.cycle_model))
    return Conclusion(sentence, measurements, Table("study.choose", columns, rows), ())


def _candidate(name: str, numbers: Array) -> Candidate:
    errors_deg, ellipsoids, cycles = numbers.T
    return Candidate(
        name,
        quantile(errors_deg, 0.5),
        quantile(errors_deg, _HIGH),
        100.0 * float(ellipsoids.mean()),
        int(np.quantile(cycles, 0.5, method="lower")),
        int(cycles.max()),
    )


def choose_calibrator(candidates: Sequence[Candidate]) -> Candidate | None:
    """Return the cheapest calibrator whose error is indistinguishable from the best.

    Returns
    -------
    Candidate or None
        None without candidates, or if the instances are too few to exclude any.

    Notes
    -----
    Its 95th percentile is at most the upper end of the interval of the smallest 95th percentile.
    """
    best = min(candidates, key=lambda candidate: candidate.high.value, default=None)
    if best is None or (at_most_deg := best.high.high) is None:
        return None
    return min(
        (candidate for candidate in candidates if candidate.high.value <= at_most_deg),
        key=lambda candidate: candidate.cycles,
    )


def _conditions(plan: Plan, conditions: Conditions) -> str:
    budget = "any number of" if conditions.cycles is None else f"at most {format_number(conditions.cycles)}"
    return (
        f"For {conditions.noise_ut:g} uT of noise in {conditions.field_ut:g} uT, {plan.points} points over at least "
        f"{conditions.coverage_percent:g} % of the sphere and {budget} cycles"
    )


def _advice(best: Candidate | None, second: Candidate | None, too_dear: Sequence[Candidate]) -> str:
    if best is None:
        return f"no calibrator; the cheapest is {min(too_dear, key=lambda candidate: candidate.most_cycles)}"
    more = choose_calibrator([candidate for candidate in too_dear if candidate.high.value < (best.high.low or 0.0)])
    return f"use {best}; {f'next is {second}' if second else 'no other one is within the budget'}" + (
        f"; with more cycles {more}" if more else ""
    )


def _measurements(candidates: Mapping[str, Candidate], cycle_model: str) -> list[Measurement]:
    return [
        measurement
        for name, candidate in candidates.items()
        for measurement in (
            quantile_measurement(f"study.choose.{name}.p95", candidate.high, "deg"),
            check(f"study.choose.{name}.cycles", candidate.most_cycles, unit="cycle", cycle_model=cycle_model),
        )
    ]


def draw(run: Run, table: Table) -> Figure:
    """Draw error against cycles, each calibrator's median and 95th percentile."""
    entries = [
        (str(row[0]), float(row[8] or 0.0), float(row[1] or 0.0), float(row[4] or 0.0), str(row[10]))
        for row in table.rows
        if row[8] is not None
    ]
    cycles = [entry[1] for entry in entries]
    figure = Figure(
        title="Error against cycles",
        description=run.verdict.sentence,
        x_label="cycles of one calibration, median",
        y_label="direction error, median to p95 [deg]",
        x_range=(min(cycles) / 1.5, max(cycles) * 1.5),
        y_range=(min(entry[2] for entry in entries) / 1.3, max(entry[3] for entry in entries) * 1.3),
        width=560.0,
        height=360.0,
        log_x=True,
        log_y=True,
    )
    for index, (name, x, median, high, choice) in enumerate(entries):
        style, mark = series(index)
        figure.bars([(x, median, high)], style)
        figure.series(
            f"{name}, {choice}" if choice else name, [(x, median)], mark=mark or Mark.DOT, mark_style=f"{style} filled"
        )
    return figure


STUDY = Study(
    name="choose",
    question="Which calibrator of the board is best for my noise, number of points, coverage and cycles?",
    conditions=1,
    instances=400,
    points=100,
    block=20,
    measure=measure,
    conclude=conclude,
    draw=draw,
    unprinted="No paper prints errors of several calibrators for conditions of one's own; the study budget draws the "
    "cycles that Mucciaccia prints (4.3).",
    most_points=MOST_POINTS,
)
