"""A recording of the virtual world, played back through registers, I2C bus and drivers."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from hiltest.boards import Board, VirtualBoard, open_board
from hiltest.errors import ConfigError
from hiltest.link.replies import SensorKind
from hiltest.procedures import open_table
from hiltest.procedures.sensor_log import UNITS, LogRow, log_sensors
from hiltest.rig import Rig
from hiltest.rig.rig_file import load_rig

RIG = Path(__file__).parents[2] / "hil" / "rigs" / "virtual-k64f.toml"
KINDS = tuple(SensorKind)


def rows_in_a_tumble(board: Board) -> list[LogRow]:
    assert board.stage is not None
    board.stage.tumble(6.0)
    return [row for part in log_sensors(board, KINDS, seconds=3.0) for row in part.rows]


def rig_of(folder: Path, rows: list[LogRow], began_s: float) -> Rig:
    """Write rows as a log does, and a rig that plays them, with other noise and another hard iron in its world."""
    columns = [f"{kind.name.lower()}_{axis}_{UNITS[kind][0]}" for kind in KINDS for axis in "xyz"]
    lines = [f"# hiltest log: a test, clock began {began_s:.9f} s after power-on", ",".join(["time_s", *columns])]
    for row in rows:
        cells = [",".join(f"{value:.7g}" for value in row.values) if kind is row.kind else ",," for kind in KINDS]
        lines.append(f"{row.time_s:.6f},{','.join(cells)}")
    (folder / "field.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    path = folder / "bench.toml"
    text = RIG.read_text(encoding="utf-8")
    for old, new in (
        ("[world]", '[world]\nplayback = "field.csv"'),
        ("seed = 1 ", "seed = 7 "),
        ("hard_iron_ut = [2.4, -2.2, 4.0]", "hard_iron_ut = [-12.4, 3.2, 9.0]"),
    ):
        assert text.count(old) == 1
        text = text.replace(old, new)
    path.write_text(text, encoding="utf-8")
    return load_rig(path)


@pytest.fixture(scope="module")
def rows() -> list[LogRow]:
    """What firmware reads of all sensors in a tumble, with noise."""
    with open_board(load_rig(RIG)) as board:
        return rows_in_a_tumble(board)


@pytest.fixture
def played(rows: list[LogRow], tmp_path: Path) -> Iterator[VirtualBoard]:
    with open_board(load_rig(RIG)) as board:
        assert board.stage is not None
        began_s = board.stage.firmware_clock_began_s
    with open_board(rig_of(tmp_path, rows, began_s)) as board:
        assert isinstance(board, VirtualBoard)
        yield board


def test_firmware_reads_the_same_counts_from_a_recording_as_from_the_world(
    rows: list[LogRow], played: VirtualBoard
) -> None:
    again = rows_in_a_tumble(played)
    assert len({row.values for row in rows}) > len(rows) / 2, "they differ: the board is turned, and there is noise"
    assert again == rows
    assert played.truth is None, "what the rig says of its world is not that of the recording"
    assert played.true_attitude(1_000_000) is None


def test_procedures_that_need_a_table_are_refused(played: VirtualBoard, tmp_path: Path) -> None:
    rig = load_rig(tmp_path / "bench.toml")
    with pytest.raises(ConfigError, match=r"bench.toml:\d+: world.playback: a turntable is not possible with a rec"):
        open_table(played, rig, prompt=input)
