"""State of simulated things, to go back to it."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable
from typing import Any, NamedTuple, Protocol

_CONTAINERS = frozenset({bytearray, list, dict, set, deque, Counter})


class HasState(Protocol):
    """A thing that can go back to a state."""

    def state(self) -> Any:
        """Return what `restore` takes; it does not change any more."""
        ...

    def restore(self, state: Any) -> None:
        """Go back to a state, which can be restored again afterwards."""
        ...


class State(NamedTuple):
    """State of a thing: its attributes, and its parts with their states."""

    attributes: dict[str, Any]
    parts: list[tuple[HasState, Any]]


class Restorable:
    """A thing whose attributes are its state: values and other things as they are, containers as copies.

    So whatever a container holds never changes, or belongs to one of the `parts`.
    """

    def parts(self) -> Iterable[HasState]:
        """Return the things whose states are a part of this one's."""
        return ()

    def state(self) -> Any:
        """Return what `restore` takes; it does not change any more."""
        return State(_copied(vars(self)), [(part, part.state()) for part in self.parts()])

    def restore(self, state: Any) -> None:
        """Go back to a state, which can be restored again afterwards."""
        vars(self).update(_copied(state.attributes))
        for part, state_of_part in state.parts:
            part.restore(state_of_part)


def _copied(attributes: dict[str, Any]) -> dict[str, Any]:
    copies = attributes.copy()
    for name, value in copies.items():
        if value.__class__ in _CONTAINERS:
            copies[name] = value.copy()
    return copies
