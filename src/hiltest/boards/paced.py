"""A virtual board that runs by itself, never ahead of wall time, at the far end of a byte stream.

In stepped time (`hiltest.boards.virtual_port`) the clock stands still unless somebody reads. A
program that opens a real serial port knows nothing of that: for it the board has to run on.
"""

from __future__ import annotations

import os
import select
import threading
import time
from types import TracebackType
from typing import Self

from hiltest.angles import Pose
from hiltest.boards.bench import VirtualBench
from hiltest.errors import BenchError, BoardFault

# How often the board is let run on [s]: late by no more than a reply of 20 bytes takes on the line.
_STEP_S = 0.002
# A board that fell behind catches up in pieces, so that its line is looked after in between.
_LONGEST_STEP_S = 0.02
_READ_BYTES = 4096


class PseudoTerminal:
    """A pair of connected terminals: other programs open `path`, the board has `board_end`. POSIX only.

    Attributes
    ----------
    path : str
        A device such as ``/dev/pts/3``.
    board_end : int
        File descriptor.
    """

    def __init__(self) -> None:
        import tty  # does not exist on Windows, where this module can still be imported

        self.board_end, self._kept = os.openpty()  # kept open: programs may come and go
        tty.setraw(self._kept)
        self.path = os.ttyname(self._kept)
        self._plugged = True

    def unplug(self) -> None:
        """Hang up, as a pulled cable does; what is open at `path` breaks. Idempotent."""
        if self._plugged:
            self._plugged = False
            os.close(self._kept)
            os.close(self.board_end)


class PacedBench:
    """Run a virtual bench in a thread, in pace with wall time, its serial line on a file descriptor.

    Cycles are those of the virtual processor, as always. When bytes arrive depends on the host:
    runs in paced time are not reproducible.

    Parameters
    ----------
    bench : VirtualBench
        Not yet powered on; nobody else may run it.
    wire : int
        File descriptor: the board's end of a `PseudoTerminal`. Whoever opened it closes it, after `stop`.

    Attributes
    ----------
    fault : BoardFault or None
        What ended the firmware. A board with a fault is silent and stays on its line.
    """

    def __init__(self, bench: VirtualBench, wire: int) -> None:
        self.fault: BoardFault | None = None
        self._bench = bench
        self._wire = wire
        self._clock = threading.Condition()  # guards bench; told after every step
        self._running = False
        self._thread = threading.Thread(target=self._run, name="hiltest-paced", daemon=True)

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    @property
    def time_s(self) -> float:
        """Virtual seconds since power-on."""
        return self._bench.machine.time_s

    def start(self) -> None:
        """Power on, and keep the board running; come back when its firmware listens."""
        os.set_blocking(self._wire, False)
        self._bench.power_on()
        self._running = True
        self._thread.start()

    def stop(self) -> None:
        """Stop the board's clock for good: its line stays, silent. Idempotent."""
        with self._clock:
            self._running = False
            self._clock.notify_all()
        if self._thread.is_alive():
            self._thread.join()

    def turn_to(self, pose: Pose, *, judged_pose: int | None = None) -> None:
        """Turn the table, and wait until it stands: in wall time.

        Raises
        ------
        BenchError
            When the firmware faults, or the board is stopped, before it does.
        """
        with self._clock:
            self._wait_for(self._bench.begin_turn(pose, judged_pose=judged_pose))

    def tumble(self, duration_s: float) -> None:
        """Go to where a tumble begins, and come back when it begins."""
        with self._clock:
            self._wait_for(self._bench.begin_tumble(duration_s))

    def _wait_for(self, time_s: float) -> None:
        self._clock.wait_for(lambda: self.time_s >= time_s or not self._running)
        if self.time_s < time_s:
            raise self.fault or BenchError("the board was stopped before its table stood")

    def _run(self) -> None:
        began_s = time.monotonic() - self.time_s
        while self._running:
            heard = self._hear()
            with self._clock:
                self._step(heard, time.monotonic() - began_s)
                self._clock.notify_all()

    def _hear(self) -> bytes:
        """Wait for bytes from the far end, but no longer than a step."""
        ready, _, _ = select.select([self._wire], [], [], _STEP_S)
        return os.read(self._wire, _READ_BYTES) if ready else b""

    def _step(self, heard: bytes, wall_s: float) -> None:
        machine = self._bench.machine
        machine.uart0.host_write(heard)
        if wall_s <= self.time_s:
            return
        try:
            machine.run_until(min(wall_s, self.time_s + _LONGEST_STEP_S))
        except BoardFault as error:
            self.fault = error
            self._running = False
        if machine.uart0.host_waiting:
            self._say(machine.uart0.host_read(machine.uart0.host_waiting))

    def _say(self, data: bytes) -> None:
        """Send what fits; a serial line with nobody at its end loses the rest too."""
        try:
            os.write(self._wire, data)
        except BlockingIOError:
            return
