"""Firmware that sleeps long and drains the sensors' FIFOs in bursts, over the emulated bus."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from hiltest.angles import Pose
from hiltest.sensors.fxas21002c import Fxas21002c
from hiltest.sensors.fxos8700cq import Fxos8700cq
from hiltest.sensors.register_device import RegisterDevice
from hiltest.virtual.k64f import VirtualK64F
from hiltest.world.distortion import MagneticDistortion
from hiltest.world.earth_field import EarthField
from hiltest.world.world import World

FIRMWARE = Path(__file__).parents[2] / "firmware_stub"
PROGRAM = Path(__file__).parent / "programs" / "fifo_reader.c"
SAMPLES, SAMPLE_BYTES = 300, 6
# Of fifo_t: what comes before the samples.
HEAD_BYTES = 8


@pytest.fixture(scope="module")
def reader(require_tool: Callable[[str], str], tmp_path_factory: pytest.TempPathFactory) -> Path:
    elf = tmp_path_factory.mktemp("fifo") / "reader.elf"
    board = FIRMWARE / "boards" / "frdm_k64f"
    sources = [PROGRAM, *sorted(board.glob("*.c")), *sorted((FIRMWARE / "sensors").glob("*.c"))]
    subprocess.run(
        [
            require_tool("arm-none-eabi-gcc"), "-mcpu=cortex-m4", "-mthumb", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard",
            "-std=c11", "-O2", "-g", "-Wall", "-Wextra", "-Wconversion", "-Werror", "-ffunction-sections",
            "-fdata-sections", "-fno-tree-loop-distribute-patterns", f"-I{FIRMWARE}", "-nostartfiles",
            f"-T{board / 'frdm_k64f.ld'}", "-Wl,--gc-sections", *map(str, sources), "-lm", "-o", str(elf),
        ],
        check=True, timeout=120,
    )  # fmt: skip
    return elf


def parts() -> tuple[Fxas21002c, Fxos8700cq]:
    world = World(EarthField(48.5, 62.0))
    world.turn_to(Pose(120.0, 20.0), time_s=0.5)
    return Fxas21002c(world, seed=4, bias_dps=(1.0, 2.0, -3.0)), Fxos8700cq(world, MagneticDistortion(), seed=4)


def polled(part: RegisterDevice, *set_up: tuple[int, int]) -> list[bytes]:
    """Read each sample of 0.075 to 1.87 s as soon as it is there, without FIFO and without firmware."""
    for register, value in set_up:
        part.start(False, 0.06)
        part.write(register, 0.06)
        part.write(value, 0.06)
        part.stop(0.06)
    samples = []
    for tick in range(15, 375):
        time_s = tick / 200.0 + 1e-6
        part.start(False, time_s)
        part.write(0x01, time_s)
        part.start(True, time_s)
        samples.append(bytes(part.read(time_s) for _ in range(SAMPLE_BYTES)))
        part.stop(time_s)
    return samples


def test_what_firmware_drains_is_what_polling_would_have_seen(reader: Path) -> None:
    board = VirtualK64F(reader, i2c1=parts())
    symbols, memory = board.image.symbols, board.processor.memory
    board.run_until(3.0, wake=lambda: any(memory.read(symbols["finished"].address, 4)))
    assert any(memory.read(symbols["finished"].address, 4))
    size = symbols["fifos"].size // 2
    gyroscope, accelerometer = parts()
    for index, expected in enumerate((polled(gyroscope, (0x13, 0x0A)), polled(accelerometer, (0x2A, 0x11)))):
        fifo = memory.read(symbols["fifos"].address + index * size, size)
        assert fifo[2] == 0, "overflows"
        assert fifo[3] == 0, "I2C status"
        drained = [fifo[at : at + SAMPLE_BYTES] for at in range(HEAD_BYTES, HEAD_BYTES + 6 * SAMPLES, SAMPLE_BYTES)]
        first = expected.index(drained[0])
        assert drained == expected[first : first + SAMPLES]
