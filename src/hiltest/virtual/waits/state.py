"""What places hold while a turn of a loop is walked through."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Protocol

from hiltest.virtual.waits.intervals import MASK, Place, Value, conjunction, extended


class NotUniform(Exception):
    """A branch, or a conditional instruction, goes this way in some of the turns and that way in others."""


class NotProvable(Exception):
    """The turn does what this cannot follow, however few turns are asked about."""


class Surroundings(Protocol):
    """What a turn begins with, and what it reads."""

    def held(self, place: Place) -> int:
        """Return what a place holds now."""
        ...

    def is_register(self, address: int) -> bool:
        """Whether a peripheral answers there."""
        ...

    def read(self, address: int, size: int, cycle: int, turns: int) -> Value:
        """Return what a register answers in the turns, of which the first reads it at a cycle of now."""
        ...


class TurnState:
    """Values of all places, as the instructions of a turn change them.

    Parameters
    ----------
    surroundings : Surroundings
    begun_with : mapping of Place to Value
        What is not the same at the beginning of each turn.
    turns : int
        Number of turns that all values are for.
    """

    def __init__(self, surroundings: Surroundings, begun_with: Mapping[Place, Value], turns: int) -> None:
        self.written: dict[Place, Value] = {}
        self.cycle = 0  # since the turn began, at the instruction
        self._surroundings = surroundings
        self._begun_with = begun_with
        self._turns = turns

    def get(self, place: Place) -> Value:
        """Return what a place holds."""
        value = self.written.get(place) or self._begun_with.get(place)
        return Value(self._surroundings.held(place), base=place) if value is None else value

    def set(self, place: Place, value: Value) -> None:
        """Write to a place."""
        self.written[place] = value

    def _address(self, value: Value) -> int:
        if not value.is_known:
            raise NotProvable
        return value.low

    def _refuse_overlap(self, address: int, size: int) -> None:
        for place in (*self.written, *self._begun_with):
            if isinstance(place, tuple) and place != (address, size):
                begin, length = place
                if begin < address + size and address < begin + length:
                    raise NotProvable

    def load(self, where: Value, size: int, *, signed: bool = False) -> Value:
        """Read memory or a register of a peripheral."""
        address = self._address(where)
        if self._surroundings.is_register(address):
            value = self._surroundings.read(address, size, self.cycle, self._turns)
        else:
            self._refuse_overlap(address, size)
            value = self.get((address, size))
        return extended(value, 8 * size, signed=True) if signed else value

    def store(self, where: Value, size: int, value: Value) -> None:
        """Write to RAM; a write to a peripheral may do anything."""
        address = self._address(where)
        if self._surroundings.is_register(address):
            raise NotProvable
        self._refuse_overlap(address, size)
        self.set((address, size), conjunction(value, Value(MASK >> 32 - 8 * size)))

    def is_true(self, value: Value) -> bool:
        """Say whether a flag is set, which must be the same in all turns."""
        if value.stale:
            raise NotProvable
        if value.width:
            raise NotUniform
        return value.low == 1


Condition = Callable[[TurnState], bool]


def _flag(name: str) -> Condition:
    return lambda state: state.is_true(state.get(name))


def _not(condition: Condition) -> Condition:
    return lambda state: not condition(state)


_N, _Z, _C, _V = (_flag(name) for name in "nzcv")


def _higher(state: TurnState) -> bool:
    return _C(state) and not _Z(state)


def _at_least(state: TurnState) -> bool:
    return _N(state) == _V(state)


def _greater(state: TurnState) -> bool:
    return not _Z(state) and _at_least(state)


#: In the order of their codes: a condition, and the opposite behind it.
CONDITIONS: tuple[Condition, ...] = tuple(
    each for condition in (_Z, _C, _N, _V, _higher, _at_least, _greater) for each in (condition, _not(condition))
)
