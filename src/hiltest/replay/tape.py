"""The seam between a run and its bench: everything that the run asks passes here, to be recorded or answered.

Bytes pass through the port that `Tape.port` returns. Whatever else a run asks of its bench, of the board's own
knowledge, of a table, of the operator, is a call of an interface, and passes through `Tape.ask`: an object that
implements an interface is wrapped, and each call on it is a question with an answer. So a method that an interface
gains is recorded without anyone's doing; what an interface does not have cannot be asked.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from hiltest.link.ports import SerialPort
from hiltest.replay.values import Member, member_of


class Tape(ABC):
    """Records the questions of a run and their answers, or answers them from such a recording."""

    @abstractmethod
    def port(self, opened: Callable[[], SerialPort]) -> SerialPort:
        """Return the port of the board; `opened` opens the one that is there."""

    @abstractmethod
    def ask(self, name: str, given: Mapping[str, Any], hint: Any, answer: Callable[[], Any]) -> Any:
        """Return the answer to a question.

        Parameters
        ----------
        name
            Of the question, such as ``stage.turn_to``.
        given
            Arguments, as JSON.
        hint
            Of the answer.
        answer
            Asks the bench.
        """

    @abstractmethod
    def begin_test(self, test: str) -> None:
        """Note that a test begins."""

    @abstractmethod
    def end(self) -> str:
        """Come to the end of the run; say what is wrong with that, empty where nothing is."""

    def method(self, name: str, member: Member, answer: Callable[..., Any]) -> Callable[..., Any]:
        """Return a method whose calls are questions."""

        def asked(*positional: Any, **named: Any) -> Any:
            return self.ask(name, member.given(positional, named), member.hint, partial(answer, *positional, **named))

        return asked


class Live(Tape):
    """Asks the bench, and keeps nothing."""

    def port(self, opened: Callable[[], SerialPort]) -> SerialPort:
        """Open the port."""
        return opened()

    def ask(self, name: str, given: Mapping[str, Any], hint: Any, answer: Callable[[], Any]) -> Any:
        """Ask the bench."""
        return answer()

    def begin_test(self, test: str) -> None:
        """Do nothing."""

    def end(self) -> str:
        """Do nothing."""
        return ""


LIVE = Live()


class Taped:
    """An object that implements an interface, each call on it a question.

    Parameters
    ----------
    name
        Of the object.
    target
        Answers where the bench is there; None in a replay.
    """

    def __init__(self, tape: Tape, name: str, interface: type, target: Any) -> None:
        self._tape, self._name, self._interface, self._target = tape, name, interface, target

    def __getattr__(self, name: str) -> Any:
        member, question = member_of(self._interface, name), f"{self._name}.{name}"
        if not member.is_method:
            return self._tape.ask(question, {}, member.hint, lambda: getattr(self._target, name))
        return self._tape.method(question, member, lambda *given, **named: getattr(self._target, name)(*given, **named))
