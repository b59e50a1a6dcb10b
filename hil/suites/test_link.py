"""Link: payloads arrive whole, damaged frames are dropped and counted, and no request is executed twice."""

from __future__ import annotations

import pytest

from hiltest.boards import Board
from hiltest.boards.board import NO_REQUEST_COST
from hiltest.link.messages import LinkStatistics
from hiltest.measurement import Limit
from hiltest.procedures import check_link
from hiltest.session.fixtures import Measure

pytestmark = pytest.mark.hil

# Time from a request's last byte to the reply's first: of six bytes on the line.
REPLY_TIME = Limit(max=500.0)


def test_the_link_keeps_its_word(board: Board, measure: Measure) -> None:
    check = check_link(board)
    uncounted = check.damaged_sent - check.damaged_counted
    # A payload that is wrong ten times in a row is the firmware's fault. Repeated payloads and overruns of the UART are
    # not evaluated if the line itself damages frames.
    measure("link.echoed", check.echoed, "", limit=Limit(min=check.expected), not_checked=check.noise)
    measure("link.damaged_uncounted", uncounted, "", limit=Limit(min=0, max=0))
    measure("link.damaged_answered", check.damaged_answered, "", limit=Limit(max=0))
    measure("link.uart_overruns", check.uart_overruns, "", limit=Limit(max=0), not_checked=check.noise)
    assert not check.wrong, f"{check.wrong} payloads came to the board whole and were answered wrong"
    assert check.repeated_answered, "a repeated request got another answer"
    assert check.executed_once, "a repeated request was carried out twice"


def test_the_board_answers_soon(board: Board, measure: Measure) -> None:
    board.session.request(LinkStatistics())
    cost = board.request_cost()
    measure(
        "link.reply_time",
        cost.latency_us if cost else None,
        "us",
        limit=REPLY_TIME if cost else None,
        not_offered="" if cost else NO_REQUEST_COST,
    )


def test_no_request_needed_a_second_attempt(board: Board, measure: Measure) -> None:
    # A cable may lose a frame, and the repeated request gets a right answer; a virtual line loses none.
    limit = Limit(max=0) if board.line_is_exact else None
    measure("link.retried", board.session.retried, "", limit=limit)
