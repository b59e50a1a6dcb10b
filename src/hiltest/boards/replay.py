"""A board whose run was recorded: its answers come from the recording, and no firmware runs."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from types import NoneType
from typing import Any, NoReturn, get_type_hints

from hiltest.boards.board import Board, BoardKind, Declared, LinkTerms
from hiltest.boards.compass import POLLED, CompassBoard, TapedReadings, VirtualCompass
from hiltest.boards.real import RealBoard
from hiltest.boards.virtual import VirtualBoard
from hiltest.device.kinds import open_interfaces
from hiltest.link.session import ATTEMPTS
from hiltest.link.transcript import Transcript
from hiltest.replay.tape import Tape
from hiltest.replay.values import member_of
from hiltest.rig import Rig

# The class says its kind, what was executed is no part of a recording, and the end of the link is no question.
_NOT_ASKED = frozenset({"kind", "execution", "close"})


def asked_of_boards(interface: type = Board) -> Iterator[str]:
    """Yield what boards answer each in its own way, beside the bytes; all else follows from these and the bytes."""
    kinds = (VirtualBoard, RealBoard) if interface is Board else (VirtualCompass,)
    overridden = {name for kind in kinds for name in vars(kind)}
    for name in sorted((overridden | get_type_hints(interface).keys() | {"origin"}) - _NOT_ASKED):
        if not name.startswith("_"):
            yield name


def put_on_tape(board: Board | CompassBoard, tape: Tape) -> dict[str, Any]:
    """Let what is asked of a board pass through a tape; return what it is, which does not change."""
    told = {}
    interface: type = CompassBoard if isinstance(board, CompassBoard) else Board
    for name in asked_of_boards(interface):
        member, question = member_of(interface, name), f"board.{name}"
        if member.is_method:
            setattr(board, name, tape.method(question, member, getattr(board, name)))
            continue
        told[name] = tape.ask(question, {}, member.hint, partial(getattr, board, name))
        if not isinstance(getattr(interface, name, None), property):
            setattr(board, name, told[name])
    return told


class ReplayBoard(Board):
    """A recorded board.

    Parameters
    ----------
    tape
        With a recording.
    declared
        What the rig says.
    transcript
        Gets every byte, both ways.

    Raises
    ------
    DivergenceError
        When the recording begins otherwise.
    HiltestError
        What the recorded board was refused for.
    """

    kind = BoardKind.REPLAY

    def __init__(self, tape: Tape, *, declared: Declared, transcript: Transcript | None = None) -> None:
        session = LinkTerms(nonce_seed=0, attempts=ATTEMPTS).session(_nothing, transcript, tape)
        super().__init__(session, description="", declared=declared)
        tape.ask("board.check", {}, NoneType, _nothing)
        self._told = put_on_tape(self, tape)
        self.description = f"replay of {self.description}"

    @property
    def origin(self) -> BoardKind:
        """Kind of the recorded board."""
        origin: BoardKind = self._told["origin"]
        return origin

    @property
    def cycle_model(self) -> str:
        """Cycle model of the recorded board."""
        model: str = self._told["cycle_model"]
        return model

    @property
    def executes_firmware(self) -> bool:
        """Whether the recorded board saw every instruction."""
        executed: bool = self._told["executes_firmware"]
        return executed


class ReplayCompass(CompassBoard):
    """A recorded board whose firmware speaks its own language: what it said is understood once more.

    Parameters
    ----------
    tape
        With a recording.
    transcript
        Gets every byte, both ways.
    """

    def __init__(self, tape: Tape, rig: Rig, *, transcript: Transcript | None = None) -> None:
        port = tape.port(_nothing)
        polled: tuple[str, ...] = tape.ask(POLLED, {}, tuple[str, ...], _nothing)
        read = {kind: partial(_read_on_tape, tape, kind) for kind in polled}
        super().__init__(
            port, rig, open_interfaces(rig, read), kind=BoardKind.REPLAY, description="", transcript=transcript
        )
        self._told: dict[str, Any] = {}

    def identify(self, tape: Tape) -> None:
        """Hear what the recorded board was."""
        self._told = put_on_tape(self, tape)
        self.description = f"replay of {self.description}"

    @property
    def origin(self) -> BoardKind:
        """Kind of the recorded board."""
        origin: BoardKind = self._told["origin"]
        return origin

    @property
    def core_clock_hz(self) -> int:
        """Core clock of the recorded board."""
        clock_hz: int = self._told["core_clock_hz"]
        return clock_hz

    @property
    def cycle_model(self) -> str:
        """Cycle model of the recorded board."""
        model: str = self._told["cycle_model"]
        return model


def _read_on_tape(tape: Tape, kind: str, _rig: Rig) -> TapedReadings:
    return TapedReadings(tape, kind, None)


def _nothing() -> NoReturn:
    raise AssertionError("a recording answers without asking")
