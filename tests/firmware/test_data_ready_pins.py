"""Firmware that waits for the sensors' interrupt pins, as the shield leads them, and never polls."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from hiltest.boards import VirtualBench
from hiltest.rig import build_world
from hiltest.rig.rig_file import load_rig

from ..parts_on_buses import parts_on_buses
from .polling import SAMPLE_BYTES, polled

RIG = Path(__file__).parents[2] / "hil" / "rigs" / "virtual-k64f.toml"
SAMPLES = 200
# Of part_t: what comes before the samples, and where in it the status and the count of edges stand.
HEAD_BYTES, STATUS, EDGES = 16, 2, slice(8, 12)


def test_every_sample_raises_its_pin_and_is_read_once(build_program: Callable[[str], Path]) -> None:
    rig = load_rig(RIG)
    board = VirtualBench(rig, firmware=build_program("data_ready.c")).machine
    symbols, memory = board.image.symbols, board.processor.memory
    board.run_until(3.0, wake=lambda: any(memory.read(symbols["finished"].address, 4)))
    assert any(memory.read(symbols["finished"].address, 4))
    size = symbols["parts"].size // 2
    _, accelerometer, gyroscope = parts_on_buses(rig, build_world(rig), rig.seed)["i2c1"]
    switched_on = (gyroscope, 0x13, 0x0A), (accelerometer, 0x2A, 0x11)
    for index, expected in enumerate(polled(*register, until_s=1.325) for register in switched_on):
        part = memory.read(symbols["parts"].address + index * size, size)
        assert part[STATUS] == 0, "I2C status"
        assert int.from_bytes(part[EDGES], "little") == SAMPLES
        parts = [part[at : at + SAMPLE_BYTES] for at in range(HEAD_BYTES, HEAD_BYTES + 6 * SAMPLES, SAMPLE_BYTES)]
        first = expected.index(parts[0])
        assert parts == expected[first : first + SAMPLES]
