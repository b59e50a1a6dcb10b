"""A record with the readings at the known angles names the cause of a bad heading, and its size."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import pytest

from hiltest.calibration import fit_direct
from hiltest.calibration.fit import FitStatus
from hiltest.calibration.quality import residual_percent, sphere_directions
from hiltest.measurement import Limit, Measurement, check
from hiltest.orientation import tilt_heading
from hiltest.orientation.angles import Pose, heading_error_deg, rotation_body_from_ned
from hiltest.run_record.outcomes import TestOutcome
from hiltest.run_record.run import Column, Findings, Table, TestResult
from hiltest.verdict.summary import summarise
from hiltest.verdict.verdict import decide, unmet_limits

from ..written_run import HEADING_TEST

Make = Callable[..., Findings]

TILTS = ((0, 0), (20, 0), (-20, 0), (0, 20), (0, -20))
POSES = [Pose(heading + 1.7, pitch, roll) for pitch, roll in TILTS for heading in range(0, 360, 30)]
TURNS = np.array([rotation_body_from_ned(pose) for pose in POSES])
FIELD_NED = 48.5 * np.array([np.cos(np.radians(62)), 0.0, np.sin(np.radians(62))])
NOISE = np.random.default_rng(5).normal(size=(60, 3))
SOFT_IRON = np.array([[1.022, 0.010, -0.006], [0.010, 0.982, 0.009], [-0.006, 0.009, 1.004]])
HARD_IRON = np.array([24.0, -22.0, 40.0])
PREDICTED = 0.79
MIRRORED = check("fit.joint.status", int(FitStatus.MIRRORED), unit="")


def turned(pose: Pose) -> np.ndarray:
    return rotation_body_from_ned(pose)


@dataclass
class Bench:
    """A bench with one thing wrong, and the record that it leaves: one calibrator, ``direct``."""

    name: str = "direct"
    iron: np.ndarray = field(default_factory=lambda: SOFT_IRON)  # at the points
    axes: np.ndarray = field(default_factory=lambda: np.eye(3))
    real_field: np.ndarray = field(default_factory=lambda: FIELD_NED)
    real_turns: np.ndarray = field(default_factory=lambda: TURNS)
    moved: Sequence[float] = (0, 0, 0)  # hard iron that comes after the points [counts]
    accelerometer_offset: Sequence[float] = (0, 0, 0)  # [g]
    held_scale: np.ndarray = field(default_factory=lambda: np.eye(3))  # what the firmware makes of the fit
    held_offset: Sequence[float] = (0, 0, 0)
    worst_limit: float = 1.8

    def tables(self) -> list[Table]:
        matrix = [f"{row}{column}" for row in "xyz" for column in "xyz"]
        vectors = [f"{name}_{axis}" for name in ("field", "gravity") for axis in "xyz"]
        readings = [f"{sensor}_{axis}" for sensor in ("magnetometer", "accelerometer") for axis in "xyz"]
        held = [*(f"soft_iron_{row}" for row in matrix), *(f"hard_iron_{axis}" for axis in "xyz")]
        gravity = [*(f"gain_{row}" for row in matrix), *(f"offset_{axis}" for axis in "xyz")]
        soft_iron, hard_iron = self.held
        nominal = [*(np.eye(3) / 8192.0).ravel(), 0.0, 0.0, 0.0]
        return [
            table("heading.known", vectors, np.hstack([TURNS @ FIELD_NED, TURNS @ np.array([0, 0, 1])]).tolist()),
            table("heading.means", readings, np.hstack([self.magnetometer, self.accelerometer]).tolist()),
            table(
                "heading.calibrations",
                ["calibration", *held, *gravity],
                [[self.name, *soft_iron.ravel(), *hard_iron, *nominal]],
            ),
            table("calibration.results", ["calibrator", "points"], [["direct", 100]]),
            table("tumble.points", list("xyz"), self.points.tolist()),
        ]

    @property
    def points(self) -> np.ndarray:
        noise = 4.0 * np.random.default_rng(11).normal(size=(100, 3))
        field_ut = 48.5 * sphere_directions(100)
        return np.round(10.0 * field_ut @ self.iron.T @ self.axes.T + HARD_IRON + noise)

    @property
    def magnetometer(self) -> np.ndarray:
        field_ut = self.real_turns @ self.real_field
        return 10.0 * field_ut @ self.iron.T @ self.axes.T + HARD_IRON + np.array(self.moved) + NOISE

    @property
    def accelerometer(self) -> np.ndarray:
        gravity_g = self.real_turns @ np.array([0, 0, 1]) + np.array(self.accelerometer_offset)
        return 8192.0 * gravity_g + 3.0 * NOISE[::-1]

    @property
    def held(self) -> tuple[np.ndarray, np.ndarray]:
        fit = fit_direct(self.points)
        return self.held_scale @ fit.soft_iron, fit.hard_iron + np.array(self.held_offset)

    def measurements(self) -> list[Measurement]:
        soft_iron, hard_iron = self.held
        right = fit_direct(self.points)
        gravity = self.accelerometer / 8192.0
        headings = [
            tilt_heading(*pair).heading_deg
            for pair in zip(gravity, (self.magnetometer - hard_iron) @ soft_iron.T, strict=True)
        ]
        in_float64 = [
            tilt_heading(*pair).heading_deg for pair in zip(gravity, right.corrected(self.magnetometer), strict=True)
        ]
        known = [pose.heading_deg for pose in POSES]
        errors = np.array([heading_error_deg(*item) for item in zip(headings, known, strict=True)])
        arithmetic = max(abs(heading_error_deg(*item)) for item in zip(headings, in_float64, strict=True))
        bias = math.degrees(math.atan2(np.sin(np.radians(errors)).mean(), np.cos(np.radians(errors)).mean()))
        centred = np.abs((errors - bias + 180) % 360 - 180).max()
        held = type(right)(FitStatus.ELLIPSOID, False, 0, soft_iron, hard_iron)
        results = [
            check(f"heading.{self.name}.max", np.abs(errors).max(), unit="deg", limit=Limit(max=self.worst_limit)),
            check(f"heading.{self.name}.bias", bias, unit="deg", limit=Limit.within(0.7)),
            check(f"heading.{self.name}.max_centred", centred, unit="deg", limit=Limit(max=self.worst_limit)),
        ]
        if self.name == "direct":
            results += [
                check("fit.direct.residual", residual_percent(self.points, held), unit="%"),
                check("heading.direct.float32_error", arithmetic, unit="deg", limit=Limit(max=0.002)),
            ]
        return [*results, check("fit.direct.residual_predicted", PREDICTED, unit="%")]


def table(name: str, columns: list[str], rows: list[list[object]]) -> Table:
    return Table(name, tuple(Column(column) for column in columns), tuple(tuple(row) for row in rows))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "bench",
    [
        Bench(held_scale=rotation_body_from_ned(Pose(0.0, 0.0, 5.0))),
        Bench(held_offset=[60.0, 0.0, 0.0]),
        Bench(held_scale=np.diag([1.2, 1.0, 1.0])),
        Bench(accelerometer_offset=[0.08, 0.0, 0.0]),
    ],
    ids=["rotation", "hard iron", "scale", "accelerometer"],
)
def test_a_cause_predicts_the_heading_error_at_each_known_angle(findings: Make, bench: Bench) -> None:
    run = findings(*bench.measurements(), tables=False)
    run.tables.update((item.name, item) for item in bench.tables())
    soft_iron, hard_iron = bench.held
    vectors = (bench.accelerometer, (bench.magnetometer - hard_iron) @ soft_iron.T)
    headings = [tilt_heading(*pair).heading_deg for pair in zip(*vectors, strict=True)]
    errors = [heading_error_deg(heading, pose.heading_deg) for heading, pose in zip(headings, POSES, strict=True)]
    assert np.abs(errors).max() > 3.0
    # The points' noise and that of the readings are not predicted.
    assert np.abs(np.array(errors) - summarise(run).predicted_deg["direct"]).max() < 1.2


@pytest.fixture
def sentence(findings: Make) -> Callable[..., str]:
    """Return a function that gives the verdict's sentence of a bench."""

    def say(bench: Bench, *more: Measurement, broken: str = "") -> str:
        failed = TestResult("test_dpi.py::test", TestOutcome.FAILED, 1.0, broken)
        tests = (TestResult(HEADING_TEST, TestOutcome.PASSED, 1.0), *([failed] if broken else []))
        run = findings(*bench.measurements(), *more, tests=tests, tables=False)
        run.tables.update((item.name, item) for item in bench.tables())
        return decide(run, pytest_exit=1).sentence

    return say


def test_poses_that_were_not_set_are_the_cause_whatever_the_headings_look_like(findings: Make) -> None:
    bench = Bench(iron=turned(Pose(0, 12)) @ SOFT_IRON)
    rows: list[list[object]] = [[number, "the readings are equal"] for number in range(2, 6)]
    run = findings(*bench.measurements(), tables=False)
    run.tables.update((item.name, item) for item in (*bench.tables(), table("heading.unset", ["pose", "fault"], rows)))
    sentence = decide(run, pytest_exit=1).sentence
    assert "the board was not at the angle of the scale (pose 2: the readings are equal, pose 3: " in sentence
    assert "and 1 more). Next: Measure these poses again" in sentence
    assert "good fit" not in sentence


def test_a_bench_with_nothing_wrong_has_no_cause(sentence: Callable[..., str]) -> None:
    assert "Likely cause" not in sentence(Bench(), broken="something else")


@pytest.mark.parametrize(
    ("bench", "cause"),
    [
        (Bench(axes=np.eye(3)[[1, 0, 2]] * [[1], [1], [-1]]), "magnetometer: x and y are exchanged, z is negated"),
        (Bench(axes=np.diag([1.0, 1.0, -1.0])), "magnetometer: z is negated (left-handed"),
        (Bench(held_offset=[6, 0, 0]), "hard-iron error (0.59 uT: x +0.59, y "),
        (Bench(held_offset=[0, -1.5, 0]), "hard-iron error (0.15 uT: x +0.00, y -0.15, z +0.00, beside"),
        (Bench(held_scale=np.diag([1.1, 1.0, 1.0])), "wrong scale (x +10.0 %, y +0.0 %, z +0.0 %, beside"),
        (Bench(held_scale=turned(Pose(0, 0, 3))), "rotation (rotated by 3 deg about x, beside"),
        (Bench(held_scale=np.eye(3)[[1, 0, 2]]), "after calibration, magnetometer: x and y are exchanged"),
        (Bench(iron=turned(Pose(0, 3)) @ SOFT_IRON), "good fit, bad heading (rotated by 3."),
        (Bench(iron=turned(Pose(0, 12)) @ SOFT_IRON), "good fit, bad heading (rotated by 12"),
        (
            Bench(real_turns=np.array([turned(Pose(p.heading_deg + 3, p.pitch_deg, p.roll_deg)) for p in POSES])),
            "constant offset (+3.",
        ),
        (
            Bench(real_turns=np.array([turned(Pose(p.heading_deg - 90, p.pitch_deg, p.roll_deg)) for p in POSES])),
            "constant offset (-89.9",
        ),
        (Bench(accelerometer_offset=[0.06, 0, 0]), "accelerometer (offset: 59.9"),
        (Bench(moved=[50, -30, 0]), "stale calibration (hard-iron error of 5."),
        (Bench(name="calibration", held_offset=[40, 0, 0]), "stale calibration (hard-iron error of 3.96 uT: x +3.96"),
    ],
    ids=[
        "axes",
        "a negated axis",
        "hard iron",
        "a little hard iron",
        "scale",
        "rotation",
        "axes of the calibration",
        "rotated iron",
        "much rotated iron",
        "declination",
        "mounting",
        "accelerometer",
        "iron that moved",
        "an old file",
    ],
)
def test_what_is_wrong_is_named_with_its_size(sentence: Callable[..., str], bench: Bench, cause: str) -> None:
    assert f"Likely cause: {cause}" in sentence(bench)


def test_a_dip_of_the_opposite_sign_is_named_though_no_heading_depends_on_it(sentence: Callable[..., str]) -> None:
    answer = sentence(Bench(real_field=FIELD_NED * [1, 1, -1]), MIRRORED, broken="joint of 300 rows: MIRRORED")
    assert "Likely cause: the dip has the opposite sign of the declared one." in answer


def test_a_refusal_as_mirrored_of_what_is_right_is_the_firmwares(sentence: Callable[..., str]) -> None:
    answer = sentence(Bench(), MIRRORED, broken="joint of 300 rows: MIRRORED")
    assert "Likely cause: joint refuses points as MIRRORED although the known angles confirm their axes" in answer


def test_what_could_not_be_evaluated_comes_behind_the_cause(sentence: Callable[..., str]) -> None:
    names = [f"cycles.{name}.total" for name in ("direct", "iterative", "corrected")]
    unset = unmet_limits(dict.fromkeys(names, Limit(max=1)), dict.fromkeys(names, "cycle"), [], ["direct"])
    for broken in ("", "joint of 300 rows: MIRRORED"):
        answer = sentence(Bench(held_offset=[6, 0, 0]), *unset, broken=broken)
        assert answer.index("Likely cause: hard-iron error") < answer.lower().index("cycles.direct.total")
