"""Cycles of the functions that a rig names, counted by a virtual board while the firmware runs."""

from __future__ import annotations

from collections.abc import Mapping

from hiltest.device.variables import Variables
from hiltest.errors import ConfigError
from hiltest.rig import Rig
from hiltest.rig.cycles import CountedFunctions
from hiltest.virtual.call_summary import CallSummary, SolutionSummary
from hiltest.virtual.call_watch import CallWatch
from hiltest.virtual.k64f import VirtualK64F
from hiltest.virtual.solution_watch import EndsWhen, SolutionEnd, SolutionWatch


class FunctionCosts:
    """Counts from the firmware's first instruction on.

    Parameters
    ----------
    machine : VirtualK64F
        Not running.
    rig : Rig

    Raises
    ------
    ConfigError
        With file and line, when the firmware has no such function or variable.
    """

    def __init__(self, machine: VirtualK64F, rig: Rig) -> None:
        self._watches: dict[str, tuple[str, CallWatch | SolutionWatch]] = {}
        for name, counted in rig.cycles.items():
            try:
                self._watches[name] = counted.functions[0], _watch(machine, counted)
            except ConfigError as error:
                raise ConfigError(f"{rig.where('cycles', name)}: cycles.{name}: {error}") from error

    def calls(self) -> Mapping[str, CallSummary]:
        """Return what the calls of each function came to, by its name in the rig."""
        return {
            name: watch.summary(function) for name, (function, watch) in self._watches.items()
            if isinstance(watch, CallWatch)
        }  # fmt: skip

    def solutions(self) -> Mapping[str, SolutionSummary]:
        """Return what the slices of each function came to, solution by solution, by its name in the rig."""
        return {name: watch.summary for name, (_, watch) in self._watches.items() if isinstance(watch, SolutionWatch)}


def _watch(machine: VirtualK64F, counted: CountedFunctions) -> CallWatch | SolutionWatch:
    if counted.ends is None:
        return machine.watch_calls(counted.functions)
    end = SolutionEnd(_word(machine, counted.ends), EndsWhen(counted.ends_when), counted.ends_bytes)
    return machine.watch_solutions(counted.functions, end)


def _word(machine: VirtualK64F, ends: str) -> str | int:
    """Return the address of a variable by its path, or a symbol and an offset as it is."""
    if "+" in ends or ends in machine.image.symbols:
        return ends
    place = Variables(machine.image).place(ends)
    if place.beyond:
        raise ConfigError(f"{ends} is behind a pointer; name a word that stays where it is")
    return place.address
