"""Cost of short runs of one kind of instruction on a board, from each memory."""

from __future__ import annotations

from hiltest.boards.board import Board
from hiltest.link.replies import CycleSource
from hiltest.link.sequences import SEQUENCES, SequencePlace, TimeSequence
from hiltest.procedures.cycles import no_cycle_counter
from hiltest.procedures.progress import Progress, silent

# The wait of code in flash depends on the phase of the flash's clock at its start; the fastest of some runs has the
# best phase.
_TIMES = 4


def measure_sequences(board: Board, *, progress: Progress | None = None) -> dict[SequencePlace, dict[str, int]]:
    """Time every sequence of the firmware from every memory.

    Parameters
    ----------
    board
        Board, of which no sensor is used.

    Returns
    -------
    dict
        Clocks of the first half of each sequence, by name: the minimum of four runs of the whole, minus the minimum of
        four of its second half.

    Raises
    ------
    DeviceError
        When the board's core has no cycle counter, or its firmware has no sequences.
    """
    if board.identity.cycle_source is CycleSource.NONE:
        raise no_cycle_counter()
    tell = progress or silent
    clocks: dict[SequencePlace, dict[str, int]] = {place: {} for place in SequencePlace}
    work = [(place, number, name) for place in SequencePlace for number, name in enumerate(SEQUENCES)]
    for done, (place, number, name) in enumerate(work):
        tell("sequences", done, len(work))
        clocks[place][name] = _clocks(board, number, place)
    tell("sequences", len(work), len(work))
    return clocks


def _clocks(board: Board, sequence: int, place: SequencePlace) -> int:
    costs = [board.session.request(TimeSequence(sequence, place)) for _ in range(_TIMES)]
    second_half = [cost.overhead_cycles for cost in costs if cost is not None]
    # Modulo 2^32, because a whole run that waited less than the half gives a negative difference.
    whole = [(cost.cycles + cost.overhead_cycles) % (1 << 32) for cost in costs if cost is not None]
    if len(whole) < _TIMES:
        raise no_cycle_counter()
    return min(whole) - min(second_half)
