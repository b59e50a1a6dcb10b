"""The operator's page as a server: who may come in, which answer counts, and what a flood of callers does."""

from __future__ import annotations

import json
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from http.client import HTTPConnection
from pathlib import Path
from threading import Thread
from urllib.parse import urlsplit

import numpy as np
import pytest

from hiltest.boards.served_lines import TOKEN_S
from hiltest.calibration.quality import sphere_directions
from hiltest.errors import ConfigError
from hiltest.procedures.questions import Glance, Question
from hiltest.rig.bench_files import DEFAULT_RIG, shipped
from hiltest.rig.rig_file import load_rig
from hiltest.run_record.run import Verdict
from hiltest.session.bench_page import BenchPage

ALL_ADDRESSES = "0.0.0.0"
STAYS_S = 20.0


@pytest.fixture
def serve() -> Iterator[Callable[..., BenchPage]]:
    with ExitStack() as stack:

        def start(host: str = "127.0.0.1") -> BenchPage:
            page = BenchPage(host)
            stack.callback(page.close)
            return page

        yield start


def ask(page: BenchPage, path: str, body: object = None, **headers: str) -> tuple[int, bytes]:
    """Send a request below the page's URL, a POST if there is a body; return its status and what came."""
    url = urlsplit(page.url)
    connection = HTTPConnection("127.0.0.1", url.port or 0, timeout=STAYS_S)
    sent = None if body is None else json.dumps(body)
    connection.request("GET" if body is None else "POST", url.path + path, sent, headers)
    response = connection.getresponse()
    return response.status, response.read()


def test_the_page_has_all_that_it_needs_and_nothing_from_elsewhere(serve: Callable[..., BenchPage]) -> None:
    page = serve()
    status, html = ask(page, "")
    assert status == 200
    assert b'<script src="bench.js" defer>' in html
    assert b"default-src 'none'" in html
    assert ask(page, "bench.js")[0] == 200
    assert ask(page, "other")[0] == 404
    assert urlsplit(page.url).path == "/"


def test_the_first_answer_to_the_present_question_counts_and_no_other(serve: Callable[..., BenchPage]) -> None:
    page = serve()
    assert ask(page, "answer", {"question": 0, "answer": ""}) == (200, b'{"taken": false}')  # nothing is asked
    page.ask("put it down: ")
    assert page.answer() is None
    assert ask(page, "answer", {"question": 0, "answer": ""}) == (200, b'{"taken": false}')
    assert ask(page, "answer", {"question": 1, "answer": "12"}) == (200, b'{"taken": true}')
    ask(page, "answer", {"question": 1, "answer": "13"})
    assert page.answer() == "12"
    page.answered()
    page.ask("again: ")
    assert ask(page, "answer", {"question": 1, "answer": ""}) == (200, b'{"taken": false}')
    assert page.answer() is None
    for body in ({}, [], {"question": 2}, "x"):
        assert ask(page, "answer", body)[0] == 400
    assert ask(page, "answer", {"question": 2, "answer": "x" * 300})[0] == 403
    ask(page, "answer", {"question": 2, "answer": "quit"})
    with pytest.raises(KeyboardInterrupt, match="the operator stops at the page"):
        page.answer()


def test_the_operator_stops_while_the_board_is_measured_and_only_once(serve: Callable[..., BenchPage]) -> None:
    page, stop = serve(), {"question": 1, "answer": "quit"}
    page.ask("turn it all round: ")
    page.answered()
    assert ask(page, "answer", {"question": 1, "answer": ""}) == (200, b'{"taken": false}')

    # In a thread of its own, because the interrupt would cut a request of the main thread.
    answers: list[tuple[int, bytes]] = []
    stopping = Thread(target=lambda: answers.append(ask(page, "answer", stop)))

    def stop_and_wait() -> None:
        began_s = time.monotonic()
        stopping.start()
        while time.monotonic() < began_s + STAYS_S:  # an interrupt by a thread does not cut a sleep
            time.sleep(0.01)

    with pytest.raises(KeyboardInterrupt):
        stop_and_wait()
    stopping.join(STAYS_S)
    assert answers == [(200, b'{"taken": true}')]
    assert ask(page, "answer", stop) == (200, b'{"taken": false}')


def test_at_the_end_a_browser_gets_the_verdict_and_the_report_before_the_page_ends(
    serve: Callable[..., BenchPage], tmp_path: Path
) -> None:
    page, report = serve(), tmp_path / "report.html"
    report.write_text("all numbers", encoding="utf-8")
    assert ask(page, "report.html")[0] == 404
    assert ask(page, "state")[0] == 200
    began_s = time.monotonic()
    ending = Thread(target=page.end, args=(Verdict("not evaluated", 22, "NOT EVALUATED. Why.", complete=True), report))
    ending.start()
    while "ended" not in (state := json.loads(ask(page, "state")[1])):
        assert time.monotonic() < began_s + STAYS_S
    assert (state["ended"]["tone"], state["ended"]["sentence"]) == ("warn", "NOT EVALUATED. Why.")
    assert ending.is_alive()
    assert ask(page, "report.html") == (200, b"all numbers")
    ending.join(STAYS_S)
    assert not ending.is_alive()


def test_the_state_is_the_question_its_live_text_and_the_sphere_with_its_hole(serve: Callable[..., BenchPage]) -> None:
    page, rig = serve(), load_rig(shipped() / "rigs" / DEFAULT_RIG)
    directions = sphere_directions(200)
    points = np.round(10.0 * rig.field.strength_ut * directions[directions[:, 2] < 0.5]).astype(np.int16)
    page.show_points(rig)(points, np.array([[8192, 0, 0], [0, 0, 8192]], np.int16))
    assert json.loads(ask(page, "state")[1])["board"] == np.eye(3).tolist()
    page.ask(Question("you did not turn.\npose 2: turn.\n  Enter or q: ", wishes=["skip", "quit"], takes_heading=True))
    page.look(Glance(1.0, False, None, "0.4 uT", turned_deg=-2.0, is_wrong_turn=True, progress="1 of 4"))
    state = json.loads(ask(page, "state")[1])
    assert state["lines"] == ["you did not turn.", "pose 2: turn.", "Enter or q"]
    assert (state["wishes"], state["takes_heading"]) == (["skip"], True)
    assert (state["live"], state["turned_deg"], state["noise"]) == (
        "board 1.0 deg, turned -2, still; 1 of 4",
        -2.0,
        "0.4 uT",
    )
    assert state["is_wrong_turn"] is True
    sphere = state["sphere"]
    assert np.array(sphere["points"]) == pytest.approx(directions[directions[:, 2] < 0.5], abs=0.01)
    assert np.array(sphere["hole"]) == pytest.approx([0.0, 0.0, 1.0], abs=0.1)
    assert sphere["radius_deg"] == pytest.approx(60.0, abs=5.0)
    assert sphere["words"].endswith("is left where its underside points down")


def test_beyond_this_machine_callers_need_the_secret_of_the_url(serve: Callable[..., BenchPage]) -> None:
    page = serve(ALL_ADDRESSES)
    token = urlsplit(page.url).path.strip("/")
    assert len(token) == 32
    page.ask("turn it: ")
    assert ask(page, "state")[0] == 200
    for path in ("/", "/state", "/answer", f"/{token[:-1]}x/state", f"/{token}", "/x/state"):
        connection = HTTPConnection("127.0.0.1", urlsplit(page.url).port or 0, timeout=STAYS_S)
        connection.request("GET", path)
        assert connection.getresponse().status == 403, path


def test_pages_of_other_sites_reach_nothing_through_the_browser_of_this_machine(
    serve: Callable[..., BenchPage],
) -> None:
    page = serve()
    page.ask("turn it: ")
    answer = {"question": 1, "answer": "q"}
    place = urlsplit(page.url).netloc
    assert ask(page, "state", Host="evil.example")[0] == 403
    assert ask(page, "answer", answer, Host="evil.example")[0] == 403
    assert ask(page, "answer", answer, Origin="http://evil.example")[0] == 403
    assert page.answer() is None
    assert ask(page, "answer", answer, Origin=f"http://{place}")[0] == 200
    assert ask(page, "state", Host="localhost:9")[0] == 200  # a port that is forwarded to this one


def test_silent_callers_hold_up_nobody(serve: Callable[..., BenchPage]) -> None:
    page = serve()
    port, began_s = urlsplit(page.url).port or 0, time.monotonic()
    with ExitStack() as stack:
        silent = [stack.enter_context(socket.create_connection(("127.0.0.1", port))) for _ in range(40)]
        assert ask(page, "state")[0] == 200
        silent[0].settimeout(max(0.1, TOKEN_S / 2.0 - (time.monotonic() - began_s)))
        assert silent[0].recv(1) == b""  # the one that waited longest was disconnected long before its time was over


def test_an_address_that_this_machine_lacks_is_refused() -> None:
    with pytest.raises(ConfigError, match="Check that this machine has the address"):
        BenchPage("192.0.2.1")
