"""Cycle counts that others published, and what the model counts of the same code.

    python -m tests.virtual.published --page docs/cycle-validation.md

writes the page's table. If an ELF file is missing, it says so and stops.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import pytest

from hiltest.virtual.board.k64f import board_for
from hiltest.virtual.calls.procedure_call import Argument
from hiltest.virtual.counts.cycle_range import cycle_range

from ..foreign_elf import foreign_elf

ONE, TWO = "cortex-m4-trm/1", "cortex-m4-trm/2"
READING = 5
"""What figures include that were read around a call: the counter and the call itself, 4 to 7 clocks."""

_AES = "Schwabe and Stoffelen, All the AES you need on Cortex-M3 and M4, STM32F407"
_X25519 = "Emill/X25519-Cortex-M4 @ e85f8167, a Cortex-M4F"
_SHORT = {_AES: "[1]", _X25519: "[2]"}
_KEY = bytes(range(16))
_SECRET = bytes.fromhex("a546e36bf0527c9d3b16154b82465edd62144c0ac1fc5a18506a2244ba449ac4")
_POINT = bytes.fromhex("e6db6867583030db3594c1a424b15f7c726624ec26b3353b10a903a6d0ab1c4c")
SHARED_SECRET = bytes.fromhex("c3da55379de9c6908e94ea4df28d084f32eccf03491c71f754b4075577a28552")


@dataclass(frozen=True)
class Published:
    """A function, its arguments, and what was published of it.

    Attributes
    ----------
    cycles : float
        As published.
    times : int
        Blocks that the figure is the mean over; 1: it is of the call, with `READING` in it.
    tables_in_flash : bool
        Whether the tables that it looks up lay in flash, where each access waits: not what is counted here.
    rounded : bool
        Whether the figure is a rounded remark.
    """

    elf: str
    function: str
    arguments: Callable[[], Sequence[Argument]]
    cycles: float
    source: str
    times: int = 1
    tables_in_flash: bool = False
    rounded: bool = False

    @property
    def path(self) -> Path:
        """ELF file; `foreign_elf` skips the test if it is missing."""
        return foreign_elf(f"{self.elf}.elf")

    @property
    def alone(self) -> float:
        """What was published, without what the reading of the counter took."""
        return self.cycles - (READING if self.times == 1 else 0)


@dataclass(frozen=True)
class Count:
    """What the model counts, of one block where many were averaged, and its range."""

    cycles: float
    low: float
    high: float

    def error(self, published: Published) -> float:
        """By which part of the published figure the count is off, signed."""
        return (self.cycles - published.alone) / published.cycles

    def holds(self, published: Published) -> bool:
        """Whether the published figure is in the range."""
        return self.low <= published.alone <= self.high


@cache
def _key_schedule(elf: str, function: str, words: int) -> bytes:
    schedule = bytearray(words)
    board_for(foreign_elf(f"{elf}.elf")).call(function, _KEY, schedule)
    return bytes(schedule)


def _encrypt() -> Sequence[Argument]:
    return bytearray(_KEY + _key_schedule("aes", "AES_128_keyschedule", 160)), bytes(16), bytearray(16)


def _counter_mode(context: Callable[[], bytes]) -> Callable[[], Sequence[Argument]]:
    return lambda: (bytearray(16) + context(), bytes(4096), bytearray(4096), 4096)


def _schedule_of(key_bytes: int, words: int) -> Callable[[], Sequence[Argument]]:
    return lambda: (bytes(range(key_bytes)), bytearray(words))


def _x25519() -> Sequence[Argument]:
    return bytearray(32), _SECRET, _POINT


FIGURES = (
    Published("aes", "AES_128_keyschedule", _schedule_of(16, 160), 244.9, _AES, tables_in_flash=True),
    Published("aes_192_ctr", "AES_192_keyschedule", _schedule_of(24, 208), 232.2, _AES, tables_in_flash=True),
    Published("aes_256_ctr", "AES_256_keyschedule", _schedule_of(32, 240), 309.9, _AES, tables_in_flash=True),
    Published("aes", "AES_128_encrypt", _encrypt, 634.7, _AES, tables_in_flash=True),
    *(
        Published(
            f"aes_{bits}_ctr",
            f"AES_{bits}_encrypt_ctr",
            _counter_mode(lambda keys=keys: bytes(16 * keys)),
            cycles,
            _AES,
            times=256,
            tables_in_flash=True,
        )
        for bits, keys, cycles in ((128, 11, 527.9), (192, 13, 644.0), (256, 15, 760.7))
    ),
    Published("aes_128_ctr_bs", "AES_128_keyschedule", _schedule_of(16, 352), 1021.9, _AES, tables_in_flash=True),
    Published(
        "aes_128_ctr_bs",
        "AES_128_encrypt_ctr",
        _counter_mode(lambda: _key_schedule("aes_128_ctr_bs", "AES_128_keyschedule", 352)),
        1616.6,
        _AES,
        times=256,
    ),
    Published("x25519_m4f", "curve25519_scalarmult", _x25519, 476_275, _X25519),
    Published("x25519_m4f_na", "curve25519_scalarmult", _x25519, 476_275 + 30_000, _X25519, rounded=True),
)


def count(published: Published, profile: str) -> Count:
    """Count a function by a profile."""
    board = board_for(published.path, profile=profile)
    result = board.call(published.function, *published.arguments())
    assert result.executed
    band = cycle_range(board.processor.profile, result.cycles, [result.executed])
    low, high = (band.low, band.high) if band else (result.cycles, result.cycles)
    return Count(*(cycles / published.times for cycles in (result.cycles, low, high)))


def mean_and_worst(counts: Sequence[tuple[Published, Count]]) -> tuple[float, float]:
    """Return the mean and the greatest error of counts, without signs."""
    errors = [abs(counted.error(published)) for published, counted in counts]
    return sum(errors) / len(errors), max(errors)


def rows(figures: Sequence[Published] = FIGURES) -> Iterator[str]:
    """Yield the lines of the page's table, and the means behind it."""
    yield "| function | published | version 1 | error | version 2 | error | range | published figure | source |"
    yield "| --- | --: | --: | --: | --: | --: | --: | --- | --- |"
    by_version: dict[str, list[tuple[Published, Count]]] = {ONE: [], TWO: []}
    for figure in figures:
        first, second = (count(figure, profile) for profile in by_version)
        by_version[ONE].append((figure, first))
        by_version[TWO].append((figure, second))
        cells = (
            f"{figure.elf}: `{figure.function}`",
            _number(figure.cycles) + (" (rounded)" if figure.rounded else ""),
            *(
                cell
                for counted in (first, second)
                for cell in (_number(counted.cycles), f"{100 * counted.error(figure):+.2f} %")
            ),
            f"{_number(second.low)} to {_number(second.high)}",
            "inside" if second.holds(figure) else "outside",
            _SHORT[figure.source] + ("; tables in flash" if figure.tables_in_flash else ""),
        )
        yield f"| {' | '.join(cells)} |"
    yield ""
    yield "| functions | version 1, mean | worst | version 2, mean | worst |"
    yield "| --- | --: | --: | --: | --: |"
    for name, chosen in (("all", lambda _: True), ("tables not in flash", lambda item: not item.tables_in_flash)):
        pairs = [[pair for pair in counts if chosen(pair[0])] for counts in by_version.values()]
        shares = [f"{100 * part:.2f} %" for counts in pairs for part in mean_and_worst(counts)]
        yield f"| {name} ({len(pairs[0])}) | {' | '.join(shares)} |"


def _number(cycles: float) -> str:
    text = f"{cycles:,.1f}".replace(",", " ")
    return text.removesuffix(".0")


def main() -> int:
    """Print the tables, and write them into the page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--page", type=Path, help="write the tables into this page")
    arguments = parser.parse_args()
    try:
        lines = "\n".join(rows())
    except pytest.skip.Exception as missing:
        print(missing)
        return 1
    print(lines)
    if arguments.page:
        text = arguments.page.read_text(encoding="utf-8")
        head, _, rest = text.partition("| function |")
        _, _, tail = rest.partition("\n\n## ")
        arguments.page.write_text(f"{head}{lines}\n\n## {tail}", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
