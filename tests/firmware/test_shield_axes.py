"""From register bytes to body-frame counts: the firmware's drivers, compiled for this machine, in six poses."""

from __future__ import annotations

import ctypes
import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FIRMWARE = ROOT / "firmware_stub"
GOLDEN = json.loads((ROOT / "fixtures" / "axes" / "shield.json").read_text())
CASES = GOLDEN["poses"] + GOLDEN["limits"]
NEW_SAMPLE, OVERWRITTEN = 0x08, 0x80
# As in boards/frdm_k64f/board_sensors.c, and where the part's status register is.
SENSOR_IDS = {"mag3110": 0, "accelerometer": 1, "fxos8700_magnetometer": 2, "gyroscope": 3}
STATUS_REGISTERS = {"mag3110": 0x00, "accelerometer": 0x00, "fxos8700_magnetometer": 0x32, "gyroscope": 0x00}


class _Sample(ctypes.Structure):
    _fields_ = [("time_us", ctypes.c_uint64), ("body", ctypes.c_int16 * 3), ("overrun", ctypes.c_bool)]


class _Sensor(ctypes.Structure):
    _fields_ = [
        ("name", ctypes.c_char_p),
        ("driver", ctypes.c_void_p),
        ("bus", ctypes.c_uint8),
        ("address", ctypes.c_uint8),
    ]


@pytest.fixture(scope="module")
def drivers(tmp_path_factory: pytest.TempPathFactory, require_tool: Callable[[str], str]) -> ctypes.CDLL:
    library = tmp_path_factory.mktemp("sensors") / "sensors.so"
    sources = [
        *sorted((FIRMWARE / "sensors").glob("*.c")),
        FIRMWARE / "boards" / "frdm_k64f" / "board_sensors.c",
        Path(__file__).with_name("host_board.c"),
    ]
    flags = ["-std=c11", "-Wall", "-Wextra", "-Wconversion", "-Werror", "-shared", "-fPIC", f"-I{FIRMWARE}"]
    subprocess.run([require_tool("gcc"), *flags, "-o", library, *sources], check=True)
    return ctypes.CDLL(str(library))


def read(drivers: ctypes.CDLL, sensor: str, status: int, data: bytes) -> tuple[int, _Sample]:
    """Put bytes into the registers of a part and let its driver read them."""
    registers = (ctypes.c_uint8 * 256).in_dll(drivers, "host_registers")
    first = STATUS_REGISTERS[sensor]
    registers[:] = bytes(256)
    registers[first : first + 7] = bytes([status]) + data
    table = (_Sensor * len(SENSOR_IDS)).in_dll(drivers, "board_sensors")
    sample = _Sample()
    result = drivers.sensor_read_if_ready(ctypes.byref(table[SENSOR_IDS[sensor]]), ctypes.byref(sample))
    return result, sample


@pytest.mark.parametrize("sensor", SENSOR_IDS)
@pytest.mark.parametrize("case", CASES, ids=lambda case: case["name"])
def test_register_bytes_become_body_counts(drivers: ctypes.CDLL, case: dict[str, dict[str, str]], sensor: str) -> None:
    result, sample = read(drivers, sensor, NEW_SAMPLE, bytes.fromhex(case["registers"][sensor]))
    assert result == 0
    assert list(sample.body) == case["body"][sensor]
    assert not sample.overrun


def test_nothing_is_read_twice(drivers: ctypes.CDLL) -> None:
    not_ready = 1
    assert read(drivers, "mag3110", 0x07, bytes(6))[0] == not_ready


def test_an_overwritten_sample_is_told(drivers: ctypes.CDLL) -> None:
    assert read(drivers, "gyroscope", NEW_SAMPLE | OVERWRITTEN, bytes(6))[1].overrun


def test_the_six_poses_tell_all_axes_and_signs_apart() -> None:
    for sensor in ("mag3110", "fxos8700_magnetometer"):
        observations = {tuple(case["body"][sensor]) for case in GOLDEN["poses"]}
        assert len(observations) == 6
        assert all(len({abs(value) for value in body}) == 3 for body in observations)
