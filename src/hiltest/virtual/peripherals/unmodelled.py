"""Peripherals that the chip has and the virtual board does not model: they store writes, and are reported once."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace

from hiltest.virtual.chip import Chip, ChipPeripheral
from hiltest.virtual.cpu import Processor
from hiltest.virtual.peripherals.bus import ALL_STEADY, StoredRegisters

# FTFE_FSTAT's CCIF: every flash command is over. A driver waits for it, whatever it has written there.
_ALWAYS_SET = {0x40020000: 0x80}
_POLLED_READS = 1000  # reads of one register in a row, with no write between: more than any driver needs for its value


@dataclass(frozen=True, slots=True)
class UnmodelledAccess:
    """The first access to a register that does nothing.

    Attributes
    ----------
    register : str
        Name of the register, ``FTM0_SC``.
    address : int
    written : int or None
        The value, for a write.
    size : int
        In bytes.
    place : str
        Function and line of the instruction.
    cycle : int
        When [clock cycles since power-on].
    accesses : int
        How many there have been to the register so far.
    """

    register: str
    address: int
    written: int | None
    size: int
    place: str
    cycle: int
    accesses: int = 1

    def __str__(self) -> str:
        if self.written is None:
            what = f"read from {self.place} got what it holds"
        else:
            what = f"write of 0x{self.written:0{2 * self.size}x} from {self.place} kept"
        return f"{self.register} at 0x{self.address:08x} is not modelled; {what}"


class UnmodelledLog:
    """Accesses to unmodelled registers, each register once, and the one that is being polled.

    Parameters
    ----------
    processor : Processor
        Says who touches it, and when.
    chip : Chip
        Has the names.

    Attributes
    ----------
    listens : bool
        Whether accesses are noted: a debugger's are not.
    """

    def __init__(self, processor: Processor, chip: Chip) -> None:
        self.listens = True
        self._processor = processor
        self._chip = chip
        self._first: dict[str, UnmodelledAccess] = {}
        self._count: Counter[str] = Counter()
        self._last_read = 0
        self._reads = 0

    @property
    def accesses(self) -> tuple[UnmodelledAccess, ...]:
        """The first access to each register, in order."""
        return tuple(replace(each, accesses=self._count[name]) for name, each in self._first.items())

    @property
    def polled(self) -> str:
        """The register that is read over and over, if one is, else nothing."""
        if self._reads < _POLLED_READS:
            return ""
        return f"{self._chip.register_name(self._last_read)} at 0x{self._last_read:08x}"

    def passed(self, addresses: list[int], turns: int) -> None:
        """Take note of turns of a loop that were passed over, in each of which these addresses are read."""
        for address in addresses:
            self._count[self._chip.register_name(address) or f"0x{address:08x}"] += turns
        if set(addresses) == {self._last_read}:
            self._reads += turns * len(addresses)

    def note(self, address: int, size: int, written: int | None) -> None:
        """Take note of an access."""
        if not self.listens:
            return
        self._reads = self._reads + 1 if written is None and address == self._last_read else 1
        self._last_read = address if written is None else 0
        name = self._chip.register_name(address) or f"0x{address:08x}"
        self._count[name] += 1
        if name in self._first:
            return
        pc = self._processor.registers.pc.get()
        place = self._processor.place(pc)
        self._first[name] = UnmodelledAccess(name, address, written, size, place, self._processor.now())


class UnmodelledPage(StoredRegisters):
    """The registers of one page of addresses.

    Parameters
    ----------
    base : int
        First address.
    peripherals : list of ChipPeripheral
        Which have registers there.
    chip : Chip
        Has their values after reset.
    log : UnmodelledLog
    """

    steady = ALL_STEADY
    counts_reads = True

    def __init__(self, base: int, peripherals: list[ChipPeripheral], chip: Chip, log: UnmodelledLog) -> None:
        self._log = log
        super().__init__(", ".join(entry.name for entry in peripherals), base, chip.reset_bytes(base))

    def read(self, offset: int, size: int) -> int:
        """Answer what was written last, or the value after reset."""
        address = self.base + offset
        self._log.note(address, size, None)
        return super().read(offset, size) | _ALWAYS_SET.get(address, 0)

    def write(self, offset: int, size: int, value: int) -> None:
        """Keep what is written."""
        self._log.note(self.base + offset, size, value)
        super().write(offset, size, value)
