"""Memory of a board, by what a rig names: of a virtual one without a server, of any other through its server."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from hiltest.boards import open_board
from hiltest.boards.memory_reading import memory_kind, open_memory
from hiltest.errors import ConfigError, DebugServerError, VersionMismatchError
from hiltest.interfaces.memory_interface import MemoryInterface
from hiltest.interfaces.quantities import Quantity
from hiltest.rig import Rig
from hiltest.rig.bench_files import rig_file
from hiltest.rig.memory_device import MemoryDevice, MemoryValue
from hiltest.rig.rig_file import load_rig
from hiltest.virtual.board.k64f import VirtualK64F
from hiltest.virtual.program.elf import FirmwareImage, load_image

from ..foreign_elf import foreign_elf
from ..interfaces.compiled import compile_c
from ..interfaces.test_gdb_client import SOURCE, WALL_LIMIT_S, own_server, qemu_server

VALUES = {
    "hard_iron": MemoryValue("calibration.hard_iron", unit="uT"),
    "heading": MemoryValue("heading_rad", unit="rad"),
}
LINES = {"device.memory.values.hard_iron": 41, "device.memory.at_return_of": 42, "device.memory.server": 43}


@pytest.fixture(scope="module")
def elf(tmp_path_factory: pytest.TempPathFactory, require_tool: Callable[[str], str]) -> Path:
    return compile_c(require_tool("arm-none-eabi-gcc"), tmp_path_factory.mktemp("moving"), SOURCE)


@pytest.fixture(scope="module")
def image(elf: Path) -> FirmwareImage:
    return load_image(elf)


@pytest.fixture(scope="module")
def rig() -> Rig:
    rig = load_rig(rig_file(Path(__file__).parent, None))
    return replace(rig, lines=LINES, path=Path("mine.toml"))


def test_a_virtual_board_is_read_without_a_server(rig: Rig, image: FirmwareImage) -> None:
    machine = VirtualK64F(image)
    memory = open_memory(rig, MemoryDevice(values=VALUES, at_return_of="update_calibration"), image, machine)
    for solution in (1, 2, 3):
        values = memory.read(machine.time_s).values
        assert values[Quantity.HARD_IRON].tolist() == [solution] * 3
    memory.close()
    machine.run_until(machine.time_s + 0.1)
    assert int.from_bytes(machine.processor.memory.read(image.symbols["rounds"].address, 4), "little") > 40


@pytest.mark.parametrize("server", ["own", pytest.param("qemu", marks=pytest.mark.slow)])
@pytest.mark.parametrize("at_return_of", ["update_calibration", None])
def test_any_other_board_is_read_through_its_server(
    rig: Rig,
    elf: Path,
    image: FirmwareImage,
    server: str,
    at_return_of: str | None,
    require_tool: Callable[[str], str],
) -> None:
    served = own_server(elf) if server == "own" else qemu_server(elf, require_tool("qemu-system-arm"))
    with served as port:
        device = MemoryDevice(values=VALUES, server=f"localhost:{port}", at_return_of=at_return_of)
        memory = opened_soon(rig, device, image)
        read = [memory.read(index) for index in range(5)]
        memory.close()
    assert all(after.time_s >= before for before, after in enumerate(read))
    solutions = [values.values[Quantity.HARD_IRON].tolist() for values in read]
    assert solutions == sorted(solutions)
    if at_return_of:
        assert all(len(set(solution)) == 1 for solution in solutions)
        assert len({solution[0] for solution in solutions}) == 5


def test_variables_of_another_build_than_the_boards_are_not_read(
    rig: Rig, elf: Path, tmp_path: Path, require_tool: Callable[[str], str]
) -> None:
    other = compile_c(require_tool("arm-none-eabi-gcc"), tmp_path, SOURCE.replace("0.001f", "0.002f"))
    with own_server(elf) as port:
        device = MemoryDevice(values=VALUES, server=f"localhost:{port}")
        with pytest.raises(
            VersionMismatchError, match=r"is not the program on the board of .*: at 0x0000\w+ it has 0x"
        ):
            opened_soon(rig, device, load_image(other))
        memory = opened_soon(rig, device, load_image(elf))
        assert memory.read(0.0).values.keys() == memory.offers
        memory.close()


def opened_soon(rig: Rig, device: MemoryDevice, image: FirmwareImage) -> MemoryInterface:
    """Connect, as soon as something listens."""
    deadline_s = time.monotonic() + WALL_LIMIT_S
    while True:
        try:
            return open_memory(rig, device, image, None)
        except DebugServerError:
            assert time.monotonic() < deadline_s
            time.sleep(0.05)


@pytest.mark.parametrize(
    ("device", "reason"),
    [
        (
            MemoryDevice(values={"hard_iron": MemoryValue("calibration.hard_irn", unit="uT")}),
            r"^mine\.toml:41: device\.memory\.values\.hard_iron: .*nearest: hard_iron",
        ),
        (
            MemoryDevice(values=VALUES, at_return_of="update"),
            r"^mine\.toml:42: device\.memory\.at_return_of: .*no function update",
        ),
        (
            MemoryDevice(values=VALUES, server="localhost:3333"),
            r"^mine\.toml:43: device\.memory\.server: a virtual board needs no server; leave it out",
        ),
    ],
)
def test_a_mistake_is_refused_with_its_place_in_the_rig(
    rig: Rig, image: FirmwareImage, device: MemoryDevice, reason: str
) -> None:
    with pytest.raises(ConfigError, match=reason):
        open_memory(rig, device, image, VirtualK64F(image))


def test_a_real_board_needs_a_server(rig: Rig, image: FirmwareImage) -> None:
    with pytest.raises(ConfigError, match=r"^mine\.toml:43: device\.memory\.server is missing: name the GDB server"):
        open_memory(rig, MemoryDevice(values=VALUES), image, None)


MEMORY = """
[device.memory]
at_return_of = "fRun_9DOF_GBY_KALMAN"
[device.memory.values]
hard_iron = { path = "sfg.MagCal.fV", unit = "uT" }
heading = { path = "sfg.SV_9DOF_GBY_KALMAN.fRhoPl", unit = "deg" }
gyroscope_bias = { path = "sfg.SV_9DOF_GBY_KALMAN.fbPl", unit = "deg/s" }
"""


@pytest.fixture
def both_kinds(tmp_path: Path) -> Callable[[str], Path]:
    """Return a function that writes the rig of NXP's fusion with its packets, and with a table for its memory."""

    def write(memory: str) -> Path:
        shipped = rig_file(Path(__file__).parent, "nxp-fusion-agm01").read_text(encoding="utf-8")
        begin, end = shipped.index("[device.sources]"), shipped.index("[field]")
        sources = '[device.sources]\nheading = "memory"\n\n'
        path = tmp_path / "mine.toml"
        path.write_text(shipped[:begin] + sources + shipped[end:] + memory, encoding="utf-8")
        return path

    return write


@pytest.mark.slow
def test_a_rig_takes_one_quantity_from_packets_and_another_from_memory(both_kinds: Callable[[str], Path]) -> None:
    rig = load_rig(both_kinds(MEMORY))
    with open_board(rig, firmware=foreign_elf("nxp_sensor_fusion.elf"), seed=1) as board:
        assert {Quantity.HEADING, Quantity.HARD_IRON, Quantity.GYROSCOPE_BIAS, Quantity.QUATERNION} <= board.offers
        answer = board.output.observe(1.0)
    read = [answer_part for answer_part in answer if Quantity.HEADING in answer_part.values]
    assert 5 <= len(read) <= 10  # one in 0.1 s, and what the function takes to be called
    # The first of the kinds that offer a quantity gives it, unless the rig says another.
    assert all(item.values.keys() == {Quantity.HEADING} for item in read)
    packets = [answer_part for answer_part in answer if Quantity.QUATERNION in answer_part.values]
    assert len(packets) >= 30
    assert not any(Quantity.HEADING in packet.values for packet in packets)


@pytest.mark.parametrize(
    ("memory", "reason"),
    [
        ("", r'device\.kind: "memory" needs a table \[device\.memory\] that says its variables'),
        (MEMORY.replace("unit", "units"), r"mine\.toml:\d+: unknown key 'units'; did you mean 'unit'"),
        (
            MEMORY.replace("at_return_of", "server"),
            r"mine\.toml:\d+: device\.memory\.server: is host:port of a GDB server",
        ),
        (
            MEMORY.replace("[device.memory.values]", "[device.memory.value]"),
            r"unknown key 'value'; did you mean 'values'",
        ),
        (MEMORY.replace('"uT"', '"uT", scale = 0'), r"mine\.toml:\d+: device\.memory\.values\.hard_iron\.scale: must"),
        (MEMORY.replace('"sfg.MagCal.fV"', "5"), r"mine\.toml:\d+: device\.memory\.values\.hard_iron\.path: .*, not 5"),
    ],
)
def test_a_wrong_table_is_refused_with_its_line(both_kinds: Callable[[str], Path], memory: str, reason: str) -> None:
    with pytest.raises(ConfigError, match=reason):
        load_rig(both_kinds(memory))


def test_a_real_board_needs_the_elf_whose_variables_are_read(both_kinds: Callable[[str], Path]) -> None:
    rig = load_rig(both_kinds(MEMORY))
    with pytest.raises(ConfigError, match=r"mine\.toml:\d+: device\.kind: memory needs the ELF .* name it with --fir"):
        memory_kind(None, None)(rig)


def test_a_real_board_is_understood_by_its_variables_alone(tmp_path: Path, elf: Path) -> None:
    shipped = rig_file(Path(__file__).parent, "frdm-k64f").read_text(encoding="utf-8")
    with own_server(elf) as port:
        path = tmp_path / "mine.toml"
        path.write_text(
            f"""{shipped}
[device]
kind = "memory"
start_s = 0.1
[device.memory]
server = "localhost:{port}"
at_return_of = "update_calibration"
[device.memory.values]
heading = {{ path = "heading_rad", unit = "rad" }}
hard_iron = {{ path = "calibration.hard_iron", unit = "uT" }}
""",
            encoding="utf-8",
        )
        with open_board(load_rig(path), firmware=elf, port="loop://") as board:
            assert board.offers == {Quantity.HEADING, Quantity.HARD_IRON}
            hard_iron = board.output.latest[Quantity.HARD_IRON]
            assert len(set(hard_iron)) == 1
            assert hard_iron[0] >= 1
