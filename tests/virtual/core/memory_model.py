"""Cycles that a part's memories add, in Python: the oracle of core/waits.c.

A read of the flash array brings one line, and the next line is read ahead at once. What was accessed is kept in a cache
of smaller entries. The flash has a clock of its own, so a read begins at one of its edges: a miss costs one flash
clock, and up to nearly another one until the edge. Synchronous flash has the core's clock, and the first clock of a
read is the fetch's own.

Line buffer, reading ahead and cache can be switched off, for each half of the flash. With all of them off every word
that is fetched and every access to data is a read of the array.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum

from hiltest.virtual.core.machine import BankSwitches
from hiltest.virtual.model.timing import CostRow, WaitingMemories
from hiltest.virtual.processor.memory import FLASH

_NOTHING = -1
_WORD_BYTES = 4  # the core fetches words: the second instruction of one is no access, unless it is jumped to
_BANKS = 2
_ALIASES = 0x22000000
_SYSTEM_BUS = 0x20000000
_AHEAD = 3  # words that the core fetches ahead of what it executes
_PARTS = 100  # conflicts are priced in hundredths of a clock an access: what was measured is a mean


class Role(IntEnum):
    """Part of an instruction in a group of accesses, as enum access_role."""

    NONE = 0
    BEGINS = 1
    FIRST_STORE = 2
    BEHIND_STORE = 3


class FlashController:
    """Line buffer, cache and read-ahead.

    Parameters
    ----------
    rows : mapping of str to CostRow
        The memory rows of a timing profile.
    begin, size
        Place of the flash.
    """

    def __init__(self, rows: Mapping[str, CostRow], begin: int = FLASH[0], size: int = FLASH[1]) -> None:
        self._begin, self._bank_bytes = begin, size // _BANKS
        self._synchronous = "flash_synchronous" in rows and rows["flash_synchronous"].value > 0
        self._clocks = rows["flash_clocks"].value - self._synchronous
        self._line_bytes = rows["flash_line_bytes"].value
        self._entry_bytes = rows["cache_entry_bytes"].value
        self._ways = rows["cache_ways"].value
        self._sets = rows["cache_sets"].value
        self._reads_ahead = rows["flash_read_ahead"].value > 0
        self._switches = [BankSwitches()] * _BANKS
        self.reset()

    @property
    def is_instant(self) -> bool:
        """Return whether a read takes no longer than a fetch."""
        return self._synchronous and not self._clocks

    def reset(self) -> None:
        """Forget all lines and words."""
        self._free_at = 0  # when the array can take the next read
        # What each way of each set holds, and its ways, the one that was not used for longest first.
        self._held = [[_NOTHING] * self._ways for _ in range(self._sets)]
        self._order = [list(range(self._ways)) for _ in range(self._sets)]
        self.forget_flash_lines()
        self.forget_word()

    def switch_flash_bank(self, bank: int, switches: BankSwitches) -> None:
        """Set what is done for one half of the flash: 0 or 1."""
        if self._switches[bank].keeps_line and not switches.keeps_line:
            self._line = _NOTHING
        self._switches[bank] = switches

    def forget_flash_lines(self) -> None:
        """Forget the line that was read last, and the one that was read ahead."""
        self._line = self._ahead = _NOTHING

    def forget_word(self) -> None:
        """Forget the fetched word: the core jumps."""
        self.word = _NOTHING

    def forget_flash_way(self, way: int) -> None:
        """Empty one way of the cache; it is filled next."""
        for held, order in zip(self._held, self._order, strict=True):
            if way < self._ways:
                held[way] = _NOTHING
                order.remove(way)
                order.insert(0, way)

    def wait(self, address: int, size: int, cycle: int, *, fetched: bool = True) -> int:
        """Return for how many core clocks an access waits that is made at a cycle.

        Parameters
        ----------
        address, size : int
            Place of an instruction or of data; it may straddle two lines.
        cycle : int
            Never earlier than that of the access before.
        fetched : bool
            Whether it is an instruction.
        """
        switches = self._switches[(address // _WORD_BYTES * _WORD_BYTES - self._begin) // self._bank_bytes]
        begin = cycle
        for word in range(address // _WORD_BYTES, (address + size - 1) // _WORD_BYTES + 1):
            cycle += self._wait_for(word, cycle, switches, fetched=fetched)
            if fetched:
                self.word = word
        return cycle - begin

    def _wait_for(self, word: int, cycle: int, switches: BankSwitches, *, fetched: bool) -> int:
        line, entry = word * _WORD_BYTES // self._line_bytes, word * _WORD_BYTES // self._entry_bytes
        waited = 0
        if not (line == self._line or self._is_cached(entry) or (fetched and word == self.word)):
            ahead = switches.reads_ahead_code if fetched else switches.reads_ahead_data
            waited = self._read(line, cycle, keeps=switches.keeps_line, ahead=ahead and self._reads_ahead)
        self._use(entry, keeps=switches.caches_code if fetched else switches.caches_data)
        return waited

    def _read(self, line: int, cycle: int, *, keeps: bool, ahead: bool) -> int:
        # The line that is read ahead is there when the array is free again; another one is read from then on.
        ready = max(self._free_at, cycle) if line == self._ahead else self._next_edge(cycle) + self._clocks
        self._line, self._free_at, self._ahead = line if keeps else _NOTHING, ready, _NOTHING
        if ahead:
            self._ahead = line + 1
            self._free_at = self._next_edge(ready) + self._clocks
        return ready - cycle

    def _next_edge(self, cycle: int) -> int:
        free = max(cycle, self._free_at)
        return free if self._synchronous else -(-free // self._clocks) * self._clocks

    def _is_cached(self, entry: int) -> bool:
        return entry in self._held[entry % self._sets]

    def _use(self, entry: int, *, keeps: bool) -> None:
        """Take note that an entry was used: it is the last one to give way, and replaces the first where it is new."""
        held, order = self._held[entry % self._sets], self._order[entry % self._sets]
        if entry not in held:
            if not keeps:
                return
            held[order[0]] = entry
        way = held.index(entry)
        order.remove(way)
        order.append(way)


class Memories:
    """Flash, banks of SRAM that code and data want at once, and data at no multiple of its size.

    Attributes
    ----------
    flash : FlashController
    """

    def __init__(self, rows: Mapping[str, CostRow], waiting: WaitingMemories | None = None) -> None:
        waiting = waiting or WaitingMemories(FLASH)
        self.flash, self._waiting = FlashController(rows, *waiting.flash), waiting
        self._rows = {name: row.value for name, row in rows.items()}
        self._parts_owed = 0
        self._hidden = False
        self._bus_free_at = self._jumped_at = 0

    def fetch(self, address: int, size: int, cycle: int) -> int:
        """Return for how many clocks the fetch of an instruction waits."""
        if address >= _SYSTEM_BUS:
            return self._wait_for_bus(address, size, cycle)
        if self.flash.is_instant or not self._is_flash(address):
            return 0
        return self.flash.wait(address, size, cycle)

    def reset(self) -> None:
        """Forget what was fetched: the flash was written."""
        self.flash.reset()
        self._bus_free_at = self._jumped_at = 0

    def _wait_for_bus(self, address: int, size: int, cycle: int) -> int:
        clocks = self._rows.get("system_fetch", 0)
        if not clocks:
            return 0
        earliest = max(self._jumped_at, cycle - _AHEAD * clocks)  # the core fetches ahead, but not before a jump
        for word in range(address // _WORD_BYTES, (address + size - 1) // _WORD_BYTES + 1):
            if word != self.flash.word:
                self._bus_free_at = max(self._bus_free_at, earliest) + clocks
            self.flash.word = word
        return max(0, self._bus_free_at - cycle)

    def jump(self, cycle: int) -> None:
        """Forget the fetched word: the core jumps."""
        self.flash.forget_word()
        self._jumped_at = cycle

    def access(self, code: int, words: int, *, is_first: bool, role: Role, address: int, size: int, cycle: int) -> int:
        """Return for how many clocks an access of the instruction at `code` waits, which moves `words` words."""
        if address >= _ALIASES:
            return 0
        wait = 0
        if address % min(size, 4):  # pairs of words are two; words at odd addresses are a byte, two and a byte
            wait = self._rows.get("unaligned", 0) * (2 if size == 4 and address % 2 else 1)
        if self._is_flash(address):
            if self._is_flash(code) and words <= 1:
                wait += self._pay(self._rows.get("flash_load", 0))
            return wait if self.flash.is_instant else wait + self.flash.wait(address, size, cycle + wait, fetched=False)
        is_late = any(begin <= address < begin + length for begin, length in self._waiting.late)
        if is_late and role is not Role.NONE:
            if role is Role.BEGINS or (role is Role.BEHIND_STORE and self._hidden):
                wait += self._rows.get("late_access", 0)
            self._hidden = role is Role.FIRST_STORE
        if min(code, address) >= _SYSTEM_BUS:
            self._bus_free_at = max(self._bus_free_at, cycle) + 1
        return wait + self._pay(self._conflict(code, words, address)) if is_first else wait

    def _pay(self, parts: int) -> int:
        if not parts:
            return 0
        whole, self._parts_owed = divmod(self._parts_owed + parts, _PARTS)
        return whole

    def _is_flash(self, address: int) -> bool:
        begin, size = self._waiting.flash
        return begin <= address < begin + size

    def flush(self) -> None:
        """Forget fetched words and parts of a clock: an exception was entered or left, or a call begins."""
        self._parts_owed = 0  # else a call would take a clock more because of what was called before it
        self.flash.forget_word()

    def _conflict(self, code_address: int, words: int, data_address: int) -> int:
        code, data = self._bank(code_address), self._bank(data_address)
        if (code, data) not in (("lower", "lower"), ("upper", "upper"), ("flash", "lower")):
            return 0
        place = code if code == data else f"{code}_{data}"
        return self._rows.get(f"{place}_{'multiple' if words > 1 else 'single'}", 0)

    def _bank(self, address: int) -> str:
        return "flash" if self._is_flash(address) else "lower" if address < _SYSTEM_BUS else "upper"
