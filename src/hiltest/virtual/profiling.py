"""Profile of the cycles of one call: by function, source line, instruction, and kind of work or stall.

`ProfilingAccounting` counts as `BlockAccounting` does, and notes how often each block ran in which function.
Every cycle is given to one instruction afterwards, by the same timing profile, so the tables add up to the
total that was counted.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

from hiltest.errors import ConfigError
from hiltest.measurement import CycleRange, in_flash
from hiltest.virtual.accounting import BlockAccounting
from hiltest.virtual.blocks import CodeBlock
from hiltest.virtual.call_tree import CallNode, CallTree
from hiltest.virtual.calling import CallResult
from hiltest.virtual.chip import MemoryMap
from hiltest.virtual.cost_classes import InstructionCost, Stall, Work, instruction_costs
from hiltest.virtual.cycle_range import cycle_range, flash_range
from hiltest.virtual.elf import FirmwareImage
from hiltest.virtual.executions import between
from hiltest.virtual.k64f import HANG_S, VirtualK64F
from hiltest.virtual.placement import LEAST_SHARE, FetchTally, Loop, LoopPlacement, placements
from hiltest.virtual.procedure_call import Argument
from hiltest.virtual.timing import TimingProfile

_SRAM_U = 0x20000000


class ProfilingAccounting(BlockAccounting):
    """Counts by block, and keeps which blocks ran along which path of calls.

    Attributes
    ----------
    tree : CallTree or None
        What is filled; nothing is kept without one.
    """

    tree: CallTree | None = None
    _noted_cycles = 0

    def follow(self, tree: CallTree) -> None:
        """Keep what runs from now on in `tree`."""
        self.tree = tree
        self._noted_cycles = self.cycles

    def begins(self, address: int, size: int) -> None:
        """Take note that the emulator is about to run a block (its block hook)."""
        self._note(address)
        super().begins(address, size)

    def settle(self, pc: int) -> None:
        """Add the block that just ended; `pc` is where execution goes on."""
        self._note(pc & ~1)
        super().settle(pc)

    def _note(self, address: int) -> None:
        """Keep the block that ends, before its cycles are added; `address` is where execution goes on."""
        if self.tree is None:
            return
        # What was added besides blocks: sleep, or the entry of an exception.
        self.tree.current.asleep_cycles += self.cycles - self._noted_cycles
        self._noted_cycles = self.cycles
        block = self._running
        if block is not None:
            went_on = address == block.end
            self._noted_cycles += block.through if went_on else block.taken
            self.tree.current.ran(block, went_on=went_on)
            self.tree.follow(block.instructions[-1], block.end, address)


@dataclass(frozen=True, slots=True)
class FunctionCost:
    """Cost of one function.

    Attributes
    ----------
    calls : int
        How often it was entered.
    cycles, self_cycles : int
        Cycles with the functions that it called, and without.
    instructions, stall_cycles : int
        Its own.
    """

    name: str
    calls: int
    cycles: int
    self_cycles: int
    instructions: int
    stall_cycles: int


@dataclass(frozen=True, slots=True)
class LineCost:
    """Cost of one source line; code inlined from elsewhere counts where it was written."""

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
    """Cycles of the last function of a chain of calls, without those that it called."""

    functions: tuple[str, ...]
    cycles: int


@dataclass(frozen=True, slots=True)
class CallProfile(CallResult):
    """Value and cost of a called function, and where its cycles went.

    Attributes
    ----------
    function : str
    cycle_model : str
        Timing profile and placement of the code that ran: ``cortex-m4-trm/2@sram``.
    work, stalls : mapping
        Cycles of each class of instructions and of each cause of waiting; with
        `asleep_cycles` they add up to `cycles`.
    asleep_cycles : int
        Cycles in which no instruction ran: WFI.
    functions, lines, addresses, stacks : tuple
        Most expensive first; `lines` is empty without debug information.
    band : CycleRange or None
        Uncertainty range of `cycles`; None when more than instructions took time,
        and for code in flash by a profile that knows no memories.
    memory_cycles : int or None
        What accesses waited for, of no instruction in the tables; None when the timing profile knows no memories.
    loops : tuple of LoopPlacement
        Those whose instructions lie badly, the one that loses most first; none by a profile without rules of fetching.
    """

    function: str
    cycle_model: str
    work: Mapping[Work, int]
    stalls: Mapping[Stall, int]
    asleep_cycles: int
    functions: tuple[FunctionCost, ...]
    lines: tuple[LineCost, ...]
    addresses: tuple[AddressCost, ...]
    stacks: tuple[StackCost, ...]
    band: CycleRange | None
    memory_cycles: int | None = None
    loops: tuple[LoopPlacement, ...] = ()

    def share(self, cycles: int) -> float:
        """Return a part of the total [%]."""
        return 100.0 * cycles / self.cycles


def profile_call(
    board: VirtualK64F, function: str, *arguments: Argument, timeout_s: float = HANG_S, clock_hz: float | None = None
) -> CallProfile:
    """Call one function of an image and find out where its cycles go.

    Parameters
    ----------
    board : VirtualK64F
        Made with ``accounting=ProfilingAccounting``.
    function : str
        Its name.
    *arguments, timeout_s, clock_hz
        As `VirtualK64F.call` takes them.

    Raises
    ------
    ConfigError
        No such function, or arguments that do not fit it.
    BoardFault
        The function faulted or hung.
    """
    processor = board.processor
    accounting = processor.accounting
    if not isinstance(accounting, ProfilingAccounting):
        raise ConfigError("this board does not keep what runs; make it with accounting=ProfilingAccounting")
    symbol = board.image.symbols.get(function)
    stack_pointer = processor.registers.cores((13,)).get
    tree = CallTree(board.image, function, symbol.address if symbol else 0, stack_pointer)
    accounting.follow(tree)
    before = accounting.snapshot(0)
    try:
        result = board.call(function, *arguments, timeout_s=timeout_s, clock_hz=clock_hz)
    finally:
        accounting.tree = None
    executed = between(before, accounting.snapshot(0))
    sums = _Sums(processor.profile, tree, processor.memory.map)
    counted = executed if not in_flash(sums.cycle_model) else None  # what flash waits for is of no row, and greater
    band = cycle_range(processor.profile, result.cycles, counted) if counted else None
    return sums.profile(board.image, function, result, band)


def with_memories(profile: CallProfile, cycles: int, timing: TimingProfile) -> CallProfile:
    """Return a profile with what the memories add.

    Parameters
    ----------
    profile : CallProfile
        Profile of the instructions alone.
    cycles : int
        Cycles of the same call, memories included.
    timing : TimingProfile
        Its memory rows give the uncertainty range where code is in flash.
    """
    waited = cycles - profile.cycles
    band = profile.band if not waited else None
    if in_flash(profile.cycle_model):
        band = flash_range(timing, cycles)
    return replace(profile, cycles=cycles, band=band, memory_cycles=waited)


class _Tally:
    """A running sum of costs."""

    __slots__ = ("cycles", "executions", "stall_cycles")

    def __init__(self) -> None:
        self.executions = self.cycles = self.stall_cycles = 0

    def add(self, executions: int, cycles: int, stall_cycles: int) -> None:
        """Add `executions` of something."""
        self.executions += executions
        self.cycles += cycles
        self.stall_cycles += stall_cycles


class _Sums:
    """Adds up what ran in every node of a call tree."""

    def __init__(self, profile: TimingProfile, tree: CallTree, memories: MemoryMap) -> None:
        self._timing = profile
        self._memories = memories
        self._root = tree.root
        self._costs: dict[tuple[int, bool], tuple[InstructionCost, ...]] = {}
        self.work: Counter[Work] = Counter(dict.fromkeys(Work, 0))
        self.stalls: Counter[Stall] = Counter(dict.fromkeys(Stall, 0))
        self.nodes: dict[CallNode, _Tally] = {}
        self._loops: dict[int, Counter[Loop]] = {}
        self._fetched: dict[int, dict[int, FetchTally]] = {}
        self.addresses: dict[tuple[int, int], tuple[CallNode, InstructionCost, _Tally]] = {}
        for node in tree.root.walk():
            self._add_node(node)

    def _add_node(self, node: CallNode) -> None:
        own = self.nodes[node] = _Tally()
        own.cycles = node.asleep_cycles
        loops = self._loops.setdefault(node.address, Counter())
        for block, went_on, count in node.runs.values():
            last = block.instructions[-1]
            if not went_on and last.target is not None and last.jumps_back(last.address):
                loops[last.target, last.address] += count
            for cost in self._of(block, went_on=went_on):
                self._note_fetch(node.address, cost, count)
                waited = 0
                for cause, cycles in cost.stalls:
                    waited += cycles
                    self.stalls[cause] += count * cycles
                self.work[cost.work] += count * cost.work_cycles
                key = node.address, cost.instruction.address
                _, _, at_address = self.addresses.setdefault(key, (node, cost, _Tally()))
                for tally in (own, at_address):
                    tally.add(count, count * (cost.work_cycles + waited), count * waited)

    def _note_fetch(self, function: int, cost: InstructionCost, count: int) -> None:
        instruction = cost.instruction
        tally = self._fetched.setdefault(function, {}).setdefault(instruction.address, FetchTally(instruction))
        tally.executions += count
        tally.late += count * sum(cycles for cause, cycles in cost.stalls if cause is Stall.FETCH)

    def _of(self, block: CodeBlock, *, went_on: bool) -> tuple[InstructionCost, ...]:
        key = id(block), went_on
        if key not in self._costs:
            self._costs[key] = tuple(instruction_costs(self._timing, block, went_on=went_on))
        return self._costs[key]

    def profile(
        self, image: FirmwareImage, function: str, result: CallResult, band: CycleRange | None
    ) -> CallProfile:
        """Make the tables."""
        addresses = tuple(sorted(self._address_costs(image), key=lambda each: (-each.cycles, each.address)))
        return CallProfile(
            result.value, result.cycles, result.instructions, result.clock_hz, function, self.cycle_model,
            self.work, self.stalls, sum(node.asleep_cycles for node in self.nodes),
            functions=tuple(sorted(self._function_costs(), key=lambda each: (-each.self_cycles, each.name))),
            lines=tuple(sorted(_line_costs(addresses), key=lambda each: (-each.cycles, each.location))),
            addresses=addresses, stacks=tuple(sorted(self._stacks(), key=lambda each: (-each.cycles, each.functions))),
            band=band, loops=tuple(self._placements(image, LEAST_SHARE * result.cycles)),
        )  # fmt: skip

    def _placements(self, image: FirmwareImage, least: float) -> list[LoopPlacement]:
        names = _distinct_names({node.address: node.name for node in self.nodes})
        found = [
            each for address, loops in self._loops.items()
            for each in placements(names[address], loops, self._fetched.get(address, {}), image)
        ]
        return sorted((each for each in found if each.cycles >= least), key=lambda each: (-each.cycles, each.address))

    @property
    def cycle_model(self) -> str:
        """Timing profile and the memories that the code ran from, the one with the most cycles first."""
        cycles: Counter[str] = Counter()
        for (_, address), (_, _, tally) in self.addresses.items():
            in_flash = self._memories.in_flash(address)
            cycles["flash" if in_flash else "sram" if address < _SRAM_U else "sram_u"] += tally.cycles
        return f"{self._timing.name}@{'+'.join(name for name, _ in cycles.most_common())}"

    def _address_costs(self, image: FirmwareImage) -> Iterator[AddressCost]:
        for (_, address), (node, cost, tally) in self.addresses.items():
            yield AddressCost(
                address, cost.instruction.text, node.name, image.location_at(address),
                tally.executions, tally.cycles, tally.stall_cycles,
            )  # fmt: skip

    def _function_costs(self) -> Iterator[FunctionCost]:
        own: dict[int, _Tally] = {}
        inclusive: Counter[int] = Counter()
        calls: Counter[int] = Counter()
        for node, tally in self.nodes.items():
            calls[node.address] += node.entries
            own.setdefault(node.address, _Tally()).add(tally.executions, tally.cycles, tally.stall_cycles)
            # A recursive function is on the path more than once, and its cycles count once.
            for address in {each.address for each in node.path()}:
                inclusive[address] += tally.cycles
        names = _distinct_names({node.address: node.name for node in self.nodes})
        for address, tally in own.items():
            yield FunctionCost(
                names[address], calls[address], inclusive[address], tally.cycles, tally.executions, tally.stall_cycles
            )

    def _stacks(self) -> Iterator[StackCost]:
        for node, tally in self.nodes.items():
            if tally.cycles:
                yield StackCost(tuple(each.name for each in node.path()), tally.cycles)


def _distinct_names(names: Mapping[int, str]) -> dict[int, str]:
    """Tell static functions of the same name apart by their addresses."""
    often = Counter(names.values())
    return {address: name if often[name] == 1 else f"{name}@{address:#x}" for address, name in names.items()}


def _line_costs(addresses: tuple[AddressCost, ...]) -> Iterator[LineCost]:
    """Sum by source line; nothing when no line is known."""
    lines: dict[str, _Tally] = {}
    for each in addresses:
        lines.setdefault(each.location, _Tally()).add(each.executions, each.cycles, each.stall_cycles)
    if any(lines):
        for location, tally in lines.items():
            yield LineCost(location or "no line known", tally.cycles, tally.executions, tally.stall_cycles)
