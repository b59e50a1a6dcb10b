"""Tables of parts: memories, peripherals, registers and pins.

The tables in ``mk64f12/`` (MK64FN1M0) and ``nrf51822/`` hold facts of a part (names, addresses, widths, values after
reset, clock gates, interrupts, sources of DMA requests) from its reference manual.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources

from hiltest.errors import ConfigError

_PAGE = 4096
_PORTS, _PINS = "ABCDE", range(32)

Region = tuple[int, int]
"""First address and size."""


def is_in(regions: Iterable[Region], address: int) -> bool:
    """Return whether any region contains an address."""
    return any(base <= address < base + size for base, size in regions)


@dataclass(frozen=True, slots=True)
class MemoryMap:
    """Memories of a part; their text has the format of ``--memory``."""

    flash: tuple[Region, ...]
    ram: tuple[Region, ...]
    aliases: tuple[tuple[int, Region], ...] = ()
    """Further addresses of memories: the address, and the memory."""

    def __str__(self) -> str:
        kinds = (("flash", self.flash), ("ram", self.ram))
        return ",".join(f"{kind}=0x{base:08x}:{size >> 10}K" for kind, regions in kinds for base, size in regions)

    def is_in_flash(self, address: int) -> bool:
        """Return whether an address is in flash."""
        return is_in(self.flash, address)


@dataclass(frozen=True, slots=True)
class ChipRegister:
    """One register: its full name, address, width in bytes and value after reset."""

    name: str
    address: int
    size: int
    reset: int


@dataclass(frozen=True, slots=True)
class ChipPeripheral:
    name: str
    base: int
    size: int
    """Size of its address range [bytes]."""
    gates: tuple[tuple[int, int], ...]
    """Number of an SCGC register (1 to 7) and bit; any set bit enables the clock. Without entries it always runs."""
    registers: tuple[ChipRegister, ...]
    interrupts: tuple[int, ...]
    """Interrupt numbers, in the order of the vector table."""
    requests: tuple[int, ...]
    """Sources of the DMA multiplexer."""


@dataclass(frozen=True, slots=True)
class ChipPin:
    """One signal of a pin such as ``PTC5``, and the multiplexer setting that selects it."""

    port: str
    number: int
    function: int
    signal: str


def pin_place(name: str) -> tuple[str, int]:
    """Return the letter of the port and the number of a pin such as ``PTC5``.

    Raises
    ------
    ConfigError
        If the part has no such pin.
    """
    letter, number = name[2:3], name[3:]
    if not (
        name.startswith("PT")
        and letter
        and letter in _PORTS
        and re.fullmatch("0|[1-9][0-9]?", number)
        and int(number) in _PINS
    ):
        raise ConfigError(f"the MK64FN1M0 has no pin {name!r}; write PTA0 to PTE31")
    return letter, int(number)


class Chip:
    """The part's peripherals.

    Parameters
    ----------
    pins
        Signals that pins may carry: those of the timers, on the pins of the FRDM-K64F's headers.
    """

    def __init__(self, peripherals: tuple[ChipPeripheral, ...], pins: tuple[ChipPin, ...]) -> None:
        self.peripherals = peripherals
        self.pins = pins
        self._registers = {
            address: register
            for peripheral in peripherals
            for register in peripheral.registers
            for address in range(register.address, register.address + register.size)
        }
        self._reset_bytes: dict[int, dict[int, int]] = {}
        for address, register in self._registers.items():
            if byte := register.reset >> 8 * (address - register.address) & 0xFF:
                self._reset_bytes.setdefault(address // _PAGE, {})[address % _PAGE] = byte
        self._pages: dict[int, list[ChipPeripheral]] = {}
        for peripheral in peripherals:
            for page in range(peripheral.base // _PAGE, (peripheral.base + peripheral.size - 1) // _PAGE + 1):
                self._pages.setdefault(page, []).append(peripheral)

    @property
    def pages(self) -> Mapping[int, list[ChipPeripheral]]:
        """Peripherals by page of 4 KiB, counted from address 0."""
        return self._pages

    def register_name(self, address: int) -> str | None:
        """Return the name of the register at an address, otherwise peripheral and offset; None without a peripheral."""
        register = self._registers.get(address)
        if register is not None:
            return register.name
        peripherals = [entry for entry in self._pages.get(address // _PAGE, ()) if entry.base <= address]
        if not peripherals:
            return None
        nearest = max(peripherals, key=lambda entry: entry.base)
        return f"{nearest.name}+0x{address - nearest.base:03X}"

    def reset_bytes(self, base: int) -> dict[int, int]:
        """Return the bytes of a page that are not zero after reset, by offset."""
        return dict(self._reset_bytes.get(base // _PAGE, {}))


def table(name: str, part: str = "mk64f12") -> Iterator[dict[str, str]]:
    """Yield the rows of one of a part's tables."""
    with (resources.files("hiltest.virtual.part") / part / name).open(encoding="ascii") as file:
        yield from csv.DictReader(file)


def _copies(row: dict[str, str]) -> list[str]:
    """Return the names of the instances of a row, from their number or their names."""
    copies = row["copies"]
    return [str(index) for index in range(int(copies))] if copies.isdigit() else copies.split() or [""]


def memories(part: str = "mk64f12") -> MemoryMap:
    """Return the memories of a part."""
    rows = list(table("memories.csv", part))
    flash, ram = (
        tuple((int(row["base"], 0), int(row["size"], 0)) for row in rows if row["kind"] == kind)
        for kind in ("flash", "ram")
    )
    return MemoryMap(flash, ram)


def mk64f12() -> Chip:
    """Return the peripherals and pins of the MK64FN1M0."""
    return chip("mk64f12")


@cache
def chip(part: str) -> Chip:
    """Return the peripherals of a part, and its pins if they carry signals, from its tables."""
    kinds: dict[str, list[tuple[str, int, int, int]]] = {}
    for row in table("registers.csv", part):
        for index, copy in enumerate(_copies(row)):
            offset = int(row["offset"], 0) + index * int(row["step"] or "0", 0)
            entry = row["name"].replace("#", copy), offset, int(row["bytes"]), int(row["reset"] or "0", 0)
            kinds.setdefault(row["kind"], []).append(entry)
    peripherals = []
    for row in table("peripherals.csv", part):
        name, base = row["name"], int(row["base"], 0)
        gates = (gate.removeprefix("SCGC").split(".") for gate in row["gates"].split())
        registers = tuple(
            ChipRegister(register if register.startswith(name) else f"{name}_{register}", base + offset, size, reset)
            for register, offset, size, reset in kinds.get(row["registers"], ())
        )
        scgc = tuple((int(register), int(bit)) for register, bit in gates)
        interrupts, requests = (tuple(map(int, row[column].split())) for column in ("interrupts", "requests"))
        peripherals.append(ChipPeripheral(name, base, int(row["size"], 0), scgc, registers, interrupts, requests))
    with_signals = table("pins.csv", part) if part == "mk64f12" else ()
    pins = (ChipPin(*pin_place(row["pin"]), int(row["function"]), row["signal"]) for row in with_signals)
    return Chip(tuple(peripherals), tuple(pins))
