"""A solution computed once more from what its slices began with, on a board that counts the waits of memories too."""

from __future__ import annotations

from dataclasses import dataclass

from hiltest.errors import ConfigError
from hiltest.virtual.elf import FirmwareImage
from hiltest.virtual.k64f import VirtualK64F
from hiltest.virtual.kept_slices import KeptSolution, Slice
from hiltest.virtual.memory_waits import MemoryAccounting
from hiltest.virtual.timing import TimingProfile

#: PFAPR, PFB0CR and PFB1CR: what of the flash controller firmware has switched.
_FLASH_SWITCHES = (0x4001F000, 0x4001F004, 0x4001F008)
_REGISTERS = 4  # of arguments
_INTEGERS = ("pointer", "signed", "unsigned")
#: Every instruction is looked at in Python, so this takes the host some ten seconds.
_MOST_CYCLES = 4_000_000


@dataclass(frozen=True, slots=True)
class Recount:
    """Cycles of a solution, counted with the waits of memories.

    Attributes
    ----------
    cycles : int
    waits : int
        Part of them that accesses waited.
    """

    cycles: int
    waits: int


def counted_with_waits(machine: VirtualK64F, kept: KeptSolution, profile: TimingProfile) -> Recount:
    """Call the slices of a solution once more, each from where the last one left the memory.

    Parameters
    ----------
    machine : VirtualK64F
        That it ran on; it stands still, and stays as it is.
    kept : KeptSolution
    profile : TimingProfile
        One with memory rows.

    Raises
    ------
    ConfigError
        When a slice cannot be called so, or does not take what it took: then something else than the slices has
        changed what they work on, and this would be the count of another computation.
    """
    if kept.cycles > _MOST_CYCLES:
        raise ConfigError(f"its {kept.cycles} cycles are more than the {_MOST_CYCLES} that are counted with waits")
    board = VirtualK64F(machine.image, profile=profile)
    board.boot()
    board.processor.memory.sram.view[:] = kept.memory
    with machine.unnoticed():
        for address in _FLASH_SWITCHES:
            board.bus.write(address, 4, machine.bus.read(address, 4))
    accounting = board.processor.accounting
    assert isinstance(accounting, MemoryAccounting)
    cycles = 0
    for number, each in enumerate(kept.slices, start=1):
        waited = accounting.memory_cycles
        taken = _call(board, each)
        without = taken - (accounting.memory_cycles - waited)
        if without != each.cycles:
            raise ConfigError(
                f"{each.function}: slice {number} of {len(kept.slices)} takes {without} cycles when it is called once "
                f"more, not {each.cycles}: something else changes what it works on"
            )
        cycles += taken
    return Recount(cycles, cycles - kept.cycles)


def _call(board: VirtualK64F, each: Slice) -> int:
    general = board.processor.registers.general
    words = general.read()
    words[13], words[15] = each.stack, words[15] | 1
    general.write(words)
    return board.call(each.function, *each.arguments[: _arguments(board.image, each.function)]).cycles


def _arguments(image: FirmwareImage, function: str) -> int:
    """Return how many registers hold arguments; all where that is unknown."""
    signature = image.signature(function)
    if signature is None:
        return _REGISTERS
    if len(signature.parameters) > _REGISTERS or not set(signature.parameters) <= set(_INTEGERS):
        raise ConfigError(f"{function} takes more than {_REGISTERS} integers and pointers")
    return len(signature.parameters)
