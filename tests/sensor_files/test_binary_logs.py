"""Binary logs: files that the packages of `hiltest[logs]` write, or in their format, give the readings back."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hiltest.errors import ConfigError
from hiltest.interfaces.packets import AnglesPacket, MagneticPacket7, encode
from hiltest.interfaces.sensor_files.binary_logs import read_binary
from hiltest.log_fitting import Samples, read_samples
from hiltest.measurement.units import AccelerationUnit, FieldUnit

POINTS = np.round(np.random.default_rng(2).uniform(-600.0, 600.0, (50, 3)))


def check(samples: Samples, unit: FieldUnit, size: float) -> None:
    assert samples.unit is unit
    np.testing.assert_allclose(samples.points, POINTS * size, rtol=1e-6)
    assert samples.time_s is not None
    np.testing.assert_allclose(np.diff(samples.time_s), 0.02, atol=1e-6)


def test_packets_of_nxp_s_sensor_fusion_give_the_points_of_their_buffer(tmp_path: Path) -> None:
    wire = b"ATSRM,2,0\r"  # the firmware's first bytes are for a Bluetooth module
    for number, point in enumerate(POINTS.astype(int).tolist()):
        wire += encode(AnglesPacket(2 * number % 256, 20_000 * number, roll=0, pitch=0, compass=0))
        wire += encode(MagneticPacket7((2 * number + 1) % 256, 120, 250, 502, 10 + number, tuple(point)))
    path = tmp_path / "board.bin"
    path.write_bytes(wire)
    check(read_samples(path), FieldUnit.UT, 0.1)


@given(st.text(alphabet="~ 0123456789.,-\n"))
def test_text_with_delimiters_of_packets_is_text(tmp_path_factory: pytest.TempPathFactory, text: str) -> None:
    path = tmp_path_factory.getbasetemp() / "delimiters.txt"
    path.write_text("~ a log ~\n" + text)
    assert read_binary(path) is None


def test_ardupilot_s_log(tmp_path: Path, require_module: Callable[[str], None]) -> None:
    require_module("pymavlink")

    def form(number: int, length: int, name: bytes, types: bytes, columns: bytes) -> bytes:
        return struct.pack("<3BBB4s16s64s", 0xA3, 0x95, 0x80, number, length, name, types, columns)

    content = form(0x80, 89, b"FMT", b"BBnNZ", b"Type,Length,Name,Format,Columns")
    content += form(0x81, 18, b"MAG", b"QBhhh", b"TimeUS,I,MagX,MagY,MagZ")
    content += form(0x82, 24, b"IMU", b"QBfff", b"TimeUS,I,AccX,AccY,AccZ")
    for row, point in enumerate(POINTS.astype(int).tolist()):
        time_us = 20_000 * row + 7_000_000
        content += struct.pack("<3BQB3h", 0xA3, 0x95, 0x81, time_us, 0, *point)
        for instance in (0, 1):
            content += struct.pack("<3BQB3f", 0xA3, 0x95, 0x82, time_us + 5_000, instance, row, -row, 9.8 + instance)
    path = tmp_path / "flight.bin"
    path.write_bytes(content)
    samples = read_samples(path)
    check(samples, FieldUnit.MG, 1.0)
    # The first accelerometer is a quarter of a step behind the magnetometer, and has none before the first reading.
    assert samples.acceleration is not None
    assert samples.acceleration_unit is AccelerationUnit.MS2
    expected = np.column_stack([np.arange(50) - 0.25, 0.25 - np.arange(50), np.full(50, 9.8)])
    np.testing.assert_allclose(samples.acceleration[1:], expected[1:], rtol=1e-6)
    assert np.isnan(samples.acceleration[0]).all()
    assert "The acceleration at 49 of 50 readings was interpolated between its own rows." in samples.notes


def test_ardupilot_s_log_as_text(tmp_path: Path, require_module: Callable[[str], None]) -> None:
    require_module("pymavlink")
    lines = [
        "FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns",
        "FMT, 129, 18, MAG, QBhhh, TimeUS,I,MagX,MagY,MagZ",
        *(f"MAG, {20_000 * row + 7_000_000}, 0, {x:.0f}, {y:.0f}, {z:.0f}" for row, (x, y, z) in enumerate(POINTS)),
    ]
    path = tmp_path / "flight.log"
    path.write_text("\n".join(lines) + "\n")
    check(read_samples(path), FieldUnit.MG, 1.0)


def test_px4_s_log(tmp_path: Path, require_module: Callable[[str], None]) -> None:
    require_module("pyulog")
    content = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0)

    def message(kind: bytes, body: bytes) -> bytes:
        return struct.pack("<HB", len(body), kind[0]) + body

    content += message(b"F", b"sensor_mag:uint64_t timestamp;float x;float y;float z;")
    content += message(b"A", struct.pack("<BH", 0, 0) + b"sensor_mag")
    for row, point in enumerate((POINTS / 1000.0).tolist()):
        content += message(b"D", struct.pack("<HQ3f", 0, 20_000 * row + 7_000_000, *point))
    path = tmp_path / "flight.ulg"
    path.write_bytes(content)
    check(read_samples(path), FieldUnit.GAUSS, 1e-3)


def test_betaflight_s_log(tmp_path: Path) -> None:
    pytest.importorskip("orangebox", reason="pip refuses its wheel, so no environment of tox has it")
    names = ("loopIteration", "time", "magADC[0]", "magADC[1]", "magADC[2]")
    content = b"H Product:Blackbox flight data recorder by Nicholas Sherwood\nH Data version:2\nH I interval:1\n"
    content += b"H P interval:1/1\nH Field I name:" + ",".join(names).encode()
    content += b"\nH Field I signed:0,0,1,1,1\nH Field I predictor:0,0,0,0,0\nH Field I encoding:1,1,0,0,0\n"
    content += b"H Field P predictor:0,0,0,0,0\nH Field P encoding:1,1,0,0,0\n"

    def variable(value: int) -> bytes:
        """Return seven bits a byte, the lowest first; all but the last byte have the highest bit."""
        return bytes([value & 0x7F | 0x80]) + variable(value >> 7) if value > 0x7F else bytes([value])

    for row, point in enumerate(POINTS.astype(int).tolist()):
        signed = b"".join(variable((value << 1) ^ (value >> 31)) for value in point)  # zigzag
        content += b"I" + variable(row) + variable(20_000 * row + 7_000_000) + signed
    path = tmp_path / "flight.bbl"
    path.write_bytes(content + b"E\xffEnd of log\0")
    check(read_samples(path), FieldUnit.COUNTS, 1.0)


@pytest.mark.parametrize("storage", ["MCAP", "SQLITE3"])
def test_ros_2_s_bag(tmp_path: Path, require_module: Callable[[str], None], storage: str) -> None:
    require_module("rosbags")
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.LATEST)
    types: dict[str, Any] = store.types
    kind = "sensor_msgs/msg/MagneticField"
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin[storage]) as writer:
        connection = writer.add_connection("/imu/mag", kind, typestore=store)
        for row, (x, y, z) in enumerate((POINTS * 1e-7).tolist()):
            time_ns = 20_000_000 * row + 1_700_000_000_000_000_000
            stamp = types["builtin_interfaces/msg/Time"](*divmod(time_ns, 1_000_000_000))
            field = types["geometry_msgs/msg/Vector3"](x, y, z)
            header = types["std_msgs/msg/Header"](stamp, "imu")
            writer.write(connection, time_ns, store.serialize_cdr(types[kind](header, field, np.zeros(9)), kind))
    (path,) = [file for file in (tmp_path / "bag").iterdir() if file.suffix in (".mcap", ".db3")]
    check(read_samples(path), FieldUnit.T, 1e-7)


@pytest.mark.parametrize(
    ("mark", "name"),
    [(b"\xa3\x95", "ArduPilot's log"), (b"ULog\x01\x12\x35", "PX4's ULog"), (b"H Product:Blackbox", "blackbox")],
)
def test_a_damaged_log_is_refused(tmp_path: Path, mark: bytes, name: str) -> None:
    path = tmp_path / "log"
    path.write_bytes(mark + b"\x01damaged" * 10)
    with pytest.raises(ConfigError, match=f"{path}: ({name}|.*{name}|no message)"):
        read_samples(path)


def test_a_missing_package_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "pyulog", None)
    path = tmp_path / "flight.ulg"
    path.write_bytes(b"ULog\x01\x12\x35\x01")
    with pytest.raises(ConfigError, match=r"PX4's ULog is read by a package: pip install 'hiltest\[logs\]'"):
        read_samples(path)
