"""Descriptions of processor faults, and the log of faults that the firmware's handlers received."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from hiltest.errors import BoardFault
from hiltest.state import Restorable
from hiltest.virtual.core.library import lib
from hiltest.virtual.core.machine import Machine
from hiltest.virtual.part.chip import is_in
from hiltest.virtual.processor.bit_band import ALIASES
from hiltest.virtual.processor.memory import PERIPHERALS, PRIVATE_PERIPHERALS
from hiltest.virtual.processor.nvic import exception_name
from hiltest.virtual.program.instruction_text import instruction_text

_MOST_RECORDS = 1000  # limits the memory for firmware that faults all the time; the first faults explain the most
_NO_CODE = (PERIPHERALS, PRIVATE_PERIPHERALS, *ALIASES)


def describe_fault(machine: Machine, code: bytes) -> str:
    """Return a description of `core.fault`.

    Parameters
    ----------
    code
        Code at the faulting address; empty if it has no memory.
    """
    fault = machine.core.fault
    if fault.kind == lib.FAULT_DATA_BUS:
        return _data_access(machine, fault)
    if fault.cause in (lib.CAUSE_FETCH_UNMAPPED, lib.CAUSE_NO_THUMB_BIT):
        return _jump(fault)
    if fault.cause == lib.CAUSE_MISALIGNED:
        text = instruction_text(fault.place, code)
        return f"unaligned access: r{fault.size} = 0x{fault.value:08x} in '{text}'"
    sentence: str = _SENTENCES[fault.cause].format(address=fault.address, value=fault.value, number=fault.size)
    return sentence


_SENTENCES = {
    lib.CAUSE_OPCODE: "undefined instruction {value:04x}",
    lib.CAUSE_FPU_DISABLED: "FPU used while CPACR disables it (NOCP)",
    lib.CAUSE_COPROCESSOR: "instruction for an absent coprocessor (NOCP)",
    lib.CAUSE_EXCLUSIVE: "unaligned exclusive access",
    lib.CAUSE_DIVISOR: "division by zero: r{number}",
    lib.CAUSE_SVC: "SVC while the SVCall handler cannot run",
    lib.CAUSE_BKPT: "breakpoint (BKPT) without a debugger",
    lib.CAUSE_STACK_FRAME: "no RAM for a stack frame at 0x{address:08x}",
    lib.CAUSE_VECTOR_READ: "no memory at VTOR 0x{address:08x}",
    lib.CAUSE_VECTOR_THUMB: "vector 0x{value:08x} of exception {number} has no Thumb bit",
    lib.CAUSE_RETURN_THREAD: "EXC_RETURN 0x{value:08x} while no exception is active",
    lib.CAUSE_RETURN_VALUE: "EXC_RETURN 0x{value:08x} matches no active exception",
    lib.CAUSE_RETURN_MODE: "stacked xPSR 0x{value:08x} belongs to another mode",
    lib.CAUSE_RETURN_THUMB: "stacked xPSR 0x{value:08x} has no Thumb bit",
}


def _data_access(machine: Machine, fault: Any) -> str:
    begin = {
        lib.CAUSE_READ_UNMAPPED: "read of unmapped address",
        lib.CAUSE_WRITE_UNMAPPED: "write to unmapped address",
        lib.CAUSE_WRITE_FLASH: "write to flash at address",
        lib.CAUSE_READ_PROTECTED: "read refused by the SYSMPU at address",
        lib.CAUSE_WRITE_PROTECTED: "write refused by the SYSMPU at address",
        lib.CAUSE_READ_REFUSED: "read of",
        lib.CAUSE_WRITE_REFUSED: "write to",
    }[fault.cause]
    is_refused = fault.cause in (lib.CAUSE_READ_REFUSED, lib.CAUSE_WRITE_REFUSED)
    target = machine.refusal if is_refused else f"0x{fault.value or fault.address:08x}"
    if fault.value:
        return f"{begin} {target} through its bit-band alias 0x{fault.address:08x}"
    return f"{begin} {target}" if is_refused else f"{begin} {target} ({fault.size} bytes)"


def _jump(fault: Any) -> str:
    if fault.cause == lib.CAUSE_NO_THUMB_BIT and fault.place == fault.address:
        return f"jump to the even address 0x{fault.address:08x}: no Thumb bit"
    begin = "execution of data at address" if is_in(_NO_CODE, fault.address) else "jump to unmapped address"
    without = ", without Thumb bit" if fault.cause == lib.CAUSE_NO_THUMB_BIT else ""
    return f"{begin} 0x{fault.address:08x}{without}"


@dataclass(frozen=True, slots=True)
class FaultRecord:
    """A fault that was delivered to the firmware."""

    fault: BoardFault
    """Cause, place and registers, ready to be raised."""
    exception: str
    """Exception that it was delivered as: "HardFault", "BusFault", "UsageFault" or "MemManage"."""
    cycle: int
    """Time of the fault [clock cycles since power-on]."""


class FaultLog(Restorable):
    """All faults since power-on, and those whose handlers have not returned.

    Attributes
    ----------
    records : list of FaultRecord
        The first thousand faults, in order.
    """

    def __init__(self) -> None:
        self.records: list[FaultRecord] = []
        self._open: list[tuple[FaultRecord, int]] = []

    def record_delivery(self, fault: BoardFault, exception: int, cycle: int, depth: int) -> None:
        """Record a fault whose handler begins; `depth` exceptions are then active."""
        record = FaultRecord(fault, exception_name(exception), cycle)
        if len(self.records) < _MOST_RECORDS:
            self.records.append(record)
        self._open.append((record, depth))

    def record_return(self, depth: int) -> None:
        """Record the return of an exception, after which `depth` are active."""
        while self._open and self._open[-1][1] > depth:
            self._open.pop()

    def forget_open(self) -> None:
        """Forget all unfinished handlers after a reset of the processor."""
        self._open.clear()

    @property
    def first_cause(self) -> BoardFault | None:
        """The fault whose handler is running, the first of nested ones; None if no fault handler runs."""
        return self._open[0][0].fault if self._open else None
