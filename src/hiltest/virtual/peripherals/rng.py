"""RNG: random words, which are the same in every run with the same seed."""

from __future__ import annotations

import hashlib

from hiltest.state import Restorable
from hiltest.virtual.part.chip import ChipPeripheral
from hiltest.virtual.peripherals.bus import ALL_STEADY
from hiltest.virtual.processor.clock import Clock
from hiltest.virtual.processor.cpu import Processor
from hiltest.virtual.processor.schedule import Event

_CR, _SR, _ER, _OR = 0x0, 0x4, 0x8, 0xC
_GO, _HA, _INTM, _CLRI, _SLP = (1 << bit for bit in range(5))
_SECV, _LRS, _ORU, _ERRI, _STATUS_SLP = (1 << bit for bit in range(5))
_ONE_WORD = 1 << 16  # OREG_SIZE
_LEVEL = 8  # OREG_LVL
_CLOCKS_A_WORD = 256  # of the module clock, from GO or from the read of a word to the next word


class RandomNumbers(Restorable):
    """The random number generator (RNGA).

    A word is a hash of the seed, of the values that firmware wrote to ER, and of the number of words since power-on. A
    reset does not restart the sequence.

    Attributes
    ----------
    seed : int
        Seed of the run; 0 until it is set.
    """

    steady = frozenset(ALL_STEADY) - frozenset(range(_OR, _OR + 4))  # an event makes a word, and a read consumes it

    def __init__(self, processor: Processor, clock: Clock, module: ChipPeripheral) -> None:
        self.name = module.name
        self.base = module.base
        self.clocked = True
        self._nvic = processor.nvic
        self._processor = processor
        self._clock = clock
        (self._interrupt,) = module.interrupts
        self.seed = 0
        self._words = 0
        self._entropy = b""
        self._making: Event | None = None
        self.reset()

    def reset(self) -> None:
        """Return to the state after reset: off, without a word."""
        self._control = 0
        self._flags = 0  # SECV, LRS, ORU, ERRI
        self._ready: int | None = None
        self._run()

    def _run(self) -> None:
        """Start the next word if one is needed."""
        if self._making is not None:
            self._making.cancel()
            self._making = None
        if self._control & _GO and not self._control & _SLP and self._ready is None:
            self._making = self._clock.call_after(_CLOCKS_A_WORD, self._make, wakes=False)

    def _make(self) -> None:
        self._making = None
        text = f"{self.seed} {self._words} ".encode() + self._entropy
        self._ready = int.from_bytes(hashlib.sha256(text).digest()[:4], "little")
        self._words += 1

    def read(self, offset: int, size: int) -> int:
        """Return a word register; a read of OR consumes the word."""
        if offset == _SR:
            status = self._flags | _ONE_WORD | (self._ready is not None) << _LEVEL
            if self._flags & _ORU:
                self._flags &= ~_ORU
                self._processor.report_changing_read()
            return status | (_STATUS_SLP if self._control & _SLP else 0)
        if offset == _OR:
            return self._take()
        return self._control if offset == _CR else 0

    def _take(self) -> int:
        word, self._ready = self._ready, None
        if word is not None:
            self._flags &= ~_LRS
            self._run()
            return word
        self._flags |= _LRS | _ORU | _ERRI | (_SECV if self._control & _HA else 0)
        self._drive()
        return 0

    def write(self, offset: int, size: int, value: int) -> None:
        """Write a word register: CR, or entropy to ER."""
        if offset == _CR:
            started = value & (_GO | _SLP) != self._control & (_GO | _SLP)
            # Writes cannot clear GO and HA.
            self._control = value & (_INTM | _SLP) | (value | self._control) & (_GO | _HA)
            if value & _CLRI:
                self._flags &= ~_ERRI
            if started:
                self._run()
            self._drive()
        elif offset == _ER:
            self._entropy = hashlib.sha256(self._entropy + value.to_bytes(4, "little")).digest()

    def _drive(self) -> None:
        self._nvic.set_line(self._interrupt, bool(self._flags & _ERRI) and not self._control & _INTM)
