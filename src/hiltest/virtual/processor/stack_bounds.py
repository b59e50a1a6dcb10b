"""Bound on the stack use of a function, from the code of every path through the function and its callees."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from hiltest.virtual.core.decoder import decode
from hiltest.virtual.core.library import lib
from hiltest.virtual.program.elf import FirmwareImage

#: 8 words, 18 words of floating-point state, and one word for alignment.
EXCEPTION_FRAME_BYTES = 27 * 4
_MOST_DEPTHS = 32  # at one instruction; only a loop that moves the stack pointer in each turn has more
_FRAME_POINTER = 7  # of GCC and Clang for Thumb
_STACK_POINTER = 13
_MOST_BYTES = 1 << 20  # largest size of straight-line code
_CALLS = {lib.FLOW_CALL, lib.FLOW_POINTER_CALL}


class NoBound(Exception):
    """Error for a function without a bound; the message names the instruction that prevents one."""


@dataclass(frozen=True, slots=True)
class _State:
    """State at a jump target."""

    address: int
    depth: int
    """Bytes below the stack pointer at the function's entry."""
    frame: int | None = None
    """The same for the frame pointer; None if it was not set from the stack pointer."""


class StackBounds:
    """Stack bounds of an image's functions.

    Notes
    -----
    Every path through the code counts, including paths that no input takes. A jump out of a function is a tail
    call, which is followed like a jump within the function. The bound of a callee is added to the depth at its call.
    """

    def __init__(self, image: FirmwareImage) -> None:
        self._image = image
        self._bounds: dict[int, int] = {}

    def bound(self, address: int) -> int:
        """Return the largest stack use of a function [bytes], without exceptions.

        Parameters
        ----------
        address
            Address of the function's first instruction.

        Raises
        ------
        NoBound
            If it or a callee is recursive, calls through a pointer, or moves the stack pointer by an unknown amount.
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
            depth, frame, visited = state.depth, state.frame, frames[state.address]
            if visited.get(depth, frame) != frame:  # different paths disagree about the frame pointer
                frame = None
            if depth in visited and visited[depth] == frame:
                continue
            visited[depth] = frame
            if len(visited) > _MOST_DEPTHS:
                raise self._no_bound(state.address, "moves the stack pointer in each turn of a loop")
            following = state.address
            for instruction in self._code(state.address):
                following = instruction.address + instruction.size
                if instruction.result != lib.NO_REGISTER or instruction.writes >> _FRAME_POINTER & 1:
                    depth, frame = self._move(instruction, depth, frame)
                    deepest = max(deepest, depth)
                if instruction.flow == lib.FLOW_ON:
                    continue
                if instruction.flow in _CALLS:
                    deepest = max(deepest, depth + self._bound(self._callee(instruction), callers))
                else:
                    open_states += [_State(target, depth, frame) for target in self._targets(instruction)]
                if self._ends(instruction, following):
                    break
            else:
                if following != state.address:  # otherwise the address holds data
                    open_states.append(_State(following, depth, frame))
        return deepest

    def _code(self, address: int) -> Iterator[Any]:
        """Decode the code at an address; data yields nothing."""
        try:
            return decode(address, self._image.code_from(address, _MOST_BYTES))
        except ValueError as error:
            raise NoBound(f"0x{address:08x} is not code in the file") from error

    def _ends(self, instruction: Any, following: int) -> bool:
        """Return whether a jump or a call is never followed by the next instruction."""
        if instruction.conditional or instruction.in_it_block:
            return False
        return instruction.flow not in _CALLS or self._is_function(following)

    def _is_function(self, address: int) -> bool:
        """Return whether a function begins at an address; a call right before it does not return."""
        function = self._image.function_at(address)
        return function is not None and function.address == address

    def _move(self, instruction: Any, depth: int, frame: int | None) -> tuple[int, int | None]:
        """Return the depth and the frame pointer after an instruction."""
        if instruction.flow == lib.FLOW_RETURN:
            return depth, frame
        base = {_STACK_POINTER: depth, _FRAME_POINTER: frame}.get(instruction.base)
        result = base - instruction.number if instruction.is_sum and base is not None else None
        if instruction.result == _STACK_POINTER:
            if result is None:
                how = "by a register" if instruction.base == _STACK_POINTER else "to another stack"
                raise self._no_bound(instruction.address, f"moves the stack pointer {how}")
            depth = result
        if instruction.writes >> _FRAME_POINTER & 1:
            frame = result if instruction.result == _FRAME_POINTER else None
        return depth, frame

    def _callee(self, instruction: Any) -> int:
        if instruction.flow == lib.FLOW_POINTER_CALL:
            raise self._no_bound(instruction.address, "calls through a pointer")
        return int(instruction.target)

    def _targets(self, instruction: Any) -> list[int]:
        """Return the targets of a jump; a return has none."""
        if instruction.flow == lib.FLOW_JUMP:
            return [instruction.target]
        if instruction.flow == lib.FLOW_TABLE:
            return self._cases(instruction)
        if instruction.flow == lib.FLOW_LITERAL:  # a veneer
            return [int.from_bytes(self._image.read(instruction.target, 4), "little") & ~1]
        if instruction.flow == lib.FLOW_POINTER:
            raise self._no_bound(instruction.address, "jumps through a pointer")
        return []

    def _cases(self, instruction: Any) -> list[int]:
        """Return the targets of a table branch; the table is between the branch and the next code."""
        begin, targets, size = instruction.address + instruction.size, list[int](), instruction.entry_size
        place = -(-begin // size) * size
        while self._image.is_data_in_code(place):
            entry = int.from_bytes(self._image.read(place, size), "little")
            targets.append(entry & ~1 if size == 4 else begin + 2 * entry)
            place += size
        if not targets:
            raise self._no_bound(instruction.address, "jumps through a table that does not follow it")
        return [target for target in targets if not begin <= target < place]  # entries for padding point into the table

    def _no_bound(self, address: int, action: str) -> NoBound:
        return NoBound(f"{self._name(address)} {action} at 0x{address:08x}")

    def _name(self, address: int) -> str:
        function = self._image.function_at(address)
        return function.name if function else f"0x{address:08x}"


def bound_with_exceptions(bounds: StackBounds, entry: int, handlers: Iterable[Iterable[int]]) -> int:
    """Return the largest use of the stack that firmware starts with [bytes].

    Parameters
    ----------
    entry
        Address of the firmware's first instruction.
    handlers
        Handlers in groups; those of a group cannot interrupt each other, so only the deepest one counts.

    Raises
    ------
    NoBound
    """
    return bounds.bound(entry) + sum(
        EXCEPTION_FRAME_BYTES + max(bounds.bound(handler) for handler in group) for group in handlers
    )
