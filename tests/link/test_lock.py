"""A board has one process at a time, any end of that process gives it back, and others are told who has it."""

from __future__ import annotations

import fcntl
import os
import signal
import subprocess
import sys
import tty
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from hiltest.errors import BenchError, PortRefusedError
from hiltest.link import lock
from hiltest.link.lock import BoardLock, Holder
from hiltest.link.ports import open_port, place_of

WAIT_S = 30.0  # for what takes a tenth of a second
OPENS = """
import sys
from hiltest.link.ports import open_port
port = open_port(sys.argv[1], rig="bench seven")
print("open", flush=True)
sys.stdin.read()
"""

Opened = Callable[[str], subprocess.Popen[str]]


@pytest.fixture
def device() -> Iterator[str]:
    """The device of a serial line."""
    far, near = os.openpty()
    tty.setraw(near)
    yield os.ttyname(near)
    os.close(far)
    os.close(near)


@pytest.fixture
def other() -> Iterator[Opened]:
    """Return a function that opens a port in another process."""
    with ExitStack() as stack:

        def start(url: str) -> subprocess.Popen[str]:
            process = subprocess.Popen(
                [sys.executable, "-c", OPENS, url], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
            )
            stack.callback(process.communicate)
            stack.callback(process.kill)
            assert process.stdout is not None
            assert process.stdout.readline() == "open\n"
            return process

        yield start


def ended(process: subprocess.Popen[str], number: signal.Signals) -> None:
    process.send_signal(number)
    process.wait(timeout=WAIT_S)


def test_the_second_process_is_told_who_has_the_board(device: str, other: Opened) -> None:
    process = other(device)
    with pytest.raises(PortRefusedError) as caught:
        open_port(device)
    assert isinstance(caught.value, BenchError)
    text = str(caught.value)
    assert f"cannot use {device}: process {process.pid} of " in text
    assert "rig bench seven" in text
    assert device in text.partition("(")[2], "its command"


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_any_end_of_a_process_gives_the_board_back(number: signal.Signals, device: str, other: Opened) -> None:
    ended(other(device), number)
    open_port(device).close()


def test_a_port_that_is_closed_gives_the_board_back_and_leaves_no_file(device: str, other: Opened) -> None:
    port = open_port(device)
    (file,) = [file for file in lock._HELD if Path(device).name in file.name]
    assert file.exists()
    port.close()
    assert not file.exists()
    other(device)


def test_a_port_that_nobody_has_any_more_gives_the_board_back(device: str, other: Opened) -> None:
    port = open_port(device)
    del port
    other(device)


def test_a_port_that_the_garbage_collector_closes_does_not_stop_who_locks_a_board(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(lock, "_folder", lambda: tmp_path)
    first, second = BoardLock("first"), BoardLock("second")
    this_process = Holder.this_process

    def collected(rig: str) -> Holder:
        first.release()  # as of a port in a cycle of references, whenever the collector runs
        return this_process(rig)

    monkeypatch.setattr(Holder, "this_process", collected)
    BoardLock("third").release()
    second.release()
    assert list(tmp_path.iterdir()) == []


def test_a_link_to_a_device_is_the_same_board(device: str, other: Opened, tmp_path: Path) -> None:
    link = tmp_path / "by-id"
    link.symlink_to(device)
    process = other(str(link))
    with pytest.raises(PortRefusedError, match=f"process {process.pid} "):
        open_port(device)


def test_a_board_stays_locked_while_its_device_is_closed(device: str, other: Opened) -> None:
    place = place_of(device)
    assert place == device
    with BoardLock(place):
        open_port(device).close()
        with pytest.raises(AssertionError):  # it could not open it
            other(device)
    other(device)


def test_a_device_is_known_by_its_serial_number(device: str, monkeypatch: pytest.MonkeyPatch) -> None:
    class Found:
        def __init__(self) -> None:
            self.device, self.serial_number = device, "0240000034554e45"

    monkeypatch.setattr("hiltest.link.ports._list_ports.comports", lambda: [Found()])
    assert place_of(device) == "0240000034554e45"


@pytest.mark.parametrize(
    ("url", "place"),
    [
        ("rfc2217://Lab-3:2217?timeout=3", "lab-3:2217"),
        ("socket://lab-3:2217", "lab-3:2217"),
        ("hil://", None),
        ("loop://", None),
        ("rfc2217://me:secret@lab-3:2217", "lab-3:2217"),
    ],
)
def test_a_port_elsewhere_is_its_host_and_number(url: str, place: str | None) -> None:
    assert place_of(url) == place


def test_another_lock_file_may_say_anything(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lock, "_folder", lambda: tmp_path)
    monkeypatch.setattr(lock, "_LOOKS", 1)
    file = tmp_path / "hiltest-board.lock"
    for text in (b"", b"\xff\xfe", b"[1]", b'{"pid": 1}', b"[" * 4000, b'{"pid":1e400,"user":1,"command":1,"since":1}'):
        file.write_bytes(text)
        with file.open() as held:
            fcntl.flock(held, fcntl.LOCK_EX)
            with pytest.raises(PortRefusedError, match="an unknown process"):
                BoardLock("board")
    with BoardLock("board"), file.open() as held, pytest.raises(BlockingIOError):
        fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)


def test_what_another_process_calls_itself_is_legible() -> None:
    parsed = Holder.parse(b'{"pid": 7, "user": "a", "command": "evil\\u001b[2J\\u202e", "since": "now", "rig": ""}')
    assert parsed is not None
    assert "\x1b" not in str(parsed)
    assert "\u202e" not in str(parsed)


def test_a_lock_that_cannot_be_made_names_its_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lock, "_folder", lambda: tmp_path / "missing")
    with pytest.raises(PortRefusedError, match="missing"):
        BoardLock("board")


def test_a_link_in_the_place_of_a_lock_is_not_followed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lock, "_folder", lambda: tmp_path)
    victim = tmp_path / "victim"
    victim.write_text("mine", encoding="utf-8")
    (tmp_path / "hiltest-board.lock").symlink_to(victim)
    with pytest.raises(PortRefusedError):
        BoardLock("board")
    assert victim.read_text(encoding="utf-8") == "mine"
