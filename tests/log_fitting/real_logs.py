"""Recordings that others made: what the tool says of each, beside what is known of it.

    python -m tests.log_fitting.real_logs [--page docs/real-logs.md]

prints the page, or writes it.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from hiltest.log_fitting import read_samples
from hiltest.log_fitting.left_out import left_out

from ..calibration.still_pairs import ALIGNED, Shots, repeats_within_deg

ROOT = Path(__file__).parents[2]
DATA = ROOT.parent / "shared" / "data"
_PACKET_COLUMNS = "field_x_uT,field_y_uT,field_z_uT"
_STANDARD_GRAVITY = 9.80665
Array = NDArray[np.float64]

_HEAD = """\
# Recorded logs, and what comes of them

Recordings that others published, from `../shared/data`, which is not part of this project: each README there says where
it comes from and what is known of it. This page is written by `tox -e real-logs`; `hiltest fit FOLDER` prints a row for
each log of your own.
"""
_MAGNETOMETERS = """\
## Magnetometers

`hiltest fit LOG --on host`: lengths in uT. Beside it scipy's geometric least squares (nine parameters) of the readings
that were not left out, and of all.
"""
_INSTRUMENTS = """\
## Cave survey instruments

circuitpython_magcal: eight shots all round and twice eight of one direction, the instrument rolled. All 24 are fitted
by `hiltest fit` with both sensors; *repeat* is how far the aligned shots are from their mean, rms [deg], by the norms
alone and by the best against gravity. [fit.md](fit.md#with-the-accelerometer) has the same with those held out.
"""
_IMUS = """\
## Accelerometers and gyroscopes

`hiltest fit imu`, beside the answer that the recording comes with.
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--page", type=Path)
    page = parser.parse_args().page
    text = "\n".join([_HEAD, *magnetometers(), *_instruments(), *_imus()])
    if page is None:
        print(text)
    else:
        page.write_text(text, encoding="utf-8")


def told(command: str, *arguments: str | Path) -> dict[str, Any]:
    """Return what ``hiltest COMMAND ... --json`` says."""
    done = subprocess.run(
        [sys.executable, "-m", "hiltest", command, *map(str, arguments), "--json"],
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    if not done.stdout:
        raise SystemExit(done.stderr)
    content: dict[str, Any] = json.loads(done.stdout)
    return content


def geometric_fit(points: Array, centre: Array, radius: float) -> tuple[Array, float]:
    """Return centre and radius of the ellipsoid with the least squares of distances along its corrected radius."""
    places = np.triu_indices(3)

    def matrix(parameters: Array) -> Array:
        upper = np.zeros((3, 3))
        upper[places] = parameters[3:]
        return upper + np.triu(upper, 1).T

    def off(parameters: Array) -> Array:
        away = points - parameters[:3]
        corrected = away @ matrix(parameters)
        lengths = np.linalg.norm(corrected, axis=1)
        # Sampson's distance: of the points from the surface, not of corrected ones.
        return (lengths - 1.0) * lengths / np.linalg.norm(corrected @ matrix(parameters), axis=1)

    start = np.concatenate([centre, (np.eye(3) / radius)[places]])
    result = least_squares(off, start, x_scale=np.abs(start) + 1.0 / radius).x
    return result[:3], float(np.linalg.det(matrix(result))) ** (-1.0 / 3.0)


def _table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [headings, ["---"] * len(headings), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


def _triple(values: Sequence[float], how: str = ".2f") -> str:
    return ", ".join(format(value, how) for value in values)


def magnetometers() -> Iterator[str]:
    """Yield the section of magnetometers."""
    yield _MAGNETOMETERS
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for name, path, log in _magnetometer_logs(Path(folder)):
            columns = _PACKET_COLUMNS if path.name == "packets.csv" else None
            answer = told("fit", path, "--on", "host", *(["--columns", columns] if columns else []))
            best = next(calibrator for calibrator in answer["calibrators"] if calibrator["name"] == answer["best"])
            samples = read_samples(path, columns=columns)
            stored = left_out(samples).rest.points
            error = best["direction_error_deg"]
            centre, radius, residual = best["hard_iron"], best["radius"], best["residual_percent"]
            scipy_s = (
                ["-", "-"]
                if centre is None
                else [_triple(geometric_fit(points, centre, radius)[0]) for points in (stored, samples.points)]
            )
            rows.append(
                [
                    name,
                    f"{answer['n_in']}, {answer['n_in'] - len(stored)}",
                    f"{answer['verdict']}, `{best['name']}`",
                    "-" if centre is None else _triple(centre),
                    "-" if radius is None else f"{radius:.2f}",
                    "-" if residual is None else f"{residual:.2f}",
                    "-" if error is None else f"{error:.2f}",
                    *scipy_s,
                    log,
                ]
            )
    headings = [
        "set",
        "readings, left out",
        "verdict, best",
        "centre",
        "radius",
        "residual [%]",
        "error [deg]",
        "scipy's centre",
        "of all readings",
        "known",
    ]
    yield _table(headings, rows)


def _magnetometer_logs(folder: Path) -> Iterator[tuple[str, Path, str]]:
    """Yield name, file and what its README says."""
    nxp, packets = DATA / "nxp_imu_fxos8700", folder / "packets.csv"
    match = re.search(r"centre at \(([^)]*)\) uT", (DATA / "README.md").read_text(encoding="utf-8"))
    centre = match.group(1) if match else "?"
    yield "nxp_imu_fxos8700, imu.csv", nxp / "imu.csv", f"geometric centre {centre}, a poor cloud"
    yield "nxp_imu_fxos8700, check_cal.csv", nxp / "check_cal.csv", "flat, four stops of about 90 degrees"
    subprocess.run(
        [sys.executable, "-m", "hiltest", "decode", str(DATA / "nxp_packets" / "imu.bin"), "--csv", str(packets)],
        check=True,
        capture_output=True,
        timeout=300,
    )
    yield "nxp_packets, imu.bin by `hiltest decode --csv`", packets, "the samples of imu.csv"
    yield "xio_fusion, sensor_data.csv", DATA / "xio_fusion" / "sensor_data.csv", "a patch of the sphere: to be refused"


def _instruments() -> Iterator[str]:
    yield _INSTRUMENTS
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for path in sorted((DATA / "circuitpython_magcal" / "tests" / "fixtures").glob("*/*.json")):
            shots, log = Shots.read(path), Path(folder) / f"{path.stem}.csv"
            np.savetxt(
                log,
                np.hstack([shots.points, shots.acceleration]),
                delimiter=",",
                header="mx,my,mz,ax,ay,az",
                comments="",
            )
            answer = told("fit", log, "--on", "host")
            by_name = {calibrator["name"]: calibrator for calibrator in answer["calibrators"]}
            best, gravity = by_name[answer["best"]], by_name[answer["best"]]["gravity"]
            norms = by_name["direct"]
            against = next((calibrator for calibrator in answer["calibrators"] if calibrator["gravity"]), None)
            rows.append(
                [
                    shots.name,
                    f"{answer['verdict']}, `{answer['best']}`",
                    f"{best['residual_percent']:.2f}",
                    _repeat(shots, norms, (gravity or (against or {}).get("gravity"))),
                    _repeat(shots, best, gravity),
                ]
            )
    yield _table(["instrument", "verdict, best", "residual [%]", "repeat, norms", "repeat, best"], rows)


def _repeat(shots: Shots, fit: dict[str, Any], gravity: dict[str, Any] | None) -> str:
    """Return how far both groups of aligned shots are from their means, with the accelerometer of a gravity fit."""
    if gravity is None or fit["soft_iron"] is None:
        return "-"
    field = (shots.points - fit["hard_iron"]) @ np.array(fit["soft_iron"]).T
    down = (shots.acceleration - gravity["accelerometer_offset"]) @ np.array(gravity["accelerometer_gain"]).T
    return ", ".join(f"{repeats_within_deg(field[rows], down[rows]):.2f}" for rows in ALIGNED)


def _imus() -> Iterator[str]:
    yield _IMUS
    ferraris, xsens = DATA / "imucal_ferraris", DATA / "imu_tk_xsens"
    answer = json.loads((ferraris / "example_cal.json").read_text(encoding="utf-8"))
    annotated = told("fit", "imu", ferraris / "annotated_session.csv", "--intervals", "part", "--rate", "102.4")
    listed = told(
        "fit",
        "imu",
        ferraris / "example_ferraris_session.csv",
        "--intervals",
        ferraris / "example_ferraris_session_list.json",
        "--accelerometer-unit",
        "m/s2",
        "--gyroscope-unit",
        "deg/s",
        "--rate",
        "102.4",
    )
    poses = told("fit", "imu", xsens / "xsens_acc.mat.gz", "--gyroscope-log", xsens / "xsens_gyro.mat.gz")
    gains = [1.0 / (_STANDARD_GRAVITY * row[place]) for place, row in enumerate(answer["K_a"])]
    rows = [
        [
            "imucal_ferraris, annotated",
            *_imu(annotated),
            f"offset {_triple(answer['b_a'], '.1f')} counts; gain "
            f"{_triple(gains, '.4g')} g/count; bias {_triple(answer['b_g'])} counts",
        ],
        ["imucal_ferraris, example", *_imu(listed), "three turns of -370.0, -353.7, -359.4 deg"],
        ["imu_tk_xsens", *_imu(poses), "offset 33124, 33275, 32365 counts; .01 % left in 38 poses"],
    ]
    headings = ["set", "accelerometer", "offset", "gain, diagonal", "spread of norms [%]", "bias", "known"]
    yield _table(headings, rows)


def _imu(message: dict[str, Any]) -> list[str]:
    accelerometer, gyroscope = message["accelerometer"], message["gyroscope"]
    gain = [accelerometer["gain"][place][place] for place in range(3)]
    return [
        str(accelerometer.get("verdict", "-")),
        _triple(accelerometer["offset"], ".5g"),
        _triple(gain, ".4g"),
        f"{accelerometer['spread_after_percent']:.3f}",
        _triple(gyroscope["bias"], ".5g"),
    ]


if __name__ == "__main__":
    main()
