"""A solution computed once more from where its slices began, with the waits of memories counted too."""

from __future__ import annotations

from dataclasses import dataclass

from hiltest.errors import ConfigError
from hiltest.virtual.board.k64f import VirtualK64F
from hiltest.virtual.calls.kept_slices import KeptSolution
from hiltest.virtual.core.library import lib
from hiltest.virtual.core.machine import Machine
from hiltest.virtual.model.timing import TimingProfile
from hiltest.virtual.peripherals.fmc import FlashControl
from hiltest.virtual.processor.memory import BoardMemory

_FLASH_SWITCHES = range(0, 12, 4)  # PFAPR, PFB0CR and PFB1CR, which firmware may have written
_LARGEST_FACTOR = 100  # more than waits make of a count, unless something else is executed


@dataclass(frozen=True, slots=True)
class Recount:
    """Cycles of a solution, counted with the waits of memories."""

    cycles: int
    waits: int
    """Part of them that accesses waited."""


def counted_with_waits(board: VirtualK64F, kept: KeptSolution, profile: TimingProfile) -> Recount:
    """Execute the slices of a solution once more, each from the state in which it began.

    Parameters
    ----------
    board
        The board that executed them; it stands still, and stays as it is.
    profile
        One with memory rows.

    Raises
    ------
    ConfigError
        If a slice does not take the cycles that it took, apart from waits: then something from outside enters, such as
        a device, and this would be the count of another computation.
    """
    machine = Machine(profile)
    BoardMemory(machine, board.processor.memory.map)
    control = FlashControl(machine)
    with board.unnoticed():
        for offset in _FLASH_SWITCHES:
            control.write(offset, 4, board.bus.read(control.base + offset, 4))
    total = 0
    for number, part in enumerate(kept.slices, start=1):
        begin = part.begin.core
        returns = lib.machine_call_again(machine.handle, part.begin.handle, _LARGEST_FACTOR * part.cycles)
        cycles = machine.core.cycles - begin.cycles
        without = cycles - (machine.core.memory_cycles - begin.memory_cycles)
        if not returns or without != part.cycles:
            raise ConfigError(
                f"{part.function}: slice {number} of {len(kept.slices)} takes {without} cycles when it is executed "
                f"once more, not {part.cycles}: something from outside changes what it does"
            )
        total += cycles
    return Recount(total, total - kept.cycles)
