"""What loads and stores do to the values of a turn."""

from __future__ import annotations

from hiltest.virtual.waits import intervals as of
from hiltest.virtual.waits.decoded import STACK_POINTER, DecodedInstruction, Operation
from hiltest.virtual.waits.intervals import MASK, Value
from hiltest.virtual.waits.state import TurnState

LOADS = {"ldr": (4, False), "ldrb": (1, False), "ldrh": (2, False), "ldrsb": (1, True), "ldrsh": (2, True)}
STORES = {"str": 4, "strb": 1, "strh": 2}


def load_operation(this: DecodedInstruction) -> Operation:
    """Return what a load of one register does."""
    size, signed = LOADS[this.name]
    where, write_back = this.where()
    write = this.writer()

    def run(state: TurnState) -> None:
        value = state.load(where(state), size, signed=signed)
        if write_back is not None:
            write_back(state)
        write(state, value)

    return run


def store_operation(this: DecodedInstruction) -> Operation:
    """Return what a store of one register does."""
    size = STORES[this.name]
    where, write_back = this.where()
    read = this.operand(0)

    def run(state: TurnState) -> None:
        state.store(where(state), size, read(state))
        if write_back is not None:
            write_back(state)

    return run


def pair_operation(this: DecodedInstruction) -> Operation:
    """Return what LDRD or STRD does."""
    where, write_back = this.where()
    reads, loads = [this.operand(0), this.operand(1)], this.name == "ldrd"
    writes = [this.writer(0), this.writer(1)] if loads else []

    def run(state: TurnState) -> None:
        first = where(state)
        places = first, of.add(first, Value(4))
        if write_back is not None:
            write_back(state)
        if loads:
            for write, value in zip(writes, [state.load(place, 4) for place in places], strict=True):
                write(state, value)
        else:
            for read, place in zip(reads, places, strict=True):
                state.store(place, 4, read(state))

    return run


def multiple_operation(this: DecodedInstruction) -> Operation:
    """Return what PUSH, POP, LDM or STM does, up or down."""
    on_stack = this.name in ("push", "pop")
    base = STACK_POINTER if on_stack else this.number(0)
    indices = range(0 if on_stack else 1, len(this.operands))
    size = 4 * len(indices)
    down = this.name in ("push", "stmdb", "ldmdb")
    step = Value((-size if down else size) & MASK)
    writes_back = on_stack or this.writes_back
    loads = this.name in ("pop", "ldm", "ldmdb")
    reads = [] if loads else [this.operand(index) for index in indices]
    writes = [this.writer(index) for index in indices] if loads else []

    def run(state: TurnState) -> None:
        begin = state.get(base)
        first = of.add(begin, step) if down else begin
        values = [read(state) for read in reads]
        places = [of.add(first, Value(4 * index)) for index in range(len(indices))]
        if writes_back:
            state.set(base, of.add(begin, step))
        for place, value in zip(places, values, strict=False):
            state.store(place, 4, value)
        loaded = [state.load(place, 4) for place in places] if loads else []
        for write, value in zip(writes, loaded, strict=True):
            write(state, value)

    return run
