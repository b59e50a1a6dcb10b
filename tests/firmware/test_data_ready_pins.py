"""Firmware that waits for the sensors' interrupt pins, as the shield leads them, and never polls."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from hiltest.boards import VirtualBench
from hiltest.rig import build_sensors, build_world
from hiltest.rig_file import load_rig
from hiltest.sensors.register_device import RegisterDevice

FIRMWARE = Path(__file__).parents[2] / "firmware_stub"
PROGRAM = Path(__file__).parent / "programs" / "data_ready.c"
RIG = Path(__file__).parents[2] / "hil" / "rigs" / "virtual-k64f.toml"
SAMPLES, SAMPLE_BYTES = 200, 6
# Of part_t: what comes before the samples, and where in it the status and the count of edges stand.
HEAD_BYTES, STATUS, EDGES = 16, 2, slice(8, 12)


@pytest.fixture(scope="module")
def reader(require_tool: Callable[[str], str], tmp_path_factory: pytest.TempPathFactory) -> Path:
    elf = tmp_path_factory.mktemp("pins") / "data_ready.elf"
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


def polled(part: RegisterDevice, control: int, value: int) -> list[bytes]:
    """Read each sample of 0.075 to 1.32 s as soon as it is there, without firmware."""
    part.start(False, 0.06)
    part.write(control, 0.06)
    part.write(value, 0.06)
    part.stop(0.06)
    samples = []
    for tick in range(15, 265):
        time_s = tick / 200.0 + 1e-6
        part.start(False, time_s)
        part.write(0x01, time_s)
        part.start(True, time_s)
        samples.append(bytes(part.read(time_s) for _ in range(SAMPLE_BYTES)))
        part.stop(time_s)
    return samples


def test_every_sample_raises_its_pin_and_is_read_once(reader: Path) -> None:
    rig = load_rig(RIG)
    board = VirtualBench(rig, firmware=reader).machine
    symbols, memory = board.image.symbols, board.processor.memory
    board.run_until(3.0, wake=lambda: any(memory.read(symbols["finished"].address, 4)))
    assert any(memory.read(symbols["finished"].address, 4))
    size = symbols["parts"].size // 2
    _, accelerometer, gyroscope = build_sensors(rig, build_world(rig), rig.seed)["i2c1"]
    expectations = (polled(gyroscope, 0x13, 0x0A), polled(accelerometer, 0x2A, 0x11))
    for index, expected in enumerate(expectations):
        part = memory.read(symbols["parts"].address + index * size, size)
        assert part[STATUS] == 0, "I2C status"
        assert int.from_bytes(part[EDGES], "little") == SAMPLES
        taken = [part[at : at + SAMPLE_BYTES] for at in range(HEAD_BYTES, HEAD_BYTES + 6 * SAMPLES, SAMPLE_BYTES)]
        first = expected.index(taken[0])
        assert taken == expected[first : first + SAMPLES]
