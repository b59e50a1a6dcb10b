"""The interface between a run and its bench, at which all questions are recorded or answered.

Bytes pass through the port that `Tape.port` returns. All other questions, to the board, a table or the operator, are
calls of an interface, and pass through `Tape.ask`: an object that implements an interface is wrapped, and each call on
it is a question with an answer. So new methods of an interface are recorded automatically, and a run cannot ask outside
the interface.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from hiltest.link.ports import SerialPort
from hiltest.tape.values import Member, member_of


class Tape(ABC):
    """Recorder of the questions of a run and their answers, or player of such a recording."""

    @abstractmethod
    def port(self, opened: Callable[[], SerialPort]) -> SerialPort:
        """Return the port of the board; `opened` opens the real one."""

    @abstractmethod
    def ask(self, name: str, arguments: Mapping[str, Any], hint: Any, answer: Callable[[], Any]) -> Any:
        """Return the answer to a question.

        Parameters
        ----------
        name
            Name of the question, such as ``stage.turn_to``.
        arguments
            Arguments, as JSON.
        hint
            Type of the answer.
        answer
            Asks the bench.
        """

    def ask_if_recorded(self, name: str, arguments: Mapping[str, Any], hint: Any, answer: Callable[[], Any]) -> Any:
        """Ask a question that recordings of earlier versions lack; the answer from such a recording is None."""
        return self.ask(name, arguments, hint, answer)

    def check(self, name: str, check: Callable[[], None]) -> None:
        """Perform a check, which raises a HiltestError or does nothing; only an error is recorded."""
        check()

    @abstractmethod
    def begin_test(self, test: str) -> None:
        """Mark the start of a test."""

    def flush(self) -> None:  # noqa: B027 - other tapes have nothing to write
        """Write a recording to the disk."""

    @abstractmethod
    def end(self) -> str:
        """End the run; return an error message, empty without an error."""

    def method(
        self, name: str, member: Member, answer: Callable[..., Any], *, may_be_absent: bool = False
    ) -> Callable[..., Any]:
        """Return a method whose calls are questions; recordings of earlier versions may lack them."""
        ask = self.ask_if_recorded if may_be_absent else self.ask

        def asked(*positional: Any, **named: Any) -> Any:
            return ask(name, member.given(positional, named), member.hint, partial(answer, *positional, **named))

        return asked


class Live(Tape):
    """Tape that asks the bench, and records nothing."""

    def port(self, opened: Callable[[], SerialPort]) -> SerialPort:
        """Open the port."""
        return opened()

    def ask(self, name: str, arguments: Mapping[str, Any], hint: Any, answer: Callable[[], Any]) -> Any:
        """Ask the bench."""
        return answer()

    def begin_test(self, test: str) -> None:
        """Do nothing."""

    def end(self) -> str:
        """Do nothing."""
        return ""


LIVE = Live()


class Taped:
    """Wrapper of an object that implements an interface; each call on it is a question.

    Parameters
    ----------
    name
        Name of the object.
    target
        Object that answers; None in a replay.
    """

    def __init__(self, tape: Tape, name: str, interface: type, target: Any) -> None:
        self._tape, self._name, self._interface, self._target = tape, name, interface, target

    def __getattr__(self, name: str) -> Any:
        member, question = member_of(self._interface, name), f"{self._name}.{name}"
        if not member.is_method:
            return self._tape.ask(question, {}, member.hint, lambda: getattr(self._target, name))
        return self._tape.method(
            question, member, lambda *positional, **named: getattr(self._target, name)(*positional, **named)
        )
