"""PORT and GPIO: configuration, output and level of pins, and interrupts of their edges."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from hiltest.state import Restorable
from hiltest.virtual.part.chip import ChipPeripheral
from hiltest.virtual.peripherals.bus import ALL_STEADY, StoredRegisters
from hiltest.virtual.peripherals.pin_signals import PinSignal
from hiltest.virtual.processor.nvic import Nvic

_GPCLR, _GPCHR, _ISFR = 0x80, 0x84, 0xA0
_PDOR, _PSOR, _PCOR, _PTOR, _PDIR, _PDDR = range(0, 0x18, 4)
_GPIO_SPACING = 0x40
_MUX_GPIO = 1
_ISF = 1 << 24
_ALL = 0xFFFFFFFF
_IRQC_LOW, _IRQC_RISING, _IRQC_FALLING, _IRQC_EITHER, _IRQC_HIGH = range(8, 13)


class Port(StoredRegisters):
    """The 32 pins of one port, with the PORT module's registers.

    Parameters
    ----------
    module : ChipPeripheral
        The PORT module.
    nvic : Nvic
        Gets the port's interrupt.
    initial : dict of int to int
        Bytes of the registers that are not zero after reset.

    Attributes
    ----------
    followed : int
        Pins whose changes `on_change` must not miss; of others that a timer drives, only PORT interrupts are told.
    driven_low : int
        Pins that the processor pulls low.
    on_change : callable
        Told after levels or `driven_low` have changed.
    on_levels : callable
        Told which pins rose and which fell.
    """

    steady = ALL_STEADY

    def __init__(self, module: ChipPeripheral, nvic: Nvic, initial: dict[int, int]) -> None:
        self._nvic = nvic
        (self._interrupt,) = module.interrupts
        self._outside = 0  # pins that something outside the chip gives a level, and which
        self._outside_high = 0
        self.followed = 0
        self._levels = 0
        self.driven_low = 0
        self.on_change: Callable[[Port], None] = lambda _port: None
        self.on_levels: Callable[[int, int], None] = lambda _rose, _fell: None
        self._signals: dict[tuple[int, int], PinSignal] = {}  # by pin and what its multiplexer selects
        self._carried: dict[int, PinSignal] = {}  # by pin
        self._heard: set[PinSignal] = set()  # of them, those whose every edge has a consequence here
        self._silent = 0  # pins that the others drive
        super().__init__(module.name, module.base, initial)

    def reset(self) -> None:
        """Return to the state after a chip reset; what is outside stays as it is."""
        super().reset()
        self._output = 0  # PDOR
        self._direction = 0  # PDDR
        self._flags = 0  # ISFR
        self._configured()

    # -- the world outside --------------------------------------------------------------------

    def drive(self, pin: int, high: bool) -> None:
        """Give a pin a level from outside."""
        self._outside |= 1 << pin
        self._outside_high = self._outside_high & ~(1 << pin) | high << pin
        self._settle()

    def lead(self, pin: int, function: int, signal: PinSignal) -> None:
        """Connect a signal of a peripheral to a pin, for when its multiplexer selects that function."""
        self._signals[pin, function] = signal

    @property
    def levels(self) -> int:
        """Levels of the pins: bit n is that of pin n."""
        if self._silent or self._carried:
            self._settle()
        return self._levels

    # -- PORT ---------------------------------------------------------------------------------

    def read(self, offset: int, size: int) -> int:
        """Answer a register; interrupt flags stand in ISFR and in each pin's own."""
        word = self._flags if offset & ~3 == _ISFR else self.word(offset & ~3)
        if offset < _GPCLR and self._flags >> (offset >> 2) & 1:
            word |= _ISF
        return word >> 8 * (offset & 3)

    def write(self, offset: int, size: int, value: int) -> None:
        """Take a register; ones clear interrupt flags."""
        value <<= 8 * (offset & 3)
        register = offset & ~3
        if register == _ISFR:
            self._flags &= ~value
            self._settle()
            return
        if register in (_GPCLR, _GPCHR):
            first = 0 if register == _GPCLR else 16
            for pin in range(16):
                if value >> (16 + pin) & 1:
                    super().write(4 * (first + pin), 2, value & 0xFFFF)
        else:
            if register < _GPCLR and value & _ISF:
                self._flags &= ~(1 << (register >> 2))
                value &= ~_ISF
            super().write(offset, size, value >> 8 * (offset & 3))
        self._configured()

    def _configured(self) -> None:
        """Gather what the pin control registers say into one mask for each question."""
        self._gpio = self._digital = self._pull_up = 0
        self._edge_up = self._edge_down = self._at_low = self._at_high = 0
        for pin in range(32):
            control, bit = self.word(4 * pin), 1 << pin
            if not control:
                continue
            mux, condition = control >> 8 & 7, control >> 16 & 0xF
            self._digital |= bit if mux else 0
            self._gpio |= bit if mux == _MUX_GPIO else 0
            self._pull_up |= bit if control & 3 == 3 else 0
            self._edge_up |= bit if condition in (_IRQC_RISING, _IRQC_EITHER) else 0
            self._edge_down |= bit if condition in (_IRQC_FALLING, _IRQC_EITHER) else 0
            self._at_low |= bit if condition == _IRQC_LOW else 0
            self._at_high |= bit if condition == _IRQC_HIGH else 0
        self._connect()
        self._settle()

    def _connect(self) -> None:
        """Carry the signals that the multiplexers select, and hear those of pins where each edge counts."""
        self._carried = {
            pin: signal
            for (pin, function), signal in self._signals.items()
            if self.word(4 * pin) >> 8 & 7 == function
        }
        followed = self._edge_up | self._edge_down | self._at_low | self._at_high | self.followed
        heard = {signal for pin, signal in self._carried.items() if followed >> pin & 1}
        for signal in heard - self._heard:
            signal.hear(self._settle)
        for signal in self._heard - heard:
            signal.leave(self._settle)
        self._heard = heard

    def _settle(self) -> None:
        """Find every pin's level, and what follows from it."""
        before, driven_before, unseen = self._levels, self.driven_low, self._silent
        self._silent = 0
        driving, output = self._direction & self._gpio, self._output
        for pin, signal in self._carried.items():
            if (level := signal.level()) is not None:
                driving |= 1 << pin
                output = output & ~(1 << pin) | level << pin
                self._silent |= (signal not in self._heard) << pin
        unseen |= self._silent  # when these have changed is not known
        resting = self._outside & self._outside_high | ~self._outside & self._pull_up
        self._levels = (driving & output | ~driving & resting) & self._digital
        self.driven_low = driving & ~output
        rose, fell = self._levels & ~before & ~unseen, before & ~self._levels & ~unseen
        self._flags |= rose & self._edge_up | fell & self._edge_down
        self._flags |= (self._levels & self._at_high | ~self._levels & self._at_low) & self._digital
        self._nvic.set_line(self._interrupt, bool(self._flags))
        if rose or fell or self.driven_low != driven_before:
            self.on_change(self)
        if rose or fell:
            self.on_levels(rose, fell)
        for pin, signal in self._carried.items():
            if (rose | fell) >> pin & 1 and signal.level() is None:
                signal.on_level(bool(rose >> pin & 1))

    # -- GPIO ---------------------------------------------------------------------------------

    def gpio_read(self, offset: int) -> int:
        """Answer a GPIO register; those that set, clear and toggle read as zero."""
        return {_PDOR: self._output, _PDIR: self.levels, _PDDR: self._direction}.get(offset, 0)

    def gpio_write(self, offset: int, value: int, mask: int) -> None:
        """Take the bits of a GPIO register that `mask` says are written."""
        if offset == _PDOR:
            self._output = self._output & ~mask | value
        elif offset == _PSOR:
            self._output |= value
        elif offset == _PCOR:
            self._output &= ~value
        elif offset == _PTOR:
            self._output ^= value
        elif offset == _PDDR:
            self._direction = self._direction & ~mask | value
        self._settle()


class Gpio(Restorable):
    """The GPIO modules of all ports, on one page.

    Parameters
    ----------
    ports : sequence of Port
        A to E.
    """

    name = "GPIO"
    base = 0x400FF000
    steady = ALL_STEADY

    def __init__(self, ports: Sequence[Port]) -> None:
        self.clocked = True
        self._ports = ports

    def reset(self) -> None:
        """The ports return to their own reset state."""

    def read(self, offset: int, size: int) -> int:
        """Answer a register, or a part of one."""
        index, register = divmod(offset, _GPIO_SPACING)
        if index >= len(self._ports):
            return 0
        return self._ports[index].gpio_read(register & ~3) >> 8 * (offset & 3)

    def write(self, offset: int, size: int, value: int) -> None:
        """Take a register, or a part of one."""
        index, register = divmod(offset, _GPIO_SPACING)
        if index < len(self._ports):
            shift = 8 * (offset & 3)
            self._ports[index].gpio_write(register & ~3, value << shift, (1 << 8 * size) - 1 << shift & _ALL)
