"""What short runs of one kind of instruction cost on a board, from each memory."""

from __future__ import annotations

from hiltest.boards.board import Board
from hiltest.link.messages import CycleSource
from hiltest.link.sequences import SEQUENCES, SequencePlace, TimeSequence
from hiltest.procedures.cycles import no_cycle_counter
from hiltest.procedures.progress import Progress, silent

# The first time from a memory a sequence may still have to be fetched into a cache; the least of some is its own.
_TIMES = 4


def measure_sequences(board: Board, *, progress: Progress | None = None) -> dict[SequencePlace, dict[str, int]]:
    """Time every sequence of the firmware from every memory.

    Parameters
    ----------
    board : Board
        It is asked for nothing else: no sensor, no turning.

    Returns
    -------
    dict
        Clocks of each sequence by name, the empty one subtracted: the least of four times.

    Raises
    ------
    DeviceError
        When the board's core has no cycle counter, or its firmware knows no sequences.
    """
    if board.identity.cycle_source is CycleSource.NONE:
        raise no_cycle_counter()
    tell = progress or silent
    found: dict[SequencePlace, dict[str, int]] = {place: {} for place in SequencePlace}
    work = [(place, number) for place in SequencePlace for number in range(1, len(SEQUENCES))]
    for done, (place, number) in enumerate(work):
        tell("sequences", done, len(work))
        found[place][SEQUENCES[number]] = min(_clocks(board, number, place) for _ in range(_TIMES))
    tell("sequences", len(work), len(work))
    return found


def _clocks(board: Board, sequence: int, place: SequencePlace) -> int:
    cost = board.session.request(TimeSequence(sequence, place))
    if cost is None:
        raise no_cycle_counter()
    # Less than nothing is what an empty one costs that has waited where this one has not.
    return cost.cycles - (1 << 32) if cost.cycles >= 1 << 31 else cost.cycles
