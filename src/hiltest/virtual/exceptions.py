"""Entering and leaving exceptions as ARMv7-M does: stacking, EXC_RETURN, lazy FPU state."""

from __future__ import annotations

from hiltest.virtual.memory import BoardMemory
from hiltest.virtual.nvic import Nvic
from hiltest.virtual.registers import CoreRegisters

_BASIC_BYTES, _EXTENDED_BYTES = 32, 104
_XPSR_REALIGNED = 1 << 9
_APSR = 0xF80F0000  # flags and GE bits, which an exception handler inherits
_THUMB = 1 << 24
_NO_FRAME = 0


class VectorError(Exception):
    """The vector of an exception has no Thumb bit: the part would take a fault instead."""


class ExceptionUnit:
    """Moves register frames to and from the stack.

    Floating-point state is stacked lazily, as at reset (FPCCR.ASPEN, LSPEN): room
    is reserved at entry and filled when the handler first uses the FPU.
    """

    def __init__(self, registers: CoreRegisters, memory: BoardMemory, nvic: Nvic) -> None:
        self._registers = registers
        self._memory = memory
        self._nvic = nvic
        self.vector_table = 0
        self.reset()

    def reset(self) -> None:
        """State after a processor reset."""
        self.vector_table = 0
        self._floating_active = False  # CONTROL.FPCA
        self._lazy_frame = _NO_FRAME  # where the floating-point state belongs while it is not yet saved

    def floating_point_runs(self) -> None:
        """A floating-point instruction is about to run."""
        if self._lazy_frame != _NO_FRAME:
            self._memory.write_words(self._lazy_frame, self._registers.floating_frame.read())
            self._lazy_frame = _NO_FRAME
        self._floating_active = True

    def take(self) -> bool:
        """Enter the most urgent deliverable exception, if there is one.

        Raises
        ------
        VectorError
            When its vector is none.
        """
        exception = self._nvic.next_exception(ceiling=self._ceiling())
        if exception is None:
            return False
        self._enter(exception)
        return True

    def _ceiling(self) -> int:
        primask, faultmask, basepri = self._registers.masks.read()
        if primask & 1 or faultmask & 1:
            return 0
        return basepri & 0xFF or 256

    def _enter(self, exception: int) -> None:
        registers = self._registers
        *frame, stack, control = registers.interrupted.read()
        xpsr = frame[7]
        from_handler = xpsr & 0x1FF != 0
        uses_psp = not from_handler and control & 2 != 0
        extended = self._floating_active
        base = (stack - (_EXTENDED_BYTES if extended else _BASIC_BYTES)) & ~7
        realigned = base + (_EXTENDED_BYTES if extended else _BASIC_BYTES) != stack
        frame[7] = (xpsr | _XPSR_REALIGNED) if realigned else (xpsr & ~_XPSR_REALIGNED)
        frame[6] &= ~1
        self._memory.write_words(base, frame)
        if extended:
            self._lazy_frame = base + _BASIC_BYTES
        self._floating_active = False
        exc_return = 0xFFFFFFE1 | (0 if extended else 0x10) | (0 if from_handler else 0x08) | (0x04 if uses_psp else 0)
        handler = self._memory.read_words(self.vector_table + 4 * exception, 1)[0]
        if not handler & 1:
            raise VectorError(f"vector 0x{handler:08x} of exception {exception} has no Thumb bit")
        registers.entry.write([base, (xpsr & _APSR) | _THUMB | exception, exc_return, handler])
        self._nvic.enter(exception)

    def leave(self, exc_return: int) -> None:
        """Return from the exception being handled.

        Parameters
        ----------
        exc_return : int
            The EXC_RETURN value that was branched to; bit 0 does not matter.
        """
        registers = self._registers
        uses_psp = exc_return & 0x04 != 0
        extended = exc_return & 0x10 == 0
        base = (registers.psp if uses_psp else registers.msp).get()
        frame = list(self._memory.read_words(base, 8))
        if extended and self._lazy_frame == _NO_FRAME:
            registers.floating_frame.write(self._memory.read_words(base + _BASIC_BYTES, 17))
        self._lazy_frame = _NO_FRAME
        self._floating_active = extended
        self._nvic.leave()
        end = base + (_EXTENDED_BYTES if extended else _BASIC_BYTES) + (4 if frame[7] & _XPSR_REALIGNED else 0)
        frame[6] |= 1
        frame[7] &= ~_XPSR_REALIGNED
        if exc_return & 0x08:
            control = registers.control.get()
            if bool(control & 2) != uses_psp:
                registers.xpsr.set(frame[7])  # CONTROL.SPSEL can change in thread mode only
                registers.control.set(control ^ 2)
        registers.resumed.write([frame[7], end, *frame])
