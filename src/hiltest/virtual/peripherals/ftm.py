"""FTM: a 16-bit counter whose channels compare, capture and make pulse widths."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from hiltest.virtual.part.chip import ChipPeripheral
from hiltest.virtual.peripherals.ftm_channel import DMA, EDGES, ELSA, ELSB, ICRST, MSA, MSB, ChannelKind, FlexChannel
from hiltest.virtual.peripherals.ftm_counter import FlexCounter
from hiltest.virtual.peripherals.pin_signals import PinSignal, PulseCounter
from hiltest.virtual.peripherals.sim import ClockGates
from hiltest.virtual.processor.clock import Clock
from hiltest.virtual.processor.cpu import Processor
from hiltest.virtual.processor.schedule import Event

_SC, _CNT, _MOD, _FIRST_CHANNEL, _CNTIN, _STATUS, _MODE, _SYNC = 0x00, 0x04, 0x08, 0x0C, 0x4C, 0x50, 0x54, 0x58
_OUTINIT, _OUTMASK, _COMBINE, _POL, _CONF, _SYNCONF, _SWOCTRL, _PWMLOAD = 0x5C, 0x60, 0x64, 0x70, 0x84, 0x8C, 0x94, 0x98
_LAST = 0x98
_TOF, _TOIE, _CPWMS = 0x80, 0x40, 0x20
_FTMEN, _INIT = 1, 2
_COMBINED, _COMPLEMENTED, _SYNCEN = 1, 2, 0x20  # of a pair in COMBINE
_CNTMIN_OR_MAX, _REINIT, _SWSYNC = 3, 4, 0x80
_CNTINC, _SYNCMODE, _SWRSTCNT, _SWWRBUF = 4, 0x80, 0x100, 0x200
_LDOK = 0x200
_SOPT4 = 0x00C  # of the SIM: a bit from 24 on selects FTM_CLKIN1
# What does nothing here, by register: faults, dead time, dual capture, hardware triggers, inversion, a common time
# base, quadrature.
_UNMODELLED = {
    0x54: 0xE0, 0x58: 0x70, 0x64: 0x5C5C5C5C, 0x6C: 0xFF, 0x7C: 0x7F, 0x80: 0x1, 0x84: 0x600, 0x90: 0xF,
}  # fmt: skip


class FlexTimer:
    """One FTM module.

    DMA requests, quadrature, faults, dead time, dual capture, hardware triggers, inversion and a common time base are
    not modelled, and noted where firmware asks for them. Capture has no filter and no delay.

    Parameters
    ----------
    processor : Processor
        Interrupts.
    clocks : ClockGates
        Bus clock and fixed clock; SOPT4.
    inputs : sequence of PulseCounter
        FTM_CLKIN0 and FTM_CLKIN1.
    module : ChipPeripheral
        Its addresses and interrupt.
    note : callable
        Told address, size and value of a write that asks for what is not modelled.
    """

    def __init__(
        self, processor: Processor, clocks: ClockGates, inputs: Sequence[PulseCounter], module: ChipPeripheral,
        note: Callable[[int, int, int], None],
    ) -> None:  # fmt: skip
        self.name = module.name
        self.base = module.base
        self.clocked = True
        (self._interrupt,) = module.interrupts
        self._nvic = processor.nvic
        self._clocks = clocks
        self._inputs = inputs
        self._note = note
        self._initial = {register.address - module.base: register.reset for register in module.registers}
        count = sum(offset < _CNTIN for offset in self._initial) // 2 - 1
        self._channels = [FlexChannel() for _ in range(count)]
        for channel in self._channels:
            self._connect(channel)
        self._event: Event | None = None
        self.reset()

    @property
    def signals(self) -> dict[str, PinSignal]:
        """What its channels take in and put out, by name."""
        return {f"{self.name}_CH{index}": channel.signal for index, channel in enumerate(self._channels)}

    def _connect(self, channel: FlexChannel) -> None:
        channel.signal.on_level = lambda high: self._edge(channel, high)
        channel.signal.on_pins = self._plan

    def reset(self) -> None:
        """Return to the state after reset: the counter stands still."""
        self._registers = {offset: value for offset, value in self._initial.items() if offset <= _LAST}
        self._counter = FlexCounter()
        self._phase = 0  # while it stands still
        self._origin = 0  # tick of the source from which prescaled ticks count
        self._seen = 0  # prescaled tick up to which flags are known
        self._modulo: int | None = None  # MOD and CNTIN written, and not taken over yet
        self._first: int | None = None
        self._overflows = 0
        self._flag = self._flag_seen = False  # TOF
        for channel in self._channels:
            channel.reset()
        self._plan()
        self._drive()

    # -- counting -----------------------------------------------------------------------------

    @property
    def _source(self) -> Clock | PulseCounter | None:
        """What it counts, as SC.CLKS selects."""
        selected = self._registers[_SC] >> 3 & 3
        external = self._inputs[self._clocks.word(_SOPT4) >> 24 + int(self.name[-1]) & 1]
        return (None, self._clocks.bus, self._clocks.fixed, external)[selected]

    def _advance(self) -> None:
        """Count up to now: flags, and values that are taken over on the way."""
        source = self._source
        if source is None:
            return
        now, counter = source.now() - self._origin >> (self._registers[_SC] & 7), self._counter
        while self._seen < now:
            until = now
            if self._may_load:
                until = min(now, counter.next_tick(counter.overflow, self._seen))
            for index, channel in enumerate(self._channels):
                times = sum(counter.times(phase, self._seen, until) for phase in counter.matches(channel.value))
                if times:
                    channel.match(self._kind(index), times)
            overflows = counter.times(counter.overflow, self._seen, until)
            counter.began += (until - counter.began) // counter.period * counter.period
            self._seen = until
            if overflows:
                self._overflow(overflows)

    def _overflow(self, times: int) -> None:
        every = (self._registers[_CONF] & 0x1F) + 1  # NUMTOF: only each of so many sets the flag
        if (self._overflows + times - 1) // every > (self._overflows - 1) // every:
            self._flag, self._flag_seen = True, False
        self._overflows += times
        self._load()

    def _restart(self, phase: int = 0) -> None:
        """Count on from a phase."""
        self._phase = phase
        source = self._source
        if source is not None:
            self._origin = source.now()
            self._seen, self._counter.began = 0, -phase

    # -- values that are taken over later -----------------------------------------------------

    @property
    def _may_load(self) -> bool:
        """Whether something will be taken over at the end of this round."""
        waits = any(channel.buffered is not None for channel in self._channels)
        waits |= self._modulo is not None or self._first is not None
        return waits and bool(self._at_once or self._synchronises)

    @property
    def _at_once(self) -> bool:
        """Whether the end of a round takes everything over."""
        return not self._registers[_MODE] & _FTMEN or bool(self._registers[_PWMLOAD] & _LDOK)

    @property
    def _synchronises(self) -> bool:
        """Whether the end of a round is the loading point of a software trigger."""
        return bool(self._registers[_SYNC] & _SWSYNC and self._registers[_SYNC] & _CNTMIN_OR_MAX)

    def _load(self) -> None:
        """Take over buffered values at the end of a round, as far as they may be."""
        counter = self._counter
        height = counter.height(self._seen - counter.began)
        if self._at_once:
            self._take_over(self._channels, modulo=True, first=True)
        elif self._synchronises:
            self._synchronise()
        if counter.up_down:  # it is on its way down, from wherever the new top is
            counter.began = self._seen - (2 * counter.top - height) % counter.period

    def _synchronise(self) -> None:
        """Take over what a software trigger lets through; it is over then."""
        self._registers[_SYNC] &= ~_SWSYNC
        options, pairs = self._registers[_SYNCONF], self._registers[_COMBINE]
        if options & _SYNCMODE and not options & _SWWRBUF:
            return
        synchronised = [ch for n, ch in enumerate(self._channels) if pairs >> 8 * (n // 2) & _SYNCEN]
        self._take_over(synchronised, modulo=True, first=bool(options & _CNTINC))

    def _take_over(self, channels: Sequence[FlexChannel], *, modulo: bool, first: bool) -> None:
        for channel in channels:
            if channel.buffered is not None:
                channel.value, channel.buffered = channel.buffered, None
        if modulo and self._modulo is not None:
            self._counter.modulo, self._modulo = self._modulo, None
        if first and self._first is not None:
            self._counter.initial, self._first = self._first, None

    def _trigger(self) -> None:
        """Begin a synchronisation by software: at once with a restart of the counter, or at a loading point."""
        options = self._registers[_SYNCONF]
        restarts = options & _SWRSTCNT if options & _SYNCMODE else self._registers[_SYNC] & _REINIT
        if restarts:
            self._synchronise()
            self._restart()

    # -- channels -----------------------------------------------------------------------------

    def _pair(self, index: int) -> int:
        return self._registers[_COMBINE] >> 8 * (index // 2)

    def _kind(self, index: int) -> ChannelKind:
        control = self._channels[index].control
        if self._registers[_SC] & _CPWMS or self._pair(index) & _COMBINED or control & MSB:
            return ChannelKind.PULSE_WIDTH
        if control & MSA:
            return ChannelKind.COMPARE
        return ChannelKind.CAPTURE if control & EDGES else ChannelKind.NOTHING

    def _edge(self, channel: FlexChannel, high: bool) -> None:
        """Take the count at an edge of a pin."""
        wanted = ELSA if high else ELSB
        if self._source is None or self._kind(self._channels.index(channel)) is not ChannelKind.CAPTURE:
            return
        if not channel.control & wanted:
            return
        self._advance()
        channel.value = self._counter.value(self._phase_now())
        channel.raise_flag()
        if channel.control & ICRST:
            self._restart()
        self._settle()

    def _active(self, index: int) -> bool:
        """Whether a channel of a pulse width is in its active part now."""
        counter, channel, phase = self._counter, self._channels[index], self._phase_now()
        if self._pair(index) & _COMBINED:
            rises, falls = self._channels[index & ~1], self._channels[index | 1]
            heights = (rises.value - counter.initial) & 0xFFFF, (falls.value - counter.initial) & 0xFFFF
            return heights[0] <= phase < heights[1]
        height = (channel.value - counter.initial) & 0xFFFF
        return phase < height or (counter.up_down and phase >= counter.period - height)

    def _output(self, index: int) -> bool | None:
        """Level of a channel's pin; None where the channel has none."""
        channel, registers = self._channels[index], self._registers
        kind, polarity = self._kind(index), bool(registers[_POL] >> index & 1)
        if kind in (ChannelKind.NOTHING, ChannelKind.CAPTURE) or not channel.control & EDGES:
            return None
        if kind is ChannelKind.PULSE_WIDTH and self._source is not None:
            pair = self._pair(index)
            leader = index & ~1 if pair & (_COMBINED | _COMPLEMENTED) else index
            inverted = bool(self._channels[leader].control & ELSA) ^ bool(leader != index and pair & _COMPLEMENTED)
            channel.high = self._active(leader) ^ inverted
        if registers[_OUTMASK] >> index & 1:
            return polarity
        forced = registers[_SWOCTRL] >> index
        return (bool(forced >> 8 & 1) if forced & 1 else channel.high) ^ polarity

    # -- events -------------------------------------------------------------------------------

    def _phase_now(self) -> int:
        return self._phase if self._source is None else (self._seen - self._counter.began) % self._counter.period

    def _next_ticks(self) -> list[int]:
        """When something happens that is seen without being looked at."""
        counter, seen, ticks = self._counter, self._seen, []
        overflow = counter.next_tick(counter.overflow, seen)
        if self._registers[_SC] & _TOIE and not self._flag:
            ticks.append(overflow)
        for index, channel in enumerate(self._channels):
            kind = self._kind(index)
            if kind in (ChannelKind.NOTHING, ChannelKind.CAPTURE):
                continue
            shown = channel.takes_pin
            if shown or channel.awaited:
                ticks += [counter.next_tick(phase, seen) for phase in counter.matches(channel.value)]
            if shown and kind is ChannelKind.PULSE_WIDTH:
                ticks += [counter.next_tick(0, seen), overflow]
        return ticks

    def _plan(self) -> None:
        if self._event is not None:
            self._event.cancel()
            self._event = None
        source = self._source
        ticks = [] if source is None else self._next_ticks()
        if ticks and source is not None:
            tick = self._origin + (min(ticks) << (self._registers[_SC] & 7))
            self._event = source.at(tick, self._happened)

    def _happened(self) -> None:
        self._event = None
        self._advance()
        self._settle()

    def _settle(self) -> None:
        """Show what has become of channels and flags, and come back when that changes."""
        for index, channel in enumerate(self._channels):
            channel.signal.drive(self._output(index))
        self._drive()
        self._plan()

    def _drive(self) -> None:
        level = self._flag and bool(self._registers[_SC] & _TOIE)
        level |= any(channel.interrupts for channel in self._channels)
        self._nvic.set_line(self._interrupt, level)

    # -- registers ----------------------------------------------------------------------------

    def read(self, offset: int, size: int) -> int:
        """Answer a word register; reading a flag is half of clearing it."""
        self._advance()
        return self._read_word(offset & ~3) >> 8 * (offset & 3)

    def _read_word(self, offset: int) -> int:
        if offset == _SC:
            self._flag_seen = self._flag
            return self._registers[_SC] | (_TOF if self._flag else 0)
        if offset == _STATUS:
            for channel in self._channels:
                channel.flag_seen = channel.flag
            return sum(channel.flag << index for index, channel in enumerate(self._channels))
        if _FIRST_CHANNEL <= offset < _FIRST_CHANNEL + 8 * len(self._channels):
            channel = self._channels[(offset - _FIRST_CHANNEL) // 8]
            if (offset - _FIRST_CHANNEL) % 8:
                return channel.value
            channel.flag_seen = channel.flag
            return channel.status
        live = {_CNT: self._counter.value(self._phase_now()), _MOD: self._counter.modulo, _CNTIN: self._counter.initial}
        return live.get(offset, self._registers.get(offset, 0))

    def write(self, offset: int, size: int, value: int) -> None:
        """Take a word register."""
        self._advance()
        is_channel = _FIRST_CHANNEL <= offset < _FIRST_CHANNEL + 8 * len(self._channels)
        is_control = is_channel and (offset - _FIRST_CHANNEL) % 8 == 0
        if value & (DMA if is_control else _UNMODELLED.get(offset, 0)):
            self._note(self.base + offset, size, value)
        if offset == _SC:
            self._write_control(value)
        elif offset == _CNT:
            self._restart()
        elif offset in (_MOD, _CNTIN):
            self._write_limit(offset, value & 0xFFFF)
        elif offset == _STATUS:
            for index, channel in enumerate(self._channels):
                channel.flag &= bool(value >> index & 1) or not channel.flag_seen
        elif is_control:
            self._channels[(offset - _FIRST_CHANNEL) // 8].write_control(value)
        elif is_channel:
            self._write_value((offset - _FIRST_CHANNEL) // 8, value & 0xFFFF)
        elif offset in self._registers:
            self._write_common(offset, value)
        self._settle()

    def _write_control(self, value: int) -> None:
        if not value & _TOF and self._flag_seen:
            self._flag = False
        phase = self._phase_now()
        counts_otherwise = (self._registers[_SC] ^ value) & 0x3F
        self._registers[_SC] = value & 0x7F
        self._counter.up_down = bool(value & _CPWMS)
        if counts_otherwise:
            self._restart(phase % self._counter.period)
        if self._source is None:
            self._take_over(self._channels, modulo=True, first=True)

    def _write_limit(self, offset: int, value: int) -> None:
        running = self._source is not None
        if offset == _MOD:
            self._modulo = value
        else:
            self._first = value
        if not running:
            self._take_over((), modulo=True, first=True)
            self._phase = 0 if offset == _CNTIN else self._phase
        elif not self._registers[_MODE] & _FTMEN:
            self._take_over((), modulo=False, first=True)

    def _write_value(self, index: int, value: int) -> None:
        channel, kind = self._channels[index], self._kind(index)
        if kind is ChannelKind.CAPTURE:
            return  # read-only
        channel.buffered = value
        synchronised = self._registers[_MODE] & _FTMEN and self._pair(index) & _SYNCEN
        if self._source is None or (kind is not ChannelKind.PULSE_WIDTH and not synchronised):
            self._take_over([channel], modulo=False, first=False)

    def _write_common(self, offset: int, value: int) -> None:
        self._registers[offset] = value
        if offset == _MODE and value & _INIT:
            self._registers[_MODE] &= ~_INIT
            for index, channel in enumerate(self._channels):
                channel.high = bool(self._registers[_OUTINIT] >> index & 1)
        elif offset == _SYNC and value & _SWSYNC:
            self._trigger()
