"""A place of labgrid is a board: with its own coordinator and exporter, from PyPI, on this machine."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread

import pytest

from hiltest.boards.labgrid import place_of
from hiltest.errors import BenchError, ConfigError, PortRefusedError
from hiltest.link.ports import open_port

from .conftest import Serve, converse
from .test_clients import free_port

WALL_LIMIT_S = 120.0
LABGRID = "labgrid>=24"


def test_a_url_names_a_place_and_what_to_do_with_it() -> None:
    place = place_of("labgrid://lab/bench-3?power=cycle&ign_set_control")
    assert (place.name, place.power_cycle, place.options) == ("lab/bench-3", True, "ign_set_control")
    for wrong in ("labgrid://", "labgrid://-p", "labgrid://bench?power=off", "labgrid://%1b[2J"):
        with pytest.raises(ConfigError):
            place_of(wrong)


def test_without_labgrid_it_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(sys, "executable", str(tmp_path / "python"))
    with pytest.raises(ConfigError, match=r"hiltest\[labgrid\]"):
        open_port("labgrid://bench")


@dataclass(frozen=True)
class Lab:
    """A coordinator with one place, `bench`, on the exporter's serial port and a power switch."""

    programs: Path
    switched: list[str]

    def client(self, *command: str, user: str = "") -> str:
        environment = {**os.environ, **({"LG_USERNAME": user} if user else {})}
        done = subprocess.run(
            [self.programs / "labgrid-client", "-p", "bench", *command],
            env=environment,
            capture_output=True,
            text=True,
            timeout=WALL_LIMIT_S,
            check=True,
        )
        return done.stdout


@pytest.fixture(scope="module")
def programs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """labgrid in an environment of its own: it brings a pyserial of its own, which would take the place of ours."""
    folder = tmp_path_factory.mktemp("labgrid")
    for command in ([sys.executable, "-m", "venv", folder], [folder / "bin" / "pip", "install", "--quiet", LABGRID]):
        subprocess.run(command, check=True, timeout=600.0)
    return folder / "bin"


@pytest.fixture
def switched() -> Iterator[tuple[str, list[str]]]:
    """A power switch with a web page, and what it was told."""
    messages: list[str] = []

    class Switch(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            messages.append(self.path)
            self.send_response(200)
            self.end_headers()

        def log_message(self, *_of_request: object) -> None:
            """Be quiet."""

    server = ThreadingHTTPServer(("127.0.0.1", 0), Switch)
    Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}", messages
    server.shutdown()
    server.server_close()


@pytest.fixture
def lab(
    serve: Serve,
    programs: Path,
    switched: tuple[str, list[str]],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    require_tool: Callable[[str], str],
) -> Iterator[Lab]:
    require_tool("ser2net")  # the exporter starts it
    served, (switch, answer) = serve(), switched
    address = f"127.0.0.1:{free_port()}"
    monkeypatch.setenv("LG_COORDINATOR", address)
    monkeypatch.setenv("PATH", f"{programs}{os.pathsep}{os.environ['PATH']}")
    (tmp_path / "exporter.yaml").write_text(
        f"board:\n  RawSerialPort:\n    port: {served.board}\n    speed: 115200\n"
        f"  NetworkPowerPort:\n    model: simplerest\n    host: '{switch}/{{index}}/{{value}}'\n    index: 1\n",
        encoding="utf-8",
    )
    coordinator = subprocess.Popen([programs / "labgrid-coordinator", "-l", address], cwd=tmp_path)
    exporter = subprocess.Popen(
        [programs / "labgrid-exporter", "-c", address, "-n", "lab", "--hostname", "127.0.0.1", "exporter.yaml"],
        cwd=tmp_path,
    )
    result = Lab(programs, answer)
    try:
        ends_s = time.monotonic() + WALL_LIMIT_S
        while "lab/board" not in (said := resources(programs)):
            assert time.monotonic() < ends_s, said
            time.sleep(0.2)
        result.client("create")
        result.client("add-match", "lab/board/*")
        yield result
    finally:
        for process in (exporter, coordinator):
            process.terminate()
            process.wait(WALL_LIMIT_S)


def resources(programs: Path) -> str:
    done = subprocess.run(
        [programs / "labgrid-client", "resources"], capture_output=True, text=True, timeout=WALL_LIMIT_S, check=False
    )
    return done.stdout


# A pseudo-terminal has no modem lines, so nobody acknowledges that they were set.
URL = "labgrid://bench?ign_set_control"


@pytest.mark.ci
@pytest.mark.filterwarnings("ignore:set(Daemon|Name):DeprecationWarning")  # pyserial's, of its RFC 2217 client
def test_a_place_is_acquired_used_and_released(lab: Lab) -> None:
    converse(URL)
    assert "acquired: None" in lab.client("show"), "it is released"
    assert lab.switched == []
    converse(f"{URL}&power=cycle")
    assert lab.switched == ["/1/0", "/1/1"]
    lab.client("acquire")
    converse(URL)
    assert "acquired: None" not in lab.client("show"), "who had it keeps it"
    lab.client("release")
    lab.client("acquire", user="somebody")
    with pytest.raises(PortRefusedError, match="somebody"):
        open_port(URL)
    lab.client("release", user="somebody")
    with pytest.raises(BenchError, match="nowhere"):
        open_port("labgrid://nowhere")
    assert "acquired: None" in lab.client("show")
