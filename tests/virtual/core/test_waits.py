"""Waits of the memories in C are those of the model in Python, for random fetches, accesses and switches."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import pytest

from hiltest.virtual.core.machine import BankSwitches
from hiltest.virtual.model import timing
from hiltest.virtual.model.profile_file import MEMORY_ROWS, MEMORY_RULES, load_profile

from .inner_library import inner_library
from .memory_model import Memories, Role

PROFILES = ("cortex-m4-k64f/1", "cortex-m4-k64f/2", "cortex-m4-k64f/3")
OFF = dict.fromkeys(("keeps_line", "reads_ahead_code", "reads_ahead_data", "caches_code", "caches_data"), False)
#: First addresses of places that matter: both ends of flash and its middle, both banks of SRAM, and what has no waits.
PLACES = (0x0, 0x8000, 0x7FFE0, 0xFFFC0, 0x1FFF0000, 0x1FFFFFC0, 0x20000000, 0x2002FFC0, 0x22000000, 0x40000000)
FLASH_PLACES = 4
#: Another part: flash at another place, and two RAMs that answer loads late.
ELSEWHERE = timing.WaitingMemories((0x08000000, 0x100000), ((0x2001C000, 0x4000), (0x20040000, 0x60000)))
PLACES_ELSEWHERE = (
    0x08000000,
    0x08008000,
    0x0807FFE0,
    0x080FFFC0,
    0x0,
    0x10000000,
    0x2001BFF0,
    0x2001FFF0,
    0x20040000,
    0x22000000,
    0x40000000,
)
STEPS = 400


def rows_of(values: Mapping[str, int]) -> dict[str, timing.CostRow]:
    return {name: timing.CostRow(value, (value, value), "") for name, value in values.items()}


class NewModel:
    """The model in C."""

    def __init__(self, values: Mapping[str, int], waiting: timing.WaitingMemories | None = None) -> None:
        self.ffi, self.library = inner_library()
        self.waits = self.ffi.new("struct memory_waits *")
        self.library.waits_begin(self.waits)
        for name, value in values.items():
            assert self.library.set_memory_row(self.waits, name.encode(), value), (name, value)
        if waiting:
            self.library.waits_set_flash(self.waits, waiting.flash)
            for ram in waiting.late:
                assert self.library.waits_add_late_ram(self.waits, ram)

    def fetch(self, address: int, size: int, cycle: int) -> int:
        return int(self.library.waits_fetch(self.waits, address, size, cycle))

    def jump(self, cycle: int) -> None:
        self.library.waits_jump(self.waits, cycle)

    def access(self, code: int, words: int, *, is_first: bool, role: Role, address: int, size: int, cycle: int) -> int:
        return int(self.library.waits_access(self.waits, code, words, is_first, role, address, size, cycle))

    def flush(self) -> None:
        self.library.waits_flush(self.waits)

    def switch(self, bank: int, switches: BankSwitches) -> None:
        self.library.waits_switch(self.waits, bank, switches._asdict())


class Course:
    """A random course of one program: mostly straight on, with jumps, accesses, and now and then something else."""

    def __init__(self, values: Mapping[str, int], chance: random.Random, *, elsewhere: bool = False) -> None:
        waiting = ELSEWHERE if elsewhere else None
        self.old, self.new, self.chance = Memories(rows_of(values), waiting), NewModel(values, waiting), chance
        self.places = PLACES_ELSEWHERE if elsewhere else PLACES
        self.cycle, self.code, self.first = 0, self.places[1], True
        self.span = chance.choice((0x40, 0x100, 0x1000))

    def go(self) -> Iterator[tuple[str, int, int]]:
        """Yield what happened, and the waits of both models."""
        for _ in range(STEPS):
            yield self.fetch()
            self.first = True
            for _ in range(self.chance.choice((0, 0, 1, 1, 3))):
                yield self.access()
                self.first = False
            if self.chance.random() < 0.2:
                self.jump()
            if self.chance.random() < 0.05:
                self.change()
            self.cycle += self.chance.randint(0, 3)

    def fetch(self) -> tuple[str, int, int]:
        size = self.chance.choice((2, 2, 4))
        waits = [model.fetch(self.code, size, self.cycle) for model in (self.old, self.new)]
        text = f"fetch of {size} bytes at 0x{self.code:x}, cycle {self.cycle}"
        self.code += size
        self.cycle += waits[0]
        return text, waits[0], waits[1]

    def access(self) -> tuple[str, int, int]:
        size = self.chance.choice((1, 2, 4, 4, 8))
        address = self.chance.choice(self.places) + self.chance.randrange(0x20)
        words = self.chance.choice((0, 0, 1, 2, 8))
        role = self.chance.choice(list(Role)) if self.first else Role.NONE
        waits = [
            model.access(
                self.code,
                words,
                is_first=self.first,
                role=role,
                address=address,
                size=size,
                cycle=self.cycle,
            )
            for model in (self.old, self.new)
        ]
        text = f"access to {size} bytes at 0x{address:x} by {words} words at 0x{self.code:x}, cycle {self.cycle}"
        self.cycle += waits[0]
        return text, waits[0], waits[1]

    def jump(self) -> None:
        places = self.places[:FLASH_PLACES] if self.chance.random() < 0.8 else self.places[:-2]
        self.code = self.chance.choice(places) + 2 * self.chance.randrange(self.span // 2)
        for model in (self.old, self.new):
            model.jump(self.cycle)

    def change(self) -> None:
        """Do something rarer to both."""
        library, waits, flash = self.new.library, self.new.waits, self.old.flash
        way, bank = self.chance.randrange(6), self.chance.randrange(2)
        switches = BankSwitches(**{name: self.chance.random() < 0.6 for name in OFF})
        changes: tuple[tuple[Callable[[], Any], Callable[[], Any]], ...] = (
            (self.old.flush, self.new.flush),
            (flash.forget_flash_lines, lambda: library.waits_forget_lines(waits)),
            (lambda: flash.forget_flash_way(way), lambda: library.waits_forget_way(waits, way)),
            (lambda: flash.switch_flash_bank(bank, switches), lambda: self.new.switch(bank, switches)),
            (self.old.reset, lambda: library.waits_reset(waits)),
        )
        for change in self.chance.choices(changes, weights=(4, 4, 4, 4, 1))[0]:
            change()


def assert_alike(values: Mapping[str, int], chance: random.Random, *, elsewhere: bool = False) -> None:
    for place, (answer, expected, counted) in enumerate(Course(values, chance, elsewhere=elsewhere).go()):
        assert counted == expected, f"step {place}: {answer}"


def shipped_values(name: str) -> dict[str, int]:
    return {name: row.value for name, row in load_profile(name).memory.items()}


def random_values(chance: random.Random) -> dict[str, int]:
    """Return values of all rows, now and then without those that a profile need not have."""
    values = {
        "flash_clocks": chance.choice((1, 2, 5, 7)),
        "flash_line_bytes": 2 ** chance.randint(2, 6),
        "flash_read_ahead": chance.randrange(2),
        "cache_entry_bytes": 2 ** chance.randint(2, 6),
        "cache_ways": chance.choice((1, 2, 4, 5, 16)),
        "cache_sets": 2 ** chance.randint(0, 6),
        "flash_uncertainty": 15,
        "unaligned": chance.randint(0, 3),
        "flash_synchronous": chance.randrange(2),
        "flash_load": chance.choice((0, 10, 100, 250)),
        "late_access": chance.randint(0, 2),
        "system_fetch": chance.randint(0, 3),
    } | {
        f"{place}_{count}": chance.choice((0, 3, 50, 150, 1000))
        for place in ("lower", "upper", "flash_lower")
        for count in ("single", "multiple")
    }
    assert values.keys() == {*MEMORY_ROWS, *MEMORY_RULES}
    return values if chance.random() < 0.8 else {row: value for row, value in values.items() if row in MEMORY_ROWS}


@pytest.mark.parametrize("seed", range(60))
def test_random_courses_wait_as_long_by_random_rows(seed: int) -> None:
    chance = random.Random(seed)
    assert_alike(random_values(chance), chance, elsewhere=seed % 2 == 1)


@pytest.mark.parametrize(
    ("row", "value"),
    [
        ("", 1),
        ("flash", 1),
        ("cache_ways", 0),
        ("cache_ways", 17),
        ("cache_sets", 128),
        ("cache_sets", 3),
        ("flash_clocks", 0),
        ("flash_clocks", 1001),
        ("flash_line_bytes", 2),
        ("flash_line_bytes", 24),
        ("cache_entry_bytes", 2),
        ("flash_read_ahead", 2),
        ("unaligned", -1),
        ("lower_single", 1001),
    ],
)
def test_a_row_that_is_none_or_out_of_range_is_refused_and_changes_nothing(row: str, value: int) -> None:
    model = NewModel(shipped_values(PROFILES[1]))
    before = bytes(model.ffi.buffer(model.waits))
    assert not model.library.set_memory_row(model.waits, row.encode(), value)
    assert bytes(model.ffi.buffer(model.waits)) == before
