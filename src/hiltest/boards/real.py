"""A real board on a serial port, turned by an operator or motors."""

from __future__ import annotations

import secrets
from types import NoneType

from hiltest.boards.board import Board, BoardKind, Declared
from hiltest.boards.faulty_port import add_faults
from hiltest.boards.output_interface import open_output
from hiltest.boards.protocol_interface import LinkTerms, ProtocolInterface
from hiltest.errors import ConfigError
from hiltest.link.ports import SerialPort, open_port
from hiltest.link.session import ATTEMPTS
from hiltest.link.transcript import Transcript
from hiltest.rig import Rig
from hiltest.tape.tape import LIVE, Tape
from hiltest.virtual.part.unique_id import REPLAYED_UNIQUE_ID, VIRTUAL_UNIQUE_ID
from hiltest.virtual.program.elf import FirmwareImage

#: Cycle model of a real processor.
SILICON = "silicon-dwt"
#: Cycle model of a board that the rig does not declare.
UNDECLARED = "undeclared"


def is_silicon(unique_id: bytes) -> bool:
    """Return whether a unique id is that of a chip."""
    # An emulator that does not model this register returns all zeros or all ones, which no chip does.
    return unique_id not in (VIRTUAL_UNIQUE_ID, REPLAYED_UNIQUE_ID, bytes(16), b"\xff" * 16)


class RealBoard(Board):
    """A board on a serial port.

    The truth of its world is unknown: truth, virtual time and instruction
    counts are not offered.

    Parameters
    ----------
    url
        Device or pyserial URL.
    rig
        Rig, which says how to understand the firmware.
    image
        ELF that runs on the board, whose variables are read by name; None if it is unknown.
    transcript
        Receives every byte, in both directions.
    tape
        Records all questions.

    Raises
    ------
    BenchError
        When the port cannot be opened, or nothing on it answers.
    ConfigError
        When the rig takes a virtual board for silicon, or silicon for a virtual board.
    """

    kind = BoardKind.REAL

    def __init__(
        self,
        url: str,
        rig: Rig,
        *,
        image: FirmwareImage | None = None,
        transcript: Transcript | None = None,
        tape: Tape = LIVE,
    ) -> None:
        self._url = url

        def open_line() -> SerialPort:
            return add_faults(open_port(url, baud=rig.link.baud, rig=rig.name), rig.faults, baud=rig.link.baud)

        declared = Declared.select(rig)
        if not rig.answers_requests:
            output = open_output(rig, open_line, image=image, transcript=transcript, tape=tape)
            super().__init__(output, description=f"board on {url}", declared=declared)
            return
        # Other programs may have used the line before, so a random seed avoids their nonces.
        terms = LinkTerms(nonce_seed=secrets.randbits(32), attempts=ATTEMPTS)
        session = terms.session(open_line, transcript, tape)
        interface = ProtocolInterface(session, declared.sensor_names, self.is_noise_free, tape=tape)
        super().__init__(interface, description=f"FRDM-K64F on {url}", declared=declared)
        if self.identity.unique_id == REPLAYED_UNIQUE_ID:  # id that `hiltest serve --replay` reports
            self.kind = BoardKind.REPLAY
        try:
            tape.ask("board.check", {}, NoneType, self._refuse_wrong_model)
        except ConfigError:
            self.close()
            raise

    @property
    def cycle_model(self) -> str:
        """Cycle model: clocks of silicon, the rig's declaration, or none.

        The chip's unique id distinguishes a virtual board from silicon, on any port. Only the rig can say which model a
        virtual board uses; without it the numbers are ``undeclared``.
        """
        if not self.answers_requests or not self.identity.cycle_source:
            return "none"
        model = self.declared.cycle_model or (SILICON if is_silicon(self.identity.unique_id) else UNDECLARED)
        return f"{model}@{self.identity.placement}"

    def _refuse_wrong_model(self) -> None:
        declared = self.declared.cycle_model
        if declared is None or (declared == SILICON) is is_silicon(self.identity.unique_id):
            return
        actual = "a chip" if is_silicon(self.identity.unique_id) else "a virtual board"
        raise ConfigError(
            f"the rig declares cycle_model = {declared!r}, but what answers on {self._url} is {actual} "
            f"(unique id {self.identity.unique_id.hex()}). Correct cycle_model under [board], "
            "or name the port of the intended board"
        )
