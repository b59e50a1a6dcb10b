"""The operator's page: the questions of the terminal in a browser, and the board as its sensors show it."""

from __future__ import annotations

import hmac
import json
import socket
import threading
import time
from _thread import interrupt_main
from collections import deque
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
from numpy.typing import NDArray

from hiltest.boards.served_lines import MOST_WAITING, TOKEN_S, listen, place_in_url, token_of
from hiltest.orientation.angles import Pose, rotation_rows
from hiltest.procedures.coverage import directions_of, hole_in_words, largest_uncovered_cap
from hiltest.procedures.questions import Glance, Question, attitude_by
from hiltest.procedures.turntables import ShowPoints
from hiltest.report.page import badge_of, render
from hiltest.rig import Rig
from hiltest.run_record.files import REPORT_FILE
from hiltest.run_record.run import Verdict

_LONGEST_ANSWER = 200
_STOP = "quit"
# Longest wait for browsers to show the verdict, at the end; one asks for news four times a second [s].
_NEWS_S = 2.0
_LOOPBACK = ("127.0.0.1", "localhost", "::1")


class BenchPage:
    """A page of one run on a port; any number of browsers can show it, and the first answer counts.

    Parameters
    ----------
    host
        Address to listen on; unless it is a loopback address, the URL contains a secret.

    Attributes
    ----------
    url : str
    report : bytes
        Page of the report, which a browser keeps when this server has ended; empty before the end.
    report_sent : threading.Event

    Raises
    ------
    ConfigError
        When the address cannot be listened on.
    """

    def __init__(self, host: str) -> None:
        listener = listen(host, 0)
        self._token = token_of(listener)
        path = f"{self._token}/" if self._token else ""
        self.url = f"http://{place_in_url(host, listener.getsockname()[1])}/{path}"
        self._lock = threading.Lock()
        self._state: dict[str, Any] = {"question": 0, "asks": False}
        self._answer: str | None = None
        self._wishes: tuple[str, ...] = ()
        self._asked_for_news_s = -_NEWS_S
        self._is_stopped = False
        self.report, self.report_sent = b"", threading.Event()
        self._server = _Server(listener, self)
        threading.Thread(target=self._server.serve_forever, args=(0.05,), daemon=True).start()

    def ask(self, text: str) -> None:
        """Show a question; an answer that came before does not count."""
        question = text if isinstance(text, Question) else Question(text)
        self._wishes, lines = tuple(question.wishes), text.strip().splitlines()
        with self._lock:
            self._answer = None
            self._state = {
                **{name: value for name, value in self._state.items() if name == "sphere"},
                "question": self._state["question"] + 1,
                "asks": True,
                "lines": [line.strip().removesuffix(":") for line in lines],
                "wishes": [wish for wish in self._wishes if wish != _STOP],
                "takes_heading": question.takes_heading,
                "ghost": _rows(question.pose),
                "asked_deg": question.asked_deg,
                "live": "" if question.live else "no live view of the board during this question",
            }

    def look(self, seen: object) -> None:
        """Show a text beside the question, and draw it if it is a glance."""
        self._update(live=str(seen))
        if isinstance(seen, Glance):
            self._update(
                board=_rows(seen.attitude),
                moves=seen.moves,
                noise=seen.noise,
                turned_deg=seen.turned_deg,
                is_wrong_turn=seen.is_wrong_turn,
            )

    def answer(self) -> str | None:
        """Return the answer to the question; None if there is none yet.

        Raises
        ------
        KeyboardInterrupt
            When the operator stops at a question that has no such answer.
        """
        with self._lock:
            answer = self._answer
        if answer == _STOP and _STOP not in self._wishes:
            raise KeyboardInterrupt("the operator stops at the page")
        return answer

    def answered(self) -> None:
        """Show that the question is answered, at the page or the terminal."""
        self._update(asks=False, progress="")

    def progress(self, text: str) -> None:
        """Show the progress of long work."""
        self._update(progress=text.strip())

    def show_points(self, rig: Rig) -> ShowPoints:
        """Return a function that shows a tumble: the sphere with its hole, and the tilt of the board."""

        def show(points: NDArray[np.int16], accelerometer: NDArray[np.int16]) -> None:
            directions = directions_of(points, field_ut=rig.field.strength_ut)
            radius_deg, hole = largest_uncovered_cap(points, field_ut=rig.field.strength_ut)
            self._update(
                board=_rows(attitude_by(accelerometer[-1].tolist(), None)),
                moves=True,
                sphere={
                    "points": [] if directions is None else directions.round(3).tolist(),
                    "hole": None if hole is None else hole.round(3).tolist(),
                    "radius_deg": radius_deg,
                    "words": hole_in_words(points, field_ut=rig.field.strength_ut, dip_deg=rig.field.dip_deg),
                },
            )

        return show

    def end(self, verdict: Verdict, report: Path) -> None:
        """Show the verdict with a link to the report, and wait shortly until a browser that is there has both."""
        self.report = report.read_bytes()
        ended = {"outcome": verdict.outcome, "sentence": verdict.sentence, "tone": badge_of(verdict.outcome).tone}
        self._update(asks=False, progress="", ended=ended)
        if time.monotonic() - self._asked_for_news_s < _NEWS_S:
            self.report_sent.wait(_NEWS_S)

    def close(self) -> None:
        """Stop serving."""
        self._server.shutdown()
        self._server.server_close()

    def news(self) -> bytes:
        """Return the state of the run as JSON, for a browser."""
        with self._lock:
            self._asked_for_news_s = time.monotonic()
            return json.dumps(self._state).encode()

    def take_answer(self, question: object, answer: object) -> bool:
        """Accept the first answer to the question that is shown; return whether it was that.

        An operator may stop at any time: between two questions the run is interrupted, as by Ctrl-C.
        """
        with self._lock:
            is_ours = self._state["asks"] and question == self._state["question"] and isinstance(answer, str)
            if is_ours and self._answer is None:
                self._answer = str(answer)
            stops = answer == _STOP and not self._is_stopped and "ended" not in self._state
            self._is_stopped |= stops
            interrupts = stops and self._answer != _STOP
        if interrupts:
            interrupt_main()
        return bool(is_ours or stops)

    def path_of(self, headers: Any, path: str) -> str | None:
        """Return the part of a path behind the secret; None if a caller may not come in.

        Where there is no secret, pages of other sites must not reach the port through the browser that shows them.
        """
        _, token, rest = path.split("/", 2) if self._token and path.count("/") > 1 else ("", "", path.lstrip("/"))
        host, origin = headers.get("Host", ""), headers.get("Origin")
        is_local = bool(self._token) or urlsplit(f"//{host}").hostname in _LOOPBACK
        is_known = hmac.compare_digest(token.encode(), self._token.encode())
        return rest if is_known and is_local and origin in (None, f"http://{host}") else None

    def _update(self, **news: Any) -> None:
        with self._lock:
            self._state.update(news)


class _Server(ThreadingHTTPServer):
    """Server with few callers at a time: one more disconnects the one that has waited longest."""

    daemon_threads = True

    def __init__(self, listener: socket.socket, page: BenchPage) -> None:
        super().__init__(listener.getsockname()[:2], _Handler, bind_and_activate=False)
        self.socket.close()
        self.socket, self.page = listener, page
        self._callers: deque[socket.socket] = deque()

    def process_request(self, request: Any, client_address: Any) -> None:
        self._callers.append(request)
        while len(self._callers) > MOST_WAITING:
            self.shutdown_request(self._callers.popleft())
        super().process_request(request, client_address)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore callers that leave, or were disconnected."""


class _Handler(BaseHTTPRequestHandler):
    timeout = TOKEN_S
    server: _Server

    def do_GET(self) -> None:
        page, path = self.server.page, self.server.page.path_of(self.headers, self.path)
        if path == "":
            self._send(render("bench.html.j2", package="hiltest.session").encode(), "text/html; charset=utf-8")
        elif path == "bench.js":
            self._send((files("hiltest.session") / path).read_bytes(), "text/javascript; charset=utf-8")
        elif path == "state":
            self._send(page.news(), "application/json")
        elif path == REPORT_FILE and page.report:
            self._send(page.report, "text/html; charset=utf-8")
            page.report_sent.set()
        else:
            self.send_error(HTTPStatus.FORBIDDEN if path is None else HTTPStatus.NOT_FOUND)

    def do_POST(self) -> None:
        page, length = self.server.page, self.headers.get("Content-Length", "")
        if page.path_of(self.headers, self.path) != "answer" or not length.isdecimal() or int(length) > _LONGEST_ANSWER:
            self.send_error(HTTPStatus.FORBIDDEN)
            return
        try:
            sent = json.loads(self.rfile.read(int(length)))
            is_taken = page.take_answer(sent["question"], sent["answer"])
        except (ValueError, TypeError, LookupError):
            self.send_error(HTTPStatus.BAD_REQUEST)
            return
        self._send(json.dumps({"taken": is_taken}).encode(), "application/json")

    def log_message(self, format: str, *arguments: Any) -> None:
        """Print nothing: the terminal belongs to the run."""

    def _send(self, body: bytes, kind: str) -> None:
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Cache-Control", "no-store")
        self.send_header("X-Content-Type-Options", "nosniff")
        self.end_headers()
        self.wfile.write(body)


def _rows(attitude: Pose | None) -> list[list[float]] | None:
    return None if attitude is None else [[round(cell, 4) for cell in row] for row in rotation_rows(attitude)]
