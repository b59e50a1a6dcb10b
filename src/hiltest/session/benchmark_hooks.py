"""The part of the plugin that passes device cycles to pytest-benchmark; registered only if that is loaded.

Like the plugin itself it is imported at the start of such a pytest run, so nothing heavy is imported here.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import partial
from itertools import cycle as endlessly
from typing import TYPE_CHECKING, Any

import pytest

from hiltest.session.bench_session import SESSION
from hiltest.session.benchmark_tables import (
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
from hiltest.session.selection import is_benchmark, uses_board

if TYPE_CHECKING:
    from pytest_benchmark.fixture import BenchmarkFixture

    from hiltest.measurement import Counted
    from hiltest.run_record.run import BoardRecord
    from hiltest.session.bench_session import HilSession

_BOARD = "board"


class DeviceClock:
    """A timer that returns device cycles: the sum over all reported rounds."""

    __name__ = "device_cycles"  # name of the timer in the JSON

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
    """Register these hooks if pytest-benchmark is loaded, under any name; it may be blocked."""
    if plugins.is_registered(sys.modules.get("pytest_benchmark.plugin")):
        plugins.register(sys.modules[__name__], "hiltest-cycle-benchmarks")


def read_rounds(
    cost: int | Counted | Iterable[int | Counted], cycle_model: str = ""
) -> tuple[list[int], str, dict[str, float]]:
    """Return the cycles of each round, their cycle model, and extra figures such as the core clock [Hz].

    Raises
    ------
    ValueError
        If there is no round, one is not a whole number of cycles, the cycle model is missing, or they have more than
        one model or clock, because such numbers are never compared.
    """
    from numbers import Integral

    from hiltest.measurement import Counted

    costs = list(cost) if isinstance(cost, Iterable) else [cost]
    models = {one.cycle_model for one in costs if isinstance(one, Counted)} | ({cycle_model} - {""})
    rounds = [one.cycles if isinstance(one, Counted) else one for one in costs]
    if not rounds:
        raise ValueError("no round was counted, so there are no cycles to show")
    wrong = [one for one in rounds if not isinstance(one, Integral) or isinstance(one, bool) or one < 0]
    if wrong:
        raise ValueError(
            f"{wrong[0]!r} is not a number of cycles: give whole numbers, or the result of cycles(elf).call()"
        )
    if len(models) != 1:
        named = f"these were counted by {' and '.join(sorted(models))}" if models else "their cycle model is unknown"
        raise ValueError(f"cycles of different models are not comparable, so all need one cycle model; {named}")
    clocks = {one.clock_hz for one in costs if hasattr(one, "clock_hz")}
    if len(clocks) > 1:
        raise ValueError(f"these were called at clocks of {' and '.join(f'{hz / 1e6:g}' for hz in sorted(clocks))} MHz")
    return [int(one) for one in rounds], models.pop(), dict(zip((CORE_CLOCK_HZ,), clocks, strict=False))


class BenchmarkCycles:
    """Reporter of a kernel's device cycles in a table of pytest-benchmark, if that is loaded.

    Parameters
    ----------
    show
        Receives kernel, rounds, cycle model and extra figures; if omitted, only the arguments are checked.
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
        """Report the cost of a kernel, once per test.

        Parameters
        ----------
        kernel
            Name of the table: rows of one kernel and one cycle model are ranked together.
        cost
            One cost per round. The result of ``cycles(elf).call(...)`` includes its cycle model.
        cycle_model
            Cycle model, ``board.cycle_model``; required for plain numbers.
        from_float64_deg
            For a calibrator: distance of its directions from those of float64 on the same points, rms over the sphere,
            the worst of the rounds, for the title of its table.

        Raises
        ------
        ValueError
            If there is no round, one is not a whole number of cycles, they have different cycle models, or the test has
            already reported a kernel.
        """
        if self._called:
            raise ValueError(f"{kernel}: pytest-benchmark shows one kernel per test; parametrize the test for more")
        rounds, model, extra = read_rounds(cost, cycle_model)
        self._called = True
        if self._show is not None:
            if from_float64_deg is not None:
                extra[FROM_FLOAT64_DEG] = float(from_float64_deg)
            self._show(kernel, rounds, model, extra)


@pytest.fixture
def benchmark_cycles(request: pytest.FixtureRequest, benchmark: BenchmarkFixture) -> Iterator[BenchmarkCycles]:
    """Show a kernel's cycles in its own table: ``benchmark_cycles("fn", cycles("app.elf").call("fn", 3))``."""
    clock = request.node.stash.get(CLOCK, None)
    board = _board_record(request.config.stash[SESSION]) if uses_board(request.node) else None

    def show(clock: DeviceClock, kernel: str, rounds: list[int], cycle_model: str, extra: dict[str, float]) -> None:
        """Let pytest-benchmark time the rounds of a kernel with a clock of device cycles."""
        # The worst round is stored even without the data of every round, because a budget applies to it.
        benchmark.extra_info |= {CYCLES: max(rounds), CYCLE_MODEL: cycle_model}
        benchmark.extra_info |= {CORE_CLOCK_HZ: _describe(board)[CORE_CLOCK_HZ]} | extra | _firmware(board)
        benchmark.group = group_name(kernel, cycle_model)
        request.config.stash[SHOWN] = True
        next_round = endlessly(rounds)
        benchmark.pedantic(lambda: clock.pass_by(next(next_round)), rounds=len(rounds))

    yield BenchmarkCycles(partial(show, clock) if clock else None)
    # pytest-benchmark warns of a fixture without use, as in a test that failed before, unless the test was skipped;
    # under -W error that would be a verdict.
    benchmark.skipped = True


def pytest_itemcollected(item: pytest.Item) -> None:
    """Set the timer of a test that reports device cycles; its other marks stay."""
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


def pytest_unconfigure(config: pytest.Config) -> None:
    """Remove the folder that pytest-benchmark makes for records, if none was saved."""
    folder = getattr(getattr(getattr(config, "_benchmarksession", None), "storage", None), "path", None)
    if folder is not None:
        with suppress(OSError):  # it has records
            folder.rmdir()


# A wrapper, so that cycles of different models stay separate under any grouping.
@pytest.hookimpl(wrapper=True)
def pytest_benchmark_group_stats(benchmarks: Sequence[Row]) -> Generator[None, Groups, Groups]:
    """Keep cycles of different models in different tables, and times in their own."""
    groups = yield
    return split_by_cycle_model(groups) if any(map(cycle_model_of, benchmarks)) else groups


def pytest_benchmark_update_machine_info(config: pytest.Config, machine_info: dict[str, Any]) -> None:
    """Name the board whose cycles were counted."""
    if SHOWN in config.stash:
        machine_info[_BOARD] = _describe(_board_record(config.stash[SESSION]))


# First, because pytest-benchmark compares at its start, when the session's board is still unknown.
@pytest.hookimpl(tryfirst=True)
def pytest_benchmark_compare_machine_info(config: pytest.Config, compared_benchmark: dict[str, Any]) -> None:
    """Store the machine of a saved run, to compare its board with this session's later."""
    saved = compared_benchmark["machine_info"].pop(_BOARD, None)
    if saved is not None:
        config.stash.setdefault(SAVED_BOARDS, []).append(saved)
    for row in compared_benchmark["benchmarks"]:
        if cycle_model_of(row):
            # A saved row is shown with its own numbers, but with the extra info of the new run, including the cycle
            # model.
            row["stats"] |= {"extra_info": row["extra_info"], "group": row["group"]}


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """Warn when saved cycles are of another board."""
    board = _describe(_board_record(config.stash[SESSION])) if SHOWN in config.stash else {}
    for saved in config.stash.get(SAVED_BOARDS, []) if board else []:
        differs = [
            f"{name} {saved.get(name)}, now {value}" for name, value in board.items() if saved.get(name) != value
        ]
        if differs:
            terminalreporter.write_line(f"the saved cycles belong to another board: {'; '.join(differs)}", yellow=True)


def _board_record(hil: HilSession) -> BoardRecord | None:
    from hiltest.session.recording import board_record

    return board_record(hil.board) if hil.board else None


def _describe(board: BoardRecord | None) -> dict[str, Any]:
    """Describe the board that counted, or the virtual one of ``cycles(elf)``."""
    if board is None:
        from hiltest.virtual.calls.call_clock import CALL_HZ

        return {"kind": "virtual", "unique_id": None, CORE_CLOCK_HZ: CALL_HZ}
    return {"kind": board.kind, "unique_id": board.unique_id, CORE_CLOCK_HZ: board.core_clock_hz}


def _firmware(board: BoardRecord | None) -> dict[str, Any]:
    """Name the firmware separately, because as part of the machine every build would be a different machine."""
    if board is None:
        return {}
    return {
        "firmware": f"{board.firmware} {board.version}".strip(),
        "build_id": board.build_id,
        "compiler": board.compiler,
        "firmware_sha256": board.firmware_sha256,
    }
