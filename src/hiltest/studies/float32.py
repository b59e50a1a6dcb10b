"""`float32`: stability of the board's calibrators in single precision against hard iron."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple
from itertools import takewhile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hiltest.calibration import reference
from hiltest.calibration.clouds import constant_part, constant_trace, solution_from_quadrics
from hiltest.calibration.conditioning import quadric_rows
from hiltest.calibration.fit import Array, FitStatus, MagnetometerFit, no_fit, squared_lengths
from hiltest.calibration.quality import direction_difference_rms_deg
from hiltest.measurement.estimates import Estimate, quantile
from hiltest.report.marks import Mark, series
from hiltest.report.svg import Figure
from hiltest.run_record.run import Cell, Column, Run, Table
from hiltest.studies.board_calibrators import MOST_POINTS, board_calibrators
from hiltest.studies.instances import Model, counted_fit, draw_instances
from hiltest.studies.methods import split_firmware_method
from hiltest.studies.quantiles import quantile_columns, quantile_measurement
from hiltest.studies.study import Block, Conclusion, Numbers, Plan, PrintedFigure, Study

#: Ratios of hard iron to the field; at larger ratios a sensor with a range of 1000 uT saturates.
RATIOS = (0.0, 1.0, 2.0, 5.0, 10.0, 20.0)
JUDGED = RATIOS.index(10.0)
#: The closed form with sums about the sensor's zero, as in the thesis and Two-Step; the firmware does not have it.
ABOUT_ZERO = "direct-about-zero"
_NOISE_UT = 0.3
_HIGH = 0.95
# Ratio to the error due to noise. Squares add up, so the total error grows by a tenth, as with a tenth more noise; data
# sheets do not state noise more accurately.
_STABLE = 0.46
_UNIT_COUNTS = 512.0  # near the field's norm; scaling by a power of two causes no rounding
_NUMBERS = 4
STABLE, UNSTABLE, UNDECIDED = "stable", "unstable", "undecided"


def names(plan: Plan) -> tuple[str, ...]:
    """Return the names of the board's calibrators, those of one's own firmware, and the one for comparison."""
    return (*plan.names(board_calibrators().names), ABOUT_ZERO)


def measure(plan: Plan, block: Block) -> Numbers:
    """Return errors in float32 and float64, the angle between both [deg], and whether the status differs.

    The order is by instance and calibrator.
    """
    board = board_calibrators()
    model = Model(plan.seed, plan.points, _NOISE_UT, stream=block.condition)
    drawn = draw_instances(model, block.first, block.count).set_hard_iron(RATIOS[block.condition] * model.field_ut)
    numbers: list[float | int] = []
    for k in range(block.count):
        counts = drawn.counts(k)
        for name in names(plan):
            file, in_table = split_firmware_method(plan, name) if name in plan.methods else (None, name)
            calibrators = board if file is None else board_calibrators(Path(file))
            single = about_zero(counts) if name == ABOUT_ZERO else calibrators.calibrate(in_table, counts)[0]
            double = reference("direct" if name == ABOUT_ZERO else in_table)(counts)
            differs = single.status != double.status
            if name != ABOUT_ZERO:
                single = counted_fit(single, counts)
            double = counted_fit(double, counts)
            numbers += [
                *(drawn.direction_error_deg(k, fit, model.field_ut) for fit in (single, double)),
                direction_difference_rms_deg(single, double),
                int(differs),
            ]
    return numbers


def about_zero(counts: Array) -> MagnetometerFit:
    """Fit the quadric of unit trace by sums about the sensor's zero, with sums and solution in float32.

    Notes
    -----
    As in C, points are added one after the other, and the elimination has no pivoting. Elementary operations, which
    IEEE 754 rounds uniquely, replace BLAS, so that the result is the same on every host. The calibration is computed in
    float64.
    """
    points = counts / _UNIT_COUNTS
    rows = np.column_stack([quadric_rows(points), -squared_lengths(points)]).astype(np.float32)
    solved = _solve_normal_equations(np.add.reduce(rows[:, :9, None] * rows[:, None, :], axis=0))
    if solved is None:
        return no_fit(FitStatus.SINGULAR)
    solution = solution_from_quadrics(3.0 * constant_part(3) + constant_trace(3) @ solved.astype(np.float64), 3)
    if int(solution.status) != FitStatus.ELLIPSOID:
        return no_fit(FitStatus.NOT_AN_ELLIPSOID)
    return MagnetometerFit(
        FitStatus.ELLIPSOID, False, 0, solution.soft_iron / _UNIT_COUNTS, _UNIT_COUNTS * solution.centre
    )


def _solve_normal_equations(equations: NDArray[np.float32]) -> NDArray[np.float32] | None:
    """Solve normal equations of shape (n, n + 1), with the right side last; None if a pivot is not positive."""
    remaining = equations.copy()
    unknowns = len(remaining)
    for pivot in range(unknowns):
        if not remaining[pivot, pivot] > 0.0:
            return None
        shares = remaining[pivot + 1 :, pivot] / remaining[pivot, pivot]
        remaining[pivot + 1 :] -= shares[:, None] * remaining[pivot]
    solution = np.zeros(unknowns, dtype=np.float32)
    for row in reversed(range(unknowns)):
        substituted = np.add.reduce(remaining[row, row + 1 : unknowns] * solution[row + 1 :])
        solution[row] = (remaining[row, unknowns] - substituted) / remaining[row, row]
    return solution


def conclude(plan: Plan, by_condition: Sequence[Sequence[Numbers]]) -> Conclusion:
    """Compute medians and 95th percentiles, and compare float32's effect with that of noise."""
    by_ratio = [
        np.concatenate([np.reshape(block, (-1, len(names(plan)), _NUMBERS)) for block in blocks])
        for blocks in by_condition
    ]
    rows: list[tuple[Cell, ...]] = []
    states: dict[str, list[str]] = {}
    apart: dict[str, list[Estimate]] = {}
    medians: list[Estimate] = []
    for ratio, numbers in zip(RATIOS, by_ratio, strict=True):
        for index, name in enumerate(names(plan)):
            single, double, angles, differs = numbers[:, index].T
            quantiles = [quantile(errors, share) for share in (0.5, _HIGH) for errors in (single, double)]
            alike = angles[differs == 0]
            added = quantile(alike if len(alike) else angles, _HIGH)
            apart.setdefault(name, []).append(added)
            states.setdefault(name, []).append(stability(added, quantiles[-1]))
            if name == ABOUT_ZERO:
                medians.append(quantiles[0])
            cells = [cell for estimate in (*quantiles, added) for cell in astuple(estimate)]
            rows.append((name, ratio, *cells, 100.0 * float(differs.mean()), states[name][-1]))
    columns = (
        Column("calibrator"),
        Column("hard iron / field"),
        *(
            column
            for share in ("median", "p95")
            for precision in ("float32", "float64")
            for column in quantile_columns(f"{precision} {share}", "deg")
        ),
        *quantile_columns("apart p95", "deg"),
        Column("other status", "%"),
        Column("float32 is"),
    )
    board = names(plan)[:-1]
    stable = sum(set(states[name]) == {STABLE} for name in board)
    unstable = [name for name in board if UNSTABLE in states[name]]
    undecided = len(board) - stable - len(unstable)
    worst = max((estimate for name in board for estimate in apart[name]), key=lambda estimate: estimate.value)
    sentence = (
        f"{stable} of the board's {len(board)} calibrators are stable in float32 up to {RATIOS[-1]:g} times the field"
        + (f", unstable are {', '.join(unstable)}" if unstable else "")
        + (f", {undecided} undecided" if undecided else "")
        + f"; the largest angle to float64 is {worst} deg in {100 * _HIGH:g} % of {plan.instances} instances, with "
        f"the 95 % confidence interval; with sums about the sensor's zero, direct is {_range(states[ABOUT_ZERO])}."
    )
    judged = [quantile(by_ratio[JUDGED][:, index, 2], _HIGH) for index in range(len(names(plan)))]
    measurements = tuple(
        quantile_measurement(f"study.float32.{name}.apart", estimate, "deg")
        for name, estimate in zip(names(plan), judged, strict=True)
        if name not in plan.methods
    )
    table = Table("study.float32", columns, tuple(rows))
    return Conclusion(sentence, measurements, table, _printed_figures(medians, states[ABOUT_ZERO]))


def stability(added: Estimate, noise: Estimate) -> str:
    """Return whether float32 is stable, if the intervals of its effect and of that of noise decide it."""
    if added.high is not None and noise.low is not None and added.high <= _STABLE * noise.low:
        return STABLE
    if added.low is not None and noise.high is not None and added.low > _STABLE * noise.high:
        return UNSTABLE
    return UNDECIDED


def _range(states: Sequence[str]) -> str:
    """Return the ratios up to which, and from which on, a calibrator's stability is decided."""
    stable = len(list(takewhile(lambda word: word == STABLE, states)))
    if stable == len(RATIOS):
        return "stable, too"
    first_unstable = next((ratio for ratio, word in zip(RATIOS, states, strict=True) if word == UNSTABLE), None)
    words = [f"stable up to {RATIOS[stable - 1]:g} times the field"] if stable else []
    words += [] if first_unstable is None else [f"unstable from {first_unstable:g} times the field on"]
    return " and ".join(words) or UNDECIDED


def _printed_figures(medians: Sequence[Estimate], states: Sequence[str]) -> tuple[PrintedFigure, ...]:
    parts = (f"{error} deg at {ratio:g}" for ratio, error in zip(RATIOS, medians, strict=True))
    measured = f"{ABOUT_ZERO} in the median {', '.join(parts)} times the field"
    suffices = False if UNSTABLE in states else None if UNDECIDED in states else True
    return (
        PrintedFigure(
            "Two-Step in single precision as hard iron grows",
            "INDUSCON 2018",
            "unstable",
            measured,
            None if suffices is None else not suffices,
            "like Two-Step, this fit sums about the sensor's zero; the board's calibrators sum about the middle of the "
            "points",
        ),
        PrintedFigure(
            "float32 for a sensor of 10 bits",
            "Mucciaccia, 4.3",
            "suffices",
            measured,
            suffices,
            "fourth powers have four times the bits of a reading: float32 suffices for sums about the middle of the "
            "points, and for sums about zero if hard iron is small",
        ),
    )


def draw(run: Run, table: Table) -> Figure:
    """Draw the effects of float32 and of noise against hard iron."""
    lines: dict[str, list[tuple[float, float]]] = {}
    for row in table.rows:
        lines.setdefault(str(row[0]), []).append((float(row[1] or 0.0), float(row[14] or 0.0)))
    direct = [(float(row[1] or 0.0), float(row[5] or 0.0)) for row in table.rows if row[0] == "direct"]
    heights = [y for line in (*lines.values(), direct) for _, y in line if y > 0.0]
    figure = Figure(
        title="Effect of float32",
        description=run.verdict.sentence,
        x_label="hard iron / field",
        y_label="angle to float64, p95 [deg]",
        x_range=(-0.5, RATIOS[-1] + 0.5),
        y_range=(min(heights) / 1.5, max(heights) * 1.5),
        x_ticks=RATIOS,
        width=560.0,
        height=360.0,
        log_y=True,
    )
    for index, (name, line) in enumerate(lines.items()):
        style, mark = ("neutral", Mark.DIAMOND) if name == ABOUT_ZERO else series(index)
        figure.series(name, line, style, mark)
    figure.series("effect of noise, median", direct, "thesis")
    return figure


STUDY = Study(
    name="float32",
    question="Which calibrators of the board are stable in single precision, as hard iron grows?",
    conditions=len(RATIOS),
    instances=200,
    points=100,
    block=20,
    measure=measure,
    conclude=conclude,
    draw=draw,
    most_points=MOST_POINTS,
)
