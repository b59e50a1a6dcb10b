"""A question at a terminal: what is beside it is kept up to date until the line is typed."""

from __future__ import annotations

import io
import json
import os
import select
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import count

import pytest

from hiltest.errors import OperatorAbsentError
from hiltest.procedures.questions import Question
from hiltest.session.bench_page import BenchPage
from hiltest.session.operator_prompt import ask

END_OF_FILE = b"\x04"


@contextmanager
def at_a_terminal() -> Iterator[int]:
    """Make a terminal standard input and output; give the operator's end of it.

    No fixture: pytest puts its own in their place again once a test is set up.
    """
    ours, theirs = os.openpty()
    with (
        os.fdopen(theirs, "r", closefd=False) as typed,
        os.fdopen(theirs, "w") as shown,
        pytest.MonkeyPatch.context() as patch,
    ):
        patch.setattr(sys, "stdin", typed)
        patch.setattr(sys, "stdout", shown)
        yield ours
    os.close(ours)


def asked_with(keyboard: int, typed: bytes, *, looks: int) -> tuple[str, str]:
    """Ask, and type when so many looks were shown; return the answer and what the terminal shows."""
    numbers = count(1)

    def live() -> str:
        number = next(numbers)
        if number == looks:
            os.write(keyboard, typed)
        return f"look {number}"

    answer, shown = ask(Question("turn it.\n  Enter: ", live), is_turn=True), b""
    # The system moves what was written to a terminal a little later, and not all at once.
    while select.select([keyboard], [], [], 0.5)[0]:
        shown += os.read(keyboard, 4096)
    return answer, shown.decode()


def test_what_is_beside_a_question_is_drawn_behind_it_until_a_line_is_typed() -> None:
    with at_a_terminal() as keyboard:
        answer, shown = asked_with(keyboard, b"87.5\n", looks=2)
    assert answer == "87.5"
    assert shown.startswith("turn it.\r\n  Enter: \x1b7  look 1\x1b[K\x1b8")
    assert shown.count("look 2") == 1


def test_keys_that_are_pressed_before_a_question_do_not_answer_it() -> None:
    with at_a_terminal() as keyboard:
        assert asked_with(keyboard, b"s\n91\n\n", looks=1)[0] == "s"
        assert asked_with(keyboard, b"12\n", looks=2)[0] == "12"


def test_the_end_of_a_terminal_is_an_absent_operator() -> None:
    with at_a_terminal() as keyboard, pytest.raises(OperatorAbsentError, match=r"at the terminal: turn it\."):
        asked_with(keyboard, END_OF_FILE, looks=1)


def test_without_a_terminal_a_question_is_a_text_as_any_other(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO("12\n"))

    def live() -> str:
        raise AssertionError("the board is asked though nothing can be drawn")

    assert ask(Question("Enter: ", live), is_turn=True) == "12"
    assert capsys.readouterr().out == "Enter: "


def test_the_first_answer_counts_from_the_page_or_from_the_terminal() -> None:
    page = BenchPage("127.0.0.1")
    try:
        with at_a_terminal() as keyboard:
            at_the_page = Question("turn it.\n  Enter: ", lambda: f"look {page.take_answer(1, '12')}")
            assert ask(at_the_page, page) == "12"
            assert json.loads(page.news())["asks"] is False
            assert page.take_answer(1, "13") is False  # a second press comes too late for any question

            def typed() -> str:
                os.write(keyboard, b"14\n")
                return "still"

            assert ask(Question("and again.\n  Enter: ", typed), page) == "14"
        state = json.loads(page.news())
        assert (state["lines"][0], state["live"], state["asks"]) == ("and again.", "still", False)
        assert page.take_answer(2, "15") is False
    finally:
        page.close()
