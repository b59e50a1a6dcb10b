"""Virtual boards, and one at the far end of a pseudo-terminal, where only bytes pass."""

from __future__ import annotations

import os
import select
import threading
import tty
from collections.abc import Callable, Iterator
from dataclasses import replace

import pytest

from hiltest.angles import Pose
from hiltest.bench_files import shipped
from hiltest.boards import VirtualBench
from hiltest.rig import Rig
from hiltest.rig_file import load_rig


@pytest.fixture(scope="session")
def rig() -> Rig:
    return load_rig(shipped() / "rigs" / "virtual-k64f.toml")


@pytest.fixture(scope="session")
def rig_without_shield(rig: Rig) -> Rig:
    assert rig.world is not None
    return replace(rig, world=replace(rig.world, fitted=("onboard-fxos8700cq",)))


@pytest.fixture(scope="session")
def real_rig() -> Rig:
    return load_rig(shipped() / "rigs" / "frdm-k64f.toml")


class PtyBoard:
    """A virtual board that runs by itself, and a pseudo-terminal as its only wire.

    It does not keep wall time: it runs as fast as it can, which a board with shorter
    waits would too.
    """

    def __init__(self, bench: VirtualBench) -> None:
        self._bench = bench
        self._turn = threading.Lock()
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        self.path = os.ttyname(self._slave)
        self._running = True
        self._thread = threading.Thread(target=self._serve)

    def __enter__(self) -> PtyBoard:
        self._bench.power_on()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._running = False
        self._thread.join(timeout=30.0)
        os.close(self._slave)
        os.close(self._master)

    def turn_to(self, pose: Pose) -> None:
        """Do what an operator does: turn the table while the board runs."""
        with self._turn:
            self._bench.turn_to(pose)

    def tumble(self, duration_s: float) -> None:
        """Begin to tumble the board."""
        with self._turn:
            self._bench.tumble(duration_s)

    def _serve(self) -> None:
        machine = self._bench.machine
        while self._running:
            heard, _, _ = select.select([self._master], [], [], 0.001)
            with self._turn:
                if heard:
                    machine.uart0.host_write(os.read(self._master, 4096))
                machine.run_until(machine.time_s + 0.005)
                waiting = machine.uart0.host_waiting
                answer = machine.uart0.host_read(waiting) if waiting else b""
            if answer:
                os.write(self._master, answer)


@pytest.fixture
def pty_board() -> Iterator[Callable[[Rig], PtyBoard]]:
    """Return a function that puts the virtual board of a rig behind a pseudo-terminal."""
    running: list[PtyBoard] = []

    def start(rig: Rig) -> PtyBoard:
        running.append(PtyBoard(VirtualBench(rig)).__enter__())
        return running[-1]

    yield start
    for board in running:
        board.__exit__()
