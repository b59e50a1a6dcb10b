"""Profile of the cycles of one call: by function, source line, instruction, and class of work or stall.

The core counts the executions of each instruction on each path of calls, and splits the instruction's cost, so that the
tables add up to the total. Waits for memories are counted separately.
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from hiltest.measurement import CycleRange
from hiltest.virtual.board.cortex_m4 import HANG_S, VirtualCortexM4
from hiltest.virtual.calls.calling import CallResult, find_function
from hiltest.virtual.calls.procedure_call import Argument
from hiltest.virtual.core.decoder import decode_first
from hiltest.virtual.core.library import ffi, lib
from hiltest.virtual.core.machine import Machine
from hiltest.virtual.counts.cost_classes import STALL_NUMBERS, WORK_OF_ROW, Stall, Work
from hiltest.virtual.counts.cycle_range import timed_range
from hiltest.virtual.counts.placement import LEAST_SHARE, FetchTally, Loop, LoopPlacement, placements
from hiltest.virtual.processor.cpu import Processor
from hiltest.virtual.processor.slices import Slice
from hiltest.virtual.program.elf import FirmwareImage, Symbol
from hiltest.virtual.program.instruction_text import instruction_text

_SRAM_U = 0x20000000
_COLD = ".cold"  # suffix of the rarely executed part of a function, which the compiler moves away


@dataclass(frozen=True, slots=True)
class FunctionCost:
    """Cost of one function."""

    name: str
    calls: int
    """Number of entries."""
    cycles: int
    self_cycles: int
    """Cycles with and without those of callees."""
    instructions: int
    stall_cycles: int
    """Stall cycles of the function itself."""


@dataclass(frozen=True, slots=True)
class LineCost:
    """Cost of one source line; inlined code counts for the line of its own source."""

    location: str
    cycles: int
    instructions: int
    stall_cycles: int


@dataclass(frozen=True, slots=True)
class AddressCost:
    """Cost of one instruction over all its executions; `cycles` includes `stall_cycles`."""

    address: int
    text: str
    function: str
    location: str
    executions: int
    cycles: int
    stall_cycles: int


@dataclass(frozen=True, slots=True)
class StackCost:
    """Cycles of the last function of a chain of calls, without its callees."""

    functions: tuple[str, ...]
    cycles: int


@dataclass(frozen=True, slots=True)
class CallProfile(CallResult):
    """Value and cost of a called function, and the distribution of its cycles."""

    function: str
    cycle_model: str
    """Timing profile and placement of the code: ``cortex-m4-trm/3@sram``."""
    work: Mapping[Work, int]
    stalls: Mapping[Stall, int]
    """Cycles of each class of instructions and of each stall; with `asleep_cycles` they add up to `cycles`."""
    asleep_cycles: int
    """Cycles of sleep (WFI)."""
    functions: tuple[FunctionCost, ...]
    lines: tuple[LineCost, ...]
    addresses: tuple[AddressCost, ...]
    stacks: tuple[StackCost, ...]
    """Most expensive first; `lines` is empty without debug information."""
    band: CycleRange | None
    """Uncertainty range of `cycles`; None if the call took exceptions or slept, or for code in flash if the profile has
    no memory rows."""
    memory_cycles: int | None = None
    """Cycles of waits for memories, for unaligned data, and between loads from two memories, part of the stalls in the
    tables; None if there are none and the profile has no memory rows."""
    counts_memories: bool = False
    """True if the profile has memory rows."""
    loops: tuple[LoopPlacement, ...] = ()
    """Loops with misaligned instructions, the most expensive first; empty if the profile has no fetch rules."""

    def share(self, cycles: int) -> float:
        """Return the share of the total [%]."""
        return 100.0 * cycles / self.cycles


@dataclass(frozen=True, slots=True)
class RunningProfile:
    """Cost of all calls of a function in running firmware, with that of the functions that it called."""

    calls: int
    cycles: int
    cycle_model: str
    lines: tuple[LineCost, ...]
    """In no order; empty without debug information. The code of interrupts during the calls is included."""

    @property
    def cycles_of_a_call(self) -> int:
        """Mean of a call, rounded."""
        return round(self.cycles / max(self.calls, 1))

    @property
    def lines_of_a_call(self) -> list[LineCost]:
        """Lines with their means of a call, rounded."""
        calls = max(self.calls, 1)
        return [
            LineCost(line.location, *(round(n / calls) for n in (line.cycles, line.instructions, line.stall_cycles)))
            for line in self.lines
        ]


def profile_call(
    board: VirtualCortexM4,
    function: str,
    *arguments: Argument,
    timeout_s: float = HANG_S,
    clock_hz: float | None = None,
    keeps_ram: bool = False,
) -> CallProfile:
    """Call one function of an image, and profile its cycles.

    Parameters
    ----------
    *arguments, timeout_s, clock_hz, keeps_ram
        As for `VirtualCortexM4.call`.

    Raises
    ------
    ConfigError
        If the function does not exist, or the arguments do not fit it.
    BoardFault
        If the function faults or hangs.
    """
    core, symbol = board.processor.core, board.image.symbols.get(function)
    owners, waited = _Owners(board.image, symbol), core.memory_cycles
    with _profiled(board.processor, owners, symbol):
        result = board.call(function, *arguments, timeout_s=timeout_s, clock_hz=clock_hz, keeps_ram=keeps_ram)
    return _Sums(board.processor, owners).profile(function, result, core.memory_cycles - waited)


@contextmanager
def _profiled(processor: Processor, owners: _Owners, function: Symbol | None) -> Iterator[None]:
    """Profile the code that is executed in the context, which begins in a function."""
    machine = processor.machine.handle
    ranges = ffi.new("struct machine_code_range[]", owners.ranges)
    if not lib.machine_begin_profile(machine, function.address if function else 0, ranges, len(ranges)):
        raise MemoryError
    is_whole = False
    try:
        yield
    finally:
        is_whole = lib.machine_end_profile(machine)
    if not is_whole:
        raise MemoryError


def profile_running(
    board: VirtualCortexM4, functions: Sequence[str | None], run: Callable[[], object]
) -> list[RunningProfile]:
    """Profile the calls of functions in firmware that runs.

    Parameters
    ----------
    functions
        None for the whole firmware, as one call.
    run
        Runs the firmware.

    Raises
    ------
    ConfigError
        If a function does not exist.
    BoardFault
        If the firmware faults.
    """
    symbols = [None if function is None else find_function(board.image, function) for function in functions]
    owners = _Owners(board.image, None)
    with _profiled(board.processor, owners, None):
        run()
    return [_Sums(board.processor, owners, within=symbol).running_profile(symbol) for symbol in symbols]


class _Owners:
    """Functions of the image's code, by address.

    Attributes
    ----------
    ranges : list of (int, int, int)
        Begin and end of a range of code, and address of its function; in order.
    """

    def __init__(self, image: FirmwareImage, callee: Symbol | None) -> None:
        self.ranges: list[tuple[int, int, int]] = []
        self._names = {callee.address: callee.name} if callee else {}
        starts = sorted({symbol.address for symbol in image.functions})
        for start, following in itertools.pairwise([*starts, 1 << 32]):
            symbol = image.function_at(start)
            if symbol is None:
                continue
            owner = symbol
            if _COLD in symbol.name:
                owner = image.symbols.get(symbol.name.partition(_COLD)[0], symbol)
            self.ranges.append((start, min(start + max(symbol.size, 2), following), owner.address))
            self._names.setdefault(owner.address, owner.name)

    def name(self, function: int) -> str:
        """Return the name of the function at an address, or the address if there is no symbol."""
        return self._names.get(function, f"{function:#x}")


class _Tally:
    """Running sum of costs."""

    __slots__ = ("cycles", "executions", "stall_cycles")

    def __init__(self, cycles: int = 0) -> None:
        self.executions, self.cycles, self.stall_cycles = 0, cycles, 0

    def add(self, executions: int, cycles: int, stall_cycles: int) -> None:
        self.executions += executions
        self.cycles += cycles
        self.stall_cycles += stall_cycles


class _Path:
    """A function on one path of calls; `functions` are the addresses of all functions on the path."""

    def __init__(self, record: Any, caller: tuple[int, ...]) -> None:
        self.function: int = record.function
        self.functions = (*caller, self.function)
        self.entries: int = record.entries
        self.asleep_cycles: int = record.idle_cycles
        self.own = _Tally(self.asleep_cycles)


class _Sums:
    """Sums of the costs on all paths."""

    def __init__(self, processor: Processor, owners: _Owners, *, within: Symbol | None = None) -> None:
        self._image, self._timing, self._memory = processor.image, processor.profile, processor.memory
        self._owners = owners
        self._paths = list(_read_paths(processor.machine))
        self._work: Counter[Work] = Counter(dict.fromkeys(Work, 0))
        self._stalls: Counter[Stall] = Counter(dict.fromkeys(Stall, 0))
        self._loops: dict[int, Counter[Loop]] = {}
        self._fetched: dict[int, dict[int, FetchTally]] = {}
        self._addresses: dict[tuple[int, int], _Tally] = {}
        for cost in _read_costs(processor.machine):
            path = self._paths[cost.path - 1]
            if within is None or within.address in path.functions:
                self._add(path, cost)

    def _add(self, path: _Path, cost: Any) -> None:
        waits = {cause: cost.stall_cycles[number] for cause, number in STALL_NUMBERS.items()}
        self._stalls.update(waits)
        self._work[WORK_OF_ROW[ffi.string(lib.machine_row_name(cost.row)).decode()]] += cost.work_cycles
        instruction = decode_first(cost.address, self._memory.code_at(cost.address))
        at_address = self._addresses.setdefault((path.function, cost.address), _Tally())
        stall_cycles = sum(waits.values()) + cost.wait_cycles
        for tally in (path.own, at_address):
            tally.add(cost.executions, cost.work_cycles + stall_cycles, stall_cycles)
        fetches = self._fetched.setdefault(path.function, {})
        fetched = fetches.setdefault(cost.address, FetchTally(cost.address, instruction.size))
        fetched.executions += cost.executions
        fetched.late += waits[Stall.FETCH]
        if cost.jumps and instruction.flow == lib.FLOW_JUMP and instruction.target <= cost.address:
            self._loops.setdefault(path.function, Counter())[instruction.target, cost.address] += cost.jumps

    def _text_at(self, address: int) -> str:
        return instruction_text(address, self._memory.code_at(address))

    def profile(self, function: str, result: CallResult, memory_cycles: int) -> CallProfile:
        """Return the profile with all tables."""
        root = self._paths[0]
        entries = result.cycles - sum(path.own.cycles for path in self._paths)  # of exceptions
        root.asleep_cycles += entries
        root.own.cycles += entries
        empty: list[Slice] = []
        executed = ([result.executed], empty) if result.executed else None
        addresses = tuple(sorted(self._address_costs(), key=lambda cost: (-cost.cycles, cost.address)))
        return CallProfile(
            result.value,
            result.cycles,
            result.instructions,
            result.clock_hz,
            function,
            self._cycle_model,
            self._work,
            self._stalls,
            sum(path.asleep_cycles for path in self._paths),
            functions=tuple(sorted(self._function_costs(), key=lambda cost: (-cost.self_cycles, cost.name))),
            lines=tuple(sorted(_line_costs(addresses), key=lambda cost: (-cost.cycles, cost.location))),
            addresses=addresses,
            stacks=tuple(sorted(self._stacks(), key=lambda cost: (-cost.cycles, cost.functions))),
            band=timed_range(self._timing, self._cycle_model, result.cycles, executed),
            memory_cycles=memory_cycles if memory_cycles or self._timing.memory else None,
            counts_memories=bool(self._timing.memory),
            stack_bytes=result.stack_bytes,
            loops=tuple(self._placements(LEAST_SHARE * result.cycles)),
        )

    def running_profile(self, function: Symbol | None) -> RunningProfile:
        """Return the profile of the calls of a function; that of the whole firmware is one call."""
        lines = tuple(_line_costs(tuple(self._address_costs())))
        calls = sum(path.entries for path in self._paths if path.function == function.address) if function else 1
        return RunningProfile(calls, sum(line.cycles for line in lines), self._cycle_model, lines)

    def _placements(self, least: float) -> list[LoopPlacement]:
        loops = [
            loop
            for function, turns in self._loops.items()
            for loop in placements(self._names[function], turns, self._fetched[function], self._image, self._text_at)
        ]
        return sorted((loop for loop in loops if loop.cycles >= least), key=lambda loop: (-loop.cycles, loop.address))

    @property
    def _names(self) -> dict[int, str]:
        """Names of functions by address; a name that several functions share is followed by the address."""
        names = {path.function: self._owners.name(path.function) for path in self._paths}
        often = Counter(names.values())
        return {function: name if often[name] == 1 else f"{name}@{function:#x}" for function, name in names.items()}

    @property
    def _cycle_model(self) -> str:
        """Timing profile, and the memories of the executed code with the most cycles first."""
        cycles: Counter[str] = Counter()
        for (_, address), tally in self._addresses.items():
            in_flash = self._memory.map.is_in_flash(address)
            cycles["flash" if in_flash else "sram" if address < _SRAM_U else "sram_u"] += tally.cycles
        return f"{self._timing.name}@{'+'.join(name for name, _ in cycles.most_common())}"

    def _address_costs(self) -> Iterator[AddressCost]:
        for (function, address), tally in self._addresses.items():
            yield AddressCost(
                address,
                self._text_at(address),
                self._owners.name(function),
                self._image.location_at(address),
                tally.executions,
                tally.cycles,
                tally.stall_cycles,
            )

    def _function_costs(self) -> Iterator[FunctionCost]:
        own: dict[int, _Tally] = {}
        inclusive: Counter[int] = Counter()
        calls: Counter[int] = Counter()
        for path in self._paths:
            calls[path.function] += path.entries
            tally = path.own
            own.setdefault(path.function, _Tally()).add(tally.executions, tally.cycles, tally.stall_cycles)
            # A recursive function is on the path several times, but its cycles count once.
            for function in set(path.functions):
                inclusive[function] += tally.cycles
        names = self._names
        for function, tally in own.items():
            yield FunctionCost(
                names[function],
                calls[function],
                inclusive[function],
                tally.cycles,
                tally.executions,
                tally.stall_cycles,
            )

    def _stacks(self) -> Iterator[StackCost]:
        for path in self._paths:
            if path.own.cycles:
                yield StackCost(tuple(map(self._owners.name, path.functions)), path.own.cycles)


def _read_paths(machine: Machine) -> Iterator[_Path]:
    callers: list[tuple[int, ...]] = [()]
    for number in itertools.count(1):
        record = lib.machine_path(machine.handle, number)
        if record == ffi.NULL:
            return
        path = _Path(record, callers[record.caller])
        callers.append(path.functions)
        yield path


def _read_costs(machine: Machine) -> Iterator[Any]:
    for number in itertools.count():
        cost = lib.machine_cost(machine.handle, number)
        if cost == ffi.NULL:
            return
        yield cost


def _line_costs(addresses: tuple[AddressCost, ...]) -> Iterator[LineCost]:
    """Yield the costs of source lines; none if the image has no line table."""
    lines: dict[str, _Tally] = {}
    for cost in addresses:
        lines.setdefault(cost.location, _Tally()).add(cost.executions, cost.cycles, cost.stall_cycles)
    if any(lines):
        for location, tally in lines.items():
            yield LineCost(location or "no line known", tally.cycles, tally.executions, tally.stall_cycles)
