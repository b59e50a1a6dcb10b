"""How many turns of a loop go as the last one did, its counters and timers running on."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple, Protocol

from hiltest.virtual.cpu import Processor
from hiltest.virtual.memory import PERIPHERALS
from hiltest.virtual.turn import Counting, LoopTurn
from hiltest.virtual.waits.decoded import Operation
from hiltest.virtual.waits.intervals import MASK, Place, Value
from hiltest.virtual.waits.operations import compiled
from hiltest.virtual.waits.state import NotProvable, NotUniform, TurnState

_FEWEST = 4  # turns that are worth the proof
_NEAR = 4  # a bisection ends where so few turns are left: they are executed as quickly
_FLAGS = {"n": 31, "z": 30, "c": 29, "v": 28}  # places in XPSR
_MASKS = ("primask", "faultmask", "basepri")
_STALE = Value(0, MASK, stale=True)


class Registers(Protocol):
    """Interface of the peripheral bus to a proof."""

    def read(self, address: int, size: int) -> int:
        """Read a register, as an access to its address would."""
        ...

    def counting(self, address: int) -> Counting | None:
        """Return how the register at an address counts; None for one that is steady."""
        ...


class Proof(NamedTuple):
    """What is known of some turns together: the next so many.

    Attributes
    ----------
    turns : int
    steps : dict of Place to int
        What a turn adds to each place that it only adds to.
    """

    turns: int
    steps: dict[Place, int]


class LoopProver:
    """Passes over turns of loops that read counters and timers, or count turns themselves.

    Parameters
    ----------
    processor : Processor
    bus : Registers

    Notes
    -----
    Every turn takes the same way, and so the same time, as long as all its branches go as they went. To prove that
    for many turns at once, one is walked through with intervals for what changes from turn to turn: of a counter all
    that it shows in those turns, of a place that a turn adds to all that it holds. Where a branch does not go one
    way for a whole interval, fewer turns are tried. What else changes must be written in a turn before it is read:
    the last turn that is proved to go this way is always executed, and leaves it as it would have been.
    """

    def __init__(self, processor: Processor, bus: Registers) -> None:
        self._processor = processor
        self._bus = bus
        self._compiled: dict[tuple[tuple[int, bool], ...], tuple[LoopTurn, list[tuple[int, Operation]] | None]] = {}

    def pass_over(self, turn: LoopTurn) -> int:
        """Return how many turns may be passed over; what they add to registers and RAM is added already.

        Negative where the turn does what cannot be followed.
        """
        operations = self._operations(turn)
        most = (turn.until - 1 - turn.began) // turn.period
        if operations is None or most < _FEWEST:
            return -1 if operations is None else 0
        surroundings = _Now(self._processor, self._bus, turn)
        try:
            proof = _longest(operations, surroundings, most)
        except NotProvable:
            return -1
        if proof is None or proof.turns < _FEWEST:
            return 0
        passed = proof.turns - 1
        for place, step in proof.steps.items():
            surroundings.write(place, surroundings.held(place) + step * passed & MASK)
        return passed

    def _operations(self, turn: LoopTurn) -> list[tuple[int, Operation]] | None:
        """Return what a turn does, with the cycle of each instruction in it; None where it cannot be followed."""
        key = tuple((id(block.instructions), jumped) for block, jumped in turn.blocks)
        if key not in self._compiled:
            try:
                operations = self._compile(turn)
            except NotProvable:
                operations = None
            self._compiled[key] = turn, operations  # with the turn, so that its blocks stay what they are
        return self._compiled[key][1]

    def _compile(self, turn: LoopTurn) -> list[tuple[int, Operation]]:
        operations: list[tuple[int, Operation]] = []
        cycle = 0
        nexts = [block.address for block, _ in (*turn.blocks[1:], turn.blocks[0])]
        for (block, jumped), goes_to in zip(turn.blocks, nexts, strict=True):
            code = self._processor.memory.read(block.address, block.end - block.address)
            for address, operation in compiled(
                block.address, code, transfers=block.transfers, jumps=jumped, goes_to=goes_to
            ):
                operations.append((cycle + block.cycles_before(address, self._processor.profile), operation))
            cycle += block.taken if jumped else block.through
        return operations


class _Now:
    """What places hold, and registers answer, when the next turn begins."""

    def __init__(self, processor: Processor, bus: Registers, turn: LoopTurn) -> None:
        self._processor = processor
        self._bus = bus
        self._turn = turn
        *cores, _pc, xpsr = processor.registers.general.read()
        masks = processor.registers.masks.read()
        self._held: dict[Place, int] = dict(enumerate(cores))
        self._held.update({flag: xpsr >> bit & 1 for flag, bit in _FLAGS.items()})
        self._held.update(zip(_MASKS, masks, strict=True))

    def held(self, place: Place) -> int:
        """Return what a place holds now."""
        if isinstance(place, tuple):
            try:
                return int.from_bytes(self._processor.memory.read(*place), "little")
            except ValueError:
                raise NotProvable from None
        return self._held[place]

    def write(self, place: Place, value: int) -> None:
        """Change what a place holds."""
        if isinstance(place, tuple):
            address, size = place
            self._processor.memory.write(address, (value & (1 << 8 * size) - 1).to_bytes(size, "little"))
        elif isinstance(place, int):
            self._processor.registers.cores((place,)).write([value])

    def is_register(self, address: int) -> bool:
        """Whether a peripheral answers there."""
        return address >= PERIPHERALS[0]

    def is_code(self, place: Place) -> bool:
        """Whether a place is where the turn's own instructions are."""
        return isinstance(place, tuple) and any(
            place[0] < block.end and block.address < sum(place) for block, _ in self._turn.blocks
        )

    def read(self, address: int, size: int, cycle: int, turns: int) -> Value:
        """Return what a register answers in the turns: an interval for one that counts."""
        counting = self._bus.counting(address)
        if counting is None:
            return Value(self._bus.read(address, size) & (1 << 8 * size) - 1)
        first = self._turn.began + cycle
        last = first + (turns - 1) * self._turn.period
        if size != counting.size or address % size:
            raise NotProvable
        if last >= counting.until:
            raise NotUniform
        low, high = counting.at(first), counting.at(last)
        return Value(low, high - low & MASK) if counting.rises else Value(high, low - high & MASK)


def _longest(operations: list[tuple[int, Operation]], now: _Now, most: int) -> Proof | None:
    """Find the most turns, up to `most`, of which it can be proved that they go alike, or nearly as many."""
    proof = _prove(operations, now, most)
    if proof is not None:
        return proof
    found, too_many = _prove(operations, now, _FEWEST), most
    while found is not None and too_many - found.turns > _NEAR:
        between = (found.turns + too_many) // 2
        proof = _prove(operations, now, between)
        if proof is None:
            too_many = between
        else:
            found = proof
    return found


def _prove(operations: list[tuple[int, Operation]], now: _Now, turns: int) -> Proof | None:
    """Walk through some turns at once; None where they do not go alike."""
    begun_with: dict[Place, Value] = {}
    steps: dict[Place, int] = {}
    try:
        while True:
            state = TurnState(now, begun_with, turns)
            for cycle, operation in operations:
                state.cycle = cycle
                operation(state)
            if not _changes(state.written, begun_with, steps, now, turns):
                break
    except NotUniform:
        return None
    rewritten = [place for place in begun_with if place not in steps]
    if any(state.written[place].stale for place in rewritten) or any(place in _MASKS for place in begun_with):
        raise NotProvable
    if any(now.is_code(place) for place in state.written):
        raise NotProvable
    return Proof(turns, steps)


def _changes(
    written: Mapping[Place, Value], begun_with: dict[Place, Value], steps: dict[Place, int], now: _Now, turns: int
) -> bool:
    """Note what turns begin with, from what one leaves; say whether that is new. What has changed once stays so."""
    changed = False
    for place, left in written.items():
        held = now.held(place)
        step = (left.offset & MASK ^ 0x80000000) - 0x80000000 if left.base == place and not left.stale else None
        known = begun_with.get(place)
        if known is None and left.is_known and left.low == held:
            continue
        if step is not None and known is None and abs(step) * (turns - 1) <= MASK:
            steps[place] = step
            width = abs(step) * (turns - 1)
            begun_with[place] = Value(held if step >= 0 else held - width & MASK, width, base=place)
        elif known is None or (known is not _STALE and steps.get(place) != step):
            steps.pop(place, None)
            begun_with[place] = _STALE
        else:
            continue
        changed = True
    return changed
