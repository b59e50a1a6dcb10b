"""The search finds the worst case of functions whose worst case is known."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from hiltest.studies.worst_case.search import Budget, Call, SearchResult, search

Numbers = NDArray[np.float64]


@dataclass
class Steps:
    """A function that takes a cycle more for each number that is at the end of its range, and refuses below 0."""

    numbers: int = 8
    called: list[tuple[float, ...]] = field(default_factory=list)

    @property
    def bounds(self) -> Numbers:
        return np.array([(-10.0, 10.0)] * self.numbers)

    def make_input(self, numbers: Numbers) -> Numbers:
        return numbers.copy()

    def vary(self, given: Numbers, random: np.random.Generator) -> Numbers:
        other = given.copy()
        other[random.integers(self.numbers)] += random.standard_normal()
        return np.clip(other, -10.0, 10.0)

    def call(self, given: Numbers) -> Call:
        self.called.append(tuple(given.tolist()))
        counts = bool(given[0] >= 0.0)
        return Call(int(np.floor(np.abs(given)).sum()) + 100 * (not counts), 0, counts)

    def saved_fields(self, given: Numbers) -> dict[str, tuple[float, ...]]:
        return {"arguments": tuple(given.tolist())}


def searched(problem: Steps, *, seed: int = 1, calls: int = 3000) -> SearchResult[Numbers]:
    return search(problem, seed=seed, budget=Budget(calls=calls), progress=lambda *_: None)


def test_the_worst_case_over_steps_and_level_ground_is_found_and_a_refused_one_is_not_it() -> None:
    result = searched(Steps())
    assert (result.call.cycles, result.call.counts) == (80, True)
    assert result.refused_cycles is not None
    assert result.refused_cycles > 100


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), calls=st.integers(1, 900))
def test_a_seed_and_a_number_of_calls_say_what_is_called(seed: int, calls: int) -> None:
    first, second = Steps(), Steps()
    assert searched(first, seed=seed, calls=calls).call == searched(second, seed=seed, calls=calls).call
    assert first.called == second.called
    assert len(first.called) == calls


def test_a_search_by_time_is_the_beginning_of_the_one_by_calls() -> None:
    by_time, by_calls = Steps(), Steps()
    search(by_time, seed=3, budget=Budget(seconds=0.05), progress=lambda *_: None)
    searched(by_calls, seed=3, calls=len(by_time.called))
    assert by_time.called == by_calls.called


def test_another_seed_searches_elsewhere() -> None:
    first, second = Steps(), Steps()
    searched(first, seed=1, calls=50)
    searched(second, seed=2, calls=50)
    assert not set(first.called) & set(second.called)


@pytest.mark.parametrize("after", [0, 1, 700])
def test_a_search_that_is_asked_to_end_has_the_worst_of_what_it_called(after: int) -> None:
    problem = Steps()
    budget = Budget(seconds=60.0, asked_to_end=lambda: len(problem.called) >= after)
    match = search(problem, seed=1, budget=budget, progress=lambda *_: None)
    assert match.calls == len(problem.called) == max(after, 1)
    ranks = [Steps().call(np.array(item)).rank for item in problem.called]
    assert match.call.rank == max(ranks)


def test_where_no_call_succeeds_the_search_says_so() -> None:
    class Refusing(Steps):
        def call(self, numbers: Numbers) -> Call:
            return Call(super().call(numbers).cycles, 4, counts=False)

    result = searched(Refusing(), calls=100)
    assert not result.call.counts
    assert result.refused_cycles == result.call.cycles


def test_a_function_that_always_takes_the_same_ends_too() -> None:
    class Flat(Steps):
        def call(self, numbers: Numbers) -> Call:
            super().call(numbers)
            return Call(7, 0, counts=True)

    assert searched(Flat(), calls=5000).call.cycles == 7
