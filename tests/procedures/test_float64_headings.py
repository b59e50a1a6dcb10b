"""Board against host on the same numbers: what float32 does to a heading."""

from __future__ import annotations

from dataclasses import replace

import pytest

from hiltest.boards import Board
from hiltest.orientation.angles import Pose
from hiltest.procedures import (
    CalibratorRun,
    KnownAngles,
    Tumble,
    Turntable,
    collect_tumble,
    float32_error_deg,
    measure_known_angles,
    run_calibrators,
)

POSES = [Pose(0.0), Pose(130.0, 20.0), Pose(250.0, 0.0, -20.0)]


@pytest.fixture
def tumble(virtual_board: Board, simulated_turntable: Turntable) -> Tumble:
    return collect_tumble(virtual_board, simulated_turntable, points=100)


@pytest.fixture
def runs(virtual_board: Board, tumble: Tumble) -> dict[str, CalibratorRun]:
    return run_calibrators(virtual_board, tumble, calibrators=["direct", "direct@80"], n=100)


@pytest.fixture
def angles(virtual_board: Board, simulated_turntable: Turntable, runs: dict[str, CalibratorRun]) -> KnownAngles:
    slots = {name: run.slot for name, run in runs.items()}
    return measure_known_angles(virtual_board, simulated_turntable, poses=POSES, slots=slots, mounting_yaw_deg=1.7)


def test_the_board_agrees_with_the_host_and_a_wrong_heading_shows(
    angles: KnownAngles, runs: dict[str, CalibratorRun], tumble: Tumble
) -> None:
    assert (runs["direct@80"].calibrator, runs["direct@80"].n, runs["direct@80"].slot) == ("direct", 80, 2)
    for name, run in runs.items():
        agreed = float32_error_deg(angles, run, tumble)
        # Headings come as float32: half an ulp at 250 degrees alone is 8e-6.
        assert agreed is not None
        assert 0.0 < agreed < 0.01, name
    moved = angles.heading_deg["direct"].copy()
    moved[1] -= 0.02
    wrong = replace(angles, heading_deg=angles.heading_deg | {"direct": moved})
    assert float32_error_deg(wrong, runs["direct"], tumble) == pytest.approx(0.02, abs=0.01)
    # Eighty points are another calibration: what the board made of one must not pass for the other.
    swapped = replace(runs["direct"], name="direct", n=80)
    difference = float32_error_deg(angles, swapped, tumble)
    assert difference is not None
    assert difference > 0.01


def test_a_calibrator_without_a_reference_has_no_such_number(
    angles: KnownAngles, runs: dict[str, CalibratorRun], tumble: Tumble
) -> None:
    assert float32_error_deg(angles, replace(runs["direct"], name="one-of-my-own"), tumble) is None
