"""Turntable of a rig, of any kind."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from hiltest.boards.board import Board
from hiltest.errors import OperatorAbsentError
from hiltest.procedures.grbl_turntable import open_grbl_turntable
from hiltest.procedures.requested_headings import RequestReader
from hiltest.procedures.turntables import OperatorTurntable, SimulatedTurntable, Turntable
from hiltest.rig import Rig
from hiltest.tape.tape import LIVE, Tape


def open_table(
    board: Board,
    rig: Rig,
    *,
    prompt: Callable[[str], str] | None = None,
    tape: Tape = LIVE,
    **shown: Any,
) -> Turntable:
    """Return the turntable: motors, the simulated table of a virtual board, or an operator.

    Parameters
    ----------
    prompt
        Shows a text to the operator and returns the line that was typed, as `input` does.
    tape
        Records the questions to motors and operator, or answers them from a recording.
    shown
        Further arguments of `OperatorTurntable`.

    Raises
    ------
    OperatorAbsentError
        When the board needs an operator and nobody can be asked.
    BenchError
        When the motors do not answer.
    ConfigError
        When the rig plays a recording instead of simulating a world.
    """
    rig.refuse_playback("a turntable")
    uncertainty_deg = rig.turntable.uncertainty_deg
    if rig.turntable.kind == "grbl":
        motors: Turntable = tape.ask("turntable", {}, Turntable, lambda: open_grbl_turntable(rig))
        return motors
    if board.stage is not None:
        return SimulatedTurntable(board.stage, uncertainty_deg=uncertainty_deg)
    if prompt is None:
        raise OperatorAbsentError("a real board needs an operator to turn it, and there is no one to ask")

    def ask(text: str) -> str:
        answer: str = tape.ask("operator", {"text": text}, str, lambda: prompt(text))
        return answer

    reader = RequestReader(board, {}, 1, 0.0) if board.answers_requests else None
    return OperatorTurntable(
        prompt=ask,
        uncertainty_deg=uncertainty_deg,
        tumble_s=rig.turntable.tumble_s,
        shows_coverage=board.answers_requests,
        look=reader.glance if reader and tape is LIVE else None,
        may_look=tape is LIVE,
        **shown,
    )
