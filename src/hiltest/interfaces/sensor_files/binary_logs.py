"""Binary logs: NXP's packets, and those of autopilots and robots by the packages of the extra ``hiltest[logs]``."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

from hiltest.budgets import BINARY_LOG, BudgetError
from hiltest.errors import ConfigError
from hiltest.interfaces.packet_csv import PacketRows
from hiltest.interfaces.packet_stream import PacketDecoder, batches
from hiltest.interfaces.packet_summary import summary_of

Rows = Iterator[dict[str, object]]

# Bytes that show the kind of a file.
_BEGIN = 4096

# Units by message and the beginning of a field's name, from ArduPilot's log documentation and PX4's messages.
_ARDUPILOT = {"MAG": ("mG", "Mag"), "IMU": ("m/s2", "Acc"), "BAT": ("A", "Curr"), "BARO": ("degC", "Temp")}
_PX4 = {"sensor_mag": "gauss", "sensor_accel": "m/s2", "sensor_gyro": "rad/s", "battery_status": "A"}
_ROS = ("MagneticField", "Imu", "Temperature", "BatteryState")
_ROS_VECTORS = {"magnetic_field": "T", "linear_acceleration": "m/s2", "angular_velocity": "rad/s"}


def read_binary(path: Path) -> list[dict[str, str]] | None:
    """Return the rows of a binary log, one for each message, as texts by names with units; None for another file.

    Raises
    ------
    ConfigError
        When a package for this kind of log is missing, or refuses it.
    """
    if not path.is_file() or path.suffix == ".gz":
        return None
    with path.open("rb") as file:
        begin = file.read(_BEGIN)
    kinds = [(name, reader) for mark, name, reader in _KINDS if begin.startswith(mark)]
    if not kinds and _has_packets(begin):
        kinds = [("packets of NXP's Sensor Fusion", _packets)]
    if not kinds:
        return None
    name, reader = kinds[0]
    rows: list[dict[str, str]] = []
    try:
        BINARY_LOG.check(size=path.stat().st_size)
        for row in reader(path):
            rows.append({key: str(value) for key, value in row.items()})
            BINARY_LOG.check(items=len(rows))
    except ImportError as error:
        step = "convert it with blackbox_decode" if error.name == "orangebox" else "pip install 'hiltest[logs]'"
        raise ConfigError(f"{path}: {name} is read by a package: {step} ({error})") from error
    except BudgetError as error:
        raise ConfigError(f"{path}: {error}; cut the log") from error
    except Exception as error:  # packages raise anything at a damaged log
        raise ConfigError(f"{path}: {name} cannot be read: {error or type(error).__name__}") from error
    return rows


def _has_packets(begin: bytes) -> bool:
    """Return whether NXP's packets make up at least half of the beginning of a file."""
    batch = PacketDecoder().feed(begin)
    return bool(batch.packets()) and 2 * batch.lost_bytes < len(begin)


def _packets(path: Path) -> Rows:
    data = path.read_bytes()
    summary, release = summary_of(data)
    rows = PacketRows(summary.kinds)
    names = rows.header().strip().split(",")
    for batch in batches(data, release):
        for line in rows.lines(batch).splitlines():
            yield {name: cell for name, cell in zip(names, line.split(","), strict=True) if cell}


def _ardupilot(path: Path) -> Rows:
    from pymavlink.DFReader import DFReader_binary, DFReader_text

    with path.open("rb") as file:
        reader = DFReader_text if file.read(3) == b"FMT" else DFReader_binary
    with closing(reader(str(path))) as log:
        while (message := log.recv_match(type=[*_ARDUPILOT])) is not None:
            kind = message.get_type()
            unit, begin = _ARDUPILOT[kind]
            row = {"TimeUS [us]": message.TimeUS}
            for name, value in message.to_dict().items():
                if name.startswith((begin, "Gyr")):
                    own_unit = "rad/s" if name.startswith("Gyr") else unit
                    row[f"{kind}{getattr(message, 'I', 0)}.{name} [{own_unit}]"] = value
            yield row


def _px4(path: Path) -> Rows:
    from pyulog import ULog

    rows = []
    with path.open("rb") as file:
        tables = ULog(file, [*_PX4]).data_list
    for data in tables:
        fields = [name for name in ("x", "y", "z", "temperature", "current_a") if name in data.data]
        units = ["degC" if name == "temperature" else _PX4[data.name] for name in fields]
        names = [f"{data.name}{data.multi_id}.{name} [{unit}]" for name, unit in zip(fields, units, strict=True)]
        columns = [data.data[name].tolist() for name in ("timestamp", *fields)]
        rows += [dict(zip(("timestamp [us]", *names), row, strict=True)) for row in zip(*columns, strict=True)]
    yield from sorted(rows, key=lambda row: float(row["timestamp [us]"]))


def _betaflight(path: Path) -> Rows:
    from orangebox import Parser

    log = Parser.load(str(path))
    names = ["time [us]" if name == "time" else name for name in log.field_names]
    for frame in log.frames():
        yield {name: value for name, value in zip(names, frame.data, strict=False) if value is not None}


def _ros(path: Path) -> Rows:
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    bag = path if path.suffix == ".bag" else path.parent
    with AnyReader([bag], default_typestore=get_typestore(Stores.LATEST)) as reader:
        connections = [topic for topic in reader.connections if topic.msgtype.rpartition("/")[2] in _ROS]
        for connection, _, data in reader.messages(connections=connections):
            message = reader.deserialize(data, connection.msgtype)
            stamp = message.header.stamp
            row: dict[str, object] = {"time [s]": f"{stamp.sec + 1e-9 * stamp.nanosec:.9f}"}
            for name, unit in _ROS_VECTORS.items():
                for axis in "xyz" if hasattr(message, name) else "":
                    row[f"{connection.topic}.{name}.{axis} [{unit}]"] = getattr(getattr(message, name), axis)
            for name, unit in (("temperature", "degC"), ("current", "A")):
                if hasattr(message, name):
                    row[f"{connection.topic}.{name} [{unit}]"] = getattr(message, name)
            yield row


_KINDS: tuple[tuple[bytes, str, Callable[[Path], Rows]], ...] = (
    (b"\xa3\x95", "ArduPilot's log", _ardupilot),
    (b"FMT, ", "ArduPilot's log as text", _ardupilot),
    (b"ULog\x01\x12\x35", "PX4's ULog", _px4),
    (b"H Product:Blackbox", "Betaflight's blackbox", _betaflight),
    (b"\x89MCAP0\r\n", "ROS 2's bag", _ros),
    (b"SQLite format 3\0", "ROS 2's bag", _ros),
    (b"#ROSBAG V2", "ROS 1's bag", _ros),
)
