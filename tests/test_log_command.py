"""``hiltest log`` and ``hiltest fit noise`` as they are typed."""

from __future__ import annotations

import csv
import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from tests.calibration.synthetic_rates import flicker, white

from hiltest.log_fitting.rate_log import read_rate_log

from .in_process import hiltest

pytestmark = pytest.mark.slow

LIMIT_S = 120


def test_a_log_has_every_sample_of_the_gyroscope_and_says_so(tmp_path: Path) -> None:
    done = hiltest("log", "--seconds", "3", "--out", "log.csv", "--seed", "4", folder=tmp_path)
    assert (done.returncode, done.stdout) == (0, "log.csv: 600 of the gyroscope\n"), done.stderr
    log = read_rate_log(tmp_path / "log.csv")
    assert (len(log.rates), log.gaps) == (600, 0)
    assert log.rate_hz == pytest.approx(200.0, rel=1e-3)
    assert log.rates.mean(axis=0) == pytest.approx([1.5, -2.1, 1.2], abs=0.1)  # the rig's bias


def test_several_sensors_are_logged_in_the_order_of_time(tmp_path: Path) -> None:
    named = [f"--sensor={name}" for name in ("gyroscope", "magnetometer", "accelerometer")]
    done = hiltest("log", "--seconds", "2", "--out", "all.csv", *named, folder=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "lost" not in done.stdout
    rows = [line for line in (tmp_path / "all.csv").read_text().splitlines() if not line.startswith("#")]
    table = list(csv.DictReader(rows))
    times = [float(row["time_s"]) for row in table]
    assert times == sorted(times)
    counts = {name: sum(bool(row[name]) for row in table) for name in table[0]}
    # All of the gyroscope's 200 a second but those before its first chunk; of the others what the requests leave.
    assert counts["gyroscope_x_dps"] >= 2 * 200 - 45
    assert counts["magnetometer_x_uT"] >= 40
    assert counts["accelerometer_z_g"] >= 100
    assert read_rate_log(tmp_path / "all.csv").gaps == 0
    gravity = np.mean([float(row["accelerometer_z_g"]) for row in table if row["accelerometer_z_g"]])
    assert gravity == pytest.approx(1.0, abs=0.01)
    assert hiltest("fit", "all.csv", "--on", "host", folder=tmp_path).returncode in (0, 1)  # it reads it


@pytest.mark.skipif(os.name != "posix", reason="signals")
def test_ctrl_c_ends_a_log_whose_file_is_whole(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    process = subprocess.Popen(
        [sys.executable, "-m", "hiltest", "log", "--seconds", "100000", "--out", str(path)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    gives_up_s = time.monotonic() + LIMIT_S
    while time.monotonic() < gives_up_s and not (path.exists() and path.stat().st_size > 5000):
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    out, errors = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 2, errors
    assert "Traceback" not in errors
    text = path.read_text()
    assert text.endswith("\n")
    log = read_rate_log(path)
    assert f"{len(log.rates)} of the gyroscope" in out
    assert len(log.rates) % 64 == 0  # whole chunks


@pytest.mark.parametrize(
    ("arguments", "code", "complaint"),
    [
        (["log", "--seconds", "0", "--out", "x.csv"], 4, "0"),
        (["log", "--seconds", "1", "--out", "none/x.csv"], 4, "cannot write none/x.csv: No such file"),
        (["log", "--seconds", "1"], 4, "--out"),
        (["log", "--seconds", "1", "--out", "x.csv", "--sensor", "barometer"], 4, "barometer"),
        (["log", "--seconds", "1", "--out", "x.csv", "--rig", "nosuch"], 4, "no rig file 'nosuch'"),
        (["log", "--seconds", "nan", "--out", "x.csv"], 4, "nan is not a number"),
        (["log", "--seconds", "inf", "--out", "x.csv"], 4, "inf is not in the range"),
        (["fit", "noise", "short.csv", "--rate", "nan"], 4, "nan is not a number"),
        (["fit", "noise", "short.csv", "--rate", "1e-320"], 4, "is not in the range"),
        (["fit", "imu", "short.csv", "--rate", "nan"], 4, "nan is not a number"),
        (["fit", "imu", "short.csv", "--turn", "nan"], 4, "nan is not a number"),
        (["fit", "noise", "none.csv"], 4, "none.csv"),
        (["fit", "noise", "bad.csv"], 4, r"bad.csv:3: column gyro_z_dps: 'x' is not a number"),
        (["fit", "noise", "short.csv"], 1, "2 samples; an Allan deviation needs at least 1000"),
    ],
)
def test_what_cannot_be_done_is_said(tmp_path: Path, arguments: list[str], code: int, complaint: str) -> None:
    header = "time_s,gyro_x_dps,gyro_y_dps,gyro_z_dps\n"
    (tmp_path / "bad.csv").write_text(header + "0,1,2,3\n1,1,2,x\n")
    (tmp_path / "short.csv").write_text(header + "0,1,2,3\n1,1,2,3\n")
    done = hiltest(*arguments, folder=tmp_path)
    assert (done.returncode, "Traceback" in done.stderr) == (code, False), done.stderr
    assert complaint in done.stderr


def test_two_hours_from_a_foreign_file_give_their_figures_back(tmp_path: Path) -> None:
    """In rad/s, without time: N of 1.06 deg/rth and B of 20 deg/h."""
    rng, rate_hz = np.random.default_rng(17), 10.0
    n = int(7200 * rate_hz)
    walk, instability = 0.025 / np.sqrt(2.0), 20.0 / 3600.0
    rates = np.column_stack(
        [
            white(rng, n, rate_hz=rate_hz, angle_random_walk=walk)
            + flicker(rng, n, rate_hz=rate_hz, bias_instability=instability)
            + bias
            for bias in (1.0, -2.0)
        ]
    )
    np.savetxt(tmp_path / "foreign.txt", np.radians(rates), fmt="%.9f", header="a b", comments="")
    done = hiltest(
        "fit",
        "noise",
        "foreign.txt",
        "--columns",
        "a,b",
        "--unit",
        "rad/s",
        "--rate",
        "10",
        "--json",
        "--html",
        "page.html",
        folder=tmp_path,
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert (found["schema"], found["unit"], found["samples"]) == ("hiltest.allan/1", "dps", n)
    for each in found["columns"]:
        assert (each["angle_random_walk"]["unit"], each["bias_instability"]["unit"]) == ("deg/rth", "deg/h")
        assert each["angle_random_walk"]["value"] == pytest.approx(60.0 * walk, rel=0.05)
        assert each["bias_instability"]["value"] == pytest.approx(20.0, rel=0.30)
    for_people = hiltest(
        "fit", "noise", "foreign.txt", "--columns", "a,b", "--unit", "rad/s", "--rate", "10", folder=tmp_path
    )
    assert "72000 samples at 10 Hz, 7200 s" in for_people.stdout
    _, header, *rows = for_people.stdout.splitlines()
    assert re.split(" {2,}", header) == ["column", "figure", "value", "68 % interval"]
    page = (tmp_path / "page.html").read_text()
    keys = ("angle_random_walk", "noise_density", "bias_instability", "rate_random_walk", "lowest")
    wanted = [each[key] for each in found["columns"] for key in keys]
    for row, number in zip(rows, wanted, strict=True):
        _, _, printed, *interval = re.split(" {2,}", row)
        assert printed in page
        if number["value"] is None:
            assert (printed, interval) == ("not seen", [])
            continue
        ends = [f"{number[end]:.4g}" for end in ("low", "high")]
        assert (printed.split(" at ")[0], interval) == (f"{number['value']:.4g} {number['unit']}", [" to ".join(ends)])
        assert number["low"] < number["value"] < number["high"]
