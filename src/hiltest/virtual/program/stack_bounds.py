"""How much stack a function can take at most, from the code alone: on every way through it and what it calls."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, replace

from hiltest.virtual.program.elf import FirmwareImage
from hiltest.virtual.program.instructions import Instruction, decode, instruction_size
from hiltest.virtual.program.stack_moves import Moves

#: 8 words, 18 more of floating-point state, and one to align them.
EXCEPTION_FRAME_BYTES = 27 * 4
_MOST_DEPTHS = 32  # at one instruction: more come of a loop that goes on moving the stack pointer
_FRAME_POINTER, _FRAME_BIT = "r7", 1 << 7  # of GCC and Clang for Thumb
_SET_FRAME = re.compile(r"(?:add|add\.w|mov) r7, sp(?:, #(0x[0-9a-f]+|\d+))?")
_RAISE_FRAME = re.compile(r"adds(?:\.w)? r7, (?:r7, )?#(0x[0-9a-f]+|\d+)")
_LITERAL = re.compile(r"ldr\.w pc, \[pc(?:, #(-?0x[0-9a-f]+|-?\d+))?\]")
_TABLE = re.compile(r"ldr(?:\.w)? pc, \[r\d+, r\d+, lsl #2\]")
_RETURNS = re.compile(r"bx lr|mov pc, lr|pop.*\bpc\b.*|ldr(?:\.w)? pc, \[sp\].*|ldm\S* sp!, .*\bpc\b.*")


class NoBound(Exception):
    """A function's stack is not bounded by its code; the message says which instruction leaves it open."""


@dataclass(frozen=True, slots=True)
class _State:
    """What is known before an instruction.

    Attributes
    ----------
    address : int
    depth : int
        Bytes below the stack pointer that the function began with.
    frame : int or None
        The same of the frame pointer, where that was set from the stack pointer.
    conditions : int
        How many instructions from here on belong to an IT block.
    """

    address: int
    depth: int
    frame: int | None = None
    conditions: int = 0


class StackBounds:
    """Bounds of an image's functions.

    Parameters
    ----------
    image : FirmwareImage

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
        address : int
            Its first instruction.

        Raises
        ------
        NoBound
            It, or what it calls, calls itself or through a pointer, or moves the stack pointer by what is not known.
        """
        return self._bound(address & ~1, ())

    def _bound(self, entry: int, callers: tuple[int, ...]) -> int:
        if entry in callers:
            chain = " -> ".join(self._name(each) for each in (*callers[callers.index(entry) :], entry))
            raise NoBound(f"it calls itself: {chain}")
        if entry not in self._bounds:
            self._bounds[entry] = self._walk(entry, (*callers, entry))
        return self._bounds[entry]

    def _walk(self, entry: int, callers: tuple[int, ...]) -> int:
        deepest, open_states = 0, [_State(entry, 0)]
        frames: dict[int, dict[int, int | None]] = defaultdict(dict)  # by address and depth
        while open_states:
            state = open_states.pop()
            known = frames[state.address]
            if known.get(state.depth, state.frame) != state.frame:  # it depends on the way that led here
                state = replace(state, frame=None)
            is_seen = state.depth in known and known[state.depth] == state.frame
            if is_seen or self._image.is_data_in_code(state.address):
                continue
            known[state.depth] = state.frame
            instruction = self._instruction(state)
            if len(known) > _MOST_DEPTHS:
                raise NoBound(f"a loop around {self._place(instruction)} moves the stack pointer on and on")
            depth, frame = self._moved(instruction, state)
            deepest = max(deepest, depth)
            if instruction.calls:
                deepest = max(deepest, depth + self._bound(self._called(instruction), callers))
            elif instruction.transfer:
                open_states += [_State(target, depth, frame) for target in self._targets(instruction)]
            if not instruction.transfer or instruction.conditional or (
                instruction.calls and not self._is_function(instruction.address + instruction.size)
            ):
                conditions = max(state.conditions - 1, 0)
                if instruction.row == "it":
                    conditions = len(instruction.text.partition(" ")[0]) - 1
                open_states.append(_State(instruction.address + instruction.size, depth, frame, conditions))
        return deepest

    def _is_function(self, address: int) -> bool:
        """Whether a function begins at an address: a call just before it does not return."""
        found = self._image.function_at(address)
        return found is not None and found.address == address

    def _instruction(self, state: _State) -> Instruction:
        try:
            code = self._image.read(state.address, 4)
        except ValueError as error:
            raise NoBound(f"0x{state.address:08x} is no code of the file") from error
        return decode(state.address, code[: instruction_size(code)], state.conditions)[0]

    def _moved(self, instruction: Instruction, state: _State) -> tuple[int, int | None]:
        """Return the depth and the frame pointer behind an instruction."""
        depth, frame, text = state.depth, state.frame, instruction.text
        if instruction.moves_stack is Moves.AS_IT_SAYS:
            depth += instruction.lowers_stack
        elif text == f"mov sp, {_FRAME_POINTER}" and frame is not None:
            depth = frame
        elif not _RETURNS.fullmatch(text):
            how = "by a register" if instruction.moves_stack is Moves.BY_A_REGISTER else "to another place"
            raise NoBound(f"{self._place(instruction)} moves the stack pointer {how}")
        if match := _SET_FRAME.fullmatch(text):
            frame = depth - int(match[1] or "0", 0)
        elif frame is not None and (match := _RAISE_FRAME.fullmatch(text)):
            frame -= int(match[1], 0)
        elif instruction.core_writes & _FRAME_BIT:
            frame = None
        return depth, frame

    def _called(self, instruction: Instruction) -> int:
        if instruction.target is None:
            raise NoBound(f"{self._place(instruction)} calls through a pointer")
        return instruction.target & ~1

    def _targets(self, instruction: Instruction) -> list[int]:
        """Return where a jump leads; nowhere for a return."""
        if instruction.target is not None:
            return [instruction.target & ~1]
        if instruction.row == "table_branch" or _TABLE.fullmatch(instruction.text):
            return self._cases(instruction)
        if _RETURNS.fullmatch(instruction.text):
            return []
        if match := _LITERAL.fullmatch(instruction.text):  # a veneer
            place = (instruction.address + 4 & ~3) + int(match[1] or "0", 0)
            return [int.from_bytes(self._image.read(place, 4), "little") & ~1]
        raise NoBound(f"{self._place(instruction)} jumps through a pointer")

    def _cases(self, instruction: Instruction) -> list[int]:
        """Return the targets of a table branch, whose table lies behind it up to where code begins again.

        TBB and TBH have halves of distances from there, LDR to the PC has addresses.
        """
        begin, found = instruction.address + instruction.size, list[int]()
        size = {"tbb": 1, "tbh": 2}.get(instruction.text.partition(" ")[0], 4)
        place = -(-begin // size) * size
        while self._image.is_data_in_code(place):
            entry = int.from_bytes(self._image.read(place, size), "little")
            found.append(entry & ~1 if size == 4 else begin + 2 * entry)
            place += size
        if not found:
            raise NoBound(f"{self._place(instruction)} jumps by a table that does not lie behind it")
        return [each for each in found if not begin <= each < place]  # what fills it up leads into it

    def _name(self, address: int) -> str:
        found = self._image.function_at(address)
        return found.name if found else f"0x{address:08x}"

    def _place(self, instruction: Instruction) -> str:
        return f"{instruction.text!r} of {self._name(instruction.address)} at 0x{instruction.address:08x}"


def bound_with_exceptions(bounds: StackBounds, entry: int, handlers: Iterable[Iterable[int]]) -> int:
    """Return the bytes that firmware can take of the stack that it starts with.

    Parameters
    ----------
    bounds : StackBounds
    entry : int
        Where it starts.
    handlers : iterable of iterable of int
        Of exceptions that cannot interrupt each other: the deepest of each comes on top.

    Raises
    ------
    NoBound
    """
    return bounds.bound(entry) + sum(
        EXCEPTION_FRAME_BYTES + max(bounds.bound(each) for each in alike) for alike in handlers
    )
