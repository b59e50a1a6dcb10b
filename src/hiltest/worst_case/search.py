"""A seeded evolutionary search for the input with the most cycles.

Differential evolution (Storn and Price, 1997) goes over the whole range of the inputs; from the worst that it found a
climb goes on, which varies the input itself and keeps each that is as bad. An equal one is kept too: cycles move in
steps of what a loop costs, and between two steps there is only level ground to walk over. A climb that is stuck ends,
and another evolution begins.
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
_STUCK = 1500  # calls of a climb without a worse one, after which it is left
# Far more than any call has: a refused input is better than none, and worse than any that counts.
_REFUSED = 1e15


@dataclass(frozen=True, slots=True)
class Call:
    """One call of the function."""

    cycles: int
    returned: int | float | None
    """Its answer, of a calibrator the status of the fit."""
    counts: bool
    """Whether the answer is a success: only then it is a worst case."""

    @property
    def rank(self) -> tuple[bool, int]:
        """Order of calls: the worst has the highest."""
        return self.counts, self.cycles


class Problem(Protocol[Input]):
    """A function, and the inputs that it may get."""

    @property
    def bounds(self) -> NDArray[np.float64]:
        """Lowest and highest of each number that an input is made of, shape (k, 2)."""

    def made(self, numbers: NDArray[np.float64]) -> Input:
        """Make an input of such numbers, shape (k,)."""

    def varied(self, given: Input, random: np.random.Generator) -> Input:
        """Return an input that is somewhat different."""

    def call(self, given: Input) -> Call:
        """Call the function."""

    def kept(self, given: Input) -> Mapping[str, Any]:
        """Return the input as the fields of a kept worst case have it."""


@dataclass(slots=True)
class Budget:
    """What a search may take."""

    calls: int | None = None
    """Number of calls: what is found follows from it and the seed alone."""
    seconds: float | None = None
    """Wall time [s]. One of both is given."""
    asked_to_end: Callable[[], bool] = lambda: False
    """Whether to end after the call that is being made."""

    def is_spent(self, calls: int, elapsed_s: float) -> bool:
        """Whether it is gone."""
        if self.asked_to_end():
            return True
        return calls >= self.calls if self.calls is not None else elapsed_s >= (self.seconds or 0.0)


@dataclass(frozen=True, slots=True)
class Found(Generic[Input]):
    """What a search has found."""

    given: Input
    """The worst input."""
    call: Call
    """What it takes; one that does not count where none did."""
    refused_cycles: int | None
    """Most cycles of a call that did not count."""
    calls: int
    elapsed_s: float


class _SpentError(Exception):
    """The budget is gone."""


class _ExploredError(Exception):
    """An evolution has made its calls."""


class _Search(Generic[Input]):
    def __init__(
        self, problem: Problem[Input], budget: Budget, progress: Progress
    ) -> None:
        self._problem, self._budget, self._progress = problem, budget, progress
        self._began_s = time.monotonic()
        self._calls, self._refused_cycles = 0, -1
        self._worst: tuple[Input, Call] | None = None

    def call(self, given: Input) -> Call:
        """Call the function, and remember the worst; the first call is made in any case."""
        elapsed_s = time.monotonic() - self._began_s
        if self._worst is not None and self._budget.is_spent(self._calls, elapsed_s):
            raise _SpentError
        found = self._problem.call(given)
        self._calls += 1
        if not found.counts:
            self._refused_cycles = max(self._refused_cycles, found.cycles)
        if self._worst is None or found.rank > self._worst[1].rank:
            self._worst = given, found
        self._progress(self._calls, elapsed_s, self._worst[1].cycles)
        return found

    def explore(self, random: np.random.Generator) -> tuple[Input, Call]:
        """Evolve numbers within their bounds; return the worst of them."""
        low, high = self._problem.bounds.T
        tried: list[tuple[Input, Call]] = []

        def fitness(numbers: NDArray[np.float64]) -> float:
            if len(tried) == _EXPLORED:
                raise _ExploredError
            given = self._problem.made(numbers)
            call = self.call(given)
            tried.append((given, call))
            return -call.cycles if call.counts else _REFUSED - call.cycles

        from scipy.optimize import differential_evolution  # 0.4 s, which a run that reads kept cases need not wait for

        with suppress(_ExploredError):  # it ends by itself when all are alike
            differential_evolution(
                fitness, self._problem.bounds, init=low + (high - low) * random.random((_POPULATION, len(low))),
                maxiter=_EXPLORED, mutation=(0.4, 0.9), recombination=0.7, tol=0.0, polish=False, seed=random,
            )  # fmt: skip
        return max(tried, key=lambda each: each[1].rank)

    def climb(self, given: Input, call: Call, random: np.random.Generator) -> None:
        """Vary an input, and whatever is as bad as that, until nothing worse comes."""
        level = 0
        while level < _STUCK:
            other = self._problem.varied(given, random)
            found = self.call(other)
            level = 0 if found.rank > call.rank else level + 1
            if found.rank >= call.rank:
                given, call = other, found

    def run(self, random: np.random.Generator) -> Found[Input]:
        """Explore and climb, again and again, until the budget is gone."""
        with suppress(_SpentError):
            while True:
                self.climb(*self.explore(random), random)
        assert self._worst is not None
        refused = self._refused_cycles if self._refused_cycles >= 0 else None
        return Found(*self._worst, refused, self._calls, time.monotonic() - self._began_s)


def search(
    problem: Problem[Input], *, seed: int, budget: Budget, progress: Progress
) -> Found[Input]:
    """Search for the input with the most cycles.

    Parameters
    ----------
    progress
        Called after each call with their number, the time that is gone [s] and the most cycles so far.

    Returns
    -------
    Found
        It follows from the seed and the number of calls, whether that was given or is how far the time went.
    """
    return _Search(problem, budget, progress).run(np.random.default_rng(seed))
