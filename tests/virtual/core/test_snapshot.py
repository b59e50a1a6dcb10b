"""A machine goes on from a snapshot as it went on when the snapshot was taken, whatever ran in between."""

from __future__ import annotations

import random
import resource
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hiltest.errors import ConfigError
from hiltest.virtual.core.library import ffi, lib
from hiltest.virtual.core.machine import NEVER, Machine
from hiltest.virtual.model.profile_file import load_profile

FLASH, FLASH_BYTES = 0x00000000, 0x40000
RAM, RAM_BYTES = 0x20000000, 0x21000
CODE, CODE_BYTES = RAM + 0x4000, 0x1000  # where stores of the code itself reach it
PAGE = 4096
DEVICE = 0x40000000
PROFILE = load_profile("cortex-m4-trm/3")
# What a program may see of the core.
FIELDS = (
    "cycles",
    "instructions",
    "device_loads",
    "other_stack",
    "control",
    "primask",
    "faultmask",
    "basepri",
    "negative",
    "zero",
    "carry",
    "overflow",
    "saturated",
    "ge",
    "it_state",
    "thumb",
    "fpscr",
    "event",
    "fpu_enabled",
    "lazy_frame",
)


class Program:
    """A machine that executes random halfwords in RAM, whose registers point to them, to data and to a device.

    Parameters
    ----------
    seed : int
        Of the code.
    """

    def __init__(self, seed: int = 1, machine: Machine | None = None) -> None:
        self.machine = machine or Machine(PROFILE)
        if machine is None:
            self.machine.add_memory(FLASH, FLASH_BYTES, writable=False)
            self.machine.add_memory(RAM, RAM_BYTES, writable=True)
        self.machine.connect(lambda address, _size: address * 37 + self.core.cycles, lambda *_: None, self.raise_again)
        self.core: Any = self.machine.core
        self.core.fpu_enabled = True
        self.write(CODE, random.Random(seed).randbytes(CODE_BYTES))
        self.place(CODE)

    def raise_again(self, error: BaseException) -> None:
        raise error

    def write(self, address: int, data: bytes) -> None:
        assert lib.machine_write(self.machine.handle, address, len(data), ffi.from_buffer(data))

    def read(self, address: int, size: int) -> bytes:
        data = ffi.new("uint8_t[]", size)
        assert lib.machine_read(self.machine.handle, address, size, data)
        return bytes(data)

    def place(self, address: int) -> None:
        """Go on at an address, with pointers in most registers."""
        core = self.core
        core.r[15], core.thumb, core.it_state = address, 1, 0
        core.sleeping = core.faultmask = core.primask = 0
        for number in range(13):
            core.r[number] = (CODE, RAM + 0x8000, DEVICE, RAM + 0x10000)[number % 4] + 64 * number
        core.r[13] = RAM + 0x20000

    def run(self, instructions: int) -> None:
        """Execute so many instructions; behind one that faults, loops, sleeps or leaves the code go on elsewhere."""
        core = self.core
        end = core.instructions + instructions
        for _ in range(20 * instructions + 1):
            if core.instructions >= end:
                return
            core.deadline, core.instruction_limit = NEVER, end
            before = core.r[15]
            if lib.machine_run(self.machine.handle) != lib.STOP_STEP:
                core.instructions += 1
                self.place(CODE + (before + 34) % CODE_BYTES)
        raise AssertionError("the program stands still")

    def state(self) -> tuple[Any, ...]:
        """Return everything that a program may see."""
        values = tuple(getattr(self.core, field) for field in FIELDS)
        return values, tuple(self.core.r), tuple(self.core.s), self.read(RAM, RAM_BYTES), self.read(FLASH, FLASH_BYTES)


@given(seed=st.integers(0, 10**6), lengths=st.tuples(*[st.integers(0, 300)] * 3))
@settings(max_examples=30)
def test_a_machine_goes_on_from_a_snapshot_as_it_did_before(seed: int, lengths: tuple[int, int, int]) -> None:
    program = Program(seed)
    before, behind, elsewhere = lengths
    program.run(before)
    snapshot, begin = program.machine.snapshot(), program.state()
    program.run(behind)
    end = program.state()
    program.write(CODE, b"\x00\xbf" * (CODE_BYTES // 2))
    program.run(elsewhere)
    program.machine.restore(snapshot)
    assert program.state() == begin
    program.run(behind)
    assert program.state() == end


@given(seed=st.integers(0, 10**6), steps=st.lists(st.integers(0, 60), min_size=2, max_size=8), data=st.data())
@settings(max_examples=20)
def test_any_of_several_snapshots_is_what_was_there(seed: int, steps: list[int], data: st.DataObject) -> None:
    program = Program(seed)
    selection = []
    for step in steps:
        program.run(step)
        selection.append((program.machine.snapshot(), program.state()))
    for _ in range(6):
        snapshot, state = data.draw(st.sampled_from(selection))
        program.machine.restore(snapshot)
        assert program.state() == state
        program.run(data.draw(st.integers(0, 60)))


@pytest.mark.parametrize("seed", range(10))
def test_another_machine_goes_on_from_a_snapshot_too(seed: int) -> None:
    program = Program(seed)
    other = Program(seed + 1)
    other.run(100)
    for _ in range(5):
        program.run(100)
        other.machine.restore(program.machine.snapshot())
        program.run(50)
        other.run(50)
        assert other.state() == program.state()


def test_a_snapshot_outlives_its_machine() -> None:
    program = Program()
    program.run(50)
    snapshot, state = program.machine.snapshot(), program.state()
    del program
    other = Program(2)
    other.machine.restore(snapshot)
    assert other.state() == state


def test_flash_that_was_programmed_is_restored() -> None:
    program = Program()
    program.write(FLASH + 0x8000, b"before")
    snapshot = program.machine.snapshot()
    program.write(FLASH + 0x8000, b"behind")
    program.machine.restore(snapshot)
    assert program.read(FLASH + 0x8000, 6) == b"before"


def test_code_that_a_snapshot_changes_is_executed_as_it_is_then() -> None:
    program = Program()
    add, subtract = b"\x01\x30\xfe\xe7", b"\x01\x38\xfe\xe7"  # adds r0, #1 or subs r0, #1; b .
    results = []
    program.write(CODE, subtract)
    snapshot = program.machine.snapshot()
    for code in (add, None, add):
        program.write(CODE, code) if code else program.machine.restore(snapshot)
        program.place(CODE)
        program.core.r[0] = 10
        assert lib.machine_run(program.machine.handle) == lib.STOP_LOOP
        results.append(program.core.r[0])
    assert results == [11, 9, 11]


def test_other_memories_are_refused() -> None:
    other = Machine(PROFILE)
    other.add_memory(RAM, RAM_BYTES, writable=True)
    with pytest.raises(ConfigError, match="other memories"):
        other.restore(Program().machine.snapshot())


def test_a_snapshot_inside_an_access_stands_before_the_instruction() -> None:
    program = Program()
    # ldr r1, [r0, #4]: the pipeline is loading; ldr r2, [r3]; adds r2, r2, #1; b .
    program.write(CODE, bytes.fromhex("4168 1a68 5218 fee7"))
    selection: list[Any] = []

    def read(address: int, _size: int) -> int:
        if address == DEVICE and not selection:
            selection.append(program.machine.snapshot())
            with pytest.raises(ConfigError, match="is executing an instruction"):
                program.machine.restore(selection[0])
        return 7

    program.machine.connect(read, lambda *_: None, program.raise_again)
    program.place(CODE)
    program.core.r[0], program.core.r[3] = RAM, DEVICE
    assert lib.machine_run(program.machine.handle) == lib.STOP_LOOP
    end = program.state()
    program.machine.restore(selection[0])
    assert program.core.r[15] == CODE + 2
    assert lib.machine_run(program.machine.handle) == lib.STOP_LOOP
    assert program.state() == end


def resident_bytes() -> int:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize()


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="needs Linux")
def test_snapshots_share_the_pages_that_are_alike() -> None:
    program = Program()
    program.write(FLASH, bytes(range(256)) * (FLASH_BYTES // 256))
    snapshot = [program.machine.snapshot()]
    before = resident_bytes()
    for number in range(400):
        program.write(RAM + number % 3 * PAGE, bytes([number % 256]))
        snapshot.append(program.machine.snapshot())
    assert resident_bytes() - before < 400 * 4 * PAGE
    program.machine.restore(snapshot[100])
    assert program.read(RAM + PAGE, 1) == bytes([97])
