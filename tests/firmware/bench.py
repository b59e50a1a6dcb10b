"""A booted virtual board at the far end of a serial line, for tests that speak the protocol byte by byte."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from pathlib import Path

from hiltest.link.framing import DamagedFrame, Frame, FrameDecoder, encode_frame
from hiltest.link.replies import Status
from hiltest.rig import build_world
from hiltest.rig.rig_file import load_rig
from hiltest.virtual.board.k64f import VirtualK64F
from hiltest.virtual.peripherals.i2c_bus import I2cDevice
from hiltest.world.sensors.register_device import RegisterDevice

from ..parts_on_buses import parts_on_buses

ROOT = Path(__file__).parents[2]
ELF = ROOT / "src" / "hiltest" / "firmware" / "hiltest-frdm-k64f.elf"
SYNC, IDENTITY, SENSORS, SELECT, READ, COLLECT, UPLOAD, POINTS, CLEAR_POINTS = range(1, 10)
CALIBRATE, SET, GET, CLEAR, AVERAGE, REST, STATISTICS, RESET = range(0x0A, 0x12)
STREAM_RESET, STREAM_FEED, STREAM_REMOVE, STREAM_STATE = range(0x12, 0x16)
SET_ACCELEROMETER, GET_ACCELEROMETER, ADD_POSE, POSES, CLEAR_POSES, UPLOAD_POSES, FIT_ACCELEROMETER = range(0x16, 0x1D)


#: The cycle model of the counts in firmware_stub/DESIGN.md: instructions alone, whatever way code lies.
COSTS_BY = "cortex-m4-trm/1"


class Bench:
    """A booted virtual board and the host's end of its serial port."""

    def __init__(
        self, i2c0: Sequence[I2cDevice] = (), i2c1: Sequence[I2cDevice] = (), *, cycle_counter: bool = True
    ) -> None:
        self.board = VirtualK64F(ELF, i2c0=i2c0, i2c1=i2c1, profile=COSTS_BY)
        self.board.cycle_counter.present = cycle_counter
        self.board.run_until(0.01)
        self.decoder = FrameDecoder()
        self.sequence = 0

    def send(self, data: bytes) -> None:
        self.board.uart0.host_write(data)

    def receive(self, *, within_s: float = 10.0) -> Frame | None:
        deadline_s = self.board.time_s + within_s
        while True:
            self.board.run_until(deadline_s, wake=lambda: self.board.uart0.host_waiting > 0)
            data = self.board.uart0.host_read(self.board.uart0.host_waiting)
            if not data:
                return None
            for result in self.decoder.feed(data):
                assert not isinstance(result, DamagedFrame)
                return result

    def request(self, kind: int, payload: bytes = b"", *, sequence: int | None = None) -> Frame:
        self.sequence = (self.sequence + 1) % 256
        used = self.sequence if sequence is None else sequence
        self.send(encode_frame(Frame(kind, used, payload)))
        reply = self.receive()
        assert reply is not None
        assert (reply.type, reply.sequence) == (kind | 0x80, used)
        return reply

    def status(self, kind: int, payload: bytes = b"") -> Status:
        return Status(self.request(kind, payload).payload[0])

    def ask(self, kind: int, payload: bytes = b"") -> bytes:
        """The data of a reply that must be OK."""
        reply = self.request(kind, payload)
        assert Status(reply.payload[0]) == Status.OK
        return reply.payload[1:]

    def counters(self) -> tuple[int, int, int, int]:
        frames, damaged, overruns, repeated = struct.unpack("<4I", self.ask(STATISTICS))
        return frames, damaged, overruns, repeated

    def upload(self, points: Sequence[tuple[int, int, int]]) -> None:
        self.ask(CLEAR_POINTS)
        for first in range(0, len(points), 160):
            part = points[first : first + 160]
            self.ask(UPLOAD, struct.pack("<HB", first, len(part)) + b"".join(struct.pack("<3h", *p) for p in part))


def sensors() -> dict[str, list[RegisterDevice]]:
    """The parts of the default rig, by bus."""
    rig = load_rig(ROOT / "hil" / "rigs" / "virtual-k64f.toml")
    return parts_on_buses(rig, build_world(rig), 1)


def bench_with(*buses: str) -> Bench:
    parts = sensors()
    return Bench(**{bus: parts[bus] for bus in buses})


def sphere(n: int) -> list[tuple[int, int, int]]:
    """Points of a spiral on a sphere of 500 counts about (100, -200, 300)."""
    golden = math.pi * (3 - math.sqrt(5))
    heights = [1 - 2 * (k + 0.5) / n for k in range(n)]
    return [
        (
            round(100 + 500 * math.sqrt(1 - z * z) * math.cos(golden * k)),
            round(-200 + 500 * math.sqrt(1 - z * z) * math.sin(golden * k)),
            round(300 + 500 * z),
        )
        for k, z in enumerate(heights)
    ]
