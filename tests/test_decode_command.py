"""``hiltest decode`` as it is typed, of files and of ports."""

from __future__ import annotations

import csv
import os
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.command_files import run
from tests.interfaces.test_packet_stream import RECORDING
from tests.serial_line import Line

from hiltest.interfaces.packet_csv import PacketRows
from hiltest.interfaces.packet_stream import batches
from hiltest.interfaces.packets import (
    KINDS,
    AnglesPacket,
    DebugPacket,
    MagneticPacket7,
    MainPacket,
    encode,
)
from hiltest.log_fitting.rate_log import read_rate_log
from hiltest.log_fitting.samples import read_samples

BURSTS = 41


def burst(n: int) -> bytes:
    """Three packets of a board that shows its buffer, one cell after the other."""
    time_us = 1_000_000 + n * 25_000
    return b"".join(
        map(
            encode,
            (
                MainPacket(
                    3 * n % 256, time_us, (8192, 0, -4096), (301, 7, 0x7E), (n, -40, 0), (30_000, 0, 0, 0), 8, 69
                ),
                AnglesPacket((3 * n + 1) % 256, time_us, 15, -20, 3599),
                MagneticPacket7((3 * n + 2) % 256, 40, 350, 500, 10 + n, (n, 2 * n, -n)),
            ),
        )
    )


STREAM = b"".join(map(burst, range(BURSTS)))
TABLE = """\
   1  sensors and orientation             41        40.0
   4  roll, pitch, heading                41        40.0
   6  magnetic calibration                41        40.0
"""


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """A file that begins and ends in the middle of a packet."""
    path = tmp_path / "toolbox.bin"
    path.write_bytes(b"\x11\x22" + STREAM + encode(DebugPacket(123, 720, 5))[:-2])
    return path


def test_a_recording_is_counted_with_rates_and_losses(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("decode", str(recording)) == 0
    said = capsys.readouterr().out
    assert f"{recording}: 123 packets of release 7, 1.0 s by the board's clock\n" in said
    assert TABLE in said
    assert "\n7 bytes in no packet, 0 packets missing" in said


def test_the_table_has_a_row_a_packet_with_units_in_its_columns(recording: Path, tmp_path: Path) -> None:
    assert run("decode", str(recording), "--csv", str(tmp_path / "out.csv")) == 0
    with (tmp_path / "out.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["type"] for row in rows] == ["1", "4", "6"] * BURSTS
    angles = {name: cell for name, cell in rows[4].items() if cell}
    assert angles == {
        "time_s": "0.025000",
        "type": "4",
        "number": "4",
        "roll_deg": "1.5",
        "pitch_deg": "-2",
        "heading_deg": "359.9",
    }
    assert "firmware_release" not in rows[0], "kinds that did not come have no column"


def test_fit_and_allan_find_their_sensors_among_the_columns_of_all_kinds(tmp_path: Path) -> None:
    rows = PacketRows(KINDS)
    path = tmp_path / "port.csv"
    path.write_text(rows.header() + "".join(rows.lines(batch) for batch in batches(STREAM)), encoding="utf-8")
    points = read_samples(path).points  # of the buffer
    assert points[1:].tolist() == [[n / 10, n / 5, -n / 10] for n in range(1, BURSTS)]
    rates = read_rate_log(path)
    assert rates.rates.tolist() == [[n / 20, -2.0, 0.0] for n in range(BURSTS)]
    assert (rates.rate_hz, rates.gaps) == (pytest.approx(40.0), 0)


def test_a_file_without_a_packet_ends_with_1(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "noise.bin").write_bytes(b"Hello World!\r\n" * 20)
    assert run("decode", str(tmp_path / "noise.bin")) == 1
    said = capsys.readouterr().out
    assert "0 packets\n280 bytes in no packet" in said


def test_a_name_that_is_neither_file_nor_port_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("decode", str(tmp_path / "gone.bin")) == 4
    assert "gone.bin is neither a file nor a serial port; ports on this machine: " in capsys.readouterr().err


@pytest.fixture
def line() -> Iterator[Line]:
    """A line to a board."""
    made = Line()
    yield made
    if made.far >= 0:
        os.close(made.far)


def test_a_port_is_listened_to_until_the_time_is_over(
    line: Line, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sender = line.send(b"ATSRM,2,0\r" + RECORDING)
    assert run("decode", line.name, "--seconds", "2", "--csv", str(tmp_path / "out.csv")) == 0
    sender.join()
    said = capsys.readouterr().out
    assert said.startswith(f"{line.name}: 6 packets of release 7, firmware 7.20")
    assert "\n10 bytes in no packet" in said
    with (tmp_path / "out.csv").open(encoding="utf-8") as file:
        assert [row["type"] for row in csv.DictReader(file)] == ["1", "2", "4", "6", "7", "3"]


def test_ctrl_c_ends_listening_and_what_came_is_shown(line: Line, capsys: pytest.CaptureFixture[str]) -> None:
    sender = line.send(STREAM, signal.SIGINT)
    assert run("decode", line.name) == 0
    sender.join()
    assert TABLE in capsys.readouterr().out


def test_a_line_that_is_unplugged_ends_with_20_and_what_came_is_shown(
    line: Line, capsys: pytest.CaptureFixture[str]
) -> None:
    sender = line.send(STREAM, unplugged=True)
    assert run("decode", line.name) == 20
    sender.join()
    said = capsys.readouterr()
    assert TABLE in said.out
    assert f"lost {line.name}: " in said.err
