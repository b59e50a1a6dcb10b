"""A real board on a serial port, turned by somebody else."""

from __future__ import annotations

import os

from hiltest.boards.board import Board, BoardKind, Declared
from hiltest.link.ports import open_port
from hiltest.link.session import Session
from hiltest.link.transcript import Transcript

#: Cycle model of a processor that exists.
SILICON = "silicon-dwt"
#: Cycle model of a board of which nobody has said whether it is silicon.
UNDECLARED = "undeclared"


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
        self._url = url
        session = Session(open_port(url, baud=baud), transcript=transcript)
        super().__init__(session, description=f"FRDM-K64F on {url}", declared=declared)

    @property
    def cycle_model(self) -> str:
        """What its cycle counter counts: what the rig says, clocks of silicon, or nothing.

        A board behind a pseudo-terminal or a network may be a virtual one, and nothing that it
        answers tells. Its numbers are ``undeclared`` unless the rig says what they are.
        """
        if not self.identity.cycle_source:
            return "none"
        model = self.declared.cycle_model or (SILICON if _is_hardware(self._url) else UNDECLARED)
        return f"{model}@{self.identity.placement}"


def _is_hardware(url: str) -> bool:
    """Say whether a port is a serial device of this machine, with a board at its other end."""
    return "://" not in url and not os.path.realpath(url).startswith("/dev/pts/")
