"""Faults of the processor: their kinds, status registers and delivery."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from hiltest.errors import BoardFault
from hiltest.virtual.nvic import BUS_FAULT, HARD_FAULT, MEM_MANAGE, USAGE_FAULT, exception_name

_BFAR_VALID = 1 << 15
_HFSR_FORCED = 1 << 30
_KEPT = 1000  # firmware that lives from its faults must not fill the host's memory; the first ones explain the most


class FaultKind(Enum):
    """A kind of fault: the exception that takes it, its bit in CFSR and its bit in HFSR."""

    EXECUTE_NEVER = (MEM_MANAGE, 1 << 0, 0)
    INSTRUCTION_BUS = (BUS_FAULT, 1 << 8, 0)
    DATA_BUS = (BUS_FAULT, 1 << 9, 0)
    UNSTACKING = (BUS_FAULT, 1 << 11, 0)
    STACKING = (BUS_FAULT, 1 << 12, 0)
    UNDEFINED_INSTRUCTION = (USAGE_FAULT, 1 << 16, 0)
    INVALID_STATE = (USAGE_FAULT, 1 << 17, 0)
    INVALID_RETURN = (USAGE_FAULT, 1 << 18, 0)
    NO_COPROCESSOR = (USAGE_FAULT, 1 << 19, 0)
    UNALIGNED = (USAGE_FAULT, 1 << 24, 0)
    DIVIDE_BY_ZERO = (USAGE_FAULT, 1 << 25, 0)
    SUPERVISOR_CALL = (HARD_FAULT, 0, _HFSR_FORCED)  # SVC where its handler may not run
    VECTOR_TABLE = (HARD_FAULT, 0, 1 << 1)
    BREAKPOINT = (HARD_FAULT, 0, 1 << 31)

    def __init__(self, exception: int, cfsr: int, hfsr: int) -> None:
        self.exception = exception
        self.cfsr = cfsr
        self.hfsr = hfsr


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault, as it was found.

    Attributes
    ----------
    kind : FaultKind
    cause : str
        What happened, for people.
    place : int
        Address of the instruction to name: for a jump into nothing, the jump.
    address : int or None
        The data address of a bus error.
    """

    kind: FaultKind
    cause: str
    place: int
    address: int | None = None


class Lockup(Exception):
    """A fault where no handler may run: the processor stops."""


class FaultStatus:
    """CFSR, HFSR, BFAR and which fault handlers are enabled."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """State after a processor reset; BFAR is unknown then, and kept here."""
        self.cfsr = 0
        self.hfsr = 0
        self.bfar = 0
        self.enabled: set[int] = set()

    def record(self, fault: Fault, *, forced: bool) -> None:
        """Set what the handler will read."""
        self.cfsr |= fault.kind.cfsr
        self.hfsr |= fault.kind.hfsr | (_HFSR_FORCED if forced else 0)
        if fault.kind is FaultKind.DATA_BUS and fault.address is not None:
            self.bfar = fault.address
            self.cfsr |= _BFAR_VALID


@dataclass(frozen=True, slots=True)
class FaultRecord:
    """A fault that was delivered to the firmware.

    Attributes
    ----------
    fault : BoardFault
        Cause, place and registers, ready to be raised.
    exception : str
        Who got it: "HardFault", "BusFault", "UsageFault" or "MemManage".
    cycle : int
        When [clock cycles since power-on].
    """

    fault: BoardFault
    exception: str
    cycle: int


class FaultLog:
    """Every fault since power-on, and those whose handlers have not returned.

    Attributes
    ----------
    records : list of FaultRecord
        The first thousand, in order.
    """

    def __init__(self) -> None:
        self.records: list[FaultRecord] = []
        self._open: list[tuple[FaultRecord, int]] = []

    def delivered(self, fault: BoardFault, exception: int, cycle: int, depth: int) -> None:
        """Note a fault whose handler begins; `depth` exceptions are active with it."""
        record = FaultRecord(fault, exception_name(exception), cycle)
        if len(self.records) < _KEPT:
            self.records.append(record)
        self._open.append((record, depth))

    def returned(self, depth: int) -> None:
        """Note that an exception returned and `depth` are still active."""
        while self._open and self._open[-1][1] > depth:
            self._open.pop()

    def forget_open(self) -> None:
        """Close all open faults: the processor was reset."""
        self._open.clear()

    @property
    def first_cause(self) -> BoardFault | None:
        """The fault that everything since follows from, while its handler runs."""
        return self._open[0][0].fault if self._open else None
