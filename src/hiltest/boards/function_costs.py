"""Cycles of the functions that a rig names, counted by a virtual board while the firmware runs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from hiltest.device.sample_buffer import SampleBuffer
from hiltest.device.variables import Variables
from hiltest.errors import BoardFault, ConfigError
from hiltest.measurement import CycleRange
from hiltest.rig import Rig
from hiltest.rig.cycles import CountedFunctions
from hiltest.virtual.board.k64f import VirtualK64F
from hiltest.virtual.calls.call_watch import CallWatch
from hiltest.virtual.calls.slice_recorder import RecordedSolution
from hiltest.virtual.calls.solution_watch import EndsWhen, SolutionEnd, SolutionWatch
from hiltest.virtual.counts.cycle_range import flash_range
from hiltest.virtual.counts.recount import count_with_waits
from hiltest.virtual.model.profile_file import MEMORY_PROFILE, load_profile
from hiltest.virtual.processor.call_summary import CallSummary, SolutionSummary


@dataclass(frozen=True, slots=True)
class LatestSolution:
    """The last solution of all that the firmware's solvers came to."""

    name: str
    """Of the solver, in the rig."""
    cycles: int
    slices: int
    """How many it took."""


@dataclass(frozen=True, slots=True)
class FlashCost:
    """What a solution takes with the waits of memories."""

    cycles: int | None
    """None where `refusal` says why."""
    cycle_model: str
    band: CycleRange | None = None
    refusal: str = ""


class Costs(Protocol):
    """What the functions that a rig names cost."""

    def calls(self) -> Mapping[str, CallSummary]:
        """Return what the calls of each function came to, by its name in the rig."""

    def solutions(self) -> Mapping[str, SolutionSummary]:
        """Return what the slices of each function came to, solution by solution, by its name in the rig."""

    def latest_solution(self) -> LatestSolution | None:
        """Return the solution that was completed last, of whichever solver; None where none was."""

    def samples(self) -> NDArray[np.float64] | None:
        """Return the samples that the firmware held when that one began, in its axes, shape (n, 3) [counts].

        None without one, and where the rig does not say where they lie.
        """

    def from_flash(self) -> FlashCost:
        """Compute that one once more with the waits of memories."""


class FunctionCosts:
    """Counts from the firmware's first instruction on.

    Parameters
    ----------
    machine
        Not running.

    Raises
    ------
    ConfigError
        With file and line, when the firmware has no such function or variable.
    """

    def __init__(self, machine: VirtualK64F, rig: Rig) -> None:
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
        """As `Costs.calls`."""
        return {
            name: watch.summary(function) for name, (function, watch) in self._watches.items()
            if isinstance(watch, CallWatch)
        }  # fmt: skip

    def solutions(self) -> Mapping[str, SolutionSummary]:
        """As `Costs.solutions`."""
        return {name: watch.summary for name, (_, watch) in self._watches.items() if isinstance(watch, SolutionWatch)}

    def stacks(self) -> Mapping[str, tuple[str, int | None]]:
        """Return each function, by its name in the rig, and the bytes of stack that the deepest of its calls took."""
        return {
            name: (function, watch.stack(function) if isinstance(watch, CallWatch) else watch.stack)
            for name, (function, watch) in self._watches.items()
        }

    def latest_solution(self) -> LatestSolution | None:
        """As `Costs.latest_solution`."""
        name, kept = self._latest()
        return LatestSolution(name, kept.cycles, len(kept.slices)) if kept else None

    def _latest(self) -> tuple[str, RecordedSolution | None]:
        found = [
            (name, kept) for name, (_, watch) in self._watches.items()
            if isinstance(watch, SolutionWatch) and (kept := watch.latest())
        ]  # fmt: skip
        return max(found, key=lambda each: each[1].ended, default=("", None))

    def samples(self) -> NDArray[np.float64] | None:
        """As `Costs.samples`."""
        _, kept = self._latest()
        if self._buffer is None or kept is None:
            return None
        return self._buffer.counts(kept.slices[0].begin.read)

    def from_flash(self) -> FlashCost:
        """As `Costs.from_flash`."""
        profile = load_profile(MEMORY_PROFILE)
        model = f"{profile.name}@flash"
        _, kept = self._latest()
        if kept is None:
            return FlashCost(None, model, refusal="no solution was completed")
        try:
            counted = count_with_waits(self._machine, kept, profile)
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


def _watch(
    machine: VirtualK64F, variables: Variables, counted: CountedFunctions
) -> CallWatch | SolutionWatch:  # fmt: skip
    if counted.ends is None:
        return machine.watch_calls(counted.functions)
    end = SolutionEnd(_word(machine, variables, counted.ends), EndsWhen(counted.ends_when), counted.ends_bytes)
    return machine.watch_solutions(counted.functions, end)


def _word(machine: VirtualK64F, variables: Variables, ends: str) -> str | int:
    """Return the address of a variable by its path, or a symbol and an offset as it is."""
    if "+" in ends or ends in machine.image.symbols:
        return ends
    place = variables.place(ends)
    if place.beyond:
        raise ConfigError(f"{ends} is behind a pointer; name a word that stays where it is")
    return place.address
