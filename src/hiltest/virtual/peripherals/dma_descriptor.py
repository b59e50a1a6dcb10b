"""A transfer control descriptor of the eDMA: 32 bytes that say what one channel moves."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field, fields
from enum import IntFlag

from hiltest.state import Restorable

SIZE = 32
_LAYOUT = struct.Struct("<IhHIiIhHiHH")
_LINK, _LINK_CHANNEL, _LINKED_COUNT = 1 << 15, 9, 0x1FF
_SMLOE, _DMLOE, _OFFSET_BITS, _BYTES_BESIDE_OFFSET = 1 << 31, 1 << 30, 20, 0x3FF
_BYTES_BY_CODE = {0: 1, 1: 2, 2: 4, 4: 16, 5: 32}


class Control:
    """Bits of CSR; above them MAJORLINKCH and BWC."""  # no flags: the complement of one has nothing above it

    START, INTMAJOR, INTHALF, DREQ, ESG, MAJORELINK, ACTIVE, DONE = (1 << bit for bit in range(8))


class DescriptorError(IntFlag):
    """What is wrong with a descriptor, as ES shows it."""

    SGE, NCE, DOE, DAE, SOE, SAE = (1 << bit for bit in range(2, 8))


@dataclass
class Descriptor(Restorable):
    """The registers of one channel, named and in the order of the manual's table."""

    saddr: int
    soff: int
    attr: int
    nbytes: int
    slast: int
    daddr: int
    doff: int
    citer: int
    dlast: int
    csr: int
    biter: int
    offsets: bool = field(default=False, kw_only=True)  # CR.EMLM: NBYTES has an offset of minor loops

    @classmethod
    def unpack(cls, data: bytes, *, offsets: bool) -> Descriptor:
        """Read it from its registers, or from memory."""
        return cls(*_LAYOUT.unpack(data), offsets=offsets)

    def pack(self) -> bytes:
        """Return its registers."""
        names = [each.name for each in fields(self)][:-1]
        return _LAYOUT.pack(*(getattr(self, name) for name in names))

    # -- what it says -------------------------------------------------------------------------

    @property
    def source_bytes(self) -> int:
        """Bytes of one read; 0 for a code that means none."""
        return _BYTES_BY_CODE.get(self.attr >> 8 & 7, 0)

    @property
    def destination_bytes(self) -> int:
        """Bytes of one write; 0 for a code that means none."""
        return _BYTES_BY_CODE.get(self.attr & 7, 0)

    @property
    def minor_bytes(self) -> int:
        """Bytes of one minor loop."""
        if not self.offsets:
            return self.nbytes or 1 << 32
        return self.nbytes & (_BYTES_BESIDE_OFFSET if self.nbytes & (_SMLOE | _DMLOE) else _DMLOE - 1)

    @property
    def count(self) -> int:
        """Minor loops that are left."""
        return self.citer & (_LINKED_COUNT if self.citer & _LINK else _LINK - 1)

    @property
    def half(self) -> int:
        """Minor loops that are left when half of them are done."""
        return (self.biter & (_LINKED_COUNT if self.biter & _LINK else _LINK - 1)) >> 1

    @property
    def minor_link(self) -> int | None:
        """The channel that a minor loop starts at its end."""
        return self.citer >> _LINK_CHANNEL & 0xF if self.citer & _LINK else None

    @property
    def major_link(self) -> int | None:
        """The channel that the major loop starts at its end."""
        return self.csr >> 8 & 0xF if self.csr & Control.MAJORELINK else None

    def error(self) -> DescriptorError:
        """Say what forbids to move anything."""
        source, destination, wrong = self.source_bytes, self.destination_bytes, DescriptorError(0)
        if not source or self.saddr % source:
            wrong |= DescriptorError.SAE
        if not source or self.soff % source:
            wrong |= DescriptorError.SOE
        if not destination or self.daddr % destination:
            wrong |= DescriptorError.DAE
        if not destination or self.doff % destination:
            wrong |= DescriptorError.DOE
        whole = source and destination and not (self.minor_bytes % source or self.minor_bytes % destination)
        if not whole or not self.minor_bytes or not self.count or (self.citer ^ self.biter) & _LINK:
            wrong |= DescriptorError.NCE
        return wrong

    # -- how it goes on -----------------------------------------------------------------------

    def step_source(self) -> None:
        """Go on behind one read."""
        self.saddr = _stepped(self.saddr, self.soff, self.attr >> 11)

    def step_destination(self) -> None:
        """Go on behind one write."""
        self.daddr = _stepped(self.daddr, self.doff, self.attr >> 3 & 0x1F)

    def end_minor_loop(self) -> None:
        """Count one minor loop; add the offset, unless it was the last."""
        self.citer -= 1
        if self.count and self.offsets and self.nbytes & (_SMLOE | _DMLOE):
            offset = self.nbytes >> 10 & (1 << _OFFSET_BITS) - 1
            offset -= (offset >> _OFFSET_BITS - 1) << _OFFSET_BITS
            self.saddr = self.saddr + (offset if self.nbytes & _SMLOE else 0) & 0xFFFFFFFF
            self.daddr = self.daddr + (offset if self.nbytes & _DMLOE else 0) & 0xFFFFFFFF

    def end_major_loop(self) -> None:
        """Adjust the addresses, and begin to count anew."""
        self.saddr = self.saddr + self.slast & 0xFFFFFFFF
        if not self.csr & Control.ESG:
            self.daddr = self.daddr + self.dlast & 0xFFFFFFFF
        self.citer = self.biter
        self.csr |= Control.DONE


def _stepped(address: int, offset: int, modulo: int) -> int:
    """Add an offset; with a modulo only the lowest bits change."""
    mask = (1 << modulo) - 1 if modulo else 0xFFFFFFFF
    return address & ~mask | address + offset & mask
