"""Exceptions of the core in C do what a model of them does, step by step.

Both begin in the same random state and take the same random steps: requests, priorities, masks, entries, returns by
right and wrong values, faults. After each one everything that software could see is compared, and the cycles.
"""

from __future__ import annotations

import random
from typing import Any

import pytest

from .exception_model import (
    ASPEN,
    BUS_FAULT,
    FIRST_INTERRUPT,
    FPCA,
    IDLE,
    KINDS,
    LSPEN,
    MEM_MANAGE,
    SPSEL,
    THUMB,
    USAGE_FAULT,
    Fault,
    Lockup,
    Memories,
    Model,
)
from .exceptions_in_c import FLASH_BYTES, PRICES, RAM, RAM_BYTES, RAM_END, Machine, exception_library

STEPS = 80
VECTORS, RAM_VECTORS = 0, 0x20000000
EXCEPTIONS = [2, 4, 5, 6, 11, 12, 14, 15, 16, 17, 20, 31, 32, 47, 48, 63, 64, 101]  # they reach over several words
RETURNS = [0xFFFFFFE1, 0xFFFFFFE9, 0xFFFFFFED, 0xFFFFFFF1, 0xFFFFFFF9, 0xFFFFFFFD]
NO_RETURNS = [0xFFFFFFF0, 0xFFFFFFF5, 0xFFFFFFE5, 0xFFFFFFFF, 0xFFFFFF01, 0xF0000001, 0xFFFFFFFC, 0xFFFFFFE8]
STACKS = [RAM + 0x2000, RAM + 0x1FF4, RAM + 0x3004, RAM_END, RAM_END - 4]
NO_STACKS = [0x8000, RAM, RAM + 20, RAM + 100, 0x40001000, 0xFFFFFFF0, 0, RAM_END - 12]
TABLES = [VECTORS, VECTORS, VECTORS, RAM_VECTORS, FLASH_BYTES, RAM_END - 16, 0x40000000, 0xFFFFFF80]
PROFILES = [
    PRICES,
    {"exception_entry": 12, "exception_return": 12},
    {"exception_entry": 100, "exception_return": 20, "tail_chain": 0, "fp_frame": 7},
]


def state_of_model(model: Model) -> dict[str, Any]:
    """Return everything that is compared."""
    registers, nvic, ceiling = model.registers, model.nvic, model.ceiling
    return {
        "r": registers.general,
        "lr": registers.link,
        "pc": registers.pc,
        "xpsr": registers.xpsr,
        "msp": registers.main_stack,
        "psp": registers.process_stack,
        "control": registers.control,
        "masks": [registers.primask, registers.faultmask, registers.basepri],
        "floats": registers.floats,
        "fpscr": registers.fpscr,
        "lazy": model.lazy_frame,
        "chained": model.is_chained,
        "saved": model.is_chained and model.is_saved,
        "cycles": model.cycles,
        "pending": nvic.pending,
        "enabled": nvic.enabled,
        "lines": nvic.lines,
        "active": nvic.active,
        "taken": nvic.taken,
        "new": nvic.newly_pending,
        "cfsr": model.cfsr,
        "hfsr": model.hfsr,
        "bfar": model.bfar,
        "ceiling": ceiling,
        "asleep": nvic.ceiling(registers, without_primask=True),
        "urgent": nvic.most_urgent(),
        "next": nvic.next_exception(ceiling),
        "priority": nvic.execution_priority(ceiling),
        "event": model.event,
        "ram": model.memories.read(RAM, RAM_BYTES),
    }


def state_in_c(machine: Machine) -> dict[str, Any]:
    """Return the same of the core in C."""
    core, call = machine.core, machine.call
    ceiling = call("machine_ceiling", False)
    return {
        "r": list(core.r[0:13]),
        "lr": core.r[14],
        "pc": core.r[15],
        "xpsr": call("machine_xpsr"),
        "msp": call("machine_stack_pointer", False),
        "psp": call("machine_stack_pointer", True),
        "control": core.control,
        "masks": [core.primask, core.faultmask, core.basepri],
        "floats": list(core.s),
        "fpscr": core.fpscr,
        "lazy": core.lazy_frame,
        "chained": core.is_chained,
        "saved": core.is_chained and core.is_saved,
        "cycles": core.cycles,
        "pending": machine.members("pending"),
        "enabled": machine.members("enabled"),
        "lines": machine.members("lines"),
        "active": machine.active,
        "taken": machine.members("taken"),
        "new": core.newly_pending,
        "cfsr": core.cfsr,
        "hfsr": core.hfsr,
        "bfar": core.bfar,
        "ceiling": ceiling,
        "asleep": call("machine_ceiling", True),
        "urgent": call("machine_most_urgent", IDLE),
        "next": call("machine_next_exception", ceiling),
        "priority": call("machine_execution_priority", ceiling),
        "event": core.event,
        "ram": bytes(machine.ram),
    }


class Pair:
    """The model and the core in C, and the steps that they take together.

    Parameters
    ----------
    seed : int
    prices : dict
        Rows of the timing profile.
    """

    def __init__(self, seed: int, prices: dict[str, int]) -> None:
        self.random = random.Random(seed)
        self.machine = Machine(prices=prices)
        self.core = self.machine.core
        self.model = Model(Memories((0, FLASH_BYTES), (RAM, RAM_BYTES)), prices)
        self.model.memories.write(0, bytes(self.machine.flash))
        self._write(RAM, self.random.randbytes(RAM_BYTES))
        self._write_vectors()
        for exception in range(4, 32):
            self._set_priority(exception, self.random.getrandbits(8))
        active = self.random.choice([[], [], [], [15], [15, 3], [12, 16, 2]])
        self._set_registers(active)
        self._set_active(active)
        self.set_floating_control()
        self.set_masks()

    def _write_vectors(self) -> None:
        vectors = [0x1000 + 16 * number + 1 for number in range(128)]
        if self.random.random() < 0.3:
            vectors[self.random.choice(EXCEPTIONS)] = 0x2000
        self._write(VECTORS, b"".join(vector.to_bytes(4, "little") for vector in vectors))
        self._write(RAM_VECTORS, b"".join((vector + 0x4000).to_bytes(4, "little") for vector in vectors))

    def _set_registers(self, active: list[int]) -> None:
        choose, bits, registers, core = self.random, self.random.getrandbits, self.model.registers, self.core
        core.exception = core.control = 0  # r13 is the main stack pointer then
        registers.general[:] = core.r[0:13] = [bits(32) for _ in range(13)]
        registers.link = core.r[14] = bits(32)
        registers.pc = core.r[15] = bits(15) & ~1
        registers.main_stack = core.r[13] = choose.choice(STACKS)
        registers.process_stack = core.other_stack = choose.choice(STACKS)
        registers.control = bits(3) & ~(SPSEL if active else 0)
        registers.xpsr = bits(32) & 0xF80F0000 | THUMB | choose.choice([0, bits(32) & 0x0600FC00])
        registers.xpsr |= active[-1] if active else 0
        self.machine.call("machine_set_control", registers.control)
        self.machine.call("machine_set_xpsr", registers.xpsr)
        self._set_floats()

    def _set_floats(self) -> None:
        registers, bits = self.model.registers, self.random.getrandbits
        registers.floats[:] = self.core.s[0:32] = [bits(32) for _ in range(32)]
        registers.fpscr = self.core.fpscr = bits(32) & 0xF7C0009F

    def _set_active(self, active: list[int]) -> None:
        self.model.nvic.active[:] = self.core.active[0 : len(active)] = active
        self.core.active_count = len(active)
        for exception in active:
            self.core.is_active[exception // 32] |= 1 << exception % 32

    def _write(self, address: int, data: bytes) -> None:
        self.model.memories.write(address, data)
        assert self.machine.call("machine_write", address, len(data), data)

    def _set_priority(self, exception: int, value: int) -> None:
        self.model.nvic.set_priority(exception, value)
        self.machine.call("machine_set_priority", exception, value)

    # -- what software and peripherals change

    def set_grouping(self) -> None:
        """Set AIRCR.PRIGROUP."""
        self.model.nvic.grouping = self.core.priority_grouping = self.random.randrange(8)

    def set_floating_control(self) -> None:
        """Set FPCCR."""
        value = self.random.choice([0, ASPEN, LSPEN, ASPEN | LSPEN, ASPEN | LSPEN])
        self.model.floating_control = self.core.floating_control = value

    def set_priority(self) -> None:
        """Set a priority byte."""
        self._set_priority(self.random.choice(EXCEPTIONS), self.random.getrandbits(8))

    def pend(self) -> None:
        """Make an exception pending."""
        exception = self.random.choice(EXCEPTIONS)
        self.model.nvic.pend(exception)
        self.machine.call("machine_pend", exception)

    def unpend(self) -> None:
        """Forget that an exception is pending."""
        exception = self.random.choice(EXCEPTIONS)
        self.model.nvic.unpend(exception)
        self.machine.call("machine_unpend", exception)

    def set_enabled(self) -> None:
        """Enable or disable an interrupt."""
        exception, enabled = self._interrupt(), self.random.random() < 0.8
        (self.model.nvic.enabled.add if enabled else self.model.nvic.enabled.discard)(exception)
        self.machine.call("machine_set_enabled", exception - FIRST_INTERRUPT, enabled)

    def set_line(self) -> None:
        """Set the line of an interrupt."""
        exception, level = self._interrupt(), self.random.random() < 0.5
        self.model.nvic.set_line(exception, level)
        self.machine.call("machine_set_line", exception - FIRST_INTERRUPT, level)

    def _interrupt(self) -> int:
        return self.random.choice([exception for exception in EXCEPTIONS if exception >= FIRST_INTERRUPT])

    def set_masks(self) -> None:
        """Set PRIMASK, FAULTMASK and BASEPRI."""
        choose, registers, core = self.random, self.model.registers, self.core
        registers.primask = core.primask = choose.choice([0, 0, 0, 1])
        registers.faultmask = core.faultmask = choose.choice([0, 0, 0, 0, 1])
        registers.basepri = core.basepri = choose.choice([0, 0, 0, 0x40, 0x85, 5])

    def set_up(self) -> None:
        """Set VTOR, and what SHCSR and CCR enable."""
        choose, model, core = self.random, self.model, self.core
        model.fault_handlers = {item for item in (MEM_MANAGE, BUS_FAULT, USAGE_FAULT) if choose.random() < 0.6}
        core.fault_enabled = sum(1 << handler for handler in model.fault_handlers)
        model.base_thread_enabled = core.base_thread_enabled = choose.random() < 0.3
        model.vector_table = core.vector_table = choose.choice(TABLES)

    def compute(self) -> None:
        """Leave other values in registers."""
        self.model.registers.general[:] = self.core.r[0:13] = [self.random.getrandbits(32) for _ in range(13)]

    def use_floats(self) -> None:
        """Execute a floating-point instruction."""
        self.model.floating_point_runs()
        self.machine.call("machine_save_floats")
        self.model.registers.control |= FPCA
        self.core.control |= FPCA
        self._set_floats()

    def move_stack(self) -> None:
        """Set a stack pointer, to no stack at times."""
        process = self.random.random() < 0.5
        stack = self.random.choice(NO_STACKS if self.random.random() < 0.3 else STACKS)
        self.model.registers.set_stack(process, stack)
        self.machine.call("machine_set_stack_pointer", process, stack)

    def spoil_frame(self) -> None:
        """Write another xPSR into a frame."""
        stack = self.machine.call("machine_stack_pointer", self.random.random() < 0.5)
        if self.machine.call("machine_holds_stack", stack, 32):
            xpsr = self.random.getrandbits(32) & ~0x1FF | self.random.choice([0, 0, 11, 15, 511])
            self._write(stack + 28, (xpsr | self.random.choice([THUMB, THUMB, 0])).to_bytes(4, "little"))

    # -- what the core does

    def look(self) -> None:
        """Enter what pre-empts."""
        active = len(self.model.nvic.active)
        fault = self.model.take()
        assert self.machine.take() == (len(self.model.nvic.active) > active)
        self._meet(fault)

    def leave(self) -> None:
        """Branch to an EXC_RETURN, to the right one most times."""
        right = self.core.r[14] if self.core.r[14] in RETURNS else self.random.choice(RETURNS)
        values = [right, self.random.choice(RETURNS), self.random.choice(NO_RETURNS)]
        (value,) = self.random.choices(values, [8, 1, 1])
        place = self.random.getrandbits(15) & ~1
        if self.core.exception == 0 and self.random.random() < 0.9:
            return  # thread mode hardly ever does that
        fault = self.model.leave(value, place)
        assert self.machine.leave(value, place) == (fault is None)
        self._meet(fault)

    def fault(self) -> None:
        """Meet a fault of any kind."""
        bits = self.random.getrandbits
        fault = Fault(self.random.choice(list(KINDS)), bits(15) & ~1, bits(32))
        _, library = exception_library()
        kind = getattr(library, f"FAULT_{fault.kind}")
        self.machine.call("note_fault", kind, library.CAUSE_NONE, fault.place, fault.address, 0, 0)
        self._meet(fault)

    def _meet(self, fault: Fault | None) -> None:
        """Both have met the same fault, which then goes to its handler."""
        noted = self.core.fault
        if fault is None:
            assert noted.kind == 0
            return
        assert (self.machine.fault[0], noted.place) == (fault.kind, fault.place)
        try:
            handler = self.model.take_fault(fault)
        except Lockup:
            handler = 0
        assert self.machine.call("machine_deliver_fault") == handler
        assert noted.kind == 0
        if handler == 0:
            self._revive()

    def _revive(self) -> None:
        """Begin again in thread mode after lockup."""
        self._set_active([])
        for word in range(8):
            self.core.is_active[word] = 0
        self._set_registers([])
        self.set_masks()

    def wake(self) -> None:
        """Sleep, and look whether something ends that."""
        for_event = self.random.random() < 0.5
        self.model.sends_on_pend = self.core.sends_on_pend = self.random.random() < 0.3
        assert self.machine.call("is_woken", for_event) == self.model.wakes(for_event=for_event)

    def compare(self) -> None:
        """Compare everything."""
        assert state_in_c(self.machine) == state_of_model(self.model)


ACTIONS = {
    Pair.look: 30,
    Pair.leave: 24,
    Pair.pend: 14,
    Pair.set_enabled: 6,
    Pair.fault: 4,
    Pair.use_floats: 6,
    Pair.set_masks: 4,
    Pair.set_line: 4,
    Pair.unpend: 3,
    Pair.set_priority: 3,
    Pair.compute: 3,
    Pair.move_stack: 2,
    Pair.set_up: 2,
    Pair.spoil_frame: 2,
    Pair.wake: 3,
    Pair.set_grouping: 1,
    Pair.set_floating_control: 1,
}


@pytest.mark.parametrize("prices", PROFILES, ids=["whole profile", "few rows", "other prices"])
@pytest.mark.parametrize("seed", range(40))
def test_the_core_and_the_model_do_the_same_in_the_same_steps(seed: int, prices: dict[str, int]) -> None:
    pair = Pair(seed, prices)
    pair.compare()
    for action in pair.random.choices(list(ACTIONS), list(ACTIONS.values()), k=STEPS):
        action(pair)
        pair.compare()
