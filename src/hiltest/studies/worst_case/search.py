"""A seeded evolutionary search for the input with the most cycles.

Differential evolution (Storn and Price, 1997) explores the range of all inputs. A local search continues from its worst
input: it varies the input, and accepts each variation that has at least as many cycles. Equal numbers are accepted,
because cycles change in steps of a loop's cost, between which they are constant. When a local search makes no more
progress, another evolution begins.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

Input = TypeVar("Input")
Progress = Callable[[int, float, int], None]

_POPULATION = 40
_EXPLORED = 600  # calls of one evolution: fifteen generations
_STUCK = 1500  # calls without progress after which a local search ends
# Far more cycles than any call has, so that refused inputs are worse candidates than all others.
_REFUSED = 1e15


@dataclass(frozen=True, slots=True)
class Call:
    """One call of the function."""

    cycles: int
    returned: int | float | None
    """Return value; for a calibrator the status of the fit."""
    counts: bool
    """True if the call succeeded; only such calls can be the worst case."""

    @property
    def rank(self) -> tuple[bool, int]:
        """Sort key, which is highest for the worst call."""
        return self.counts, self.cycles


class Problem(Protocol[Input]):
    """A function and its inputs."""

    @property
    def bounds(self) -> NDArray[np.float64]:
        """Bounds of the numbers that define an input, shape (k, 2)."""

    def make_input(self, numbers: NDArray[np.float64]) -> Input:
        """Return the input that numbers within the bounds define, shape (k,)."""

    def vary(self, base: Input, random: np.random.Generator) -> Input:
        """Return a variation of an input."""

    def call(self, candidate: Input) -> Call:
        """Call the function."""

    def saved_fields(self, candidate: Input) -> Mapping[str, Any]:
        """Return the input as fields of a `WorstCase`."""


@dataclass(slots=True)
class Budget:
    """Limits of a search."""

    calls: int | None = None
    """Number of calls, which determines the result together with the seed."""
    seconds: float | None = None
    """Wall time [s]; either this or `calls` is set."""
    asked_to_end: Callable[[], bool] = lambda: False
    """Returns whether to end after the current call."""

    def is_spent(self, calls: int, elapsed_s: float) -> bool:
        """Return whether the budget is spent."""
        if self.asked_to_end():
            return True
        return calls >= self.calls if self.calls is not None else elapsed_s >= (self.seconds or 0.0)


@dataclass(frozen=True, slots=True)
class SearchResult(Generic[Input]):
    """Result of a search."""

    worst_input: Input
    call: Call
    """Call with the worst input; it does not count if no call does."""
    refused_cycles: int | None
    """Most cycles of a call that does not count; None without such a call."""
    calls: int
    elapsed_s: float


class _SpentError(Exception):
    """Signal that the budget is spent."""


class _ExploredError(Exception):
    """Signal that an evolution has used its calls."""


class _Search(Generic[Input]):
    def __init__(self, problem: Problem[Input], budget: Budget, progress: Progress) -> None:
        self._problem, self._budget, self._progress = problem, budget, progress
        self._began_s = time.monotonic()
        self._calls, self._refused_cycles = 0, -1
        self._worst: tuple[Input, Call] | None = None

    def call(self, candidate: Input) -> Call:
        """Call the function, and record the worst case; the budget does not apply to the first call."""
        elapsed_s = time.monotonic() - self._began_s
        if self._worst is not None and self._budget.is_spent(self._calls, elapsed_s):
            raise _SpentError
        call = self._problem.call(candidate)
        self._calls += 1
        if not call.counts:
            self._refused_cycles = max(self._refused_cycles, call.cycles)
        if self._worst is None or call.rank > self._worst[1].rank:
            self._worst = candidate, call
        self._progress(self._calls, elapsed_s, self._worst[1].cycles)
        return call

    def explore(self, random: np.random.Generator) -> tuple[Input, Call]:
        """Evolve numbers within their bounds; return the worst input and its call."""
        low, high = self._problem.bounds.T
        tried: list[tuple[Input, Call]] = []

        def fitness(numbers: NDArray[np.float64]) -> float:
            if len(tried) == _EXPLORED:
                raise _ExploredError
            candidate = self._problem.make_input(numbers)
            call = self.call(candidate)
            tried.append((candidate, call))
            return -call.cycles if call.counts else _REFUSED - call.cycles

        from scipy.optimize import differential_evolution  # takes 0.4 s, and a replay does not need it

        with suppress(_ExploredError):  # the evolution also ends when all members are equal
            differential_evolution(
                fitness,
                self._problem.bounds,
                init=low + (high - low) * random.random((_POPULATION, len(low))),
                maxiter=_EXPLORED,
                mutation=(0.4, 0.9),
                recombination=0.7,
                tol=0.0,
                polish=False,
                seed=random,
            )
        return max(tried, key=lambda pair: pair[1].rank)

    def climb(self, start: Input, call: Call, random: np.random.Generator) -> None:
        """Vary an input, and continue from each variation that is at least as bad, until there is no progress."""
        level = 0
        while level < _STUCK:
            other = self._problem.vary(start, random)
            next_call = self.call(other)
            level = 0 if next_call.rank > call.rank else level + 1
            if next_call.rank >= call.rank:
                start, call = other, next_call

    def run(self, random: np.random.Generator) -> SearchResult[Input]:
        """Alternate exploration and local search until the budget is spent."""
        with suppress(_SpentError):
            while True:
                self.climb(*self.explore(random), random)
        assert self._worst is not None
        refused = self._refused_cycles if self._refused_cycles >= 0 else None
        return SearchResult(*self._worst, refused, self._calls, time.monotonic() - self._began_s)


def search(problem: Problem[Input], *, seed: int, budget: Budget, progress: Progress) -> SearchResult[Input]:
    """Search for the input with the most cycles.

    Parameters
    ----------
    progress
        Called after each call with the number of calls, the elapsed time [s] and the most cycles so far.

    Returns
    -------
    SearchResult
        Result, which is a function of the seed and the number of calls, even if a time limit determines that number.
    """
    return _Search(problem, budget, progress).run(np.random.default_rng(seed))
