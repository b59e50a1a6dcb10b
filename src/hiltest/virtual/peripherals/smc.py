"""SMC, LLWU and PMC: sleep modes, the clocks in them, and wake-up."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from enum import Enum

from hiltest.state import Restorable
from hiltest.virtual.part.chip import ChipPeripheral
from hiltest.virtual.peripherals.bus import StoredRegisters, read_by_bytes, write_by_bytes
from hiltest.virtual.peripherals.port import Port
from hiltest.virtual.peripherals.sim import ClockGates
from hiltest.virtual.processor.cpu import Processor

_PMPROT, _PMCTRL, _VLLSCTRL, _PMSTAT = range(4)
_AVLLS, _ALLS, _AVLP = 0x02, 0x08, 0x20
_STOP, _VLPS, _LLS, _VLLS = 0, 2, 3, 4  # PMCTRL.STOPM
_VLPR = 2  # PMCTRL.RUNM
_EREFSTEN = 0x20  # OSC_CR: OSCERCLK continues in STOP
_PE1, _ME, _F1, _F2, _F3, _LAST = 0x0, 0x4, 0x5, 0x6, 0x7, 0xA
_REGSC, _ACKISO = 0x2, 0x08
# LLWU_P0 to P15.
_PINS = ("E1", "E2", "E4", "A4", "A13", "B0", "C1", "C3", "C4", "C5", "C6", "C11", "D0", "D2", "D4", "D6")
_MODULES = {58: 0, 46: 5, 47: 7}  # by interrupt: LPTMR, the RTC's alarm and its seconds
# Interrupts that need no clock: PMC, LLWU, WDOG, I2C, UART, ADC, CMP, RTC, USB, MCG, LPTMR, ports.
_ASYNCHRONOUS = (20, 21, 22, 24, 25, 31, 33, 35, 37, 39, 40, 41, 46, 47, 53, 54, *range(57, 64), 66, 68, 70, 73, 74)


class SleepMode(Enum):
    """Sleep mode that WFI enters: its name, and its value in PMSTAT."""

    WAIT = "WAIT", 0x01
    VLPW = "VLPW", 0x08
    STOP = "STOP", 0x02
    VLPS = "VLPS", 0x10
    LLS = "LLS", 0x20
    VLLS = "VLLS", 0x40

    @property
    def gated(self) -> bool:
        """Return whether only the LLWU ends the mode."""
        return self in (SleepMode.LLS, SleepMode.VLLS)


class WakeUpUnit(Restorable):
    """LLWU, which ends LLS and VLLS; the registers of its filters only store writes.

    Parameters
    ----------
    ports
        Ports of the wake-up pins, by letter.
    """

    steady = range(0x1000)

    def __init__(self, module: ChipPeripheral, processor: Processor, ports: Mapping[str, Port]) -> None:
        self.name = module.name
        self.base = module.base
        self.clocked = True
        self.on_wake: Callable[[], None] = lambda: None
        self.keeps = False  # flags survive the reset that ends VLLS
        (self._interrupt,) = module.interrupts
        self._initial = bytes(register.reset for register in module.registers)
        self._nvic = processor.nvic
        processor.waiting.on_events = self._check_modules
        for letter, port in ports.items():
            port.on_levels = self._watch(letter)
            port.watch(sum(1 << int(pin[1:]) for pin in _PINS if pin[0] == letter))
        self.reset()

    def _watch(self, letter: str) -> Callable[[int, int], None]:
        inputs = {number: int(pin[1:]) for number, pin in enumerate(_PINS) if pin[0] == letter}

        def check_pins(rose: int, fell: int) -> None:
            for number, pin in inputs.items():
                edges = (rose >> pin & 1) | (fell >> pin & 1) << 1
                if edges & self._registers[_PE1 + number // 4] >> 2 * (number % 4):
                    self._raise(_F1 + number // 8, number % 8)

        return check_pins

    def reset(self) -> None:
        if not self.keeps:
            self._registers = bytearray(self._initial)
        self.asleep = False
        self._drive()

    @property
    def has_source(self) -> bool:
        """Return whether any pin or module is enabled as a source of wake-up."""
        return any(self._registers[_PE1 : _ME + 1])

    def sleep(self) -> None:
        """React to the sources from now on; a module whose interrupt is already active wakes the part at once."""
        self.asleep = True
        self._check_modules()

    def _check_modules(self) -> None:
        for interrupt, module in _MODULES.items():
            if self._nvic.is_driven(interrupt) and self._registers[_ME] >> module & 1:
                self._raise(_F3, module)

    def _raise(self, register: int, bit: int) -> None:
        if self.asleep:
            self.asleep = False
            self._registers[register] |= 1 << bit
            self._drive()
            self.on_wake()

    def _drive(self) -> None:
        self._nvic.set_line(self._interrupt, any(self._registers[_F1 : _F3 + 1]))

    def read(self, offset: int, size: int) -> int:
        if size > 1:
            return read_by_bytes(self, offset, size)
        return self._registers[offset] if offset <= _LAST else 0

    def write(self, offset: int, size: int, value: int) -> None:
        """Write a byte register; ones clear flags of pins, and flags of modules are cleared in the modules."""
        if size > 1:
            write_by_bytes(self, offset, size, value)
        elif offset in (_F1, _F2):
            self._registers[offset] &= ~value
        elif offset <= _LAST and offset != _F3:
            self._registers[offset] = value
        for interrupt, module in _MODULES.items():
            if not self._nvic.is_driven(interrupt):
                self._registers[_F3] &= ~(1 << module)
        self._drive()


class PowerManagement(StoredRegisters):
    """PMC, with a supply voltage that is never too low; REGSC shows the isolation of pins after VLLS."""

    def write(self, offset: int, size: int, value: int) -> None:
        """Store the value; a one in REGSC.ACKISO ends the isolation."""
        before = self._bytes[_REGSC]
        super().write(offset, size, value)
        if offset == _REGSC:
            self._bytes[_REGSC] = value & 0x11 | 0x04 | (before & ~value & _ACKISO)

    def isolate(self) -> None:
        """Isolate the pins, as after VLLS."""
        self._bytes[_REGSC] |= _ACKISO


class SystemModes(StoredRegisters):
    """SMC: the run and sleep modes.

    VLPR changes only the mode: its limits of the clocks are not checked.

    Parameters
    ----------
    wake_up
        Called with the number of the VLLS mode when it ends; resets the part.
    """

    def __init__(
        self,
        module: ChipPeripheral,
        processor: Processor,
        clocks: ClockGates,
        oscillator: StoredRegisters,
        unit: WakeUpUnit,
        wake_up: Callable[[int], None],
    ) -> None:
        self._processor = processor
        self._clocks = clocks
        self._oscillator = oscillator
        self._unit = unit
        self._wake_up = wake_up
        self.asleep_in: SleepMode | None = None
        unit.on_wake = self._wake
        processor.waiting.on_sleep = self._sleep
        super().__init__(
            module.name, module.base, {register.address - module.base: register.reset for register in module.registers}
        )

    def write(self, offset: int, size: int, value: int) -> None:
        """Write a byte register: PMPROT once, and to PMCTRL only modes that PMPROT allows."""
        if size > 1:
            write_by_bytes(self, offset, size, value)
        elif offset == _PMPROT and not self._bytes[_PMPROT]:
            self._bytes[_PMPROT] = value & (_AVLLS | _ALLS | _AVLP)
        elif offset == _VLLSCTRL:
            self._bytes[_VLLSCTRL] = value & 0x27
        elif offset == _PMCTRL:
            self._set_modes(value)

    def _set_modes(self, value: int) -> None:
        allowed, before = self._bytes[_PMPROT], self._bytes[_PMCTRL]
        needed = {_VLPS: _AVLP, _LLS: _ALLS, _VLLS: _AVLLS}.get(value & 7, 0)
        stop = value & 7 if needed & allowed == needed else before & 7
        runs_low = value >> 5 & 3 == _VLPR and allowed & _AVLP
        self._bytes[_PMCTRL] = value & 0x80 | (_VLPR << 5 if runs_low else 0) | stop
        self._bytes[_PMSTAT] = 0x04 if runs_low else 0x01

    # -- sleep --------------------------------------------------------------------------------

    @property
    def _mode(self) -> SleepMode:
        """Return the mode that WFI enters now."""
        low = self._bytes[_PMSTAT] == 0x04
        if not self._processor.waiting.sleeps_deeply:
            return SleepMode.VLPW if low else SleepMode.WAIT
        chosen = {_VLPS: SleepMode.VLPS, _LLS: SleepMode.LLS, _VLLS: SleepMode.VLLS}
        return chosen.get(self._bytes[_PMCTRL] & 7, SleepMode.VLPS if low else SleepMode.STOP)

    def _sleep(self, begins: bool) -> None:
        """Stop the clocks when WFI begins, and start them when it ends."""
        before, self.asleep_in = self.asleep_in, self._mode if begins else None
        if begins and self.asleep_in not in (SleepMode.WAIT, SleepMode.VLPW):
            external = bool(self._oscillator.word(0) & _EREFSTEN)
            self._clocks.stop(external_runs=external and self.asleep_in is not SleepMode.VLLS)
            self._processor.waiting.gated = self.asleep_in is not None and self.asleep_in.gated
            if self._processor.waiting.gated:
                self._unit.sleep()
        elif before not in (None, SleepMode.WAIT, SleepMode.VLPW):
            self._processor.waiting.gated = self._unit.asleep = False
            self._clocks.restart(from_stop=before is SleepMode.STOP)

    def _wake(self) -> None:
        if self.asleep_in is SleepMode.VLLS:
            self._wake_up(self._bytes[_VLLSCTRL] & 7)
        self._processor.waiting.gated = False
        self._processor.return_soon()

    def describe(self) -> str:
        """Return a description of the present sleep mode."""
        mode = self.asleep_in
        if mode in (None, SleepMode.WAIT, SleepMode.VLPW):
            return ""
        wakes = self._unit.has_source if mode.gated else any(map(self._processor.nvic.is_enabled, _ASYNCHRONOUS))
        return f" ({mode.value[0]}{'' if wakes else ', with no source of wake-up enabled'})"
