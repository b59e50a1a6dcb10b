"""Quantities from variables of a running board: whole, in their units, and without a trace in the firmware."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hiltest.boards import VirtualBench
from hiltest.boards.memory_reading import BoardWire
from hiltest.errors import BoardFault, ConfigError
from hiltest.interfaces.gdb_client import GdbClient
from hiltest.interfaces.memory_interface import MemoryInterface, read_description, read_descriptions
from hiltest.interfaces.memory_ranges import ReadAhead, together
from hiltest.interfaces.quantities import PolledInterface, Quantity
from hiltest.interfaces.variables import Variables
from hiltest.rig.bench_files import rig_file
from hiltest.rig.memory_device import MemoryValue
from hiltest.rig.rig_file import load_rig
from hiltest.virtual.board.k64f import VirtualK64F
from hiltest.virtual.program.elf import FirmwareImage, load_image

from ..foreign_elf import foreign_elf
from .compiled import compile_c
from .test_gdb_client import SOURCE

HARD_IRON = {"hard_iron": MemoryValue("calibration.hard_iron", unit="uT")}
ALL = HARD_IRON | {
    "heading": MemoryValue("heading_rad", unit="rad"),
    "magnetometer": MemoryValue("field_nt", unit="nT"),
    "accelerometer": MemoryValue(("acceleration_mg[0]", "acceleration_mg[1]", "acceleration_mg[2]"), unit="mg"),
    "calibrated": MemoryValue("is_calibrated"),
    "gyroscope_bias": MemoryValue("newest->hard_iron", unit="rad/s", scale=0.5),
}
HERE = Path(__file__).parent
POLL_S = 0.0007  # at another point of the program's round each time


@pytest.fixture(scope="module")
def image(tmp_path_factory: pytest.TempPathFactory, require_tool: Callable[[str], str]) -> FirmwareImage:
    folder = tmp_path_factory.mktemp("read")
    return load_image(compile_c(require_tool("arm-none-eabi-gcc"), folder, SOURCE))


@pytest.fixture
def machine(image: FirmwareImage) -> Iterator[VirtualK64F]:
    result = VirtualK64F(image)
    result.boot()
    yield result
    assert not result.debugged


def opened(
    machine: VirtualK64F, values: dict[str, MemoryValue], at_return_of: str | None = None, call_within_s: float = 1.0
) -> MemoryInterface:
    readings = read_descriptions(values, Variables(machine.image), lambda name: name)
    entry = machine.image.symbols[at_return_of].address if at_return_of else None
    return MemoryInterface(GdbClient(BoardWire(machine)), readings, at_return_of=entry, call_within_s=call_within_s)


def test_each_quantity_is_read_in_its_own_unit(machine: VirtualK64F) -> None:
    machine.run_until(0.2)
    interface: PolledInterface = opened(machine, ALL, "update_calibration")
    assert interface.offers == {Quantity.named(name) for name in ALL}
    observation = interface.read(machine.time_s)
    values = {item.key: numbers.tolist() for item, numbers in observation.values.items()}
    solution = values["hard_iron"][0]
    assert values.pop("gyroscope_bias") == pytest.approx([0.5 * solution * 180 / np.pi] * 3, rel=1e-12)
    assert values.pop("heading")[0] == pytest.approx(0.18 / np.pi * (solution - 1), rel=1e-4)  # a sum of float32
    # 0.4 g in float64: a number of thousandths has no exact one.
    assert values.pop("accelerometer") == pytest.approx([0.003, -0.004, 1.0], rel=1e-15)
    assert values == {"hard_iron": [solution] * 3, "magnetometer": [20, -1, 43], "calibrated": [1]}
    assert solution > 20
    assert observation.time_s == machine.time_s
    assert interface.read(5.0).time_s > 5.0


def test_at_the_return_of_a_function_what_it_writes_is_whole(machine: VirtualK64F) -> None:
    interface = opened(machine, HARD_IRON, "update_calibration")
    read = []
    for count in range(1, 30):
        machine.run_until(count * POLL_S)
        (numbers,) = interface.read(machine.time_s).values.values()
        assert len(set(numbers)) == 1
        read.append(numbers[0])
    assert sorted(set(read)) == read
    assert (interface.moving, interface.not_called, interface.reads) == ({}, 0, 29)
    assert interface.remarks() == ()


def test_a_single_halt_would_have_read_it_half_written(machine: VirtualK64F) -> None:
    place = Variables(machine.image).place("calibration.hard_iron")
    torn = 0
    for count in range(1, 30):
        machine.run_until(count * POLL_S)
        torn += len(set(place.numbers(place.read(machine.processor.memory.read)))) > 1
    assert torn > 5


SLOW_UPDATE = """
#include <stdint.h>
volatile float hard_iron[3], heading;
static void wait(uint32_t count) { for (volatile uint32_t k = 0; k < count; k++); }
int main(void)
{
    (*(volatile uint32_t *)0xE000ED88) |= 0xFu << 20;
    __asm volatile("dsb\\n isb");
    for (uint32_t round = 0;; round++) {
        if (round % 40 == 0)
            for (int axis = 0; axis < 3; axis++) {
                hard_iron[axis] += 1;
                wait(800);
                heading += 1;
            }
        wait(1000);
        heading += 1;
    }
}
"""


def test_without_a_function_it_is_read_until_it_stands_still_but_for_what_never_does(
    tmp_path: Path, require_tool: Callable[[str], str]
) -> None:
    machine = VirtualK64F(compile_c(require_tool("arm-none-eabi-gcc"), tmp_path, SLOW_UPDATE))
    machine.boot()
    place = Variables(machine.image).place("hard_iron")
    interface = opened(
        machine, {"hard_iron": MemoryValue("hard_iron", unit="uT"), "heading": MemoryValue("heading", unit="deg")}
    )
    torn, headings = 0, []
    for count in range(1, 80):
        machine.run_until(machine.time_s + 0.0011)
        torn += len(set(place.numbers(place.read(machine.processor.memory.read)))) > 1
        values = interface.read(machine.time_s).values
        assert len(set(values[Quantity.HARD_IRON])) == 1
        headings.append(values[Quantity.HEADING][0])
        assert interface.reads == count
    assert torn > 2
    assert headings == sorted(set(headings))
    assert interface.moving == {Quantity.HEADING: interface.reads}
    (remark,) = interface.remarks()
    assert remark.startswith("heading changed during 79 of 79 readings")


def test_a_function_that_is_not_called_in_time_is_counted_and_the_values_are_read_all_the_same(
    machine: VirtualK64F,
) -> None:
    interface = opened(machine, {"magnetometer": ALL["magnetometer"]}, "never_called", call_within_s=0.01)
    for _ in range(2):
        assert interface.read(0.0).values[Quantity.MAGNETOMETER].tolist() == [20, -1, 43]
    assert (interface.not_called, interface.moving) == (2, {})
    (remark,) = interface.remarks()
    assert remark.startswith("in 2 of 2 readings the function of at_return_of was not called within 0.01 s")


def test_a_pointer_that_is_not_set_yet_leaves_its_quantity_out_and_says_why(machine: VirtualK64F) -> None:
    interface = opened(machine, {name: ALL[name] for name in ("magnetometer", "gyroscope_bias")})
    machine.run_until(1e-6)
    assert set(interface.read(0.0).values) == {Quantity.MAGNETOMETER}
    assert re.fullmatch(r"newest->hard_iron: the pointer at 0x2\w+ is 0 now", interface.absent[Quantity.GYROSCOPE_BIAS])
    assert interface.remarks()[0].startswith("gyroscope_bias has no value: newest->hard_iron: the pointer at")
    pointer = machine.image.symbols["newest"].address
    machine.processor.memory.write(pointer, (0xF0000000).to_bytes(4, "little"))
    assert set(interface.read(0.0).values) == {Quantity.MAGNETOMETER}
    assert "a pointer is invalid: refuses to read 12 bytes" in interface.absent[Quantity.GYROSCOPE_BIAS]
    machine.run_until(0.2)
    assert set(interface.read(0.0).values) == interface.offers
    assert interface.absent == {}


class CountingWire(BoardWire):
    """Counts the packets that ask for memory."""

    asked = 0

    def send(self, data: bytes) -> None:
        self.asked += data.startswith(b"$m")
        super().send(data)


def test_what_lies_together_is_asked_for_at_once(machine: VirtualK64F) -> None:
    wire = CountingWire(machine)
    values = {name: ALL[name] for name in ALL if name != "gyroscope_bias"}
    readings = read_descriptions(values, Variables(machine.image), lambda name: name)
    interface = MemoryInterface(GdbClient(wire), readings, at_return_of=machine.image.symbols["depth"].address)
    interface.read(0.0)
    assert wire.asked <= 2  # seven variables: those with a value at first lie apart from those without


@given(st.lists(st.tuples(st.integers(0, 4000), st.integers(1, 300)), max_size=12))
def test_ranges_that_are_read_together_have_every_byte_that_is_wanted(ranges: list[tuple[int, int]]) -> None:
    def memory(address: int, size: int) -> bytes:
        return bytes(index % 251 for index in range(address, address + size))

    ahead = ReadAhead(memory, together(ranges))
    for address, size in [*ranges, (5000, 3)]:
        assert ahead(address, size) == memory(address, size)


def state(machine: VirtualK64F) -> tuple[object, ...]:
    return machine.cycles, machine.instructions, machine.time_s, bytes(machine.processor.memory.sram.view)


@pytest.mark.parametrize("at_return_of", [None, "update_calibration", "depth", "never_called"])
def test_the_firmware_does_not_notice_that_it_is_read(
    machine: VirtualK64F, image: FirmwareImage, at_return_of: str | None
) -> None:
    interface = opened(machine, ALL, at_return_of, call_within_s=0.01)
    for count in range(12):
        interface.read(machine.time_s)
        machine.run_until(machine.time_s + POLL_S)
        if count == 6:
            interface.close()
            interface = opened(machine, ALL, at_return_of, call_within_s=0.01)
    end_s = machine.time_s + 0.01
    machine.run_until(end_s)
    alone = VirtualK64F(image)
    alone.run_until(end_s)
    assert state(machine) == state(alone)
    assert alone.instructions > 100_000


def test_virtual_time_stands_still_while_memory_is_read(machine: VirtualK64F) -> None:
    machine.run_until(0.005)
    client = GdbClient(BoardWire(machine))
    before = state(machine)
    client.read(0x20000000, 5000)
    client.registers()
    assert state(machine) == before
    client.close()
    machine.run_until(0.006)
    assert state(machine) != before


def read_often(interface: MemoryInterface) -> None:
    for _ in range(100):
        interface.read(0.0)


def test_a_fault_of_the_firmware_is_the_firmwares_and_leaves_nobody_waiting(machine: VirtualK64F) -> None:
    for at_return_of in ("never_called", None):
        machine.reset()
        interface = opened(machine, HARD_IRON, at_return_of)
        interface.read(machine.time_s)
        rounds = int.from_bytes(machine.processor.memory.read(machine.image.symbols["rounds"].address, 4), "little")
        machine.processor.memory.write(machine.image.symbols["faults_at"].address, (rounds + 8).to_bytes(4, "little"))
        with pytest.raises(BoardFault, match="0xf0000000"):
            read_often(interface)
        interface.close()


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("hard_iron", MemoryValue("calibration.hard_iron"), "unit is missing; write the firmware's own, one of uT, nT"),
        (
            "hard_iron",
            MemoryValue("calibration.hard_iron", unit="deg"),
            "unit 'deg' is no unit of hard_iron; write one of",
        ),
        ("calibrated", MemoryValue("is_calibrated", unit="uT"), "unit 'uT' is no unit of calibrated; write one of: 1"),
        (
            "hard_iron",
            MemoryValue("heading_rad", unit="uT"),
            "hard_iron is 3 numbers, and these are 1 (heading_rad is volatile float)",
        ),
        ("heading", MemoryValue(("heading_rad", "heading_rad"), unit="rad"), "heading is 1 numbers, and these are 2"),
        ("heading", MemoryValue("heading_deg", unit="deg"), "no variable heading_deg; nearest: heading_rad"),
    ],
)
def test_a_value_that_is_no_such_quantity_is_refused(
    image: FirmwareImage, name: str, value: MemoryValue, reason: str
) -> None:
    with pytest.raises(ConfigError, match=re.escape(reason)):
        read_description(Quantity.named(name), value, Variables(image))


def test_a_quantity_that_there_is_not_is_refused_with_its_place(image: FirmwareImage) -> None:
    with pytest.raises(ConfigError, match=r"^rig\.toml:7 hard_iorn: no quantity 'hard_iorn'; nearest: hard"):
        read_descriptions({"hard_iorn": HARD_IRON["hard_iron"]}, Variables(image), lambda name: f"rig.toml:7 {name}")


NXP_VALUES = {
    "heading": MemoryValue("sfg.SV_9DOF_GBY_KALMAN.fRhoPl", unit="deg"),
    "quaternion": MemoryValue("sfg.SV_9DOF_GBY_KALMAN.fqPl"),
    "magnetometer_calibrated": MemoryValue("sfg.Mag.fBc", unit="uT"),
    "inverse_soft_iron": MemoryValue("sfg.MagCal.finvW"),
    "calibrated": MemoryValue("sfg.MagCal.iValidMagCal"),
}


@pytest.mark.slow
@pytest.mark.parametrize("at_return_of", [None, "fRun_9DOF_GBY_KALMAN"])
def test_nxps_sensor_fusion_is_read_by_its_names_and_sends_what_it_sends_alone(at_return_of: str | None) -> None:
    rig, firmware = load_rig(rig_file(HERE, None)), foreign_elf("nxp_sensor_fusion.elf")
    read, alone = (VirtualBench(rig, firmware=firmware, seed=1).machine for _ in range(2))
    interface = opened(read, NXP_VALUES, at_return_of)
    while read.time_s < 0.8:
        values = interface.read(read.time_s).values
        read.run_until(read.time_s + 0.02)
    assert (interface.not_called, interface.moving) == (0, {})
    # A unit quaternion in float32, and the rotation about the vertical that the heading is; not yet calibrated.
    assert np.linalg.norm(values[Quantity.QUATERNION]) == pytest.approx(1.0, abs=1e-6)
    assert values[Quantity.INVERSE_SOFT_IRON].reshape(3, 3).tolist() == np.eye(3).tolist()
    assert values[Quantity.CALIBRATED] == 0
    assert 30 < np.linalg.norm(values[Quantity.MAGNETOMETER_CALIBRATED]) < 120
    for machine in (read, alone):
        machine.run_until(1.0)
    assert state(read) == state(alone)
    sent = alone.uart0.host_read(alone.uart0.host_waiting)
    assert len(sent) > 1000
    assert read.uart0.host_read(read.uart0.host_waiting) == sent
