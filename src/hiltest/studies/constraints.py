"""`constraints`: improvement of fits that are constrained to ellipsoids, by a step towards the unconstrained fit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import bisect
from scipy.spatial.transform import Rotation

from hiltest.calibration.clouds import Clouds, Solution, constant_part, constant_trace
from hiltest.calibration.fit import Array, FitStatus
from hiltest.calibration.gradient_descent import fit_gradient_descent
from hiltest.calibration.li import fit_li
from hiltest.errors import HiltestError
from hiltest.measurement import check
from hiltest.report.marks import KeyEntry, Mark, series
from hiltest.report.svg import Figure
from hiltest.run_record.run import Cell, Column, Run, Table
from hiltest.studies.methods import calibrate
from hiltest.studies.study import Block, Conclusion, Numbers, Plan, PrintedFigure, Study

# Surfaces of the points in each condition, before noise. Points of the ellipsoid cover only a cap, so that noise can
# make the best quadric another surface.
SURFACES = (
    "ellipsoid",
    "one-sheet hyperboloid",
    "two-sheet hyperboloid",
    "elliptic paraboloid",
    "hyperbolic paraboloid",
)
METHODS = {"gradient-descent": fit_gradient_descent, "li": fit_li}
_NOISE = (0.2, 0.05, 0.05, 0.05, 0.05)
_CAP = 0.15  # of the sphere
# For the rarest surface, a fifth of the optima with 30 points are not ellipsoids, and a thirtieth with 100 points.
_ATTEMPTS = 2000
# Figures of a method: whether its fit is an ellipsoid, the parameter at which the line leaves the ellipsoids, whether
# the quadric half-way to there is an ellipsoid, whether it is better, and the ratio of its error to that of the fit.
_FIGURES = 5
_COUNTS = 1000.0  # of a length of 1, for methods of one's own


def measure(plan: Plan, block: Block) -> Numbers:
    """Return whether the optimum's determinant is positive, and the figures of each method, for each cloud."""
    numbers: list[float | int] = []
    for instance in range(block.first, block.first + block.count):
        key = np.random.SeedSequence([plan.seed, block.condition, instance])
        clouds = _draw(np.random.Generator(np.random.Philox(key)), block.condition, plan.points)
        best = unconstrained(clouds)
        numbers.append(int(np.linalg.det(shape_of(best)) > 0.0))
        for method in METHODS.values():
            numbers += _method_figures(clouds, best, method.solve(clouds))
        for name in plan.methods:
            fit, _ = calibrate(plan, name, _COUNTS * clouds.points)
            ellipsoid = Solution(fit.soft_iron * _COUNTS, fit.hard_iron / _COUNTS, np.array(fit.status, np.int8))
            numbers += _method_figures(clouds, best, ellipsoid)
    return numbers


def _draw(random: np.random.Generator, surface: int, count: int) -> Clouds:
    """Draw points until the best quadric of unit trace is not an ellipsoid."""
    for _ in range(_ATTEMPTS):
        clouds = Clouds.centre(_points(random, surface, count))
        if not np.linalg.eigvalsh(shape_of(unconstrained(clouds)))[0] > 0.0:
            return clouds
    raise HiltestError(
        f"the best quadric of {count} points was an ellipsoid {_ATTEMPTS} times ({SURFACES[surface]}): use fewer points"
    )


def _points(random: np.random.Generator, surface: int, count: int) -> Array:
    """Draw points of a surface with noise; the surface's axes have random directions and lengths."""
    u, turn = random.uniform(-1.0, 1.0, count), random.uniform(0.0, 2.0 * np.pi, count)
    sign = random.choice([-1.0, 1.0], count)
    height = 1.0 - _CAP * (1.0 + u)
    across = np.sqrt(1.0 - height * height)
    cosine, sine = np.cos(turn), np.sin(turn)
    x, y, z = (
        (across * cosine, across * sine, height),
        (np.cosh(u) * cosine, np.cosh(u) * sine, np.sinh(u)),
        (np.sinh(u) * cosine, np.sinh(u) * sine, sign * np.cosh(u)),
        (u * cosine, u * sine, u * u),
        (u, np.cos(turn), u * u - np.cos(turn) ** 2),
    )[surface]
    points = np.column_stack([x, y, z]) * random.uniform(0.5, 1.5, 3)
    turned: Array = Rotation.random(rng=random).apply(points)
    return turned + _NOISE[surface] * random.standard_normal(turned.shape)


def unconstrained(clouds: Clouds) -> Array:
    """Return the coefficients of unit trace with the smallest algebraic error, shape (10,)."""
    basis, sphere = constant_trace(clouds.axes), constant_part(clouds.axes)
    parameters = np.linalg.solve(clouds.normal, -(basis.T @ clouds.scatter @ sphere))
    return np.asarray(sphere + basis @ parameters)


def coefficients(solution: Solution) -> Array:
    """Return the coefficients of unit trace, shape (10,), of the ellipsoid that a solution maps to the sphere."""
    shape = solution.soft_iron @ solution.soft_iron
    linear = -2.0 * shape @ solution.centre
    constant = solution.centre @ shape @ solution.centre - 1.0
    first, second = np.triu_indices(3, 1)
    quadric = np.concatenate([np.diag(shape), 2.0 * shape[first, second], linear, [constant]])
    return np.asarray(quadric / np.trace(shape))


def shape_of(quadric: Array) -> Array:
    """Return the matrix of a quadric's squares and products, shape (3, 3)."""
    shape = np.diag(quadric[:3])
    first, second = np.triu_indices(3, 1)
    shape[first, second] = shape[second, first] = quadric[3:6] / 2.0
    return shape


def is_ellipsoid(quadric: Array) -> bool:
    """Return whether a quadric is an ellipsoid: its shape is positive definite and its level positive."""
    shape = shape_of(quadric)
    if not np.linalg.eigvalsh(shape)[0] > 0.0:
        return False
    return bool(0.25 * quadric[6:9] @ np.linalg.solve(shape, quadric[6:9]) > quadric[9])


def leaves_at(best: Array, constrained: Array) -> float:
    """Return the parameter at which the line from a constrained fit (1) to the best one (0) leaves the ellipsoids.

    Notes
    -----
    The criterion is the smallest eigenvalue of the shape, which is concave along the line and has one zero. The
    determinant (Mucciaccia, 4.2.1) fails if the best shape has two negative eigenvalues: it is positive at both ends.
    """

    def smallest(t: float) -> float:
        return float(np.linalg.eigvalsh(shape_of(best + t * (constrained - best)))[0])

    return float(bisect(smallest, 0.0, 1.0))


def _method_figures(clouds: Clouds, best: Array, solution: Solution) -> list[float | int]:
    if int(solution.status) != FitStatus.ELLIPSOID:
        return [0] * _FIGURES
    constrained = coefficients(solution)
    tau = leaves_at(best, constrained)
    between = best + (tau + 1.0) / 2.0 * (constrained - best)
    error, before = (float(quadric @ clouds.scatter @ quadric) for quadric in (between, constrained))
    return [1, tau, int(is_ellipsoid(between)), int(error < before), error / before]


def conclude(plan: Plan, by_condition: Sequence[Sequence[Numbers]]) -> Conclusion:
    """Count the improvements, and judge the thesis' statements."""
    methods = plan.names(tuple(METHODS))
    size = 1 + _FIGURES * len(methods)
    by_surface = [np.concatenate([np.reshape(block, (-1, size)) for block in blocks]) for blocks in by_condition]
    rows: list[tuple[Cell, ...]] = []
    for surface, clouds in zip(SURFACES, by_surface, strict=True):
        for k, method in enumerate(methods):
            figures = clouds[:, 1 + _FIGURES * k : 1 + _FIGURES * (k + 1)]
            fitted = figures[figures[:, 0] == 1]
            rows.append(
                (
                    surface,
                    method,
                    len(clouds),
                    len(fitted),
                    int((fitted[:, 2] * fitted[:, 3]).sum()),
                    *(float(np.median(fitted[:, column])) if len(fitted) else None for column in (4, 1)),
                )
            )
    fits, better = (sum(int(row[column] or 0) for row in rows) for column in (3, 4))
    total, both_positive = sum(map(len, by_surface)), int(sum(clouds[:, 0].sum() for clouds in by_surface))
    columns = (
        Column("surface"),
        Column("constrained fit"),
        Column("clouds"),
        Column("ellipsoids"),
        Column("bettered"),
        Column("error left"),
        Column("line leaves at"),
    )
    values = {"clouds": total, "fits": fits, "bettered": better, "determinant_fails": both_positive}
    printed = (
        PrintedFigure(
            "constrained fits with a better ellipsoid on the line to the unconstrained one",
            "Mucciaccia, 3.3.2 and 4.2",
            "all",
            f"{better} of {fits}",
            better == fits,
            "the positive definite shapes are an open convex set, and along the line the error falls strictly",
        ),
        PrintedFigure(
            "clouds in which bisection of the determinant finds the border",
            "Mucciaccia, 4.2.1",
            "all",
            f"{total - both_positive} of {total}",
            not both_positive,
            "with two negative eigenvalues the determinant is positive at both ends; the smallest eigenvalue has one "
            "zero",
        ),
    )
    sentence = (
        f"{better} of {fits} constrained fits have a better ellipsoid on the line to the unconstrained fit; the "
        f"determinant does not find the border in {both_positive} of {total} clouds."
    )
    measurements = tuple(check(f"study.constraints.{name}", value, unit="") for name, value in values.items())
    return Conclusion(sentence, measurements, Table("study.constraints", columns, tuple(rows)), printed)


def draw(run: Run, table: Table) -> Figure:
    """Draw the error after one step along the line, for each surface."""
    figure = Figure(
        title="Error after one step along the line",
        description=run.verdict.sentence,
        x_label=", ".join(f"{number} {surface}" for number, surface in enumerate(SURFACES, 1)),
        y_label="ratio to the constrained fit, median",
        x_range=(0.5, len(SURFACES) + 0.5),
        y_range=(0.0, 1.05),
        x_ticks=tuple(float(number) for number in range(1, len(SURFACES) + 1)),
        width=700.0,
        height=360.0,
    )
    figure.level(1.0, "thesis")
    figure.key.append(KeyEntry("printed: each point is below 1", "thesis"))
    for k, method in enumerate(dict.fromkeys(str(row[1]) for row in table.rows)):
        style, mark = series(k)
        points = [
            (SURFACES.index(str(row[0])) + 1.0 + 0.1 * (2 * k - 1), float(row[5]))
            for row in table.rows
            if row[1] == method and row[5] is not None
        ]
        figure.series(method, points, mark=mark or Mark.DOT, mark_style=f"{style} filled")
    return figure


STUDY = Study(
    name="constraints",
    question="Is there a better ellipsoid on the line from a constrained fit to the unconstrained one?",
    conditions=len(SURFACES),
    instances=60,
    points=30,
    block=20,
    measure=measure,
    conclude=conclude,
    draw=draw,
)
