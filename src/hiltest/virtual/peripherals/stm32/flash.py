"""FLASH: sectors that are erased, words that stores program, and the lock."""

from __future__ import annotations

import itertools

from hiltest.virtual.part.chip import ChipPeripheral
from hiltest.virtual.peripherals.stm32.block import Block
from hiltest.virtual.peripherals.unmodelled import UnmodelledLog
from hiltest.virtual.processor.clock import PICOSECONDS, Clock
from hiltest.virtual.processor.cpu import Processor
from hiltest.virtual.processor.schedule import Event

_KEYR, _OPTKEYR, _SR, _CR, _OPTCR = 0x04, 0x08, 0x0C, 0x10, 0x14
_KEYS = 0x45670123, 0xCDEF89AB
_EOP, _OPERR, _WRPERR, _PGAERR, _PGPERR, _PGSERR, _BSY = 1, 2, 1 << 4, 1 << 5, 1 << 6, 1 << 7, 1 << 16
_ERRORS = 0x1F0
_PG, _SER, _MER, _STRT, _EOPIE, _ERRIE, _LOCK = 1, 2, 4, 1 << 16, 1 << 24, 1 << 25, 1 << 31
_US = PICOSECONDS // 10**6
#: Typical times of the data sheet (DS10314) by PSIZE: of a store, and of the erasure of a sector by its KiB [us].
_STORE_US = 16
_ERASE_US = {
    16: (400_000, 300_000, 250_000, 250_000),
    64: (1_200_000, 700_000, 550_000, 550_000),
    128: (2_000_000, 1_300_000, 1_000_000, 1_000_000),
}


class FlashControl(Block):
    """The controller. A core that fetches from the flash stops while it is busy; option bytes have no model.

    Parameters
    ----------
    begin
        First address of the flash, which is also seen at 0.
    sectors_kib
        Sizes of its sectors.
    """

    def __init__(
        self,
        processor: Processor,
        module: ChipPeripheral,
        *,
        begin: int,
        sectors_kib: list[int],
        time: Clock,
        log: UnmodelledLog,
    ) -> None:
        self._begin, self._sectors_kib, self._time, self._log = begin, sectors_kib, time, log
        self._flash_bytes = sum(sectors_kib) << 10
        self._end: Event | None = None
        super().__init__(processor, module)

    def reset(self) -> None:
        super().reset()
        if self._end is not None:
            self._end.cancel()
        self._end = None
        self._keys = 0  # correct keys since the lock; -1 after a wrong one
        self._drive()

    def _drive(self) -> None:
        self.drive_interrupt(bool(self.word(_SR) & (_EOP | _OPERR)))  # which EOPIE and ERRIE let be set

    def _work(self, us: int) -> None:
        """Be busy for a time, in which a core that fetches from the flash stops."""
        tick = self._time.now() + us * _US
        self.change_word(_SR, put=_BSY)
        self._end = self._time.call_at(tick, self._finish)
        if self.processor.memory.map.is_in_flash(self.processor.registers.pc.get()):
            self.processor.core.cycles = max(self.processor.now(), int(self._time.cycle_of(tick)))

    def _finish(self) -> None:
        self._end = None
        self.change_word(_SR, clear=_BSY, put=_EOP if self.word(_CR) & _EOPIE else 0)
        self.change_word(_CR, clear=_STRT)
        self._drive()

    def _fail(self, error: int) -> None:
        self.change_word(_SR, put=error | (_OPERR if self.word(_CR) & _ERRIE else 0))
        self.change_word(_CR, clear=_STRT)
        self._drive()

    # -- operations ---------------------------------------------------------------------------

    def _sector_of(self, offset: int) -> int:
        """Return the number of the sector at an offset in the flash."""
        ends = list(itertools.accumulate(kib << 10 for kib in self._sectors_kib))
        return next(number for number, end in enumerate(ends) if offset < end)

    def _is_protected(self, sector: int) -> bool:
        return not self.word(_OPTCR) >> 16 + sector & 1

    def program(self, address: int, size: int, value: int) -> None:
        """Program flash by a store of the core, which clears bits."""
        offset = address - (self._begin if address >= self._begin else 0)
        if not self.word(_CR) & _PG:
            self._fail(_PGSERR)
        elif size != 1 << (self.word(_CR) >> 8 & 3):
            self._fail(_PGPERR)
        elif address % size:
            self._fail(_PGAERR)
        elif offset + size > self._flash_bytes or self._is_protected(self._sector_of(offset)):
            self._fail(_WRPERR)
        else:
            place, memory = self._begin + offset, self.processor.memory
            before = int.from_bytes(memory.read(place, size), "little")
            memory.write(place, (before & value).to_bytes(size, "little"))
            self._work(_STORE_US)

    def _erase(self) -> None:
        """Erase the selected sectors, or all."""
        control = self.word(_CR)
        numbers = range(len(self._sectors_kib)) if control & _MER else [control >> 3 & 15]
        if not control & (_SER | _MER) or control & _PG:
            self._fail(_PGSERR)
        elif any(number >= len(self._sectors_kib) or self._is_protected(number) for number in numbers):
            self._fail(_WRPERR)
        else:
            for number in numbers:
                begin = self._begin + (sum(self._sectors_kib[:number]) << 10)
                self.processor.memory.write(begin, b"\xff" * (self._sectors_kib[number] << 10))
            self._work(sum(_ERASE_US[self._sectors_kib[number]][control >> 8 & 3] for number in numbers))

    # -- registers ----------------------------------------------------------------------------

    def read_word(self, offset: int) -> int:
        return 0 if offset in (_KEYR, _OPTKEYR) else self.word(offset)

    def write_word(self, offset: int, value: int, mask: int) -> None:
        if offset == _KEYR:
            is_next = 0 <= self._keys < len(_KEYS) and value == _KEYS[self._keys]
            self._keys = self._keys + 1 if is_next else -1  # a wrong key locks until the next reset
            self.change_word(_CR, clear=_LOCK if self._keys == len(_KEYS) else 0)
        elif offset == _SR:
            self.change_word(_SR, clear=value & (_EOP | _OPERR | _ERRORS))
        elif offset in (_OPTKEYR, _OPTCR):
            self._log.note(self.base + offset, 4, value)
        elif offset != _CR:
            super().write_word(offset, value, mask)
        elif not self.word(_CR) & _LOCK:
            before = self.word(_CR)
            super().write_word(offset, value, mask)
            self._keys = 0 if self.word(_CR) & _LOCK else self._keys
            if self.word(_CR) & ~before & _STRT:
                self._erase()
        self._drive()
