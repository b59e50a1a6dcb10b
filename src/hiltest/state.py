"""State of simulated things, for snapshots."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable
from typing import Any, NamedTuple, Protocol

_CONTAINERS = frozenset({bytearray, list, dict, set, deque, Counter})


class HasState(Protocol):
    """A thing that can return to a state."""

    def state(self) -> Any:
        """Return a state for `restore`, which does not change afterwards."""
        ...

    def restore(self, state: Any) -> None:
        """Return to a state, which can be restored again afterwards."""
        ...


class State(NamedTuple):
    """State of a thing: its attributes, and its parts with their states."""

    attributes: dict[str, Any]
    parts: list[tuple[HasState, Any]]


class Restorable:
    """A thing whose state consists of its attributes: containers are copied, other values are shared.

    So the elements of a container must never change, or belong to one of the `parts`.
    """

    def parts(self) -> Iterable[HasState]:
        """Return the things whose states are part of this one's."""
        return ()

    def state(self) -> Any:
        """Return a state for `restore`, which does not change afterwards."""
        return State(_copy_attributes(vars(self)), [(part, part.state()) for part in self.parts()])

    def restore(self, state: Any) -> None:
        """Return to a state, which can be restored again afterwards."""
        vars(self).update(_copy_attributes(state.attributes))
        for part, state_of_part in state.parts:
            part.restore(state_of_part)


def _copy_attributes(attributes: dict[str, Any]) -> dict[str, Any]:
    copies = attributes.copy()
    for name, value in copies.items():
        if value.__class__ in _CONTAINERS:
            copies[name] = value.copy()
    return copies
