"""The part of the plugin that gives device cycles to pytest-benchmark; registered only where that is loaded.

Like the plugin itself it is imported at the start of such a pytest run, so nothing heavy is imported here.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from functools import partial
from itertools import cycle as endlessly
from typing import TYPE_CHECKING, Any

import pytest

from hiltest.cycle_benchmarks.tables import (
    CORE_CLOCK_HZ,
    CYCLE_MODEL,
    CYCLES,
    FROM_FLOAT64_DEG,
    Groups,
    Row,
    cycle_model_of,
    group_name,
    scale_cycles,
    split_by_cycle_model,
)
from hiltest.session import SESSION
from hiltest.session.selection import is_benchmark, uses_board

if TYPE_CHECKING:
    from pytest_benchmark.fixture import BenchmarkFixture

    from hiltest.measurement import Counted
    from hiltest.record.run import BoardRecord
    from hiltest.session import HilSession

_BOARD = "board"


class DeviceClock:
    """A timer that reads device cycles: those of every round that has been shown to it."""

    __name__ = "device_cycles"  # what the JSON calls the timer

    def __init__(self) -> None:
        self._cycles = 0

    def __call__(self) -> int:
        """Return the cycles so far."""
        return self._cycles

    def pass_by(self, cycles: int) -> None:
        """Advance the clock by some cycles."""
        self._cycles += cycles


CLOCK: pytest.StashKey[DeviceClock] = pytest.StashKey()
SHOWN: pytest.StashKey[bool] = pytest.StashKey()
SAVED_BOARDS: pytest.StashKey[list[dict[str, Any]]] = pytest.StashKey()


def join_pytest_benchmark(plugins: pytest.PytestPluginManager) -> None:
    """Take part where pytest-benchmark does, under the name it was loaded by; it may be blocked."""
    if plugins.is_registered(sys.modules.get("pytest_benchmark.plugin")):
        plugins.register(sys.modules[__name__], "hiltest-cycle-benchmarks")


def read_rounds(
    cost: int | Counted | Iterable[int | Counted], cycle_model: str = ""
) -> tuple[list[int], str, dict[str, float]]:
    """Return the cycles of each round, what counted them, and the core clock [Hz] where they bring one.

    Raises
    ------
    ValueError
        If there is no round, one is not a whole number of cycles, nothing says what counted them, or they were
        counted by more than one model or at more than one clock: such numbers are never compared.
    """
    from numbers import Integral

    from hiltest.measurement import Counted

    each = list(cost) if isinstance(cost, Iterable) else [cost]
    models = {one.cycle_model for one in each if isinstance(one, Counted)} | ({cycle_model} - {""})
    rounds = [one.cycles if isinstance(one, Counted) else one for one in each]
    if not rounds:
        raise ValueError("no round was counted, so there are no cycles to show")
    wrong = [one for one in rounds if not isinstance(one, Integral) or isinstance(one, bool) or one < 0]
    if wrong:
        raise ValueError(f"{wrong[0]!r} is no number of cycles: give whole numbers, or what cycles(elf).call() returns")
    if len(models) != 1:
        named = f"these were counted by {' and '.join(sorted(models))}" if models else "nothing says what counted these"
        raise ValueError(f"cycles need one cycle model, or they could be compared with another's; {named}")
    clocks = {one.clock_hz for one in each if hasattr(one, "clock_hz")}
    if len(clocks) > 1:
        raise ValueError(f"these were called at clocks of {' and '.join(f'{hz / 1e6:g}' for hz in sorted(clocks))} MHz")
    return [int(one) for one in rounds], models.pop(), dict(zip((CORE_CLOCK_HZ,), clocks, strict=False))


class BenchmarkCycles:
    """Shows the device cycles of a kernel in a table of pytest-benchmark, where that takes part.

    Parameters
    ----------
    show
        Takes kernel, rounds, cycle model and what else is known; without it nothing is shown, and wrong arguments
        fail all the same.
    """

    def __init__(self, show: Callable[[str, list[int], str, dict[str, float]], None] | None = None) -> None:
        self._show = show
        self._called = False

    def __call__(
        self,
        kernel: str,
        cost: int | Counted | Iterable[int | Counted],
        *,
        cycle_model: str = "",
        from_float64_deg: float | None = None,
    ) -> None:
        """Show what a kernel cost, once in a test.

        Parameters
        ----------
        kernel
            Names the table: rows of one kernel and one cycle model are ranked together.
        cost
            One for each round. What ``cycles(elf).call(...)`` returns brings its cycle model.
        cycle_model
            Needed for numbers: what counted them, ``board.cycle_model``.
        from_float64_deg
            For a calibrator: distance of its directions from those of float64 on the same points, rms over the sphere,
            the worst of the rounds. The title of its table then says so.

        Raises
        ------
        ValueError
            If there is no round, one is not a whole number of cycles, they were not counted by one model, or the test
            has shown a kernel already.
        """
        if self._called:
            raise ValueError(f"{kernel}: a test shows one kernel, as pytest-benchmark has it; parametrize it for more")
        rounds, model, known = read_rounds(cost, cycle_model)
        self._called = True
        if self._show is not None:
            if from_float64_deg is not None:
                known[FROM_FLOAT64_DEG] = float(from_float64_deg)
            self._show(kernel, rounds, model, known)


@pytest.fixture
def benchmark_cycles(request: pytest.FixtureRequest, benchmark: BenchmarkFixture) -> Iterator[BenchmarkCycles]:
    """Show a kernel's cycles in its own table: ``benchmark_cycles("fn", cycles("app.elf").call("fn", 3))``."""
    clock = request.node.stash.get(CLOCK, None)
    board = _board_of(request.config.stash[SESSION]) if uses_board(request.node) else None

    def show(clock: DeviceClock, kernel: str, rounds: list[int], cycle_model: str, known: dict[str, float]) -> None:
        """Let pytest-benchmark time the rounds of a kernel by a clock that reads device cycles."""
        # The worst round stays when the data of every round does not: a budget holds for it.
        benchmark.extra_info |= {CYCLES: max(rounds), CYCLE_MODEL: cycle_model}
        benchmark.extra_info |= {CORE_CLOCK_HZ: _describe(board)[CORE_CLOCK_HZ]} | known | _firmware(board)
        benchmark.group = group_name(kernel, cycle_model)
        request.config.stash[SHOWN] = True
        next_round = endlessly(rounds)
        benchmark.pedantic(lambda: clock.pass_by(next(next_round)), rounds=len(rounds))

    yield BenchmarkCycles(partial(show, clock) if clock else None)
    # pytest-benchmark warns of a fixture without use, as in a test that failed before, unless the test was skipped;
    # under -W error that would be a verdict.
    benchmark.skipped = True


def pytest_itemcollected(item: pytest.Item) -> None:
    """Give a test that shows device cycles a timer that reads them; its other marks stay."""
    # Under pytest-codspeed pytest-benchmark does nothing, and marks with a timer are refused.
    if item.config.pluginmanager.has_plugin("pytest-benchmark") and is_benchmark(item):
        item.stash[CLOCK] = clock = DeviceClock()
        marked = item.get_closest_marker("benchmark")
        options = dict(marked.kwargs) if marked else {}
        item.add_marker(pytest.mark.benchmark(**options | {"timer": clock}), append=False)


def pytest_benchmark_scale_unit(
    config: pytest.Config, unit: str, benchmarks: Sequence[Row], best: Mapping[str, float]
) -> tuple[str, float] | None:
    """Show tables of device cycles in cycles; tables of seconds stay."""
    return scale_cycles(unit, benchmarks, best, config.getoption("benchmark_time_unit", None))


# A wrapper: whatever groups them, cycles of different models stay apart.
@pytest.hookimpl(wrapper=True)
def pytest_benchmark_group_stats(benchmarks: Sequence[Row]) -> Generator[None, Groups, Groups]:
    """Keep cycles of different models in different tables, and times in their own."""
    groups = yield
    return split_by_cycle_model(groups) if any(map(cycle_model_of, benchmarks)) else groups


def pytest_benchmark_update_machine_info(config: pytest.Config, machine_info: dict[str, Any]) -> None:
    """Name the board whose cycles were counted."""
    if SHOWN in config.stash:
        machine_info[_BOARD] = _describe(_board_of(config.stash[SESSION]))


# First: pytest-benchmark compares while it starts, when it is not known yet which board this session will use.
@pytest.hookimpl(tryfirst=True)
def pytest_benchmark_compare_machine_info(config: pytest.Config, compared_benchmark: dict[str, Any]) -> None:
    """Keep the machine of a saved run, to compare its board with this session's once that is known."""
    saved = compared_benchmark["machine_info"].pop(_BOARD, None)
    if saved is not None:
        config.stash.setdefault(SAVED_BOARDS, []).append(saved)
    for row in compared_benchmark["benchmarks"]:
        if cycle_model_of(row):
            # A saved row is shown with its own numbers under what the new run says of it, its cycle model too.
            row["stats"] |= {"extra_info": row["extra_info"], "group": row["group"]}


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """Warn when saved cycles are of another board."""
    board = _describe(_board_of(config.stash[SESSION])) if SHOWN in config.stash else {}
    for saved in config.stash.get(SAVED_BOARDS, []) if board else []:
        differs = [
            f"{name} {saved.get(name)}, now {value}" for name, value in board.items() if saved.get(name) != value
        ]
        if differs:
            terminalreporter.write_line(f"the saved cycles are of another board: {'; '.join(differs)}", yellow=True)


def _board_of(hil: HilSession) -> BoardRecord | None:
    from hiltest.session.recording import board_record

    return board_record(hil.board) if hil.board else None


def _describe(board: BoardRecord | None) -> dict[str, Any]:
    """Say what counted: a board, or the virtual one that ``cycles(elf)`` makes for itself."""
    if board is None:
        from hiltest.virtual.calls.call_clock import CALL_HZ

        return {"kind": "virtual", "unique_id": None, CORE_CLOCK_HZ: CALL_HZ}
    return {"kind": board.kind, "unique_id": board.unique_id, CORE_CLOCK_HZ: board.core_clock_hz}


def _firmware(board: BoardRecord | None) -> dict[str, Any]:
    """Name the firmware; as a part of the machine every build would be another machine."""
    if board is None:
        return {}
    return {
        "firmware": f"{board.firmware} {board.version}".strip(), "build_id": board.build_id,
        "compiler": board.compiler, "firmware_sha256": board.firmware_sha256,
    }
