"""Packets as rows of a CSV file, one packet per row."""

from __future__ import annotations

from collections.abc import Iterable

from hiltest.interfaces.packet_fields import Packet, TimedPacket
from hiltest.interfaces.packet_stream import PacketBatch
from hiltest.interfaces.packet_summary import BoardClock


class PacketRows:
    """Lines of a CSV file with units in the column names.

    A cell is empty if the packet of the row does not have the quantity. A packet without a time stamp has the time of
    the last one that has one.

    Parameters
    ----------
    kinds
        Kinds that get columns; others are omitted.
    """

    def __init__(self, kinds: Iterable[type[Packet]]) -> None:
        self._kinds = frozenset(kinds)
        self._columns = tuple(dict.fromkeys(name for kind in kinds for name in kind.columns()))
        self._clock = BoardClock()
        self._time_s = ""

    def header(self) -> str:
        """Return the first line."""
        return ",".join(["time_s", "type", "number", *self._columns]) + "\n"

    def lines(self, batch: PacketBatch) -> str:
        """Return the lines of a batch."""
        return "".join(self._line(packet) for packet in batch.packets() if type(packet) in self._kinds)

    def _line(self, packet: Packet) -> str:
        if isinstance(packet, TimedPacket):
            self._time_s = f"{self._clock.advance(packet.time_us):.6f}"
        values = packet.values()
        cells = [f"{values[name]:.10g}" if name in values else "" for name in self._columns]
        return ",".join([self._time_s, str(packet.type), str(packet.number), *cells]) + "\n"
