"""SIM, MCG and OSC: which clocks run, how fast, and which peripherals have one."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from hiltest.virtual.chip import mk64f12
from hiltest.virtual.peripherals.bus import Peripheral, StoredRegisters, read_by_bytes, write_by_bytes
from hiltest.virtual.unique_id import VIRTUAL_UNIQUE_ID

OSCILLATOR_HZ = 50_000_000  # the Ethernet PHY's clock on EXTAL0
_SLOW_REFERENCE_HZ = 32_768
_FAST_REFERENCE_HZ = 4_000_000
_SCGC_FIRST, _SCGC_LAST = 0x028, 0x040  # SCGC1..SCGC7 in the page at 0x40048000
_CLKDIV1 = 0x044


class ClockGenerator:
    """MCG: the multipurpose clock generator, locked as soon as it is set up."""

    name = "MCG"
    base = 0x40064000

    def __init__(self) -> None:
        self.clocked = True
        self.on_change: Callable[[], None] = lambda: None
        self.reset()

    def reset(self) -> None:
        """FEI: FLL on the internal reference."""
        self._registers = bytearray(0x10)
        self._registers[0] = 0x04  # C1: IREFS
        self._registers[1] = 0x80  # C2: LOCRE0
        self.on_change()

    def read(self, offset: int, size: int) -> int:
        """Answer a register; S follows from what was set up."""
        if size > 1:
            return read_by_bytes(self, offset, size)
        if offset >= len(self._registers):
            return 0
        return self._status() if offset == 6 else self._registers[offset]

    def write(self, offset: int, size: int, value: int) -> None:
        """Take a byte; S is read-only."""
        if size > 1:
            write_by_bytes(self, offset, size, value)
        elif offset < len(self._registers) and offset != 6:
            self._registers[offset] = value
            self.on_change()

    @property
    def _source(self) -> int:
        return self._registers[0] >> 6

    @property
    def _pll_selected(self) -> bool:
        return bool(self._registers[5] & 0x40)

    @property
    def _pll_runs(self) -> bool:
        """Whether PLLS or PLLCLKEN0 has it running; never in BLPI and BLPE."""
        bypassed_at_low_power = self._source != 0 and self._registers[1] & 0x02
        return not bypassed_at_low_power and (self._pll_selected or bool(self._registers[4] & 0x40))

    def _status(self) -> int:
        internal = bool(self._registers[0] & 0x04)
        clock = {0: 3 if self._pll_selected else 0, 1: 1}.get(self._source, 2)
        selected = 0x20 if self._pll_selected else 0  # PLLST
        locked = 0x40 if self._pll_runs else 0  # LOCK0
        return (0x10 if internal else 0) | selected | locked | clock << 2 | 0x02  # OSCINIT0

    @property
    def output_hz(self) -> float:
        """MCGOUTCLK [Hz]."""
        if self._source == 1:
            return _FAST_REFERENCE_HZ / 2 if self._registers[1] & 1 else _SLOW_REFERENCE_HZ
        if self._source == 2:
            return OSCILLATOR_HZ
        if self._pll_selected:
            divider = (self._registers[4] & 0x1F) + 1
            return OSCILLATOR_HZ / divider * ((self._registers[5] & 0x1F) + 24)
        return _SLOW_REFERENCE_HZ * 640


class ClockGates(StoredRegisters):
    """SIM, second page: clock gates, dividers, identification.

    Parameters
    ----------
    generator : ClockGenerator
        Where the core clock comes from.

    Attributes
    ----------
    core_hz, bus_hz : float
        Core and system clock, and bus clock [Hz].
    on_gates : callable
        Told that gates may have opened or closed.
    """

    def __init__(self, generator: ClockGenerator) -> None:
        self._generator = generator
        generator.on_change = self._divide
        self._gated: list[tuple[Peripheral, list[tuple[int, int]]]] = []
        self.on_gates: Callable[[], None] = lambda: None
        # SDID of an MK64FN1M0VLL12: family K6x, subfamily K64, 100 pins.
        identification = {0x024: 0x08, 0x025: 0x03, 0x026: 0x00, 0x027: 0x64}
        # UIDH, UIDMH, UIDML, UIDL: words in that order, each with its lowest byte first.
        unique = {0x054 + (index ^ 3): byte for index, byte in enumerate(VIRTUAL_UNIQUE_ID)}
        super().__init__("SIM", 0x40048000, mk64f12().reset_bytes(0x40048000) | identification | unique)

    def gate(self, peripheral: Peripheral, gates: Iterable[tuple[int, int]]) -> None:
        """Clock a peripheral while any of these bits of SCGC registers (1..7) is set; always, if there are none."""
        bits = [(_SCGC_FIRST + 4 * (register - 1), bit) for register, bit in gates]
        if bits:
            self._gated.append((peripheral, bits))
            self._open_gates()

    def reset(self) -> None:
        """Close every gate but those that are open out of reset."""
        super().reset()
        self._divide()
        self._open_gates()

    def write(self, offset: int, size: int, value: int) -> None:
        """Keep the value; open and close gates."""
        super().write(offset, size, value)
        self._divide()
        if _SCGC_FIRST <= offset <= _SCGC_LAST + 3:
            self._open_gates()

    def _open_gates(self) -> None:
        for peripheral, bits in self._gated:
            peripheral.clocked = any(self.word(register) >> bit & 1 for register, bit in bits)
        self.on_gates()

    def _divide(self) -> None:
        # Looked up for every byte on the wires, changed a few times at start-up.
        dividers = self.word(_CLKDIV1)
        self.core_hz = self._generator.output_hz / ((dividers >> 28) + 1)
        self.bus_hz = self._generator.output_hz / ((dividers >> 24 & 0xF) + 1)
