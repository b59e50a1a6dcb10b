"""Cycles of the functions that a rig names, counted by a virtual board while the firmware runs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from hiltest.errors import BoardFault, ConfigError
from hiltest.interfaces.sample_buffer import SampleBuffer
from hiltest.interfaces.variables import Variables
from hiltest.measurement import CycleRange
from hiltest.rig import Rig
from hiltest.rig.cycles import CountedFunctions
from hiltest.virtual.board.k64f import VirtualK64F
from hiltest.virtual.board.virtual_machine import VirtualMachine
from hiltest.virtual.calls.call_watch import CallWatch
from hiltest.virtual.calls.slice_recorder import RecordedSolution
from hiltest.virtual.calls.solution_watch import EndsWhen, SolutionEnd, SolutionWatch
from hiltest.virtual.counts.cycle_range import flash_range
from hiltest.virtual.counts.recount import count_with_waits
from hiltest.virtual.model.profile_file import MEMORY_PROFILE, load_profile
from hiltest.virtual.processor.call_summary import CallSummary, SolutionSummary


@dataclass(frozen=True, slots=True)
class LatestSolution:
    """The most recent solution of any of the firmware's solvers."""

    name: str
    """Name of the solver in the rig."""
    cycles: int
    slices: int
    """Number of slices that it took."""


@dataclass(frozen=True, slots=True)
class FlashCost:
    """Cost of a solution with the wait states of memories."""

    cycles: int | None
    """Cost; None if there is a `refusal`."""
    cycle_model: str
    band: CycleRange | None = None
    refusal: str = ""


class Costs(Protocol):
    """Cycle costs of the functions that a rig names."""

    def calls(self) -> Mapping[str, CallSummary]:
        """Return a summary of each function's calls, by its name in the rig."""

    def solutions(self) -> Mapping[str, SolutionSummary]:
        """Return a summary of each function's solutions, by its name in the rig."""

    def awake_share(self) -> float:
        """Return the share of the time since power-on in which the processor did not sleep."""

    def latest_solution(self) -> LatestSolution | None:
        """Return the most recent solution of any solver; None without one."""

    def samples(self) -> NDArray[np.float64] | None:
        """Return the samples that the firmware held when that solution began, in its axes, shape (n, 3) [counts].

        None without a solution, or if the rig does not name their buffer.
        """

    def from_flash(self) -> FlashCost:
        """Compute that solution again with the wait states of memories."""


class FunctionCosts:
    """Counter of calls and cycles from the firmware's first instruction on.

    Parameters
    ----------
    machine
        Not running.

    Raises
    ------
    ConfigError
        When the firmware has no such function or variable; the message has file and line.
    """

    def __init__(self, machine: VirtualMachine, rig: Rig) -> None:
        self._machine = machine
        variables = Variables(machine.image)
        self._buffer = _sample_buffer(variables, rig)
        self._watches: dict[str, tuple[str, CallWatch | SolutionWatch]] = {}
        for name, counted in rig.cycles.items():
            try:
                self._watches[name] = counted.functions[0], _watch(machine, variables, counted)
            except ConfigError as error:
                raise ConfigError(f"{rig.where('cycles', name)}: cycles.{name}: {error}") from error

    def calls(self) -> Mapping[str, CallSummary]:
        """See `Costs.calls`."""
        return {
            name: watch.summary(function)
            for name, (function, watch) in self._watches.items()
            if isinstance(watch, CallWatch)
        }

    def solutions(self) -> Mapping[str, SolutionSummary]:
        """See `Costs.solutions`."""
        return {name: watch.summary for name, (_, watch) in self._watches.items() if isinstance(watch, SolutionWatch)}

    def stacks(self) -> Mapping[str, tuple[str, int | None]]:
        """Return each function by its name in the rig, with the bytes of stack that its deepest call took."""
        return {
            name: (function, watch.stack(function) if isinstance(watch, CallWatch) else watch.stack)
            for name, (function, watch) in self._watches.items()
        }

    def awake_share(self) -> float:
        """See `Costs.awake_share`."""
        processor = self._machine.processor
        return 1.0 - processor.idle_cycles / max(processor.now(), 1)

    def latest_solution(self) -> LatestSolution | None:
        """See `Costs.latest_solution`."""
        name, solution = self._latest()
        return LatestSolution(name, solution.cycles, len(solution.slices)) if solution else None

    def _latest(self) -> tuple[str, RecordedSolution | None]:
        solutions = [
            (name, solution)
            for name, (_, watch) in self._watches.items()
            if isinstance(watch, SolutionWatch) and (solution := watch.latest())
        ]
        return max(solutions, key=lambda entry: entry[1].ended, default=("", None))

    def samples(self) -> NDArray[np.float64] | None:
        """See `Costs.samples`."""
        _, solution = self._latest()
        if self._buffer is None or solution is None:
            return None
        return self._buffer.counts(solution.slices[0].begin.read)

    def from_flash(self) -> FlashCost:
        """See `Costs.from_flash`."""
        profile = load_profile(MEMORY_PROFILE)
        model = f"{profile.name}@flash"
        _, solution = self._latest()
        if solution is None:
            return FlashCost(None, model, refusal="no solution was completed")
        if not isinstance(self._machine, VirtualK64F):
            return FlashCost(None, model, refusal="the waits of this board's memories are not modelled")
        try:
            counted = count_with_waits(self._machine, solution, profile)
        except (ConfigError, BoardFault) as error:
            return FlashCost(None, model, refusal=str(error))
        return FlashCost(counted.cycles, model, flash_range(profile, counted.cycles))


def _sample_buffer(variables: Variables, rig: Rig) -> SampleBuffer | None:
    described = rig.device and rig.device.memory and rig.device.memory.samples
    if not described:
        return None
    try:
        return SampleBuffer(described.paths, described.used, variables)
    except ConfigError as error:
        raise ConfigError(f"{rig.where('device', 'memory', 'samples')}: device.memory.samples: {error}") from error


def _watch(machine: VirtualMachine, variables: Variables, counted: CountedFunctions) -> CallWatch | SolutionWatch:
    if counted.ends is None:
        return machine.watch_calls(counted.functions)
    end = SolutionEnd(_word(machine, variables, counted.ends), EndsWhen(counted.ends_when), counted.ends_bytes)
    return machine.watch_solutions(counted.functions, end)


def _word(machine: VirtualMachine, variables: Variables, ends: str) -> str | int:
    """Return the address of a variable by its path, or a symbol and an offset as it is."""
    if "+" in ends or ends in machine.image.symbols:
        return ends
    place = variables.place(ends)
    if place.beyond:
        raise ConfigError(f"{ends} is behind a pointer; name a word that stays where it is")
    return place.address
