"""A real board on a serial port, turned by somebody else."""

from __future__ import annotations

from hiltest.boards.board import Board, BoardKind, Declared
from hiltest.link.ports import open_port
from hiltest.link.session import Session
from hiltest.link.transcript import Transcript


class RealBoard(Board):
    """An FRDM-K64F with the hiltest firmware.

    Nobody knows the truth of its world: truth, virtual time and instruction
    counts are not offered.

    Parameters
    ----------
    url : str
        Device or pyserial URL.
    baud : int
        Line speed.
    declared : Declared
        What the rig says.
    transcript : Transcript, optional
        Gets every byte, both ways.

    Raises
    ------
    BenchError
        When the port cannot be opened, or nothing on it answers.
    """

    kind = BoardKind.REAL

    def __init__(self, url: str, *, baud: int, declared: Declared, transcript: Transcript | None = None) -> None:
        session = Session(open_port(url, baud=baud), transcript=transcript)
        super().__init__(session, description=f"FRDM-K64F on {url}", declared=declared)

    @property
    def cycle_model(self) -> str:
        """What its cycle counter counts: clocks of the silicon, or nothing."""
        return f"silicon-dwt@{self.identity.placement}" if self.identity.cycle_source else "none"
