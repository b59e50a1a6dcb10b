"""Print the errors of the attitude filter on recorded motion, as docs/fusion.md has them.

    python -m tests.orientation.motion_errors [FOLDER]

reads each .npz file of the folder, by default `../shared/data/broad`. The filter comes with half and twice of each
setting. `float32` is the firmware's C.
"""

from __future__ import annotations

import argparse
import ctypes
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hiltest.orientation.attitude_errors import AttitudeScore, Estimator, attitude_errors, score_estimator
from hiltest.orientation.attitude_filter import AttitudeFilterSettings, filter_attitudes
from hiltest.orientation.motion_recording import MotionRecording, read_motion_recording

from .filters import FirmwareFilter, build

Reals = NDArray[np.float64]

# Starts within the motion, and the seconds after them whose errors are printed.
STARTS_S = (1, 3, 6, 10, 14, 17, 25)
AFTER_START_S = (0, 1, 3, 5, 10, 30)
STANDARD_GRAVITY = 9.80665
DATA = Path(__file__).parents[3] / "shared" / "data" / "broad"


def firmware_attitudes(
    library: ctypes.CDLL, gyroscope_rad_s: Reals, gravity_g: Reals, field: Reals, rate_hz: float
) -> Reals:
    """Return the attitudes of the firmware's attitude filter; an estimator, once it has its library."""
    firmware = FirmwareFilter(library)
    attitudes = np.empty((len(field), 4))
    columns = (gyroscope_rad_s.tolist(), gravity_g.tolist(), field.tolist())
    for index, readings in enumerate(zip(*columns, strict=True)):
        firmware.update(*readings, 1.0 / rate_hz)
        attitudes[index] = firmware.attitude
    return attitudes


def with_settings(settings: AttitudeFilterSettings) -> Estimator:
    """Return the attitude filter with these settings."""
    return lambda gyroscope, gravity, field, rate_hz: filter_attitudes(gyroscope, gravity, field, rate_hz, settings)


def trial_rows(recordings: Sequence[MotionRecording], estimators: Mapping[str, Estimator]) -> Iterator[str]:
    """Yield a table of total, heading and inclination error of each trial, and the means."""
    yield "| | " + " | ".join(f"`{name}`" for name in estimators) + " |"
    yield "|---" + "|--:" * len(estimators) + "|"
    scores: list[list[AttitudeScore]] = []
    for recording in recordings:
        scores.append([score_estimator(recording, estimator)["motion"] for estimator in estimators.values()])
        yield f"| {Path(recording.name).stem.replace('_', ' ')} | " + " | ".join(map(cell, scores[-1])) + " |"
    yield "| mean | " + " | ".join(cell(*column) for column in zip(*scores, strict=True)) + " |"


def phase_rows(recordings: Sequence[MotionRecording], estimator: Estimator) -> Iterator[str]:
    """Yield a table of the total error in each phase of each trial."""
    scores = [score_estimator(recording, estimator) for recording in recordings]
    names = list(max(scores, key=len))
    yield "| | " + " | ".join(names) + " |"
    yield "|---" + "|--:" * len(names) + "|"
    for recording, phases in zip(recordings, scores, strict=True):
        cells = (f"{phases[name].total_deg:.2f}" if name in phases else "-" for name in names)
        yield f"| {Path(recording.name).stem.replace('_', ' ')} | " + " | ".join(cells) + " |"


def setting_rows(recordings: Sequence[MotionRecording]) -> Iterator[str]:
    """Yield a table of the mean errors with half and twice of each setting."""
    default = AttitudeFilterSettings()
    yield "| | half | twice |"
    yield "|---|--:|--:|"
    for name, value in asdict(default).items():
        cells = []
        for factor in (0.5, 2.0):
            estimator = with_settings(replace(default, **{name: factor * value}))
            cells.append(cell(*(score_estimator(recording, estimator)["motion"] for recording in recordings)))
        yield f"| `{name}` | " + " | ".join(cells) + " |"


def start_errors_deg(recording: MotionRecording, estimator: Estimator) -> Reals:
    """Return the rms errors [deg] in seconds after starts within the motion, shape (starts, seconds)."""
    rates = recording.gyroscope_rad_s - recording.rest_bias_rad_s()
    second = round(recording.rate_hz)
    errors = []
    for start_s in STARTS_S:
        first = recording.first_motion + start_s * second
        part = slice(first, first + (AFTER_START_S[-1] + 1) * second)
        attitudes = estimator(
            rates[part],
            -recording.acceleration_m_s2[part] / STANDARD_GRAVITY,
            recording.field_ut[part],
            recording.rate_hz,
        )
        total_deg = attitude_errors(attitudes, recording.truth[part]).total_deg
        seconds = (total_deg[after * second : (after + 1) * second] for after in AFTER_START_S)
        errors.append([np.sqrt(np.nanmean(values**2)) for values in seconds])
    return np.array(errors)


def start_rows(recordings: Sequence[MotionRecording], estimator: Estimator) -> Iterator[str]:
    """Yield a table of the errors after starts within the motion."""
    errors = np.concatenate([start_errors_deg(recording, estimator) for recording in recordings])
    yield "| seconds after the start | " + " | ".join(map(str, AFTER_START_S)) + " |"
    yield "|---" + "|--:" * len(AFTER_START_S) + "|"
    for name, row in (("median", np.median(errors, axis=0)), ("largest", errors.max(axis=0))):
        yield f"| {name} of {len(errors)} | " + " | ".join(f"{value:.1f}" for value in row) + " |"


def cell(*scores: AttitudeScore) -> str:
    """Return the means of total, heading and inclination error."""
    errors = [(score.total_deg, score.heading_deg, score.inclination_deg) for score in scores]
    return " / ".join(f"{value:.2f}" for value in np.mean(errors, axis=0))


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, nargs="?", default=DATA)
    recordings = [read_motion_recording(path) for path in sorted(parser.parse_args().folder.glob("*.npz"))]
    with tempfile.TemporaryDirectory() as folder:
        float32: Callable[..., Reals] = partial(firmware_attitudes, build("gcc", Path(folder)))
        estimators = {"attitude_filter": filter_attitudes, "float32": float32}
        tables = (
            trial_rows(recordings, estimators),
            phase_rows(recordings, filter_attitudes),
            start_rows(recordings, filter_attitudes),
            setting_rows(recordings),
        )
        for table in tables:
            for row in table:
                print(row, flush=True)
            print()


if __name__ == "__main__":
    main()
