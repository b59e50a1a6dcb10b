"""How much stack a function can take at most, from the code alone: on every way through it and what it calls."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from hiltest.virtual.core.decoder import decode
from hiltest.virtual.core.library import lib
from hiltest.virtual.program.elf import FirmwareImage

#: 8 words, 18 more of floating-point state, and one to align them.
EXCEPTION_FRAME_BYTES = 27 * 4
_MOST_DEPTHS = 32  # at one instruction: more come of a loop that goes on moving the stack pointer
_FRAME_POINTER = 7  # of GCC and Clang for Thumb
_STACK_POINTER = 13
_MOST_BYTES = 1 << 20  # of code without a jump
_CALLS = {lib.FLOW_CALL, lib.FLOW_POINTER_CALL}


class NoBound(Exception):
    """A function's stack is not bounded by its code; the message says which instruction leaves it open."""


@dataclass(frozen=True, slots=True)
class _State:
    """Where execution may come to by a jump."""

    address: int
    depth: int
    """Bytes below the stack pointer that the function began with."""
    frame: int | None = None
    """The same of the frame pointer, where that was set from the stack pointer."""


class StackBounds:
    """Bounds of an image's functions.

    Notes
    -----
    Every way through the code counts, also those that no input takes. A jump out of a function is followed as one
    within it: it is a tail call. A call's bound is added to the depth that it is made at.
    """

    def __init__(self, image: FirmwareImage) -> None:
        self._image = image
        self._bounds: dict[int, int] = {}

    def bound(self, address: int) -> int:
        """Return the bytes that a function can take, exceptions not included.

        Parameters
        ----------
        address
            Its first instruction.

        Raises
        ------
        NoBound
            It, or what it calls, calls itself or through a pointer, or moves the stack pointer by what is not known.
        """
        return self._bound(address & ~1, ())

    def _bound(self, entry: int, callers: tuple[int, ...]) -> int:
        if entry in callers:
            chain = " -> ".join(self._name(caller) for caller in (*callers[callers.index(entry) :], entry))
            raise NoBound(f"it calls itself: {chain}")
        if entry not in self._bounds:
            self._bounds[entry] = self._walk(entry, (*callers, entry))
        return self._bounds[entry]

    def _walk(self, entry: int, callers: tuple[int, ...]) -> int:
        deepest, open_states = 0, [_State(entry, 0)]
        frames: dict[int, dict[int, int | None]] = defaultdict(dict)  # by address and depth
        while open_states:
            state = open_states.pop()
            depth, frame, known = state.depth, state.frame, frames[state.address]
            if known.get(depth, frame) != frame:  # it depends on the way that led here
                frame = None
            if depth in known and known[depth] == frame:
                continue
            known[depth] = frame
            if len(known) > _MOST_DEPTHS:
                raise self._open(state.address, "moves the stack pointer on and on in a loop")
            following = state.address
            for instruction in self._code(state.address):
                following = instruction.address + instruction.size
                if instruction.result != lib.NO_REGISTER or instruction.writes >> _FRAME_POINTER & 1:
                    depth, frame = self._moved(instruction, depth, frame)
                    deepest = max(deepest, depth)
                if instruction.flow == lib.FLOW_ON:
                    continue
                if instruction.flow in _CALLS:
                    deepest = max(deepest, depth + self._bound(self._called(instruction), callers))
                else:
                    open_states += [_State(target, depth, frame) for target in self._targets(instruction)]
                if self._ends(instruction, following):
                    break
            else:
                if following != state.address:  # no data there
                    open_states.append(_State(following, depth, frame))
        return deepest

    def _code(self, address: int) -> Iterator[Any]:
        """Decode the code at an address; nothing where data is."""
        try:
            return decode(address, self._image.code_from(address, _MOST_BYTES))
        except ValueError as error:
            raise NoBound(f"0x{address:08x} is no code of the file") from error

    def _ends(self, instruction: Any, following: int) -> bool:
        """Whether execution does not go on behind a jump or a call."""
        if instruction.conditional or instruction.in_it_block:
            return False
        return instruction.flow not in _CALLS or self._is_function(following)

    def _is_function(self, address: int) -> bool:
        """Whether a function begins at an address: a call just before it does not return."""
        found = self._image.function_at(address)
        return found is not None and found.address == address

    def _moved(self, instruction: Any, depth: int, frame: int | None) -> tuple[int, int | None]:
        """Return the depth and the frame pointer behind an instruction."""
        if instruction.flow == lib.FLOW_RETURN:
            return depth, frame
        base = {_STACK_POINTER: depth, _FRAME_POINTER: frame}.get(instruction.base)
        result = base - instruction.number if instruction.is_sum and base is not None else None
        if instruction.result == _STACK_POINTER:
            if result is None:
                how = "by a register" if instruction.base == _STACK_POINTER else "to another place"
                raise self._open(instruction.address, f"moves the stack pointer {how}")
            depth = result
        if instruction.writes >> _FRAME_POINTER & 1:
            frame = result if instruction.result == _FRAME_POINTER else None
        return depth, frame

    def _called(self, instruction: Any) -> int:
        if instruction.flow == lib.FLOW_POINTER_CALL:
            raise self._open(instruction.address, "calls through a pointer")
        return int(instruction.target)

    def _targets(self, instruction: Any) -> list[int]:
        """Return where a jump leads; nowhere for a return."""
        if instruction.flow == lib.FLOW_JUMP:
            return [instruction.target]
        if instruction.flow == lib.FLOW_TABLE:
            return self._cases(instruction)
        if instruction.flow == lib.FLOW_LITERAL:  # a veneer
            return [int.from_bytes(self._image.read(instruction.target, 4), "little") & ~1]
        if instruction.flow == lib.FLOW_POINTER:
            raise self._open(instruction.address, "jumps through a pointer")
        return []

    def _cases(self, instruction: Any) -> list[int]:
        """Return the targets of a table branch, whose table lies behind it up to where code begins again."""
        begin, found, size = instruction.address + instruction.size, list[int](), instruction.entry_size
        place = -(-begin // size) * size
        while self._image.is_data_in_code(place):
            entry = int.from_bytes(self._image.read(place, size), "little")
            found.append(entry & ~1 if size == 4 else begin + 2 * entry)
            place += size
        if not found:
            raise self._open(instruction.address, "jumps by a table that does not lie behind it")
        return [each for each in found if not begin <= each < place]  # what fills it up leads into it

    def _open(self, address: int, what: str) -> NoBound:
        return NoBound(f"{self._name(address)} {what} at 0x{address:08x}")

    def _name(self, address: int) -> str:
        found = self._image.function_at(address)
        return found.name if found else f"0x{address:08x}"


def bound_with_exceptions(bounds: StackBounds, entry: int, handlers: Iterable[Iterable[int]]) -> int:
    """Return the bytes that firmware can take of the stack that it starts with.

    Parameters
    ----------
    entry
        Where it starts.
    handlers
        Of exceptions that cannot interrupt each other: the deepest of each comes on top.

    Raises
    ------
    NoBound
    """
    return bounds.bound(entry) + sum(
        EXCEPTION_FRAME_BYTES + max(bounds.bound(each) for each in alike) for alike in handlers
    )
