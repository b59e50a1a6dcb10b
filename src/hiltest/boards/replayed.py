"""A recorded board: its answers come from the recording, and no firmware runs."""

from __future__ import annotations

from functools import partial
from types import NoneType
from typing import Any, NoReturn

from hiltest.boards.board import Board, BoardKind, Declared
from hiltest.boards.output_interface import POLLED, OutputInterface, TapedReadings
from hiltest.boards.protocol_interface import LinkTerms, ProtocolInterface
from hiltest.interfaces.kinds import open_interfaces
from hiltest.link.session import ATTEMPTS
from hiltest.link.transcript import Transcript
from hiltest.rig import Rig
from hiltest.tape.tape import Tape
from hiltest.tape.values import member_of

FACTS = frozenset(
    {
        "compiler_flags",
        "cycle_model",
        "description",
        "elf_build_id",
        "firmware_sha256",
        "memory_use",
        "origin",
        "seed",
        "sensor_settings",
        "stage",
        "truth",
    }
)
"""Members of every board that its recording answers; the others follow from these, and from the bytes on the line."""
FACTS_WITH_REQUESTS = FACTS | {
    "call_counter",
    "cycle_range",
    "executes_firmware",
    "instructions_counted",
    "request_cost",
    "sleep",
    "timed_steps",
    "true_attitude",
    "true_disturbances_ut",
}
"""Such members if the firmware answers requests."""
FACTS_OF_OUTPUT = FACTS | {"core_clock_hz", "costs", "firmware", "delivered_fields", "delivered_samples"}
"""Such members if it does not."""
_LATER = frozenset({"delivered_fields", "delivered_samples", "request_cost", "sensor_settings"})
"""Members that recordings of earlier versions lack."""


def put_on_tape(board: Board, tape: Tape) -> dict[str, Any]:
    """Put a board's questions on a tape; return its constant facts."""
    facts = {}
    for name in sorted(FACTS_WITH_REQUESTS if board.answers_requests else FACTS_OF_OUTPUT):
        member, question = member_of(Board, name), f"board.{name}"
        if member.is_method:
            method = tape.method(question, member, getattr(board, name), may_be_absent=name in _LATER)
            setattr(board, name, method)
            continue
        facts[name] = tape.ask(question, {}, member.hint, partial(getattr, board, name))
        if not isinstance(getattr(Board, name, None), property):
            setattr(board, name, facts[name])
    return facts


class ReplayBoard(Board):
    """A recorded board.

    Parameters
    ----------
    tape
        Tape with a recording.
    rig
        Rig, which says how to understand the firmware.
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

    def __init__(self, tape: Tape, rig: Rig, *, transcript: Transcript | None = None) -> None:
        declared = Declared.select(rig)
        interface: ProtocolInterface | OutputInterface
        if rig.answers_requests:
            session = LinkTerms(nonce_seed=0, attempts=ATTEMPTS).session(_refuse_call, transcript, tape)
            interface = ProtocolInterface(session, declared.sensor_names, self.is_noise_free, tape=tape)
            tape.ask("board.check", {}, NoneType, _refuse_call)
        else:
            port = tape.port(_refuse_call)
            polled: tuple[str, ...] = tape.ask(POLLED, {}, tuple[str, ...], _refuse_call)
            decoders = open_interfaces(rig, {kind: partial(_read_on_tape, tape, kind) for kind in polled})
            interface = OutputInterface(port, rig, decoders, transcript=transcript, may_be_overheard=False)
        super().__init__(interface, description="", declared=declared)
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
        clock_hz: int = self._facts.get("core_clock_hz", 0)
        return super().core_clock_hz or clock_hz

    @property
    def cycle_model(self) -> str:
        """Cycle model of the recorded board."""
        model: str = self._facts["cycle_model"]
        return model

    @property
    def executes_firmware(self) -> bool:
        """True if the recorded board saw every instruction."""
        executed: bool = self._facts.get("executes_firmware", False)
        return executed


def _read_on_tape(tape: Tape, kind: str, _rig: Rig) -> TapedReadings:
    return TapedReadings(tape, kind, None)


def _refuse_call() -> NoReturn:
    raise AssertionError("a recording answers without asking")
