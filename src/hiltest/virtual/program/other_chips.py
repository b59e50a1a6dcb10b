"""Recognition of images for another chip than the MK64FN1M0, by the marks in ``chips.csv``.

Names decide if there are any: those of files and functions first, then those in the debug information. Otherwise the
decision follows from the memories that the vector table points into and the register blocks whose addresses the code
contains.

The columns of the table, whose first row is the virtual board's chip and those with the same memories and registers:

``name``
    The chip in sentences, unless `names` says it more exactly.
``names``
    Regular expression of a chip in names of files and functions and in debug information, in lower case. CMSIS names
    start-up and header files after the chip, vendors their libraries. Words are letters with a digit behind them, such
    as the k64f in frdm_k64f. Radios (nRF24L01, CC1101) must not match. In the last rows it is a machine of ELF headers.
``flash``, ``ram``
    First addresses and sizes of the memories that code and stack are in; the flash of STM32 is at 0, too. A chip with
    `names` and another stack is not this one.
``blocks``
    First addresses and sizes of register blocks that nearly all firmware of the chip uses, at places where the
    MK64FN1M0 has none, except in rows of Kinetis.
``vectors``
    Numbers of exceptions that have a handler of their own and that the MK64FN1M0 does not have.

Source of addresses: the memory maps of the vendors' reference manuals, and their CMSIS headers.
"""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from itertools import takewhile
from typing import TYPE_CHECKING, Any

import numpy as np

from hiltest.errors import ConfigError
from hiltest.text import join_words

if TYPE_CHECKING:
    from hiltest.virtual.program.elf import FirmwareImage

Region = tuple[int, int]
"""First address and size."""
_SYMBOL_NAMES, _DEBUG_NAMES = (".strtab",), (".debug_str", ".debug_line_str", ".debug_line", ".debug_info")
#: Where vector tables begin in an image: behind nothing, RP2040's second stage, or headers and boot loaders.
_TABLE_OFFSETS = (0, 0x100, 0x200, 0x400, 0x1000, 0x2000, 0x4000)
_RAM = range(0x04000000, 0x40000000)  # where initial stack pointers of all these chips are
_STACK_END = 0x100  # initial stacks at the end of a memory are multiples of it
_VECTORS = 128
_LEAST_MARKS = 2  # because the address of a single block may be a number by chance
_MOST_SHOWN = 3
_WORD = re.compile(r"[a-z]+[0-9]\w*")
_LDR, _LDR_WIDE, _MOV, _MOVW, _MOVT = 0x4800, 0xF8DF, 0xF04F, 0xF240, 0xF2C0
_LEAST_TURNS = 8  # of MOV; smaller numbers stand for other patterns
_PAGE = 0xFFF
#: Virtual boards by a part of the names of their chips; the first one decides.
_MACHINES = {"nrf51": "microbit-v1", "stm32f40": "stm32f407-disco", "stm32f4": "stm32f411-disco"}
_FAR_HALVES = 16  # compilers schedule MOVW and MOVT of one address at most a few instructions apart


@dataclass(frozen=True, slots=True, eq=False)
class _Chip:
    """One row of the table."""

    name: str
    names: str
    flash: tuple[Region, ...]
    ram: tuple[Region, ...]
    blocks: tuple[Region, ...]
    vectors: tuple[int, ...]

    def names_it(self, word: str) -> bool:
        return bool(self.names and re.match(self.names, word))


@dataclass(frozen=True, slots=True)
class OtherChip:
    """The chip that an image is for."""

    name: str
    """Such as ``MK22F51212`` or ``STM32F2 or STM32F4``; empty if several chips have such memories."""
    evidence: str
    """Marks by which it was recognised."""

    @property
    def machine(self) -> str | None:
        """Board of the virtual boards that has such a chip, as ``machine`` under ``[board]`` of a rig names it."""
        names = f"{self.name} {self.evidence}".lower()
        return next((machine for mark, machine in _MACHINES.items() if mark in names), None)

    def __str__(self) -> str:
        kind = f"{_article(self.name)} {self.name} image" if self.name else "an image for another chip"
        return f"this is {kind} ({self.evidence})"


def _regions(text: str) -> tuple[Region, ...]:
    pairs = (item.split(":") for item in text.split())
    return tuple((int(base, 0), int(size, 0)) for base, size in pairs)


@cache
def _table() -> tuple[_Chip, ...]:
    with (resources.files("hiltest.virtual.program") / "chips.csv").open(encoding="ascii") as file:
        return tuple(
            _Chip(
                row["name"],
                row["names"],
                _regions(row["flash"]),
                _regions(row["ram"]),
                _regions(row["blocks"]),
                tuple(map(int, row["vectors"].split())),
            )
            for row in csv.DictReader(file)
        )


def _article(name: str) -> str:
    """Return the indefinite article before the name of a chip, whose first letters are spelled."""
    is_spelled = name[:1] in "AEFHILMNRSXn" and not name.startswith(("SAM", "MAX"))
    return "an" if is_spelled or name.startswith("i.") else "a"


def machine_title(machine: str) -> str:
    """Return a name of the processor that an ELF header names, such as ``EM_AVR``; empty if the table has none."""
    return next((row.name for row in _table() if row.names == machine), "")


def refuse_other_chip(image: FirmwareImage) -> None:
    """Raise a ConfigError if an image is for another chip than the virtual board's."""
    chip = other_chip(image)
    if chip is not None:
        other = f'`machine = "{chip.machine}"` under [board] of a rig is a virtual board with such a chip. '
        raise ConfigError(
            f"{image.name}: {chip}, and the virtual board is an MK64FN1M0 with other memories and registers. "
            f"{other if chip.machine else ''}"
            "`hiltest profile` counts the cycles of its functions and `hiltest judge` judges its calibrator, both "
            "without peripherals; `hiltest init --firmware` proposes a rig for its own board. For the virtual board "
            "link for 1 MiB of flash at 0 and 256 KiB of SRAM at 0x1fff0000"
        )


def other_chip(image: FirmwareImage) -> OtherChip | None:
    """Return the chip that an image is for; None if it may be the MK64FN1M0."""
    stack, entry, vectors = _vector_table(image)
    for sections in (_SYMBOL_NAMES, _DEBUG_NAMES):
        text = b"\0".join(image.section(name) for name in sections).decode("latin-1").lower()
        words = Counter(_WORD.findall(text))
        chips = [chip for chip in _table() if stack is None or not chip.ram or _is_in(chip.ram, stack - 4)]
        names = {chip: Counter({word: words[word] for word in words if chip.names_it(word)}) for chip in chips}
        if any(names.values()):
            return _most_named(names)
    return _by_layout(image, stack, entry, vectors)


def _most_named(names: dict[_Chip, Counter[str]]) -> OtherChip | None:
    chip = max(names, key=lambda chip: names[chip].total())  # the MK64FN1M0 is the first of equals
    if chip is _table()[0]:
        return None
    words = [word for word, _ in names[chip].most_common()]
    parts = [match[0].partition("_")[0] for word in words if (match := re.match(chip.names, word))]
    part = next((part for part in parts if any(letter.isdigit() for letter in part)), "")
    name = part.upper().replace("NRF", "nRF") or chip.name
    return OtherChip(name, f"it names {join_words(words, _MOST_SHOWN)}")


def _by_layout(image: FirmwareImage, stack: int | None, entry: int, vectors: tuple[int, ...]) -> OtherChip | None:
    """Return the chips whose memories contain an image's and whose marks it has most."""
    ours, *others = _table()
    words = _words(image)
    fits = [chip for chip in others if _is_in(chip.flash, entry) and (stack is None or _is_in(chip.ram, stack - 4))]
    marks = {chip: _marks(chip, words, vectors) for chip in fits}
    most = max(marks.values(), default=(0, 0))
    is_ours = _is_in(ours.flash, entry) and (stack is None or _is_in(ours.ram, stack - 4))
    is_known = stack is not None and most[0] >= _LEAST_MARKS
    if is_ours and not (is_known and most > _marks(ours, words, vectors)):
        return None
    places = f"its code is at 0x{entry:08x}" + ("" if stack is None else f", its stack at 0x{stack:08x}")
    if is_known:
        best = " or ".join(chip.name for chip in fits if marks[chip] == most)
        return OtherChip(best, f"{places}, and it uses {most[0]} of its register blocks or interrupts")
    if _is_in(ours.flash, entry) and stack is not None and stack % _STACK_END:
        return None  # a mistake in a linker script, which is refused as such
    fits += [chip for chip in others if not chip.ram and _is_in(chip.flash, entry)]
    alike = [chip.name for chip in others if chip.names and chip in fits]
    return OtherChip("", f"{places}, as on {join_words(alike, _MOST_SHOWN)}") if alike else None


def _marks(chip: _Chip, words: np.ndarray[Any, np.dtype[np.uint32]], vectors: tuple[int, ...]) -> tuple[int, int]:
    """Return the numbers of a chip's blocks and interrupts that an image uses, and of those that are certain.

    GCC addresses a register by the begin of its page of 4 KiB and an offset, and a page may have several blocks.
    """
    certain = [bool(((words >= base) & (words - base < size)).any()) for base, size in chip.blocks]
    likely = [bool((words == base & ~_PAGE).any()) for base, _ in chip.blocks]
    interrupts = any(number in vectors for number in chip.vectors)
    return sum(map(any, zip(certain, likely, strict=True))) + interrupts, sum(certain) + interrupts


def _words(image: FirmwareImage) -> np.ndarray[Any, np.dtype[np.uint32]]:
    """Return the words of an image that may be addresses of registers: loaded literals, and those of MOVW and MOVT."""
    words = []
    for segment in image.segments:
        halves = np.frombuffer(segment.data[: len(segment.data) // 4 * 4], "<u2").astype(np.uint32)
        first, second = halves[:-1], halves[1:]
        pc = np.arange(len(first)) * 2 + 4 & ~3
        loads = (first & 0xF800 == _LDR, (first & 0xFF) * 4), (first == _LDR_WIDE, second & 0xFFC)
        targets = np.concatenate([(pc + offset)[chosen] for chosen, offset in loads])
        words.append(np.frombuffer(halves.astype("<u2"), "<u4")[targets[targets < 2 * len(halves)] // 4])
        number = (first & 15) << 12 | (first & 0x400) << 1 | (second & 0x7000) >> 4 | second & 0xFF
        turns, turned = (number & 0xFFF) >> 7, number & 0x7F | 0x80  # the form of MOV, which turns eight bits right
        is_mov = (first & 0xFBFF == _MOV) & (turns >= _LEAST_TURNS)
        number = np.where(is_mov, turned >> turns | turned << 32 - turns, number)
        is_wide = second < 0x8000
        low = np.flatnonzero(is_wide & (is_mov | (first & 0xFBF0 == _MOVW)))
        words.append(number[low])
        for top in np.flatnonzero(is_wide & (first & 0xFBF0 == _MOVT)):
            near = low[(low < top) & (low >= top - _FAR_HALVES)]
            lower = number[near[second[near] >> 8 & 15 == second[top] >> 8 & 15][-1:]]
            words.append(number[top] << 16 | lower & 0xFFFF)
    return np.unique(np.concatenate(words))


def _is_in(regions: Iterable[Region], address: int) -> bool:
    return any(base <= address < base + size for base, size in regions)


def _vector_table(image: FirmwareImage) -> tuple[int | None, int, tuple[int, ...]]:
    """Return initial stack pointer, reset address, and the numbers of exceptions with a handler of their own.

    Without a vector table the stack pointer is None, and the address is that of the first code.
    """
    parts = sorted((part for part in image.segments if part.data), key=lambda part: part.address)
    for part in parts:
        for offset in _TABLE_OFFSETS:
            words = tuple(np.frombuffer(part.data[offset : offset + 4 * _VECTORS].ljust(4 * _VECTORS, b"\0"), "<u4"))
            stack, entry = int(words[0]), int(words[1])
            if stack % 4 == 0 and stack in _RAM and entry & 1 and _may_be_code(entry, part.address, parts):
                return stack, entry & ~1, tuple(_own_handlers(words, part.address, parts))
    return None, parts[0].address, ()


def _may_be_code(entry: int, base: int, parts: Sequence[Any]) -> bool:
    """Return whether an address is in the image; that of a raw binary is unknown, and its load address is 0."""
    in_image = any(part.run_address <= entry < part.run_address + part.run_size for part in parts)
    return in_image or (base == 0 and len(parts) == 1 and any(_is_in(chip.flash, entry) for chip in _table()))


def _own_handlers(words: Sequence[int], base: int, parts: Sequence[Any]) -> Iterator[int]:
    """Yield the numbers of exceptions whose handler is no other exception's, up to the end of the table."""
    handlers = [
        *takewhile(lambda word: not word or (word & 1 and _may_be_code(int(word), base, parts)), map(int, words[1:]))
    ]
    counts = Counter(handlers)
    return (number for number, handler in enumerate(handlers, start=1) if handler and counts[handler] == 1)
