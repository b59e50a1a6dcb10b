"""A channel of an FTM: its registers and its pin."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum, auto

from hiltest.virtual.peripherals.pin_signals import PinSignal

CHF, CHIE, MSB, MSA, ELSB, ELSA, ICRST, DMA = 0x80, 0x40, 0x20, 0x10, 0x08, 0x04, 0x02, 0x01
EDGES = ELSB | ELSA


class ChannelKind(Enum):
    """What a channel does, as its own and the common registers say."""

    NOTHING = auto()
    CAPTURE = auto()
    COMPARE = auto()
    PULSE_WIDTH = auto()


@dataclass(slots=True)
class FlexChannel:
    """State of one channel.

    Attributes
    ----------
    signal : PinSignal
    control, value : int
        CnSC without its flag, and CnV in effect.
    buffered : int or None
        CnV that was written and is not taken over yet.
    flag, flag_seen : bool
        CHF, and whether it was read since it was set: a zero written clears it then.
    high : bool
        Its output, before polarity.
    """

    signal: PinSignal = field(default_factory=PinSignal)
    control: int = 0
    value: int = 0
    buffered: int | None = None
    flag: bool = False
    flag_seen: bool = False
    high: bool = False

    def reset(self) -> None:
        """Return to the state after reset."""
        self.control = self.value = 0
        self.buffered = None
        self.flag = self.flag_seen = self.high = False

    def write_control(self, value: int) -> None:
        """Take CnSC; a zero clears a flag that was read."""
        if not value & CHF and self.flag_seen:
            self.flag = False
        self.control = value & 0x7F

    def raise_flag(self) -> None:
        """Set CHF; to be cleared it must be read again."""
        self.flag, self.flag_seen = True, False

    def match(self, kind: ChannelKind, times: int) -> None:
        """Take note that the counter was at its value."""
        if kind in (ChannelKind.COMPARE, ChannelKind.PULSE_WIDTH):
            self.raise_flag()
        if kind is ChannelKind.COMPARE:
            action = self.control & EDGES
            if action == ELSA:
                self.high ^= bool(times & 1)
            elif action:
                self.high = action == EDGES

    @property
    def takes_pin(self) -> bool:
        """Whether it has an output, and a pin that shows it."""
        return bool(self.control & EDGES) and self.signal.pins > 0

    @property
    def status(self) -> int:
        """CnSC with its flag."""
        return self.control | (CHF if self.flag else 0)

    @property
    def awaited(self) -> bool:
        """Whether its next match interrupts."""
        return bool(self.control & CHIE) and not self.flag

    @property
    def interrupts(self) -> bool:
        """Whether it asks for an interrupt; with DMA it asks for a transfer instead."""
        return self.flag and self.control & (CHIE | DMA) == CHIE
