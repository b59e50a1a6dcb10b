"""How a command is called in this process, the files that commands read, and the documents that they print."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from jsonschema import Draft202012Validator
from tests.calibration.synthetic_rates import white
from tests.finished_run import Finished
from tests.interfaces.test_packet_stream import RECORDING
from tests.log_fitting.recording import six_faces_and_turns, write

import hiltest
from hiltest.commands.cli import main
from hiltest.procedures.golden_points import golden_points


def run(*arguments: str) -> int:
    """Run a command in this process; return its exit code."""
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    return int(ended.value.code or 0)


def folder_of_inputs(parent: pytest.TempPathFactory, default_run: Finished, points: str) -> Path:
    """Return a folder with the record of a run, an IMU log and magnetometer points."""
    folder = parent.mktemp("inputs")
    (folder / "run.json").write_bytes((default_run.folder / "run.json").read_bytes())
    write(folder / "imu.csv", *six_faces_and_turns().readings())
    (folder / "points.csv").write_text(f"mx_uT,my_uT,mz_uT\n{points}\n", encoding="utf-8")
    return folder


def folder_of_all_inputs(parent: pytest.TempPathFactory, default_run: Finished) -> Path:
    """Return such a folder with 400 points, and a dearer record, packets and a resting gyroscope's rates besides."""
    points = "\n".join(",".join(f"{value:.1f}" for value in point) for point in golden_points(400) / 10.0)
    folder = folder_of_inputs(parent, default_run, points)
    record = default_run.record
    next(each for each in record["measurements"] if each["name"] == "cycles.direct.total")["value"] += 1
    (folder / "mine.py").write_text(
        "def calibrate(samples):\n    return samples[0], [[1, 0, 0], [0, 1, 0], [0, 0, 1]]\n", encoding="utf-8"
    )
    (folder / "dearer.json").write_text(json.dumps(record), encoding="utf-8")
    (folder / "packets.bin").write_bytes(RECORDING)
    random = np.random.default_rng(1)
    rates = [white(random, 4000, rate_hz=100.0, angle_random_walk=0.01) for _axis in "xyz"]
    table = np.column_stack([np.arange(4000) / 100.0, *rates])
    header = "time_s,gyro_x_dps,gyro_y_dps,gyro_z_dps"
    np.savetxt(folder / "rates.csv", table, fmt="%.6f", delimiter=",", header=header, comments="")
    return folder


def json_schema(schema: str) -> dict[str, Any]:
    """Return the shipped JSON Schema of a document."""
    name = schema.partition("/")[0].removeprefix("hiltest.")
    path = Path(hiltest.__file__).parent / "schemas" / f"{name}.schema.json"
    content: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return content


def checked(text: str, schema: str) -> dict[str, Any]:
    """Return a document that its schema describes."""
    content: dict[str, Any] = json.loads(text)
    assert content["schema"] == schema
    errors = Draft202012Validator(json_schema(schema)).iter_errors(content)
    assert [f"{error.json_path}: {error.message}" for error in errors] == []
    return content
