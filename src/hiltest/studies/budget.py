"""`budget`: error of each calibrator on the board against the available clock cycles, for the same points."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from hiltest.boards import Board, open_board
from hiltest.calibration import FIRMWARE
from hiltest.calibration.fit import Array
from hiltest.calibration.quality import COUNTS_PER_UT, direction_error_rms_deg, sphere_directions
from hiltest.errors import ConfigError
from hiltest.measurement import Measurement, check
from hiltest.procedures import Effort, effort_curve, evenly_spread, upload_points
from hiltest.report.marks import series
from hiltest.report.svg import Figure
from hiltest.rig.bench_files import shipped
from hiltest.rig.rig_file import load_rig
from hiltest.run_record.run import Column, Run, Table
from hiltest.studies.board_calibrators import board_calibrators
from hiltest.studies.methods import split_firmware_method
from hiltest.studies.study import Block, Conclusion, Numbers, Plan, PrintedFigure, Study

NAMES = tuple(sorted(FIRMWARE))
# Noise and number of points of the thesis, and soft and hard iron of an ordinary board.
_FIELD_UT, _NOISE_UT, _HARD_IRON_UT, _STRETCH, _POINTS = 50.0, 0.3, 50.0, 0.2, 30
#: Clock cycles.
BUDGETS = tuple(np.rint(np.geomspace(2_000, 400_000, 24)).astype(int).tolist())
_DIRECTIONS = sphere_directions(200)
# Numbers of a curve: the error at each budget, the final error, its cycles, and the cycles that suffice for it.
_NUMBERS = len(BUDGETS) + 3
_NONE = -1.0
# Cycles suffice if their error is at most this factor of the final error.
_SUFFICIENT = 1.05
# Cycles according to the thesis, and its factor between its own calibrator and the others.
_THESIS_PER_POINT, _THESIS_FIXED, _TIMES = 168, 2600, 10.0


def measure(plan: Plan, block: Block) -> Numbers:
    """Return the numbers of each calibrator for each instance: errors [deg], and cycles."""
    numbers: list[float | int] = []
    files: dict[str | None, list[str]] = {None: list(NAMES)}
    for method in plan.methods:
        elf, name = split_firmware_method(plan, method)
        files.setdefault(elf, []).append(name)
    with ExitStack() as stack:
        rig = load_rig(shipped() / "rigs" / "virtual-k64f.toml")
        boards = {file: stack.enter_context(open_board(rig, firmware=Path(file) if file else None)) for file in files}
        most = min(board.identity.max_points for board in boards.values())
        if plan.points > most:
            raise ConfigError(f"the board stores {most} points, not {plan.points}: reduce --points")
        for instance in range(block.first, block.first + block.count):
            random = np.random.Generator(np.random.Philox(key=[plan.seed, instance]))
            axes = Rotation.random(rng=random).as_matrix()
            soft_iron = (axes * random.uniform(1.0 - _STRETCH, 1.0 + _STRETCH, 3)) @ axes.T
            offset_ut = random.uniform(-_HARD_IRON_UT, _HARD_IRON_UT, 3)
            field_ut = _FIELD_UT * sphere_directions(plan.points)[evenly_spread(plan.points)]
            points_ut = field_ut @ soft_iron + offset_ut + _NOISE_UT * random.standard_normal(field_ut.shape)
            readings = COUNTS_PER_UT * (_FIELD_UT * _DIRECTIONS @ soft_iron + offset_ut)
            for file, board in boards.items():
                upload_points(board, np.rint(COUNTS_PER_UT * points_ut).astype(np.int16))
                for name in files[file]:
                    numbers += _curve(board, name, plan.points, readings)
    return numbers


def _curve(board: Board, name: str, points: int, readings: Array) -> list[float | int]:
    efforts = [effort for effort in effort_curve(board, name, points=points) if effort.fit.has_fit]
    errors = [direction_error_rms_deg(effort.fit, readings, _DIRECTIONS) for effort in efforts]
    if not efforts:
        return [*[_NONE] * (_NUMBERS - 2), 0, 0]
    enough = len(errors)
    while enough > 1 and errors[enough - 2] <= _SUFFICIENT * errors[-1]:
        enough -= 1
    return [
        *(_error_within(efforts, errors, budget) for budget in BUDGETS),
        errors[-1],
        efforts[-1].cycles,
        efforts[enough - 1].cycles,
    ]


def _error_within(efforts: Sequence[Effort], errors: Sequence[float], budget: int) -> float:
    """Return the error of the largest effort within a budget."""
    paid = [error for effort, error in zip(efforts, errors, strict=True) if effort.cycles <= budget]
    return paid[-1] if paid else _NONE


def conclude(plan: Plan, by_condition: Sequence[Sequence[Numbers]]) -> Conclusion:
    """Compute means, and judge the ratios of the calibrators' cycles."""
    names = plan.names(NAMES)
    numbers = np.concatenate([np.reshape(block, (-1, len(names), _NUMBERS)) for block in by_condition[0]])
    means, lowest = numbers.mean(axis=0), numbers.min(axis=0)
    rows = tuple(
        (name, budget, float(means[k, place]) if lowest[k, place] >= 0.0 else None)
        for k, name in enumerate(names)
        for place, budget in enumerate(BUDGETS)
    )
    columns = (Column("calibrator"), Column("cycles", "cycle"), Column("mean error", "deg"))
    errors, cycles, enough = (dict(zip(names, means[:, k].tolist(), strict=True)) for k in (-3, -2, -1))
    sentence = (
        f"From {plan.points} points, direct has an error of {errors['direct']:.2f} deg after {cycles['direct']:.0f} "
        "cycles; to within 5 % of the final error "
        f"{', '.join(f'{name} takes {enough[name]:.0f}' for name in _OTHERS)}, "
        f"in the mean of {len(numbers)} instances."
    )
    return Conclusion(
        sentence,
        tuple(_measurements(errors, cycles)),
        Table("study.budget", columns, rows),
        tuple(_printed_figures(plan, cycles, enough)),
    )


_OTHERS = {
    "iterative": "FSFLK",
    "gradient-descent": "gradient descent",
    "gauss-newton": "Gauss-Newton",
}


def _measurements(errors: dict[str, float], cycles: dict[str, float]) -> list[Measurement]:
    measurements = []
    for name in NAMES:
        measurements.append(check(f"study.budget.{name}.mean_error", errors[name], unit="deg"))
        measurements.append(
            check(
                f"study.budget.{name}.mean_cycles",
                cycles[name],
                unit="cycle",
                cycle_model=board_calibrators().cycle_model,
            )
        )
    return measurements


def _printed_figures(plan: Plan, cycles: dict[str, float], enough: dict[str, float]) -> list[PrintedFigure]:
    ours, theirs = cycles["direct"], _THESIS_PER_POINT * plan.points + _THESIS_FIXED
    why = {
        "iterative": "it solves for all ten elements at once, and only once; the thesis counts 2860 cycles per point",
        "gradient-descent": "its steps use moments, whose cost does not depend on the points; most of it is curvatures",
        "gauss-newton": "a step takes about 420 cycles per point, and one or two steps from the sphere nearly suffice",
    }
    return [
        PrintedFigure(
            f"cycles of its own calibrator for {plan.points} points",
            "Mucciaccia, 4.3",
            f"{theirs}",
            f"{ours:.0f}",
            bool(abs(ours - theirs) < 0.1 * theirs),
            "two passes keep 34 sums in registers, the thesis has 54 sums; the matrix is solved in assembly",
        ),
        *(
            PrintedFigure(
                f"speed ratio to {method}",
                "Mucciaccia, 4.4 and Figure 22",
                f"more than {_TIMES:g}",
                f"{enough[name] / ours:.1f} to within 5 % of its final error, {cycles[name] / ours:.1f} to its end",
                enough[name] > _TIMES * ours,
                why[name],
            )
            for name, method in _OTHERS.items()
        ),
    ]


def draw(run: Run, table: Table) -> Figure:
    """Draw mean error against cycles, on logarithmic axes."""
    lines: dict[str, list[tuple[float, float]]] = {str(row[0]): [] for row in table.rows}
    for name, cycles, error in table.rows:
        if error is not None:
            lines[str(name)].append((float(cycles or 0) / 1000.0, float(error)))
    all_errors = [error for line in lines.values() for _, error in line]
    figure = Figure(
        title="Mean error over available cycles",
        description=run.verdict.sentence,
        x_label="thousand cycles",
        y_label="rms over the sphere [deg]",
        x_range=(BUDGETS[0] / 1100.0, BUDGETS[-1] / 900.0),
        y_range=(min(all_errors) / 1.3, max(all_errors) * 1.3),
        width=560.0,
        height=360.0,
        log_x=True,
        log_y=True,
    )
    for index, (name, line) in enumerate(lines.items()):
        style, mark = series(index)
        figure.series(name, line, style, mark)
    figure.upright((_THESIS_PER_POINT * _POINTS + _THESIS_FIXED) / 1000.0, "printed: its own calibrator", "thesis")
    return figure


STUDY = Study(
    name="budget",
    question="How large is the error of each calibrator on the board for the same points and a budget of clock cycles?",
    conditions=1,
    instances=100,
    points=_POINTS,
    block=5,
    measure=measure,
    conclude=conclude,
    draw=draw,
)
