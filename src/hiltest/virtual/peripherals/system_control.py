"""The processor's own peripherals: NVIC, SCB and SysTick."""

from __future__ import annotations

import math
from collections.abc import Callable

from hiltest.virtual.clock import Clock
from hiltest.virtual.cpu import Processor
from hiltest.virtual.nvic import FIRST_INTERRUPT, INTERRUPTS, NMI, PENDSV, SYSTICK
from hiltest.virtual.peripherals.bus import ALL_STEADY
from hiltest.virtual.peripherals.cycle_counter import CycleCounter
from hiltest.virtual.peripherals.fault_registers import CFSR, HFSR, FaultRegisters
from hiltest.virtual.schedule import Event
from hiltest.virtual.turn import Counting

_CPUID = 0x410FC241  # Cortex-M4 r0p1
_ICSR, _VTOR, _AIRCR, _SCR, _CCR, _SHPR1, _CPACR = 0xD04, 0xD08, 0xD0C, 0xD10, 0xD14, 0xD18, 0xD88
_DEMCR, _STIR, _FPCCR, _FPCAR = 0xDFC, 0xF00, 0xF34, 0xF38
_CCR_STKALIGN, _CCR_DIV_0_TRP, _CCR_NONBASETHRDENA = 1 << 9, 1 << 4, 1 << 0
_SCR_SLEEPONEXIT, _SCR_SLEEPDEEP, _SCR_SEVONPEND = 1 << 1, 1 << 2, 1 << 4
_ICSR_SETS = {31: NMI, 28: PENDSV, 26: SYSTICK}  # the bit below the last two clears
_FPU_FULL_ACCESS = 0xF << 20
_TRCENA = 1 << 24
_CLKSOURCE = 1 << 2  # of SysTick's CSR


class SysTick:
    """The 24-bit system timer; on this part it counts the core clock, whatever CLKSOURCE is written."""

    def __init__(self, processor: Processor, core: Clock) -> None:
        self._nvic = processor.nvic
        self._accounting = processor.accounting
        self._core = core
        self._event: Event | None = None
        self.reset()

    def reset(self) -> None:
        """Return to the state after reset: disabled."""
        self._cancel()
        self._control = _CLKSOURCE
        self._reload = 0
        self._expires_at = 0  # tick behind that at which it is zero, while it counts
        self._held = 0  # the count while it does not
        self._flag = False

    def _value(self) -> int:
        return self._value_at(self._core.now())

    def _value_at(self, tick: int) -> int:
        if self._event is None:
            return self._held
        return max(self._expires_at - tick - 1, 0) & 0xFFFFFF

    def counting(self) -> Counting:
        """Return how CVR counts: down to zero, which is an event."""
        return Counting(lambda cycle: self._value_at(self._core.ticks_at(cycle)), rises=False, until=math.inf)

    def read(self, offset: int) -> int:
        """Answer CSR, RVR, CVR or CALIB; reading CSR clears COUNTFLAG."""
        if offset == 0x10:
            flag, self._flag = self._flag, False
            if flag:
                self._accounting.end_watch()
            return self._control | (1 << 16 if flag else 0)
        return {0x14: self._reload, 0x18: self._value()}.get(offset, 0xC0000000)

    def write(self, offset: int, value: int) -> None:
        """Take CSR, RVR or CVR; any write to CVR clears the count."""
        if offset == 0x10:
            self._held = self._value()
            was_enabled, self._control = self._control & 1, value & 3 | _CLKSOURCE
            if self._control & 1 and not was_enabled:
                self._start(self._held)
            elif not self._control & 1:
                self._cancel()
        elif offset == 0x14:
            self._reload = value & 0xFFFFFF
            if self._control & 1 and self._event is None:  # it stands at zero
                self._start(0)
        elif offset == 0x18:
            self._flag = False
            self._held = 0
            if self._control & 1:
                self._start(0)

    def _cancel(self) -> None:
        if self._event is not None:
            self._event.cancel()
            self._event = None

    def _start(self, held: int) -> None:
        """Count on from a value, or from the reload value if that is zero; with none it stays at zero."""
        self._cancel()
        if held or self._reload:
            self._expire_at(self._core.now() + (held or self._reload) + 1)

    def _expire_at(self, tick: int) -> None:
        self._expires_at = tick
        self._event = self._core.at(tick, self._expire)

    def _expire(self) -> None:
        self._flag = True
        self._event = None
        self._held = 0
        if self._control & 2:
            self._nvic.pend(SYSTICK)
        if self._reload:
            self._expire_at(self._expires_at + self._reload + 1)


class SystemControlSpace:
    """The page at 0xE000E000: SysTick, NVIC and SCB.

    Parameters
    ----------
    processor : Processor
        Processor that the registers belong to.
    core : Clock
        The core clock, which SysTick counts.
    counter : CycleCounter
        Is enabled by DEMCR.
    request_reset : callable
        Called when AIRCR asks for a system reset.
    """

    name = "SCS"
    base = 0xE000E000
    counters = frozenset(range(0x18, 0x1C))  # SysTick's CVR
    steady = frozenset(ALL_STEADY) - counters

    def __init__(
        self, processor: Processor, core: Clock, counter: CycleCounter, request_reset: Callable[[], None]
    ) -> None:
        self.clocked = True
        self._processor = processor
        self._counter = counter
        self._request_reset = request_reset
        self._systick = SysTick(processor, core)
        self._faults = FaultRegisters(processor.exceptions, processor.nvic)
        self.reset()

    def reset(self) -> None:
        """State after a processor reset."""
        self._systick.reset()
        self._stored: dict[int, int] = {_CCR: _CCR_STKALIGN}
        self._processor.fpu_enabled = False
        waiting = self._processor.waiting
        waiting.sleeps_on_exit = waiting.sleeps_deeply = False
        self._processor.event_register.reset()
        self._processor.trap_division_by_zero(False)

    def read(self, offset: int, size: int) -> int:
        """Answer a register; byte access is for priorities."""
        word = self._read_word(offset & ~3)
        return word >> 8 * (offset & 3)

    def counting(self, _offset: int) -> Counting:
        """Return how SysTick counts."""
        return self._systick.counting()

    def _read_word(self, offset: int) -> int:
        nvic = self._processor.nvic
        if 0x10 <= offset <= 0x1C:
            return self._systick.read(offset)
        if 0x100 <= offset < 0x380:
            kind, first = offset & 0xF80, 32 * (offset & 0x7F) // 4
            return self._bits(kind, first)
        if 0x400 <= offset < 0x400 + INTERRUPTS:
            return self._priorities(FIRST_INTERRUPT + offset - 0x400)
        if _SHPR1 <= offset < _SHPR1 + 12:
            return self._priorities(4 + offset - _SHPR1)
        if offset == _ICSR:
            return self._interrupt_control()
        if offset in FaultRegisters.offsets:
            return self._faults.read(offset)
        if offset == _AIRCR:
            return 0xFA050000 | nvic.priority_grouping << 8
        exceptions = self._processor.exceptions
        answers = {
            0x004: 2, 0xD00: _CPUID, _VTOR: exceptions.vector_table,
            _FPCCR: exceptions.floating_control | bool(exceptions.lazy_frame), _FPCAR: exceptions.lazy_frame,
        }  # fmt: skip
        return answers.get(offset, self._stored.get(offset, 0))

    def _interrupt_control(self) -> int:
        nvic = self._processor.nvic
        word = nvic.active[-1] if nvic.active else 0
        word |= (len(nvic.active) <= 1) << 11  # RETTOBASE
        word |= (nvic.most_urgent() or 0) << 12
        word |= any(exception >= FIRST_INTERRUPT for exception in nvic.pending) << 22
        return word | sum((exception in nvic.pending) << bit for bit, exception in _ICSR_SETS.items())

    def _bits(self, kind: int, first: int) -> int:
        nvic = self._processor.nvic
        word = 0
        for bit in range(min(32, max(INTERRUPTS - first, 0))):
            number = first + bit
            if kind in (0x100, 0x180):
                state = nvic.enabled[number]
            elif kind in (0x200, 0x280):
                state = FIRST_INTERRUPT + number in nvic.pending
            else:
                state = FIRST_INTERRUPT + number in nvic.active
            word |= state << bit
        return word

    def _priorities(self, first: int) -> int:
        priority = self._processor.nvic.priority
        return sum(priority.get(first + index, 0) << 8 * index for index in range(4))

    def write(self, offset: int, size: int, value: int) -> None:
        """Take a register."""
        nvic = self._processor.nvic
        if 0x10 <= offset <= 0x1C:
            self._systick.write(offset, value)
        elif 0x100 <= offset < 0x300:
            self._set_bits(offset & 0xF80, 8 * (offset & 0x7F), size, value)
        elif 0x400 <= offset < 0x400 + INTERRUPTS:
            self._set_priorities(FIRST_INTERRUPT + offset - 0x400, size, value)
        elif _SHPR1 <= offset < _SHPR1 + 12:
            self._set_priorities(4 + offset - _SHPR1, size, value)
        elif offset == _ICSR:
            for bit, exception in _ICSR_SETS.items():
                if value >> bit & 1:
                    nvic.pend(exception)
                elif exception != NMI and value >> (bit - 1) & 1:
                    nvic.pending.discard(exception)
        elif offset == _STIR:
            if value & 0x1FF < INTERRUPTS:
                nvic.pend(FIRST_INTERRUPT + (value & 0x1FF))
        else:
            word, shift = offset & ~3, 8 * (offset & 3)
            if size < 4:  # a part of a word; beside ones that clear, zeros change nothing
                kept = 0 if word in (CFSR, HFSR) else self._read_word(word) & ~((1 << 8 * size) - 1 << shift)
                value = kept | value << shift
            self._write_scb(word, value)

    def _write_scb(self, offset: int, value: int) -> None:
        processor = self._processor
        if offset == _VTOR:
            processor.exceptions.vector_table = value & ~0x7F
        elif offset == _AIRCR:
            self._write_aircr(value)
        elif offset in FaultRegisters.offsets:
            self._faults.write(offset, value)
        elif offset == _FPCCR:
            processor.exceptions.floating_control = value & ~1
        else:
            self._stored[offset] = value
            if offset == _CPACR:
                processor.fpu_enabled = value & _FPU_FULL_ACCESS == _FPU_FULL_ACCESS
                processor.look_soon()  # what counts may not ask again before each block that uses it
            elif offset == _SCR:
                processor.waiting.sleeps_on_exit = bool(value & _SCR_SLEEPONEXIT)
                processor.waiting.sleeps_deeply = bool(value & _SCR_SLEEPDEEP)
                processor.event_register.on_pend = bool(value & _SCR_SEVONPEND)
            elif offset == _CCR:
                processor.exceptions.base_thread_enabled = bool(value & _CCR_NONBASETHRDENA)
                processor.trap_division_by_zero(bool(value & _CCR_DIV_0_TRP))
            elif offset == _DEMCR:
                self._counter.enable_trace(bool(value & _TRCENA))

    def _write_aircr(self, value: int) -> None:
        if value >> 16 != 0x05FA:  # the key
            return
        self._processor.nvic.priority_grouping = value >> 8 & 7
        if value & 4:
            self._request_reset()

    def _set_bits(self, kind: int, first: int, size: int, value: int) -> None:
        nvic = self._processor.nvic
        for bit in range(8 * size):
            number = first + bit
            if not value >> bit & 1 or number >= INTERRUPTS:
                continue
            if kind in (0x100, 0x180):
                nvic.set_enabled(number, kind == 0x100)
            elif kind == 0x200:
                nvic.pend(FIRST_INTERRUPT + number)
            else:
                nvic.clear_pending(number)

    def _set_priorities(self, first: int, size: int, value: int) -> None:
        for index in range(size):
            self._processor.nvic.set_priority(first + index, value >> 8 * index & 0xFF)
