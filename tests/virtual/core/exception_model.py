"""A model of the core's exceptions, written for reading and not for speed; the core in C is compared with it.

It goes back to the virtual board's first implementation, in Python on the registers of Unicorn, which the core in C was
compared with before that one was removed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

NMI, HARD_FAULT, MEM_MANAGE, BUS_FAULT, USAGE_FAULT, SVCALL, FIRST_INTERRUPT = 2, 3, 4, 5, 6, 11, 16
IDLE = 256  # a priority that everything beats
THUMB, REALIGNED, EXCEPTION_NUMBER = 1 << 24, 1 << 9, 0x1FF  # xPSR
_APSR = 0xF80F0000
_EXISTS = 0xFF0FFDFF  # bits of xPSR
NPRIV, SPSEL, FPCA = 1, 2, 4  # CONTROL
ASPEN, LSPEN = 1 << 31, 1 << 30  # FPCCR
_FPSCR = 0xF7C0009F
_BASIC, _EXTENDED = 32, 104
_FORCED, _BFARVALID = 1 << 30, 1 << 15
_FIXED_PRIORITIES = {NMI: -2, HARD_FAULT: -1}
_PRIORITY_MASK = 0xF0
_RETURNS = {0xFFFFFFE1, 0xFFFFFFE9, 0xFFFFFFED, 0xFFFFFFF1, 0xFFFFFFF9, 0xFFFFFFFD}

# For each kind of fault: the exception that takes it, its bits in CFSR and in HFSR.
KINDS = {
    "EXECUTE_NEVER": (MEM_MANAGE, 1 << 0, 0),
    "INSTRUCTION_BUS": (BUS_FAULT, 1 << 8, 0),
    "DATA_BUS": (BUS_FAULT, 1 << 9, 0),
    "UNSTACKING": (BUS_FAULT, 1 << 11, 0),
    "STACKING": (BUS_FAULT, 1 << 12, 0),
    "UNDEFINED_INSTRUCTION": (USAGE_FAULT, 1 << 16, 0),
    "INVALID_STATE": (USAGE_FAULT, 1 << 17, 0),
    "INVALID_RETURN": (USAGE_FAULT, 1 << 18, 0),
    "NO_COPROCESSOR": (USAGE_FAULT, 1 << 19, 0),
    "UNALIGNED": (USAGE_FAULT, 1 << 24, 0),
    "DIVIDE_BY_ZERO": (USAGE_FAULT, 1 << 25, 0),
    "SUPERVISOR_CALL": (HARD_FAULT, 0, _FORCED),
    "VECTOR_TABLE": (HARD_FAULT, 0, 1 << 1),
    "BREAKPOINT": (HARD_FAULT, 0, 1 << 31),
}


class Lockup(Exception):
    """A fault while no handler may run."""


@dataclass(frozen=True, slots=True)
class Fault:
    """A fault: its kind, the address of the instruction, and of the data."""

    kind: str
    place: int
    address: int = 0


class Memories:
    """Flash and RAM.

    Parameters
    ----------
    flash, ram : tuple of int
        First address and number of bytes.
    """

    def __init__(self, flash: tuple[int, int], ram: tuple[int, int]) -> None:
        self._ram = ram
        self._bytes = {region: bytearray(region[1]) for region in (flash, ram)}

    def holds_stack(self, address: int, size: int) -> bool:
        """Whether a range is RAM."""
        base, length = self._ram
        return base <= address and address + size <= base + length

    def _at(self, address: int, size: int) -> memoryview:
        for (base, length), data in self._bytes.items():
            if base <= address and address + size <= base + length:
                return memoryview(data)[address - base : address - base + size]
        raise ValueError(f"no memory at 0x{address:x}")

    def read(self, address: int, size: int) -> bytes:
        """Read bytes; ValueError if there is no memory."""
        return bytes(self._at(address, size))

    def write(self, address: int, data: bytes) -> None:
        """Write bytes; ValueError if there is no memory."""
        self._at(address, len(data))[:] = data

    def read_words(self, address: int, count: int) -> list[int]:
        """Read words; ValueError if there is no memory."""
        data = self.read(address, 4 * count)
        return [int.from_bytes(data[at : at + 4], "little") for at in range(0, len(data), 4)]

    def write_words(self, address: int, words: Sequence[int]) -> None:
        """Write words; ValueError if there is no memory."""
        self.write(address, b"".join(word.to_bytes(4, "little") for word in words))


@dataclass
class Registers:
    """Registers of a core with an FPU."""

    general: list[int] = field(default_factory=lambda: [0] * 13)
    link: int = 0
    pc: int = 0
    xpsr: int = THUMB
    main_stack: int = 0
    process_stack: int = 0
    control: int = 0
    primask: int = 0
    faultmask: int = 0
    basepri: int = 0
    floats: list[int] = field(default_factory=lambda: [0] * 32)
    fpscr: int = 0

    @property
    def in_thread(self) -> bool:
        """Whether no handler runs."""
        return self.xpsr & EXCEPTION_NUMBER == 0

    @property
    def uses_process_stack(self) -> bool:
        """Whether the stack pointer is PSP."""
        return self.in_thread and bool(self.control & SPSEL)

    def stack(self, process: bool) -> int:
        """Return a stack pointer."""
        return self.process_stack if process else self.main_stack

    def set_stack(self, process: bool, value: int) -> None:
        """Set a stack pointer."""
        if process:
            self.process_stack = value & 0xFFFFFFFF
        else:
            self.main_stack = value & 0xFFFFFFFF


class Nvic:
    """Which exceptions wait, and which may be taken."""

    def __init__(self) -> None:
        self.enabled: set[int] = set()
        self.lines: set[int] = set()
        self.pending: set[int] = set()
        self.taken: set[int] = set()
        self.active: list[int] = []
        self.priority: dict[int, int] = {}
        self.grouping = 0
        self.newly_pending = False

    def pend(self, exception: int) -> None:
        """Make an exception pending."""
        self.newly_pending |= exception not in self.pending
        self.pending.add(exception)

    def unpend(self, exception: int) -> None:
        """Forget that one is pending, unless its line holds it."""
        if exception not in self.lines or exception in self.active:
            self.pending.discard(exception)

    def set_line(self, exception: int, level: bool) -> None:
        """Set the line of an interrupt."""
        if level and exception not in self.lines:
            self.lines.add(exception)
            self.pend(exception)
        elif not level:
            self.lines.discard(exception)

    def set_priority(self, exception: int, value: int) -> None:
        """Set a priority byte."""
        if exception not in _FIXED_PRIORITIES:
            self.priority[exception] = value & _PRIORITY_MASK

    def _order(self, exception: int) -> int:
        return _FIXED_PRIORITIES.get(exception, self.priority.get(exception, 0))

    def _grouped(self, priority: int) -> int:
        return priority if priority < 0 else priority & (0xFF << self.grouping + 1)

    def preemption_priority(self, exception: int) -> int:
        """Priority against what runs."""
        return self._grouped(self._order(exception))

    def ceiling(self, registers: Registers, *, without_primask: bool = False) -> int:
        """Priority that the masks raise execution to."""
        if registers.faultmask:
            return -1
        if registers.primask and not without_primask:
            return 0
        base = registers.basepri & _PRIORITY_MASK
        return self._grouped(base) if base else IDLE

    def execution_priority(self, ceiling: int) -> int:
        """Priority of what runs."""
        return min([ceiling, *(self.preemption_priority(exception) for exception in self.active)])

    def most_urgent(self) -> int:
        """Return the exception that comes first, or 0."""
        ready = [number for number in self.pending if number < FIRST_INTERRUPT or number in self.enabled]
        return min(ready, key=lambda exception: (self._order(exception), exception), default=0)

    def next_exception(self, ceiling: int) -> int:
        """Return the exception that pre-empts what runs, or 0."""
        first = self.most_urgent()
        return first if first and self.preemption_priority(first) < self.execution_priority(ceiling) else 0

    def enter(self, exception: int) -> None:
        """Make an exception active."""
        self.pending.discard(exception)
        self.taken.add(exception)
        self.active.append(exception)

    def leave(self) -> None:
        """End the exception that became active last."""
        exception = self.active.pop()
        if exception in self.lines:
            self.pending.add(exception)


class Model:
    """Entries, returns and faults.

    Parameters
    ----------
    memories : Memories
    prices : mapping
        Rows of a timing profile, as far as it has them.
    """

    def __init__(self, memories: Memories, prices: dict[str, int]) -> None:
        self.memories, self._prices = memories, prices
        self.registers, self.nvic = Registers(), Nvic()
        self.cycles = self.vector_table = self.floating_control = self.lazy_frame = 0
        self.cfsr = self.hfsr = self.bfar = 0
        self.fault_handlers: set[int] = set()
        self.base_thread_enabled = self.is_chained = self.is_saved = self.event = self.sends_on_pend = False

    @property
    def ceiling(self) -> int:
        """Priority that the masks raise execution to."""
        return self.nvic.ceiling(self.registers)

    # -- floating-point state

    def floating_point_runs(self) -> None:
        """Save what is to be saved before a floating-point instruction."""
        if self.lazy_frame:
            self._save_floats()
            self.cycles += self._prices.get("fp_frame", 0)

    def _save_floats(self) -> None:
        self.memories.write_words(self.lazy_frame, [*self.registers.floats[:16], self.registers.fpscr])
        self.lazy_frame = 0

    # -- entry

    def take(self) -> Fault | None:
        """Enter the exception that pre-empts what runs, if there is one; return what went wrong on the way in."""
        exception = self.nvic.next_exception(self.ceiling)
        if exception:
            return self._enter(exception)
        self.is_chained = False
        return None

    def _enter(self, exception: int) -> Fault | None:
        registers = self.registers
        place, process = registers.pc, registers.uses_process_stack
        stack = registers.stack(process)
        extended = bool(registers.control & FPCA) and bool(self.floating_control & ASPEN)
        size = _EXTENDED if extended else _BASIC
        base = (stack - size) & 0xFFFFFFF8
        exc_return = 0xFFFFFFE1 | (not extended) << 4 | registers.in_thread << 3 | process << 2
        fault = self._push(base, size, realigned=(base + size) & 0xFFFFFFFF != stack)
        try:
            (vector,) = self.memories.read_words(self.vector_table + 4 * exception, 1)
        except ValueError:
            vector, fault = 0, Fault("VECTOR_TABLE", place)
        if not vector & 1 and fault is None:
            fault = Fault("INVALID_STATE", place)
        registers.set_stack(process, base)
        registers.xpsr = registers.xpsr & _APSR | (vector & 1) * THUMB | exception
        registers.control &= NPRIV
        registers.link, registers.pc = exc_return, vector & ~1
        self.nvic.enter(exception)
        self.cycles += self._entry_cycles(saves=extended and not self.lazy_frame)
        self.is_chained = self.is_saved = False
        self.event = True
        if exception == HARD_FAULT and fault is not None and fault.kind == "STACKING":
            self._record(fault, forced=False)  # nothing is more urgent: the handler runs without a frame
            return None
        return fault

    def _push(self, base: int, size: int, *, realigned: bool) -> Fault | None:
        registers = self.registers
        if not self.memories.holds_stack(base, size):
            return Fault("STACKING", registers.pc)
        general, xpsr = registers.general, registers.xpsr | (REALIGNED if realigned else 0)
        self.memories.write_words(base, [*general[:4], general[12], registers.link, registers.pc, xpsr])
        if size == _EXTENDED:
            self.lazy_frame = base + _BASIC
            if (self.is_chained and self.is_saved) or not self.floating_control & LSPEN:
                self._save_floats()
        return None

    def _entry_cycles(self, *, saves: bool) -> int:
        saving = self._prices.get("fp_frame", 0) if saves else 0
        if self.is_chained:  # the return has counted both
            return 0 if self.is_saved else saving
        return self._prices["exception_entry"] + saving

    # -- faults

    def take_fault(self, fault: Fault) -> int:
        """Take a fault to its handler; return the exception that was entered."""
        priority = self.nvic.execution_priority(self.ceiling)
        expected = handler = KINDS[fault.kind][0]
        if expected not in self.fault_handlers or self.nvic.preemption_priority(expected) >= priority:
            if priority <= -1:
                raise Lockup
            handler = HARD_FAULT
        self._record(fault, forced=handler != expected)
        again = self._enter(handler)
        if again is None:
            return handler
        if handler == HARD_FAULT:
            raise Lockup
        return self.take_fault(again)

    def _record(self, fault: Fault, *, forced: bool) -> None:
        _, cfsr, hfsr = KINDS[fault.kind]
        self.cfsr |= cfsr
        self.hfsr |= hfsr | (_FORCED if forced else 0)
        if fault.kind == "DATA_BUS":
            self.bfar = fault.address
            self.cfsr |= _BFARVALID

    # -- return

    def leave(self, exc_return: int, place: int) -> Fault | None:
        """Return by an EXC_RETURN; `place` is the branch. Return what was wrong."""
        registers, nvic = self.registers, self.nvic
        exc_return |= 1
        process, to_thread, extended = bool(exc_return & 4), bool(exc_return & 8), not exc_return & 16
        base, size = registers.stack(process), _EXTENDED if extended else _BASIC
        if registers.in_thread or not nvic.active:
            return Fault("EXECUTE_NEVER", place)
        may_return = (len(nvic.active) == 1 or self.base_thread_enabled) if to_thread else len(nvic.active) > 1
        if exc_return not in _RETURNS or not may_return:
            return Fault("INVALID_RETURN", place)
        if not self.memories.holds_stack(base, size):
            return Fault("UNSTACKING", place)
        frame = self.memories.read_words(base, 8)
        if (frame[7] & EXCEPTION_NUMBER == 0) != to_thread:
            return Fault("INVALID_RETURN", place)
        restores = extended and not self.lazy_frame
        if restores:
            *floats, fpscr = self.memories.read_words(base + _BASIC, 17)
            registers.floats[:16], registers.fpscr = floats, fpscr & _FPSCR
        if extended:
            self.lazy_frame = 0
        if nvic.active[-1] != NMI:
            registers.faultmask = 0
        nvic.leave()
        registers.control = registers.control & NPRIV | process * SPSEL | extended * FPCA
        registers.general[:4], registers.general[12] = frame[:4], frame[4]
        registers.link, registers.pc, registers.xpsr = frame[5], frame[6] & ~1, frame[7] & _EXISTS
        registers.set_stack(process, base + size + (4 if frame[7] & REALIGNED else 0))
        self.event = True
        if not frame[7] & THUMB:
            return Fault("INVALID_STATE", registers.pc)
        self.cycles += self._return_cycles(restores=restores)
        return None

    def _return_cycles(self, *, restores: bool) -> int:
        if "tail_chain" in self._prices and self.nvic.next_exception(self.ceiling):
            self.is_chained, self.is_saved = True, restores
            return self._prices["tail_chain"]
        return self._prices["exception_return"] + (self._prices.get("fp_frame", 0) if restores else 0)

    # -- sleep

    def wakes(self, *, for_event: bool) -> bool:
        """Whether something ends WFI, or WFE; an event that does is taken."""
        ceiling: Callable[..., int] = self.nvic.ceiling
        if self.nvic.next_exception(ceiling(self.registers, without_primask=not for_event)):
            return True
        if not for_event:
            return False
        was_set = self.event or (self.sends_on_pend and self.nvic.newly_pending)
        self.event = self.nvic.newly_pending = False
        return was_set
