"""Filters of `hiltest judge`: their state, their answers and their errors on a simulated motion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hiltest.commands.cli import main
from hiltest.errors import BoardFault, ConfigError
from hiltest.judge.entries import is_filter, open_filter
from hiltest.judge.filter_scores import FilterResult, judge_filter
from hiltest.judge.filters import FilterAnswers, OwnFilter, readings_of, stride_of
from hiltest.judge.judgement import filter_document
from hiltest.judge.motions import simulated_motion
from hiltest.orientation.motion_recording import MotionRecording

Write = Callable[..., str]
# The tilt-compensated heading of one reading: no state, so that its errors are those of noise alone.
HEADING_C = """
#include "hiltest_judge.h"
#include <math.h>

static float heading_deg;

void filter_init(float rate_hz) { heading_deg = 0.0f * rate_hz; }

void filter_update(const float gyroscope[3], const float a[3], const float m[3], float dt)
{
    float east[3] = {a[1] * m[2] - a[2] * m[1], a[2] * m[0] - a[0] * m[2], a[0] * m[1] - a[1] * m[0]};
    float north_x = east[1] * a[2] - east[2] * a[1];
    heading_deg = 57.2957795f * atan2f(east[0], north_x / sqrtf(a[0] * a[0] + a[1] * a[1] + a[2] * a[2]))
                  + 0.0f * gyroscope[0] * dt;
}

float filter_heading(void) { return heading_deg; }
"""
COUNTING_C = """
#include "hiltest_judge.h"

static float updates, started_with = 7.0f;

void filter_init(float rate_hz) { updates = 0.0f; started_with = rate_hz; }
void filter_update(const float g[3], const float a[3], const float m[3], float dt) { updates += g && a && m && dt > 0; }
void filter_quaternion(float quaternion[4])
{
    quaternion[0] = updates;
    quaternion[1] = started_with;
    quaternion[2] = quaternion[3] = 1.0f;
}
"""
PYTHON = """
import numpy as np


class Heading:
    def __init__(self, rate_hz):
        self._heading = 0.0

    def update(self, gyroscope, acceleration, field, dt):
        east = np.cross(acceleration, field)
        north = np.cross(east, acceleration) / np.linalg.norm(acceleration)
        self._heading = np.degrees(np.arctan2(east[0], north[0]))

    def heading(self):
        return self._heading


class Diverging(Heading):
    def heading(self):
        return float("inf")


class Wide(Heading):
    def heading(self):
        return np.zeros(3)


class Absent(Heading):
    def heading(self):
        return None


class Exacting(Heading):
    def update(self, *values):
        assert all(vector.dtype == np.float64 for vector in values[:3]), "a package in C++ takes no other type"
"""


@cache
def motion() -> MotionRecording:
    """Return the first 20 s of the simulated motion."""
    whole, count = simulated_motion(), 2000
    parts = {
        name: getattr(whole, name)[:count]
        for name in ("gyroscope_rad_s", "acceleration_m_s2", "field_ut", "truth", "movement")
    }
    return replace(whole, **parts)


@pytest.fixture(autouse=True)
def compilers(require_tool: Callable[[str], str]) -> None:
    for tool in ("arm-none-eabi-gcc", "arm-none-eabi-g++", "cc"):
        require_tool(tool)


@pytest.fixture
def write(tmp_path: Path) -> Write:
    def write_source(text: str, name: str) -> str:
        (tmp_path / name).write_text(text, encoding="utf-8")
        return str(tmp_path / name)

    return write_source


def answers_of(named: str) -> FilterAnswers:
    with open_filter(named) as judged:
        return judged.follow(motion())


def result_of(named: str) -> FilterResult:
    with open_filter(named) as judged:
        return judge_filter(judged, "judged", [motion()])


def test_rates_of_the_simulated_motion_turn_its_attitudes_into_each_other() -> None:
    whole = simulated_motion()
    rates, gravity, field = readings_of(whole)
    truth = Rotation.from_quat(whole.truth)
    turned = truth[:-1] * Rotation.from_rotvec(rates[1:] / whole.rate_hz)
    # White noise of 0.18 deg/s for 10 ms is 0.002 deg; the largest of 48 000 is below six times 1.5 of it.
    assert np.degrees((turned.inv() * truth[1:]).magnitude()).max() < 6 * 0.003
    assert np.abs(truth.apply(gravity) - (0.0, 0.0, 1.0)).max() < 6 * 0.002
    in_earth = truth.apply(field)
    assert np.abs(in_earth - in_earth.mean(axis=0)).max() < 6 * 0.4
    assert in_earth.mean(axis=0) == pytest.approx(
        48.5 * np.array([np.cos(np.radians(62)), 0.0, np.sin(np.radians(62))]), abs=0.05
    )
    assert not whole.movement[:600].any()
    assert 0.2 < whole.movement.mean() < 0.3


def test_variables_of_a_filter_are_kept_between_updates_and_start_anew(write: Write) -> None:
    with open_filter(write(COUNTING_C, "count.c")) as judged:
        for _ in range(2):
            answers = judged.follow(motion())
            assert answers.quaternions is not None
            assert (answers.quaternions[:, 1] == 100.0).all()
            assert list(answers.quaternions[:, 0]) == list(answers.places + 1)
    assert stride_of(motion()) == 2


def test_a_filter_in_c_errs_as_the_same_one_in_python(write: Write) -> None:
    source, script = write(HEADING_C, "heading.c"), f"{write(PYTHON, 'heading.py')}:Heading"
    assert is_filter(source, None)
    assert is_filter(script, None)
    on_core, on_host = result_of(source), result_of(script)
    for core, host in zip(on_core.scores, on_host.scores, strict=True):
        assert (core.phase, core.total_deg, core.answers) == (host.phase, None, host.answers)
        assert core.heading_deg == pytest.approx(host.heading_deg, abs=1e-3)  # float32 of 360 degrees
    # Noise of 0.4 uT in a horizontal field of 22.8 and 2 mg times the tangent of the dip: 1.0 and 0.2 deg.
    assert next(score.heading_deg for score in on_core.scores if score.phase == "rest") == pytest.approx(1.03, abs=0.1)
    assert on_core.cycles is not None
    assert on_core.low is not None
    assert on_core.high is not None
    assert on_core.low <= on_core.cycles <= on_core.high
    assert on_core.cycles <= (on_core.most_cycles or 0)
    assert on_core.cycle_model == "cortex-m4-trm/3@sram"
    assert on_host.cycles is None
    assert on_host.host_us is not None


def test_the_attitude_filter_is_better_than_single_readings(write: Write) -> None:
    own = judge_filter(OwnFilter(), "hiltest", [motion()])
    scores = {score.phase: score for score in own.scores}
    assert scores["rest"].heading_deg < 0.3
    assert (scores["rest"].inclination_deg or 1.0) < 0.1
    # 516 to 536 cycles an update, and at most 665: docs/fusion.md.
    assert 516 <= (own.cycles or 0) <= 536
    assert (own.most_cycles or 0) <= 665
    single = result_of(write(HEADING_C, "heading.c"))
    assert filter_document([own, replace(single, role="against", cycles=None)], {}).exit_code == 0
    assert filter_document([own, replace(single, role="against")], {}).exit_code == 21, "it takes more cycles"
    assert filter_document([single, replace(own, role="against")], {}).exit_code == 21
    assert filter_document([own], {"total": 0.01}).exit_code == 1
    assert filter_document([single], {"total": 1.0}).exit_code == 22


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("one.c", "void filter_update(int n) { (void)n; }", "no function filter_init"),
        (
            "two.c",
            "void filter_init(float r) {(void)r;}\nvoid filter_update(void) {}\n",
            "neither filter_quaternion nor",
        ),
    ],
)
def test_a_filter_without_a_function_of_the_contract_is_refused(
    write: Write, name: str, text: str, message: str
) -> None:
    with pytest.raises(ConfigError, match=message):
        answers_of(write(text, name))


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        ("Diverging", "in the motion rig: a heading is not finite"),
        ("Wide", r"TypeError: the answer has shape \(3,\)"),
        ("Absent", "shape None"),
    ],
)
def test_answers_that_are_none_have_no_row(write: Write, kind: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        result_of(f"{write(PYTHON, 'heading.py')}:{kind}")


def test_a_python_filter_gets_float64(write: Write) -> None:
    assert result_of(f"{write(PYTHON, 'heading.py')}:Exacting").scores


def test_a_fault_names_motion_and_reading(write: Write) -> None:
    text = COUNTING_C.replace("{ updates +=", "{ if (updates > 9.0f) *(volatile int *)0xffffff00 = 1; updates +=")
    with pytest.raises(BoardFault, match=r"fault.c in the motion rig, reading 10: "):
        answers_of(write(text, "fault.c"))


def test_the_command_judges_a_class(write: Write, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    named = f"{write(PYTHON, 'heading.py')}:Heading"
    for limit, code in (("heading=1.5", 0), ("heading=0.5", 1)):
        with pytest.raises(SystemExit) as ended:
            main(["judge", named, "--alone", "--limit", limit])
        assert int(ended.value.code or 0) == code
    page = (tmp_path / "hil-out" / "judge" / "judge.html").read_text(encoding="utf-8")
    assert "Heading" in page
    assert "first seconds" in page
