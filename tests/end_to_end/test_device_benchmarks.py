"""``pytest hil/benchmarks``: every kernel's device cycles, the same numbers that the suites judge."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from hiltest.boards import open_board
from hiltest.boards.board import Board
from hiltest.link.messages import Calibrate
from hiltest.procedures import golden_points, measure_dpi_cycles, upload_points
from hiltest.rig.bench_files import shipped
from hiltest.rig.rig_file import load_rig


@pytest.fixture(scope="module")
def board() -> Board:
    return open_board(load_rig(shipped() / "rigs" / "virtual-k64f.toml"))


def run(folder: Path, *arguments: str | Path) -> subprocess.CompletedProcess[str]:
    """Run pytest in a folder, on the bench that comes with hiltest."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("HIL_")}
    command = [sys.executable, "-m", "pytest", f"--rootdir={folder}", "-p", "no:cacheprovider", *map(str, arguments)]
    return subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, check=False, timeout=240
    )


@pytest.fixture(scope="module")
def rows(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, Any]]:
    """What pytest-benchmark keeps of each benchmark, by name."""
    folder = tmp_path_factory.mktemp("bench")
    done = run(folder, shipped() / "benchmarks", "-W", "error", "--benchmark-json=cycles.json")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "Name (time in s)" not in done.stdout
    content = json.loads((folder / "cycles.json").read_text(encoding="utf-8"))
    return {row["name"]: row for row in content["benchmarks"]}


def test_every_calibrator_of_the_firmware_has_its_rows(board: Board, rows: dict[str, dict[str, Any]]) -> None:
    kernels = {row["group"].partition(",")[0] for row in rows.values()}
    assert {*board.identity.calibrators, "dpi", "accelerometer fit", "attitude filter", "heading"} <= kernels
    assert {f"test_new_point[{name}]" for name in board.identity.stream_calibrators} <= rows.keys()
    assert {row["extra_info"]["cycle_model"] for row in rows.values() if row["group"].startswith("direct,")} == {
        board.cycle_model
    }


def test_the_numbers_are_those_of_the_board(board: Board, rows: dict[str, dict[str, Any]]) -> None:
    for name in board.identity.calibrators:
        counted = []
        for index in range(2):
            upload_points(board, golden_points(100, index=index))
            cost = board.session.request(Calibrate(100, name)).cost
            assert cost is not None
            counted.append(cost.cycles)
        assert rows[f"test_calibrator[{name}-100]"]["stats"]["data"][:2] == counted
    gravity = measure_dpi_cycles(board)
    sizes = dict(zip(gravity.sizes.tolist(), gravity.cycles.tolist(), strict=True))
    for pairs in (300, 500):
        assert rows[f"test_against_gravity[{pairs}]"]["stats"]["data"][0] == sizes[pairs]


def test_headings_and_updates_of_the_filter_take_what_the_kernels_take(rows: dict[str, dict[str, Any]]) -> None:
    heading, turn, update = (
        rows[f"test_{name}"]["stats"] for name in ("tilt_heading", "attitude_filter_turn", "attitude_filter_update")
    )
    assert (heading["min"], round(heading["mean"]), heading["max"]) == (746, 857, 916)
    assert turn["min"] == turn["max"] == 155
    assert update["min"] == update["max"] == 537


def test_a_calibrator_that_is_in_no_list_is_named(tmp_path: Path) -> None:
    for file in ("conftest.py", "test_calibrator_cycles.py"):
        text = (shipped() / "benchmarks" / file).read_text(encoding="utf-8")
        text = re.sub(r"^CALIBRATORS = \([^)]*\)", 'CALIBRATORS = ("direct", "gone")', text, flags=re.M)
        (tmp_path / file).write_text(text)
    done = run(tmp_path, "-rs", "-k", "test_calibrator and 30")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "corrected is in no table: add it to CALIBRATORS in test_calibrator_cycles.py" in done.stdout
    assert "this firmware has no calibrator 'gone'" in done.stdout
