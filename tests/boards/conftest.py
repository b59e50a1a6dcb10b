"""Rigs, and a virtual board at the far end of a pseudo-terminal, where only bytes pass."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import replace

import pytest

from hiltest.bench_files import shipped
from hiltest.boards import VirtualBench
from hiltest.boards.lines import PseudoTerminal
from hiltest.boards.paced import PacedBench
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
    """A paced virtual board and its cable."""

    def __init__(self, rig: Rig) -> None:
        self._terminal = PseudoTerminal()
        stepped = VirtualBench(rig)
        self.machine = stepped.machine
        self.bench = PacedBench(stepped, self._terminal)
        self.path = self._terminal.path
        self.bench.start()

    def unplug(self) -> None:
        """Pull the cable."""
        self.bench.stop()
        self._terminal.unplug()


@pytest.fixture
def pty_board() -> Iterator[Callable[[Rig], PtyBoard]]:
    """Return a function that puts the virtual board of a rig behind a pseudo-terminal."""
    with ExitStack() as stack:

        def start(rig: Rig) -> PtyBoard:
            board = PtyBoard(rig)
            stack.callback(board.unplug)
            return board

        yield start
