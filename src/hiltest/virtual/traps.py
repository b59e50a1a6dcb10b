"""Stops of the emulator: the core faults, calls its supervisor, or returns from an exception."""

from __future__ import annotations

import ctypes
import itertools
import struct
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from typing import Any

import unicorn

from hiltest.virtual.code_hook import CODE_CALLBACK
from hiltest.virtual.elf import FirmwareImage
from hiltest.virtual.engine import add_hook
from hiltest.virtual.faults import Fault, FaultKind
from hiltest.virtual.instructions import Instruction
from hiltest.virtual.memory import PLAIN, BoardMemory
from hiltest.virtual.registers import CoreRegisters

_INTR_UNDEFINED, _INTR_SVC, _INTR_PREFETCH_ABORT, _INTR_DATA_ABORT = 1, 2, 3, 4
_INTR_BREAKPOINT, _INTR_EXCEPTION_RETURN, _INTR_NO_COPROCESSOR = 7, 8, 17
_INTERRUPT_CALLBACK = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_uint32, ctypes.c_void_p)
_THUMB = 1 << 24
_WFE = (b"\x20\xbf", b"\xaf\xf3\x02\x80")

_DATA_ACCESS = {
    unicorn.UC_MEM_READ_UNMAPPED: "read of unmapped address",
    unicorn.UC_MEM_WRITE_UNMAPPED: "write to unmapped address",
    # The page that called functions return to; the part has nothing there. Flash is handled below.
    unicorn.UC_MEM_WRITE_PROT: "write to unmapped address",
    unicorn.UC_MEM_READ_PROT: "read of unmapped address",
}
_FETCHES = {
    unicorn.UC_MEM_FETCH_UNMAPPED: "jump to unmapped address",
    unicorn.UC_MEM_FETCH_PROT: "execution of data at address",
}


def never_executed(address: int) -> bool:
    """Whether the architecture forbids code there: devices, and the system region."""
    return 0x40000000 <= address < 0x60000000 or address >= 0xA0000000


def _divisions(image: FirmwareImage) -> Iterator[tuple[int, bytes]]:
    """Find words that look like SDIV or UDIV: address and code, whose third byte ends in the divisor."""
    for segment in image.segments:
        halfwords = struct.unpack(f"<{len(segment.data) // 2}H", segment.data[: len(segment.data) & ~1])
        for index, (first, second) in enumerate(itertools.pairwise(halfwords)):
            if first & 0xFFD0 == 0xFB90 and second & 0xF0F0 == 0xF0F0:
                for start in {segment.address, segment.run_address}:
                    yield start + 2 * index, segment.data[2 * index : 2 * index + 4]


class Traps:
    """Finds the reason why the emulator stopped.

    Parameters
    ----------
    engine : Uc
        The emulator.
    registers : CoreRegisters
    memory : BoardMemory
    stop : callable
        Stops the emulator.
    abort : callable
        Stops it because of an error of the host.

    Attributes
    ----------
    fault : Fault or None
        What the instruction at PC did, since `clear`.
    exc_return : int
        The EXC_RETURN that was branched to, since `clear`, or 0.
    waits_for_event : bool
        Whether a WFE found no event, since `clear`.
    take_event : callable
        Called by WFE; answers whether it may go on.
    supervisor_call : callable
        Called after an SVC; answers whether its handler may run.
    jumped_from : callable
        Answers with the address of the latest branch, if it led nowhere.
    at_breakpoint : callable
        Called at a BKPT with its address; answers whether a debugger halts there.
    fpu_enabled, traps_division_by_zero : bool
        CPACR and CCR.DIV_0_TRP.
    """

    def __init__(
        self, engine: Any, registers: CoreRegisters, memory: BoardMemory, *, stop: Callable[[], None],
        abort: Callable[[BaseException], None],
    ) -> None:  # fmt: skip
        self.fault: Fault | None = None
        self.exc_return = 0
        self.waits_for_event = False
        self.take_event: Callable[[], bool] = lambda: True
        self.fpu_enabled = False
        self.traps_division_by_zero = False
        self.supervisor_call: Callable[[], bool] = lambda: True
        self.jumped_from: Callable[[], int | None] = lambda: None
        self.at_breakpoint: Callable[[int], bool] = lambda _address: False
        self._engine = engine
        self._registers = registers
        self._memory = memory
        self._stop = stop
        self._abort = abort
        self._watched: dict[int, str] = {}
        self._looks: dict[int, tuple[bytes, Callable[[], None]]] = {}
        self._instruction_hook = CODE_CALLBACK(self._on_instruction)  # the emulator keeps only the pointer
        self._interrupt_hook = _INTERRUPT_CALLBACK(self._on_interrupt)
        add_hook(engine, unicorn.UC_HOOK_INTR, self._interrupt_hook)
        unmapped = unicorn.UC_HOOK_MEM_UNMAPPED | unicorn.UC_HOOK_MEM_FETCH_PROT
        engine.hook_add(unmapped, self._on_invalid_memory)
        protected = unicorn.UC_HOOK_MEM_READ_PROT | unicorn.UC_HOOK_MEM_WRITE_PROT
        for first, last in PLAIN:  # elsewhere: the bus
            engine.hook_add(protected, self._on_invalid_memory, begin=first, end=last)
        engine.hook_add(unicorn.UC_HOOK_INSN_INVALID, self._on_invalid_instruction)

    def clear(self) -> None:
        """Forget what stopped the emulator last."""
        self.fault = None
        self.exc_return = 0
        self.waits_for_event = False

    def _found(self, kind: FaultKind, cause: str, place: int, address: int | None = None) -> None:
        if self.fault is None:
            self.fault = Fault(kind, cause, place & ~1, address)

    def _on_interrupt(self, _engine: int, number: int, _data: int) -> None:
        try:
            self._note_interrupt(number, self._registers.pc.get())
            self._stop()
        except BaseException as error:  # re-raised by the processor; ctypes would print and drop it
            self._abort(error)

    def _note_interrupt(self, number: int, pc: int) -> None:
        if number == _INTR_SVC:
            if not self.supervisor_call():
                self._found(FaultKind.SUPERVISOR_CALL, "SVC where the SVCall handler may not run", pc - 2)
        elif number == _INTR_EXCEPTION_RETURN:
            self.exc_return = pc
        elif number == _INTR_BREAKPOINT:
            if not self.at_breakpoint(pc):
                self._found(FaultKind.BREAKPOINT, "breakpoint (BKPT) without a debugger", pc)
        elif number == _INTR_PREFETCH_ABORT:
            self._fetched(unicorn.UC_MEM_FETCH_PROT, pc, self.jumped_from() or pc)
        elif number == _INTR_DATA_ABORT:
            self._found(FaultKind.UNALIGNED, "unaligned exclusive access", pc)
        elif number == _INTR_NO_COPROCESSOR:
            self._found(FaultKind.NO_COPROCESSOR, "instruction for a coprocessor that is not there (NOCP)", pc)
        elif number == _INTR_UNDEFINED:
            self._found(FaultKind.UNDEFINED_INSTRUCTION, "undefined instruction", pc)
        else:
            self._found(FaultKind.UNDEFINED_INSTRUCTION, f"processor exception {number}", pc)

    def _on_invalid_memory(self, _engine: Any, access: int, address: int, size: int, _value: int, _data: Any) -> bool:
        pc = self._registers.pc.get()
        if access in _FETCHES:
            self._fetched(access, address, self.jumped_from() or pc)
            return False
        cause = _DATA_ACCESS.get(access, f"memory access {access} at")
        if access == unicorn.UC_MEM_WRITE_PROT and self._memory.map.in_flash(address):
            cause = "write to flash at address"
        self._found(FaultKind.DATA_BUS, f"{cause} 0x{address:08x} ({size} bytes)", pc, address)
        return False

    def refuse(self, access: int, address: int, reason: str) -> None:
        """An access to a peripheral is a bus error; says where, and why."""
        what = "write to" if access == unicorn.UC_MEM_WRITE_PROT else "read of"
        self._found(FaultKind.DATA_BUS, f"{what} {reason}", self._registers.pc.get(), address)

    def _fetched(self, access: int, address: int, place: int) -> None:
        """Report an instruction fetch fault, at the jump that led there."""
        cause = f"{_FETCHES[access]} 0x{address:08x}"
        if not self._registers.xpsr.get() & _THUMB:
            self._found(FaultKind.INVALID_STATE, f"{cause}, without Thumb bit", place)
        elif never_executed(address):
            self._found(FaultKind.EXECUTE_NEVER, cause, place)
        else:
            self._found(FaultKind.INSTRUCTION_BUS, cause, place)

    def _on_invalid_instruction(self, _engine: Any, _data: Any) -> bool:
        pc = self._registers.pc.get()
        if not self._registers.xpsr.get() & _THUMB:
            self._found(FaultKind.INVALID_STATE, f"jump to the even address 0x{pc:08x}: no Thumb bit", pc)
            return False
        if self._is_behind_wfe(pc & ~1):
            if not self.take_event():
                self.waits_for_event = True
                self._stop()
            return True
        code = self._memory.read(pc & ~1, 2)
        self._found(FaultKind.UNDEFINED_INSTRUCTION, f"undefined instruction {code[::-1].hex()}", pc)
        return False

    def _is_behind_wfe(self, pc: int) -> bool:
        """Whether it was WFE that the emulator did not know: it comes here then with the PC behind it."""
        place = self.jumped_from()
        if place is None or place >= pc:
            return False
        return self._memory.read(place, pc - place) in _WFE

    # -- instructions that fault on what their registers hold ----------------------------------

    def unwatched(self, instructions: Iterable[Instruction]) -> list[Instruction]:
        """Return the instructions that are not watched yet."""
        return [each for each in instructions if self._watched.get(each.address) != each.text]

    def watch(self, instructions: Iterable[Instruction], first: int, end: int) -> None:
        """Have instructions looked at each time before they run.

        Few instructions are such, so a hook on each costs little; what the emulator
        has translated of the code from `first` to `end` must go, or it would not know of them.
        """
        for instruction in self.unwatched(instructions):
            self._watched[instruction.address] = instruction.text
            code = self._memory.read(instruction.address, instruction.size)
            self._look_before(instruction.address, code, partial(self._look, instruction))
        self._engine.ctl_remove_cache(first, end)

    def _look_before(self, address: int, code: bytes, look: Callable[[], None]) -> None:
        """Call `look` before the instruction at an address runs, while it is still that one."""
        hooked = address in self._looks
        self._looks[address] = code, look
        if not hooked:
            add_hook(self._engine, unicorn.UC_HOOK_CODE, self._instruction_hook, within=(address, address))

    def _on_instruction(self, _engine: int, address: int, _size: int, _data: int) -> None:
        try:
            code, look = self._looks[address]
            if self._memory.read(address, len(code)) == code:  # firmware may have put other code there
                look()
        except BaseException as error:  # re-raised by the processor; ctypes would print and drop it
            self._abort(error)

    def _look(self, instruction: Instruction) -> None:
        address = instruction.address
        if instruction.uses_fpu and not self.fpu_enabled:
            self._found(FaultKind.NO_COPROCESSOR, "FPU used while CPACR disables it (NOCP)", address)
            self._stop()
        elif instruction.aligned_base >= 0:
            value = self._registers.cores((instruction.aligned_base,)).get()
            if value & 3:
                cause = f"unaligned access: r{instruction.aligned_base} = 0x{value:08x} in '{instruction.text}'"
                self._found(FaultKind.UNALIGNED, cause, address)
                self._stop()

    def watch_divisions(self, image: FirmwareImage) -> None:
        """Have every division of an image looked at; data that looks like one is never executed."""
        for address, code in _divisions(image):
            if address not in self._looks:
                self._look_before(address, code, partial(self._look_at_divisor, address, code[2] & 0xF))
        self._engine.ctl_flush_tb()

    def _look_at_divisor(self, address: int, divisor: int) -> None:
        if self.traps_division_by_zero and self._registers.cores((divisor,)).get() == 0:
            self._found(FaultKind.DIVIDE_BY_ZERO, f"division by zero: r{divisor}", address)
            self._stop()
