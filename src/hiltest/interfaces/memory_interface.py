"""Quantities read from a running board's memory, by the names of the firmware's variables."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from hiltest.errors import ConfigError, HiltestError
from hiltest.interfaces.function_return import halt_at_return
from hiltest.interfaces.gdb_client import GdbClient, MemoryRefusedError
from hiltest.interfaces.memory_ranges import ReadAhead, together
from hiltest.interfaces.places import NullPointer, Place, ReadMemory
from hiltest.interfaces.quantities import Observation, Quantity
from hiltest.interfaces.variable_index import nearest_names
from hiltest.interfaces.variables import Variables
from hiltest.measurement.units import conversion, unit_words

#: Run time of the firmware between two compared readings [s]: shorter than the period of 100 Hz values.
APART_S = 0.002
#: Number of readings after which a value that changed in each counts as always moving.
MOVES_AFTER = 3
_MOST_READINGS = 8
_CALL_WITHIN_S = 1.0


class Described(Protocol):
    """A quantity's variables as a rig describes them: `hiltest.rig.memory_device.MemoryValue`."""

    @property
    def paths(self) -> tuple[str, ...]:
        """One path to all numbers, or one path for each."""

    @property
    def unit(self) -> str | None:
        """Unit of the variable times `scale`; None for the quantity's own, if it has none."""

    @property
    def scale(self) -> float:
        """Factor on the variable."""

    @property
    def type(self) -> str | None:
        """Type of the variables, if only the symbol table has them."""


@dataclass(frozen=True, slots=True)
class Reading:
    """Places of a quantity's numbers, with `factor` and `offset` to its unit."""

    places: tuple[Place, ...]
    factor: float
    offset: float = 0.0

    def take(self, memory: ReadMemory) -> tuple[bytes, ...]:
        """Read the bytes of all places."""
        return tuple(place.read(memory) for place in self.places)

    def numbers(self, contents: tuple[bytes, ...]) -> NDArray[np.float64]:
        """Decode the bytes, in the quantity's unit."""
        numbers = [place.numbers(data) for place, data in zip(self.places, contents, strict=True)]
        return np.array([number for part in numbers for number in part], dtype=np.float64) * self.factor + self.offset


def read_description(quantity: Quantity, described: Described, variables: Variables) -> Reading:
    """Find the variables of a quantity.

    Raises
    ------
    ConfigError
        When a path leads nowhere, the unit does not fit the quantity, or the count of numbers differs from it.
    """
    units = ", ".join(unit_words(quantity.unit)) or "none"
    if described.unit is None and quantity.unit:
        raise ConfigError(f"unit is missing; write the firmware's own, one of {units}")
    unit = conversion(described.unit or "", quantity.unit)
    if unit is None:
        raise ConfigError(f"unit {described.unit!r} is no unit of {quantity.key}; write one of: {units}")
    places = tuple(variables.place(path, type_=described.type) for path in described.paths)
    count = sum(len(place.scalars) for place in places)
    if count != quantity.size:
        types = ", ".join(f"{place.path} is {place.type_text}" for place in places)
        raise ConfigError(f"{quantity.key} is {quantity.size} numbers, and these are {count} ({types})")
    return Reading(places, described.scale * unit.factor, unit.offset)


@dataclass(frozen=True, slots=True)
class _Snapshot:
    """Bytes of all quantities in one halt, and the reasons for missing ones."""

    contents: Mapping[Quantity, tuple[bytes, ...]]
    absent: Mapping[Quantity, str] = field(default_factory=dict)

    def changed(self, since: _Snapshot) -> frozenset[Quantity]:
        """Return the quantities whose bytes differ from an earlier snapshot."""
        return frozenset(
            quantity for quantity in self.contents if self.contents[quantity] != since.contents.get(quantity)
        )


class MemoryInterface:
    """Reader of a running board's variables through its debug server.

    All values are read in one halt. If the rig names a function, the halt is at the return of its next call. Without
    one, or if it is not called in time, the firmware may have been writing the values: they are read again after it has
    run on, until two readings agree in all quantities except those that change every time.

    Parameters
    ----------
    client
        Client of a halted processor; the firmware runs after construction.
    at_return_of
        Address of a function.
    call_within_s
        Longest wait for a call.

    Attributes
    ----------
    offers : frozenset of Quantity
    reads : int
        Number of readings.
    moving : dict of Quantity to int
        Number of readings in which a value never stood still, so that the last halt's value was used.
    not_called : int
        Number of readings in which the function was not called in time.
    absent : mapping of Quantity to str
        Reason why a quantity had no value in the latest reading: a null pointer on the way.
    """

    def __init__(
        self,
        client: GdbClient,
        readings: Mapping[Quantity, Reading],
        *,
        at_return_of: int | None = None,
        call_within_s: float = _CALL_WITHIN_S,
    ) -> None:
        self.offers = frozenset(readings)
        self.reads = self.not_called = 0
        self.moving: dict[Quantity, int] = {}
        self.absent: Mapping[Quantity, str] = {}
        self._client, self._readings = client, readings
        self._ranges = together(place.extent for reading in readings.values() for place in reading.places)
        self._entry, self._call_within_s = at_return_of, call_within_s
        client.go_on()

    def read(self, time_s: float) -> Observation:
        """Read all quantities.

        Raises
        ------
        DebugServerError
            When the debug server is gone, or refuses an address.
        """
        client, began_s = self._client, self._client.now()
        try:
            client.halt()
            snapshot = self._whole()
        except BaseException:
            with suppress(HiltestError):  # the first error is reported
                self._release()
            raise
        took_s = client.now() - began_s
        self._release()
        self.reads += 1
        self.absent = snapshot.absent
        values = {
            quantity: self._readings[quantity].numbers(contents) for quantity, contents in snapshot.contents.items()
        }
        return Observation(time_s + took_s, values)

    def remarks(self) -> tuple[str, ...]:
        """Return remarks on how the values were read; empty without any."""
        remarks = [
            f"{quantity.key} changed during {count} of {self.reads} readings, which may be inconsistent; name the "
            "function that writes it under at_return_of"
            for quantity, count in self.moving.items()
        ]
        if self.not_called:
            remarks.append(
                f"in {self.not_called} of {self.reads} readings the function of at_return_of was not called "
                f"within {self._call_within_s:g} s: its variables were read without it"
            )
        return (*remarks, *(f"{quantity.key} has no value: {reason}" for quantity, reason in self.absent.items()))

    def close(self) -> None:
        """Disconnect; the firmware runs on. Idempotent."""
        self._client.close()

    def _release(self) -> None:
        if not self._client.running:
            self._client.go_on()

    def _whole(self) -> _Snapshot:
        if self._entry is None:
            return self._steady()
        if halt_at_return(self._client, self._entry, self._call_within_s):
            return self._snapshot()
        self.not_called += 1
        return self._steady()

    def _steady(self) -> _Snapshot:
        """Read until two consecutive readings agree, except for quantities that change in all of them."""
        latest, always = self._snapshot(), self.offers
        for count in range(1, _MOST_READINGS):
            self._client.run_for(APART_S)
            before, latest = latest, self._snapshot()
            changed = latest.changed(before)
            always &= changed
            if not changed or (count >= MOVES_AFTER and changed == always):
                break
        for quantity in changed:
            self.moving[quantity] = self.moving.get(quantity, 0) + 1
        return latest

    def _snapshot(self) -> _Snapshot:
        contents: dict[Quantity, tuple[bytes, ...]] = {}
        absent: dict[Quantity, str] = {}
        memory = ReadAhead(self._client.read, self._ranges)
        for quantity, reading in self._readings.items():
            try:
                contents[quantity] = reading.take(memory)
            except NullPointer as reason:
                absent[quantity] = str(reason)
            except MemoryRefusedError as refused:
                if not any(place.beyond for place in reading.places):
                    raise
                absent[quantity] = f"a pointer is invalid: {refused.reason}"
        return _Snapshot(contents, absent)


def read_descriptions(
    values: Mapping[str, Described], variables: Variables, where: Callable[[str], str]
) -> dict[Quantity, Reading]:
    """Find the variables of all quantities of a rig, by their names.

    Parameters
    ----------
    where
        Returns file, line and key of a quantity's entry.

    Raises
    ------
    ConfigError
        With the place in the rig, when there is no such quantity, or for the reasons of `read_description`.
    """
    readings: dict[Quantity, Reading] = {}
    for name, described in values.items():
        try:
            readings[Quantity.named(name)] = read_description(Quantity.named(name), described, variables)
        except KeyError:
            hint = nearest_names(name, [quantity.key for quantity in Quantity])
            raise ConfigError(f"{where(name)}: no quantity {name!r}; {hint}") from None
        except ConfigError as error:
            raise ConfigError(f"{where(name)}: {error}") from error
    return readings
