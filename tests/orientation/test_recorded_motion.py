"""The attitude filter on seven trials of BROAD, whose README is in `../shared/data/broad`."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hiltest.orientation.attitude_errors import AttitudeScore, score_estimator
from hiltest.orientation.attitude_filter import AttitudeFilterSettings, filter_attitudes
from hiltest.orientation.motion_recording import MotionRecording, read_motion_recording

from ..interfaces.conftest import shared_data  # noqa: F401  # a fixture
from .motion_errors import start_errors_deg

PAGE = (Path(__file__).parents[2] / "docs" / "fusion.md").read_text(encoding="utf-8")
# Total, heading and inclination error over the motion [deg] of the attitude filter, as the page prints them. Float64
# repeats them to the last digit.
ERRORS_DEG = {
    name.replace(" ", "_"): tuple(map(float, errors.split(" / ")))
    for name, errors in re.findall(r"^\| (\d\d [^|]*) \| ([0-9./ ]+) \| [0-9./ ]+ \| [0-9./ ]+ \|$", PAGE, re.M)
}


@pytest.fixture(scope="session")
def trials(shared_data: Callable[[str], Path]) -> Mapping[str, MotionRecording]:  # noqa: F811 (the fixture)
    folder = shared_data("broad/README.md").parent
    return {name: read_motion_recording(folder / f"{name}.npz") for name in ERRORS_DEG}


@pytest.fixture(scope="session")
def scores(trials: Mapping[str, MotionRecording]) -> Mapping[str, Mapping[str, AttitudeScore]]:
    return {name: score_estimator(trial, filter_attitudes) for name, trial in trials.items()}


def mean_total_deg(trials: Mapping[str, MotionRecording], settings: AttitudeFilterSettings) -> float:
    def estimate(*readings: np.ndarray | float) -> np.ndarray:
        return filter_attitudes(*readings, settings)

    return float(np.mean([score_estimator(trial, estimate)["motion"].total_deg for trial in trials.values()]))


def test_the_mean_error_over_seven_trials_is_below_2_degrees(scores: Mapping[str, Mapping[str, AttitudeScore]]) -> None:
    errors_deg = {
        name: tuple(round(value, 2) for value in (motion.total_deg, motion.heading_deg, motion.inclination_deg))
        for name, motion in ((name, phases["motion"]) for name, phases in scores.items())
    }
    print(errors_deg)
    assert len(errors_deg) == 7
    assert errors_deg == ERRORS_DEG
    assert np.mean([total for total, _, _ in errors_deg.values()]) < 2.0


def test_rest_first_seconds_translation_and_magnets_have_rows(
    scores: Mapping[str, Mapping[str, AttitudeScore]],
) -> None:
    """No row exceeds 3 degrees, the worst error of a whole trial, by more than the half that a part may add."""
    for name, phases in scores.items():
        assert {"motion", "rest", "translation"} <= set(phases), name
        assert max(score.total_deg for score in phases.values()) < 4.5, name
    assert "first seconds" in scores["07_undisturbed_fast_rotation_B"]
    assert scores["34_disturbed_attached_magnet_3cm"]["disturbed field"].samples > 10_000


def test_a_start_in_motion_is_forgotten_within_30_seconds(trials: Mapping[str, MotionRecording]) -> None:
    errors_deg = start_errors_deg(trials["18_undisturbed_fast_translation_with_breaks_B"], filter_attitudes)
    print(errors_deg.round(1))
    assert errors_deg[:, 0].max() > 30.0
    # A first heading that is 180 degrees wrong has 2 (2 / 30)^2 of its weight at most after the first 2 s: 2 degrees,
    # beside the errors of the whole motion. It is corrected by 57 degrees times the gain at most, which takes longer.
    assert np.median(errors_deg[:, -1]) < 3.0
    assert errors_deg[:, -1].max() < 10.0


@pytest.mark.ci
@pytest.mark.parametrize("factor", [0.5, 2.0])
@pytest.mark.parametrize("setting", ["tilt_time_s", "heading_time_s"])
def test_a_time_of_half_or_twice_its_length_stays_below_2_degrees(
    trials: Mapping[str, MotionRecording], setting: str, factor: float
) -> None:
    """So the times are no result of a search; docs/fusion.md has the table."""
    default = AttitudeFilterSettings()
    changed = replace(default, **{setting: factor * getattr(default, setting)})
    error_deg = mean_total_deg(trials, changed)
    print(f"{setting} x {factor}: {error_deg:.2f} deg")
    assert error_deg < 2.0
