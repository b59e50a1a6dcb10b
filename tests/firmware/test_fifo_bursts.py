"""Firmware that sleeps long and drains the sensors' FIFOs in bursts, over the emulated bus."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from hiltest.orientation.angles import Pose
from hiltest.virtual.board.k64f import VirtualK64F
from hiltest.world.distortion import MagneticDistortion
from hiltest.world.earth_field import EarthField
from hiltest.world.sensors.fxas21002c import Fxas21002c
from hiltest.world.sensors.fxos8700cq import Fxos8700cq
from hiltest.world.world import World

from .polling import SAMPLE_BYTES, polled

SAMPLES = 300
# Of fifo_t: what comes before the samples.
HEAD_BYTES = 8


def parts() -> tuple[Fxas21002c, Fxos8700cq]:
    world = World(EarthField(48.5, 62.0))
    world.turn_to(Pose(120.0, 20.0), time_s=0.5)
    return Fxas21002c(world, seed=4, bias_dps=(1.0, 2.0, -3.0)), Fxos8700cq(world, MagneticDistortion(), seed=4)


def test_what_firmware_drains_is_what_polling_would_have_seen(build_program: Callable[[str], Path]) -> None:
    board = VirtualK64F(build_program("fifo_reader.c"), i2c1=parts())
    symbols, memory = board.image.symbols, board.processor.memory
    board.run_until(3.0, wake=lambda: any(memory.read(symbols["finished"].address, 4)))
    assert any(memory.read(symbols["finished"].address, 4))
    size = symbols["fifos"].size // 2
    gyroscope, accelerometer = parts()
    switched_on = (gyroscope, 0x13, 0x0A), (accelerometer, 0x2A, 0x11)
    for index, expected in enumerate(polled(*register, until_s=1.875) for register in switched_on):
        fifo = memory.read(symbols["fifos"].address + index * size, size)
        assert fifo[2] == 0, "overflows"
        assert fifo[3] == 0, "I2C status"
        drained = [fifo[at : at + SAMPLE_BYTES] for at in range(HEAD_BYTES, HEAD_BYTES + 6 * SAMPLES, SAMPLE_BYTES)]
        first = expected.index(drained[0])
        assert drained == expected[first : first + SAMPLES]
