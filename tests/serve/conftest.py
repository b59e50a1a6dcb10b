"""The command ``hiltest serve`` as a process, and somebody else's firmware for it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from hiltest.link.messages import Average, Sensors
from hiltest.link.ports import open_port
from hiltest.link.session import Session

HERE = Path(__file__).parent
START = HERE.parent / "virtual" / "programs"
FLAGS = [
    "-mcpu=cortex-m4",
    "-mthumb",
    "-O1",
    "-g",
    "-nostdlib",
    "-ffreestanding",
    "-Wl,--build-id=none",
    f"-Wl,-T,{START / 'flash.ld'}",
]
WALL_LIMIT_S = 60.0  # for what takes a second


class Served:
    """A running ``hiltest serve``.

    Attributes
    ----------
    board, turntable : str
        What it printed: where a serial program finds them.
    gdb_port : int
        With ``--gdb``.
    """

    def __init__(self, *arguments: str, folder: Path) -> None:
        environment = {name: value for name, value in os.environ.items() if not name.startswith("HIL_")}
        self.process = subprocess.Popen(
            [sys.executable, "-m", "hiltest", "serve", *arguments],
            cwd=folder,
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        assert self.process.stdout is not None
        further = {"turntable": "--replay" not in arguments, "gdb": "--gdb" in arguments}
        names = ["board", *(name for name, is_there in further.items() if is_there)]
        printed = [self.process.stdout.readline().strip().partition(": ") for _ in names]
        assert [name for name, _, _ in printed] == names, self.process.communicate()[1]
        urls = {name: url for name, _, url in printed}
        self.board, self.turntable = urls["board"], urls.get("turntable", "")
        self.gdb_port = int(urls["gdb"].rpartition(":")[2]) if "gdb" in urls else 0

    def end(self, number: signal.Signals = signal.SIGINT) -> tuple[int, str]:
        """Send a signal; return exit code and what was said on stderr."""
        self.process.send_signal(number)
        return self.ended()

    def ended(self) -> tuple[int, str]:
        """Wait for the end; return exit code and what was said on stderr."""
        _, answer = self.process.communicate(timeout=WALL_LIMIT_S)
        return self.process.returncode, answer

    def kill(self) -> None:
        """Leave no process behind, whatever a test did."""
        self.process.kill()
        self.process.communicate(timeout=WALL_LIMIT_S)


Serve = Callable[..., Served]


@pytest.fixture
def serve(tmp_path: Path) -> Iterator[Serve]:
    """Return a function that starts ``hiltest serve`` with arguments, and comes back when it has printed its ports."""
    with ExitStack() as stack:

        def start(*arguments: str) -> Served:
            served = Served(*arguments, folder=tmp_path)
            stack.callback(served.kill)
            return served

        yield start


@pytest.fixture
def foreign(tmp_path: Path, require_tool: Callable[[str], str]) -> Path:
    """Build the ELF of somebody else's firmware."""
    elf = tmp_path / "upper_case.elf"
    sources = [START / "start.S", HERE / "programs" / "upper_case.c"]
    command = [require_tool("arm-none-eabi-gcc"), *FLAGS, *map(str, sources), "-o", str(elf)]
    subprocess.run(command, check=True, timeout=WALL_LIMIT_S)
    return elf


def converse(url: str) -> None:
    """Do what a hiltest session begins with, and take a measurement; everything is answered at once."""
    session = Session(open_port(url))
    try:
        session.synchronise()
        assert session.identify().name == "hiltest-frdm-k64f"
        assert sum(sensor.present for sensor in session.request(Sensors())) == 6
        down = session.request(Average(16)).accelerometer.mean[2]
        assert abs(down - 8192) < 100  # 1 g, level; 12 mg for offset, gain and noise
    finally:
        session.close()
