"""Streaming calibrators: cycles per point, and accuracy over received points."""

from __future__ import annotations

import numpy as np
import pytest

from hiltest.boards import Board
from hiltest.calibration.accelerometer import AccelerometerFit
from hiltest.procedures import RequestedAngles, StreamRun, heading_errors_deg
from hiltest.session.fixtures import Measure

pytestmark = pytest.mark.hil


def test_cost_of_a_new_point(board: Board, streams: dict[str, StreamRun], measure: Measure) -> None:
    for name, run in streams.items():
        point_cycles = run.cycles if run.cycles is not None and len(run.cycles) else None
        for statistic, function in (("mean", np.mean), ("median", np.median), ("max", np.max)):
            cycles = None if point_cycles is None else float(function(point_cycles))
            measure(f"stream.{name}.cycles_{statistic}", cycles, "cycle", cycle_model=board.cycle_model)
        cycles = run.last.state.cost and run.last.state.cost.cycles
        measure(f"stream.{name}.total", run.total, "cycle", cycle_model=board.cycle_model, band=run.total_range)
        measure(f"stream.{name}.fit_cycles", cycles, "cycle", cycle_model=board.cycle_model, band=run.fit_range)


def test_cost_of_a_point_taken_back(board: Board, streams: dict[str, StreamRun], measure: Measure) -> None:
    for name, run in streams.items():
        if run.remove_cycles is not None:
            for statistic, function in (("mean", np.mean), ("max", np.max)):
                cycles = float(function(run.remove_cycles))
                measure(f"stream.{name}.remove_{statistic}", cycles, "cycle", cycle_model=board.cycle_model)


def test_points_held_and_tier_at_the_end(streams: dict[str, StreamRun], measure: Measure) -> None:
    for name, run in streams.items():
        measure(f"stream.{name}.held", run.last.state.held, "")
        measure(f"stream.{name}.elements", run.last.state.elements or None, "")
        measure(f"stream.{name}.refused", int(run.refused), "")


def test_what_is_known_on_the_way(
    known_angles: RequestedAngles, streams: dict[str, StreamRun], accelerometer_fit: AccelerometerFit, measure: Measure
) -> None:
    # The host computes these headings in float64 from the board's means, because there are more stages than slots. The
    # last stage is in a slot too: heading.<name>.max is the board's own answer for it.
    rows = []
    for name, run in streams.items():
        for stage in run.stages:
            errors = heading_errors_deg(known_angles, stage.fit, accelerometer_fit)
            worst, mean = (None, None) if errors is None else (float(abs(errors).max()), float(abs(errors).mean()))
            state = stage.state
            rows.append(
                [
                    name,
                    stage.points,
                    state.fit.name,
                    state.is_sphere,
                    state.held,
                    state.elements,
                    state.accepted,
                    state.fit_error_percent,
                    worst,
                    mean,
                ]
            )
    measure.table(
        "stream.stages",
        {"calibrator": "", "points": "", "fit": "", "sphere": "", "held": "", "elements": "", "accepted": ""}
        | {"fit_error": "%", "max_error": "deg", "mean_error": "deg"},
        rows,
    )
