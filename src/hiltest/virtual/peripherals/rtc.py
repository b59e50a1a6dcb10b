"""RTC: a counter of seconds with an alarm, on a 32.768 kHz crystal; and the register files that share its battery."""

from __future__ import annotations

from hiltest.state import Restorable
from hiltest.virtual.part.chip import ChipPeripheral
from hiltest.virtual.peripherals.bus import StoredRegisters
from hiltest.virtual.peripherals.mcg import RTC_HZ
from hiltest.virtual.peripherals.sim import ClockGates
from hiltest.virtual.processor.cpu import Processor
from hiltest.virtual.processor.schedule import Event

_TSR, _TPR, _TAR, _TCR, _CR, _SR, _LR, _IER = range(0, 0x20, 4)
_WAR, _RAR = 0x800, 0x804
_SWR, _UM, _OSCE = 1, 1 << 3, 1 << 8
_TIF, _TOF, _TAF, _TCE = 1, 2, 4, 0x10
_TSIE = 0x10
_LOCKS = {_TCR: 1 << 3, _CR: 1 << 5, _SR: 1 << 4, _LR: 1 << 6}  # bits of LR; a zero rejects writes until power-on
_SECOND_TICKS = 1 << 15  # without the correction by TCR


class RealTimeClock(Restorable):
    """The RTC module, which only power-on resets.

    Supervisor protection (CR.SUP, CR.WPE) and the access registers WAR and RAR store writes
    and reject nothing.
    """

    steady = frozenset(range(0x1000)) - frozenset(range(_TPR, _TPR + 4))

    def __init__(self, processor: Processor, clocks: ClockGates, module: ChipPeripheral) -> None:
        self.name = module.name
        self.base = module.base
        self._open = False
        self._interrupt, self._second_interrupt = module.interrupts
        self._nvic = processor.nvic
        self._clocks = clocks
        self._event: Event | None = None
        self._began = 0  # start of this second, in ticks of the crystal
        self._rest = 0  # TPR while the counter is stopped
        self.power_on()

    @property
    def clocked(self) -> bool:
        """Return whether the clock gate is open; a closed gate blocks interrupts too."""
        return self._open

    @clocked.setter
    def clocked(self, is_open: bool) -> None:
        self._open = is_open
        self._drive()

    def power_on(self) -> None:
        """Return to the state after the battery is connected."""
        self._lock = 0xFF
        self._access = {_WAR: 0xFF, _RAR: 0xFF}
        self._control = 0
        self._software_reset()

    def _software_reset(self) -> None:
        """Reset all registers except CR and the access registers."""
        self._stop()
        self._seconds = self._alarm = self._compensation = 0
        self._status = _TIF
        self._enabled = 7  # IER
        self._lock = 0xFF
        self._rest = 0
        self._interval = 0  # TCR.CIC: seconds up to the next corrected second
        self._correction = 0  # TCR.TCV
        self._switch()

    def reset(self) -> None:
        """Update the interrupt lines; a reset of the chip changes nothing else."""
        self._drive()

    # -- counting -----------------------------------------------------------------------------

    def _counts(self) -> bool:
        return self._status & (_TCE | _TIF | _TOF) == _TCE and bool(self._control & _OSCE)

    def _prescaler(self) -> int:
        """Return TPR: ticks of the crystal in this second."""
        if self._event is None:
            return self._rest
        return min(max(self._clocks.rtc.now() - self._began, 0), _SECOND_TICKS - 1)

    def _stop(self) -> None:
        if self._event is not None:
            self._rest = self._prescaler()
            self._event.cancel()
            self._event = None

    def _switch(self) -> None:
        """Start or stop the counter by control and status."""
        self._stop()
        self._clocks.crystal_runs = bool(self._control & _OSCE)
        if self._counts():
            self._began = self._clocks.rtc.now() - self._rest
            self._plan()
        self._drive()

    def _plan(self) -> None:
        end = self._began + RTC_HZ - self._correction
        self._event = self._clocks.rtc.call_at(end, lambda: self._second(end), wakes=bool(self._enabled & (_TSIE | 6)))

    def _second(self, tick: int) -> None:
        if self._seconds == self._alarm:
            self._status |= _TAF
        self._seconds = (self._seconds + 1) & 0xFFFFFFFF
        if not self._seconds:
            self._status |= _TOF
        self._began, self._rest = tick, 0
        self._correct()
        self._event = None
        if self._counts():
            self._plan()
        if self._enabled & _TSIE and self._open:
            self._nvic.set_line(self._second_interrupt, True)  # an edge, which firmware need not acknowledge
        self._drive()

    def _correct(self) -> None:
        """Set the length of the second that begins; TCR corrects one second of each interval."""
        if self._interval:
            self._interval -= 1
            self._correction = 0
        else:
            self._interval = self._compensation >> 8
            ticks = self._compensation & 0xFF
            self._correction = ticks - 256 if ticks & 0x80 else ticks

    def _drive(self) -> None:
        self._nvic.set_line(self._second_interrupt, False)
        # TIIE, TOIE and TAIE in IER are at the same bits as TIF, TOF and TAF in SR.
        self._nvic.set_line(self._interrupt, self._open and bool(self._status & self._enabled & 7))

    # -- registers ----------------------------------------------------------------------------

    def read(self, offset: int, size: int) -> int:
        """Return a register; time reads as zero while it is invalid."""
        valid = not self._status & (_TIF | _TOF)
        current = self._interval << 24 | (self._correction & 0xFF) << 16
        answers = {
            _TSR: self._seconds if valid else 0,
            _TPR: self._prescaler() if valid else 0,
            _TAR: self._alarm,
            _TCR: current | self._compensation,
            _CR: self._control,
            _SR: self._status,
            _LR: self._lock,
            _IER: self._enabled,
            **self._access,
        }
        return answers.get(offset & ~3, 0) >> 8 * (offset & 3)

    def write(self, offset: int, size: int, value: int) -> None:
        """Write a word register, unless LR has locked it."""
        if offset in _LOCKS and not self._lock & _LOCKS[offset] and not (offset == _SR and self._control & _UM):
            return
        if offset == _TSR and not self._status & _TCE:
            self._seconds = value
            self._status &= ~(_TIF | _TOF)
        elif offset == _TPR and not self._status & _TCE:
            self._rest = value & 0x7FFF
        elif offset == _TAR:
            self._alarm = value
            self._status &= ~_TAF
        elif offset == _TCR:
            self._compensation = value & 0xFFFF
        elif offset == _LR:
            self._lock &= value & 0x78 | 0x87
        elif offset == _IER:
            self._enabled = value & 0x97
        elif offset in self._access:
            self._access[offset] = value & 0xFF
        else:
            self._write_state(offset, value)
        self._switch()

    def _write_state(self, offset: int, value: int) -> None:
        if offset == _CR:
            self._control = value & 0x3F1F
            if value & _SWR:
                self._software_reset()
        elif offset == _SR:
            self._status = self._status & ~_TCE | value & _TCE


class BatteryRegisters(StoredRegisters):
    """A register file, RFVBAT or RFSYS, which only power-on clears."""

    def __init__(self, module: ChipPeripheral) -> None:
        super().__init__(module.name, module.base)
        self.power_on()

    def power_on(self) -> None:
        super().reset()

    def reset(self) -> None:
        """Keep the content."""
