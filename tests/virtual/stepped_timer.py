"""An FTM that takes a step at every tick, and the core's own by itself, on a clock with a tick each cycle."""

from __future__ import annotations

from hiltest.virtual.core.library import ffi, lib
from hiltest.virtual.core.machine import NEVER, Machine
from hiltest.virtual.model.profile_file import DEFAULT_PROFILE, load_profile
from hiltest.virtual.processor.nvic import Nvic

BASE, INTERRUPT = 0x40038000, 42
SC, MOD, FIRST_CHANNEL, STATUS, CONF = 0x00, 0x08, 0x0C, 0x50, 0x84

Changes = list[tuple[int, bool]]
"""Cycles at which a level has changed, and to what."""


class SteppedChannel:
    """Control, value in effect and value that was written, flag, and level of a channel."""

    def __init__(self) -> None:
        self.control = self.value = self.written = 0
        self.flag = self.seen = self.high = False

    def match(self, *, compares: bool) -> None:
        """Be at the value of the counter."""
        self.flag, self.seen = True, False
        if compares:
            self.high = {4: not self.high, 8: False, 12: True}[self.control & 12]


class SteppedTimer:
    """A counter from 0 with two channels, without buffers but for those at the end of a round.

    Attributes
    ----------
    control : int
        SC.
    interrupts : Changes
        Of its interrupt.
    edges : Changes
        Of channel 0.
    """

    def __init__(self) -> None:
        self.control = self.count = self.modulo = self.written = self.silent = self.overflows = self.cycle = 0
        self.up_down = self.goes_down = self.flag = self.seen = False
        self.channels = SteppedChannel(), SteppedChannel()
        self.interrupts: Changes = []
        self.edges: Changes = []

    def write(self, offset: int, value: int) -> None:
        """Take a register."""
        channel = self.channels[(offset - FIRST_CHANNEL) // 8 % 2]
        if offset == SC:
            self.flag &= bool(value & 0x80) or not self.seen
            self.control = value & 0x7F
        elif offset == MOD:
            self.written = value
        elif offset == CONF:
            self.silent = value
        elif offset == STATUS:
            for index, entry in enumerate(self.channels):
                entry.flag &= bool(value >> index & 1) or not entry.seen
        elif offset % 8 == FIRST_CHANNEL % 8:
            channel.control = value
        else:
            channel.written = value
            if self._compares(channel):
                channel.value = value
        if not self.control & 0x18:
            self._load()
        self._look()

    def read_status(self) -> int:
        """Read the flags of the channels."""
        for channel in self.channels:
            channel.seen = channel.flag
        return sum(channel.flag << index for index, channel in enumerate(self.channels))

    def read_overflow(self) -> int:
        """Read TOF."""
        self.seen = self.flag
        return self.flag << 7

    def level(self, index: int) -> bool:
        """Level of a channel."""
        channel = self.channels[index]
        if self.control & 0x18 and not self._compares(channel):
            on_its_way_down = self.up_down and (self.count == self.modulo or (self.goes_down and self.count > 0))
            active = self.count < channel.value or (on_its_way_down and self.count == channel.value)
            return active != bool(channel.control & 4)
        return channel.high

    def run(self, cycles: int) -> None:
        """Step through cycles."""
        for _ in range(cycles):
            self.cycle += 1
            if self.cycle % (1 << (self.control & 7)) == 0:
                self._step()
            self._look()

    def _compares(self, channel: SteppedChannel) -> bool:
        return not (self.up_down or channel.control & 0x20)

    def _step(self) -> None:
        ends = self.count == self.modulo and not self.goes_down
        if self.up_down:
            self.goes_down = (self.goes_down or ends) and self.count > 0
            self.count += -1 if self.goes_down else 1
        else:
            self.count = 0 if ends else self.count + 1
        for channel in self.channels:
            if channel.value == self.count:
                channel.match(compares=self._compares(channel))
        if ends:
            if self.overflows % (self.silent + 1) == 0:
                self.flag, self.seen = True, False
            self.overflows += 1
            self._load()

    def _load(self) -> None:
        self.modulo = self.written
        for channel in self.channels:
            channel.value = channel.written

    def _look(self) -> None:
        interrupts = self.flag and bool(self.control & 0x40)
        interrupts |= any(channel.flag and channel.control & 0x40 for channel in self.channels)
        _keep(self.interrupts, self.cycle, interrupts)
        _keep(self.edges, self.cycle, self.level(0))


def _keep(changes: Changes, cycle: int, level: bool) -> None:
    if level != (changes[-1][1] if changes else False):
        changes.append((cycle, level))


class TimerAlone:
    """The core's FTM; as `SteppedTimer`.

    Parameters
    ----------
    heard : int
        Channels that are heard: `edges` are those of channel 0, as they are told.
    """

    def __init__(self, heard: int) -> None:
        self._machine = Machine(load_profile(DEFAULT_PROFILE))
        self._nvic = Nvic(self._machine)
        self._callback = ffi.callback("void(void *, int32_t)", self._look)
        clock = self._machine.add_clock()
        self._machine.set_clock(clock, 0, 0, 0, 1, 1)
        connections = ffi.new("struct machine_ftm *", (2, INTERRUPT, clock, clock, self._callback))
        assert lib.machine_add_ftm(self._machine.handle, BASE, connections[0])
        self.interrupts: Changes = []
        self.edges: Changes = []
        lib.machine_report_channels(self._machine.handle, BASE, heard)

    def _look(self, _context: object = None, _channel: int = 0) -> None:
        cycle = self._machine.core.cycles
        _keep(self.interrupts, cycle, self._nvic.is_driven(INTERRUPT))
        _keep(self.edges, cycle, self.level(0))

    def read(self, offset: int) -> int:
        """Read a register."""
        value: int = lib.machine_read_device(self._machine.handle, BASE + offset, 4)
        return value

    def write(self, offset: int, value: int) -> None:
        """Write a register."""
        lib.machine_write_device(self._machine.handle, BASE + offset, 4, value)
        self._look()

    def level(self, channel: int) -> bool:
        """Level of a channel, which has one."""
        level: int = lib.machine_channel_level(self._machine.handle, BASE, channel)
        return level > 0

    def run(self, cycles: int) -> None:
        """Go on from event to event."""
        core = self._machine.core
        end = core.cycles + cycles
        while (event := lib.machine_next_event(self._machine.handle)) <= end and event != NEVER:
            core.cycles = max(core.cycles, event)
            lib.machine_fire_events(self._machine.handle)
            _keep(self.interrupts, core.cycles, self._nvic.is_driven(INTERRUPT))
        core.cycles = end
