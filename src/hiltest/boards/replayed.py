"""A recorded board: its answers come from the recording, and no firmware runs."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from types import NoneType
from typing import Any, NoReturn, get_type_hints

from hiltest.boards.board import Board, BoardKind, Declared, LinkTerms
from hiltest.boards.compass import POLLED, CompassBoard, TapedReadings, VirtualCompass
from hiltest.boards.real import RealBoard
from hiltest.boards.virtual import VirtualBoard
from hiltest.interfaces.kinds import open_interfaces
from hiltest.link.session import ATTEMPTS
from hiltest.link.transcript import Transcript
from hiltest.rig import Rig
from hiltest.tape.tape import Tape
from hiltest.tape.values import member_of

# Not recorded: the kind, which the class determines; executed instructions; and the end of the link.
_NOT_ASKED = frozenset({"kind", "execution", "close"})


def asked_of_boards(interface: type = Board) -> Iterator[str]:
    """Yield the names of the members that each kind of board implements; all others follow from these and the bytes."""
    kinds = (VirtualBoard, RealBoard) if interface is Board else (VirtualCompass,)
    overridden = {name for kind in kinds for name in vars(kind)}
    for name in sorted((overridden | get_type_hints(interface).keys() | {"origin"}) - _NOT_ASKED):
        if not name.startswith("_"):
            yield name


def put_on_tape(board: Board | CompassBoard, tape: Tape) -> dict[str, Any]:
    """Put a board's questions on a tape; return its constant facts."""
    facts = {}
    interface: type = CompassBoard if isinstance(board, CompassBoard) else Board
    for name in asked_of_boards(interface):
        member, question = member_of(interface, name), f"board.{name}"
        if member.is_method:
            setattr(board, name, tape.method(question, member, getattr(board, name)))
            continue
        facts[name] = tape.ask(question, {}, member.hint, partial(getattr, board, name))
        if not isinstance(getattr(interface, name, None), property):
            setattr(board, name, facts[name])
    return facts


class ReplayBoard(Board):
    """A recorded board.

    Parameters
    ----------
    tape
        Tape with a recording.
    declared
        Declarations of the rig.
    transcript
        Receives every byte, in both directions.

    Raises
    ------
    DivergenceError
        When the recording begins differently.
    HiltestError
        The error that refused the recorded board.
    """

    kind = BoardKind.REPLAY

    def __init__(self, tape: Tape, *, declared: Declared, transcript: Transcript | None = None) -> None:
        session = LinkTerms(nonce_seed=0, attempts=ATTEMPTS).session(_refuse_call, transcript, tape)
        super().__init__(session, description="", declared=declared)
        tape.ask("board.check", {}, NoneType, _refuse_call)
        self._facts = put_on_tape(self, tape)
        self.description = f"replay of {self.description}"

    @property
    def origin(self) -> BoardKind:
        """Kind of the recorded board."""
        origin: BoardKind = self._facts["origin"]
        return origin

    @property
    def cycle_model(self) -> str:
        """Cycle model of the recorded board."""
        model: str = self._facts["cycle_model"]
        return model

    @property
    def executes_firmware(self) -> bool:
        """Whether the recorded board saw every instruction."""
        executed: bool = self._facts["executes_firmware"]
        return executed


class ReplayCompass(CompassBoard):
    """A recorded board whose firmware has its own protocol: its output is interpreted again.

    Parameters
    ----------
    tape
        Tape with a recording.
    transcript
        Receives every byte, in both directions.
    """

    def __init__(self, tape: Tape, rig: Rig, *, transcript: Transcript | None = None) -> None:
        port = tape.port(_refuse_call)
        polled: tuple[str, ...] = tape.ask(POLLED, {}, tuple[str, ...], _refuse_call)
        read = {kind: partial(_read_on_tape, tape, kind) for kind in polled}
        super().__init__(
            port, rig, open_interfaces(rig, read), kind=BoardKind.REPLAY, description="", transcript=transcript
        )
        self._facts: dict[str, Any] = {}

    def identify(self, tape: Tape) -> None:
        """Read the identity of the recorded board."""
        self._facts = put_on_tape(self, tape)
        self.description = f"replay of {self.description}"

    @property
    def origin(self) -> BoardKind:
        """Kind of the recorded board."""
        origin: BoardKind = self._facts["origin"]
        return origin

    @property
    def core_clock_hz(self) -> int:
        """Core clock of the recorded board."""
        clock_hz: int = self._facts["core_clock_hz"]
        return clock_hz

    @property
    def cycle_model(self) -> str:
        """Cycle model of the recorded board."""
        model: str = self._facts["cycle_model"]
        return model


def _read_on_tape(tape: Tape, kind: str, _rig: Rig) -> TapedReadings:
    return TapedReadings(tape, kind, None)


def _refuse_call() -> NoReturn:
    raise AssertionError("a recording answers without asking")
