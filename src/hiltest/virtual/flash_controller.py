"""The K64F's flash controller (FMC): how long an access to flash waits.

A read of the flash array brings one line, and the next line is read ahead at once. What was accessed is kept in a cache
of smaller entries. The flash has a clock of its own, so a read begins at one of its edges: a miss costs one flash
clock, and up to nearly another one until the edge.
"""

from __future__ import annotations

from collections.abc import Mapping

from hiltest.virtual.timing import CostRow

_NOTHING = -1


class FlashController:
    """Line buffer, cache and read-ahead.

    Parameters
    ----------
    rows : mapping of str to CostRow
        The memory rows of a timing profile.
    """

    def __init__(self, rows: Mapping[str, CostRow]) -> None:
        self._clocks = rows["flash_clocks"].value
        self._line_bytes = rows["flash_line_bytes"].value
        self._entry_bytes = rows["cache_entry_bytes"].value
        self._ways = rows["cache_ways"].value
        self._sets = rows["cache_sets"].value
        self._reads_ahead = rows["flash_read_ahead"].value > 0
        self.reset()

    def reset(self) -> None:
        """Nothing was read yet."""
        self._line = self._ahead = _NOTHING
        self._free_at = 0  # when the array can take the next read
        # The entries of each set, the one that was not used for longest first.
        self._cache: list[list[int]] = [[] for _ in range(self._sets)]

    def wait(self, address: int, size: int, cycle: int) -> int:
        """Return for how many core clocks an access waits that is made at a cycle.

        Parameters
        ----------
        address, size : int
            Of an instruction or of data; it may straddle two lines.
        cycle : int
            Never earlier than that of the access before.
        """
        first, last = address // self._entry_bytes, (address + size - 1) // self._entry_bytes
        begin = cycle
        for entry in range(first, last + 1):
            cycle += self._wait_for(entry, cycle)
        return cycle - begin

    def _wait_for(self, entry: int, cycle: int) -> int:
        line = entry * self._entry_bytes // self._line_bytes
        waited = 0 if line == self._line or self._is_cached(entry) else self._read(line, cycle)
        self._keep(entry)
        return waited

    def _read(self, line: int, cycle: int) -> int:
        # The line that is read ahead is there when the array is free again; another one is read from then on.
        ready = max(self._free_at, cycle) if line == self._ahead else self._next_edge(cycle) + self._clocks
        self._line, self._free_at, self._ahead = line, ready, _NOTHING
        if self._reads_ahead:
            self._ahead = line + 1
            self._free_at = self._next_edge(ready) + self._clocks
        return ready - cycle

    def _next_edge(self, cycle: int) -> int:
        return -(-max(cycle, self._free_at) // self._clocks) * self._clocks

    def _is_cached(self, entry: int) -> bool:
        return entry in self._cache[entry % self._sets]

    def _keep(self, entry: int) -> None:
        ways = self._cache[entry % self._sets]
        if entry in ways:
            ways.remove(entry)
        ways.append(entry)
        del ways[: -self._ways]
