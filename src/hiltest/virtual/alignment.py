"""What must be aligned for code not to fault, where the emulator lets it pass."""

from __future__ import annotations

from dataclasses import dataclass

from hiltest.virtual.instructions import Instruction

_ALWAYS = -1  # where a register comes from that is always a multiple of four


@dataclass(frozen=True, slots=True)
class Alignment:
    """Alignment that straight-line code needs of its addresses.

    Attributes
    ----------
    registers : tuple of int
        Core registers that must be multiples of four when the code begins.
    inside : tuple of Instruction
        Instructions whose base is computed or loaded within the code: it has to
        be looked at when they run.
    """

    registers: tuple[int, ...]
    inside: tuple[Instruction, ...]


def required_alignment(instructions: list[Instruction]) -> Alignment:
    """Find what must be aligned for straight-line code not to fault.

    The part faults on unaligned LDM, STM, LDRD, STRD and floating-point
    transfers; the emulator lets them pass. Bases are followed through moves and
    steps of whole words, so that most can be checked once, where a block begins.
    """
    # The stack pointer and the pc that ADR adds to are multiples of four whatever is written to them.
    origin: dict[int, int] = {register: register for register in range(13)} | {14: 14, 13: _ALWAYS, 15: _ALWAYS}
    needed: set[int] = set()
    inside: list[Instruction] = []
    for instruction in instructions:
        if instruction.aligned_base in origin:
            needed.add(origin[instruction.aligned_base])
        elif instruction.aligned_base >= 0:
            inside.append(instruction)
        derived = {written: origin.get(source) for written, source in instruction.derived}
        for register in (*range(13), 14):
            if instruction.core_writes >> register & 1:
                origin.pop(register, None)
        origin.update({written: source for written, source in derived.items() if source is not None and written < 13})
    return Alignment(tuple(sorted(needed - {_ALWAYS})), tuple(inside))
