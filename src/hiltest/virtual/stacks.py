"""How deep the stacks of firmware have been, seen by where its stack pointer was.

A stack is a range of addresses that the stack pointer has had without a jump: it is lowered by instructions and by
exceptions' frames, and each value at the beginning of a block lies in a range that is known. Where it does not, the
stack pointer was set to another place, such as a new task's, and a stack begins there. Nothing is painted.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

#: Above every address: the stack pointer has not been seen.
NOT_SEEN = 2**32 - 1
_CONTEXT_BYTES = 104  # r4 to r11, EXC_RETURN, s16 to s31, and what aligns them


@dataclass(slots=True)
class Stack:
    """A stack that has been used.

    Attributes
    ----------
    top : int
        Address above it: the stack pointer while it was empty.
    lowest : int
        Lowest address that the stack pointer has had.
    first_pc : int
        The code that ran when it was first seen: of a task the function that it begins with.
    """

    top: int
    lowest: int
    first_pc: int

    @property
    def used(self) -> int:
        """Bytes that it has held at most."""
        return self.top - self.lowest


class Stacks:
    """The stacks of a processor.

    Attributes
    ----------
    known : list of Stack
        In the order in which they were first seen; the first is the one that firmware starts with.
    read_pc, read : callable
        Read the program counter, and bytes at an address.
    """

    def __init__(self) -> None:
        self.known: list[Stack] = []
        self.read_pc: Callable[[], int] = lambda: 0
        self.read: Callable[[int, int], bytes] = lambda _address, _size: b""
        self._lowest, self._in_block = NOT_SEEN, NOT_SEEN
        self._below: tuple[Stack, int, bytes] | None = None

    def reaches(self, above: int, lowest: int) -> Stack:
        """Take note that the stack pointer went down from `above` to `lowest`, and return the stack that it is on."""
        found = next((each for each in self.known if each.lowest <= above <= each.top), None)
        if found is None:
            found = Stack(above, above, self.read_pc() & ~1)
            self.known.append(found)
        found.lowest = min(found.lowest, lowest)
        for other in [each for each in self.known if each is not found and found.lowest < each.top <= found.top]:
            # It was first seen half way down, or has run into the one below it: no border between them is left.
            found.lowest = min(found.lowest, other.lowest)
            self.known.remove(other)
        return found

    def block_begins(self) -> None:
        """Take note that what was seen of a block is of one that has ended."""
        self._lowest, self._in_block = min(self._lowest, self._in_block), NOT_SEEN

    def in_block(self, lowest: int) -> None:
        """Take note of how low the block that runs takes the stack pointer."""
        self._in_block = lowest

    def take_lowest(self, *, has_ended: bool = True) -> int:
        """Return how low the stack pointer has been since the last time, with the block that runs if it has ended."""
        if has_ended:
            self.block_begins()
        lowest, self._lowest = self._lowest, NOT_SEEN
        return lowest

    def used_from(self, stack: int, lowest: int) -> int | None:
        """Return the bytes between two addresses that the stack pointer has had; None where two stacks lie between."""
        within = any(each.lowest <= lowest and stack <= each.top for each in self.known)
        return stack - lowest if within else None

    def handler_begins(self, lowest: int) -> None:
        """Take note of what lies below the frame of a thread's exception, where the handler has another stack.

        A kernel that switches tasks puts their other registers there, and the stack pointer never shows it.
        """
        stack = next(each for each in self.known if each.lowest <= lowest <= each.top)
        below = lowest - _CONTEXT_BYTES
        self._below = None
        if below < stack.lowest:
            with suppress(ValueError):  # no memory: nothing is put there
                self._below = stack, below, self.read(below, _CONTEXT_BYTES)

    def handler_ends(self) -> None:
        """Look whether something was put there."""
        if self._below is not None:
            stack, below, before = self._below
            self._below = None
            after = self.read(below, _CONTEXT_BYTES)
            if after != before:
                first = next(at for at in range(0, _CONTEXT_BYTES, 4) if after[at : at + 4] != before[at : at + 4])
                stack.lowest = min(stack.lowest, below + first)
