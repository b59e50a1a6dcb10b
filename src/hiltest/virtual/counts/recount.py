"""Counts of solutions with waits for memories, from repeating their slices."""

from __future__ import annotations

from dataclasses import dataclass

from hiltest.errors import ConfigError
from hiltest.virtual.board.k64f import VirtualK64F
from hiltest.virtual.calls.slice_recorder import RecordedSolution
from hiltest.virtual.core.library import lib
from hiltest.virtual.core.machine import Machine
from hiltest.virtual.model.timing import TimingProfile
from hiltest.virtual.peripherals.fmc import FlashControl
from hiltest.virtual.processor.memory import BoardMemory

_FLASH_SWITCHES = range(0, 12, 4)  # PFAPR, PFB0CR and PFB1CR, which firmware may have written
_LARGEST_FACTOR = 100  # waits add less than this, unless the repeated slice executes other code


@dataclass(frozen=True, slots=True)
class Recount:
    """Cycles of a solution with waits for memories."""

    cycles: int
    waits: int
    """Part of `cycles` that are waits."""


def count_with_waits(board: VirtualK64F, solution: RecordedSolution, profile: TimingProfile) -> Recount:
    """Repeat the slices of a solution, each from its initial state.

    Parameters
    ----------
    board
        Board that executed them; it must not be running, and is not changed.
    profile
        Profile with memory rows.

    Raises
    ------
    ConfigError
        If a slice does not take the same cycles, apart from waits: it then depends on external state, such as that of a
        device, and the count would be that of another computation.
    """
    machine = Machine(profile)
    BoardMemory(machine, board.processor.memory.map)
    control = FlashControl(machine)
    with board.pause_unmodelled():
        for offset in _FLASH_SWITCHES:
            control.write(offset, 4, board.bus.read(control.base + offset, 4))
    total = 0
    for number, part in enumerate(solution.slices, start=1):
        begin = part.begin.core
        returns = lib.machine_call_again(machine.handle, part.begin.handle, _LARGEST_FACTOR * part.cycles)
        cycles = machine.core.cycles - begin.cycles
        waits = machine.core.memory_cycles - begin.memory_cycles
        without = cycles - waits + machine.core.address_cycles - begin.address_cycles
        if not returns or without != part.cycles:
            raise ConfigError(
                f"{part.function}: slice {number} of {len(solution.slices)} takes {without} cycles when repeated, not "
                f"{part.cycles}: it depends on external state"
            )
        total += cycles
    return Recount(total, total - solution.cycles)
