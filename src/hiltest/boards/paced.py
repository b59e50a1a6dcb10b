"""A virtual board that runs by itself, never ahead of wall time, at the far end of byte streams.

In stepped time (`hiltest.boards.virtual_port`) the clock stands still unless the host reads. A
program that opens a real serial port knows nothing of that: for it the board has to run on.
"""

from __future__ import annotations

import math
import select
import threading
import time
from collections.abc import Callable
from types import TracebackType
from typing import Protocol, Self

from hiltest.angles import Pose
from hiltest.boards.bench import START_UP_S, VirtualBench
from hiltest.boards.lines import PortLine
from hiltest.errors import BenchError, BoardFault
from hiltest.virtual.board.k64f import VirtualK64F
from hiltest.virtual.peripherals.uart import Uart

# How often the board is let run on [s]: late by no more than a reply of 20 bytes takes on the line.
_STEP_S = 0.002
# A board that fell behind catches up in pieces, so that its lines are looked after in between. They are
# this long in virtual time, and shorter where that would take the host longer [s].
_LONGEST_STEP_S = 0.02
_SHORTEST_STEP_S = 0.0002
# What a board's line takes at once, and what it still takes of a program that left when the next one comes [s]:
# together with what is on the wire that one is heard well within a second.
QUEUED_S = 0.25
_BITS_A_BYTE = 10
# A program that opens a port drops what is there already, a moment later: until then, or until it sends something,
# nothing is sent to it [s].
_OPENING_S = 0.25
# What is kept for the first program on a line [byte]: 5 s of output at 115 200 baud.
_KEPT_BYTES = 1 << 16


class Device(Protocol):
    """A device on a line whose clock is the bench's."""

    def room(self) -> int:
        """Number of bytes that it can take now."""

    def hear(self, data: bytes) -> None:
        """Take bytes from the line."""

    def say(self) -> bytes:
        """Return what it has to say by now."""


class SerialPortOfBoard:
    """A UART of the board as a device; takes bytes no faster than a serial line brings them.

    Parameters
    ----------
    uart
        By default UART0.
    """

    def __init__(self, machine: VirtualK64F, uart: Uart | None = None) -> None:
        self._machine = machine
        self._uart = uart or machine.uart0
        self._heard_by_s = 0.0  # virtual time at which everything taken so far will have arrived

    @property
    def bytes_queued(self) -> int:
        """What the line brings in `QUEUED_S`."""
        return max(1, round(QUEUED_S * self._uart.line_baud / _BITS_A_BYTE))

    def room(self) -> int:
        """A read at a time, as soon as the one before has nearly arrived; none before the firmware listens."""
        if self._machine.time_s < START_UP_S:
            return 0
        return self.bytes_queued if self._heard_by_s <= self._machine.time_s + _LONGEST_STEP_S else 0

    def hear(self, data: bytes) -> None:
        """Put bytes on the line to the board."""
        uart = self._uart
        seconds = len(data) * _BITS_A_BYTE / uart.line_baud
        self._heard_by_s = max(self._heard_by_s, self._machine.time_s) + seconds
        uart.host_write(data)

    def say(self) -> bytes:
        """Fetch what the board has sent."""
        uart = self._uart
        return uart.host_read(uart.host_waiting) if uart.host_waiting else b""


class _ServedLine:
    """A line with the device at its end.

    Parameters
    ----------
    keeps
        Whether what the device says before the first program is there is kept for it, or lost.
    """

    def __init__(self, line: PortLine, device: Device, *, keeps: bool) -> None:
        self.line = line
        self._keeps = keeps
        self._device = device
        self._kept = bytearray()
        self._since_s = math.inf  # when the program that is there was first seen
        self.came = False  # whether one has been there, and open for good

    def look(self) -> None:
        """See whether a program is there, and take what it has sent."""
        data = self.line.receive(self._device.room())
        now_s = time.monotonic()
        self._since_s = min(self._since_s, now_s) if self.line.connected else math.inf
        self.came = self.came or now_s - self._since_s >= _OPENING_S or self.line.queue.used
        if data:
            self._device.hear(data)

    def answer(self) -> None:
        """Send what the device has to say, behind what was kept."""
        said = self._device.say()
        if not self._keeps or (self.came and not self._kept):
            self.line.send(said)
            return
        self._kept += said[: _KEPT_BYTES - len(self._kept)]
        if self.came:
            del self._kept[: self.line.send(bytes(self._kept))]


class PacedBench:
    """Run a virtual bench in a thread, in pace with wall time, its serial line open to other programs.

    Cycles are those of the virtual processor, as always. When bytes arrive depends on the host:
    runs in paced time are not reproducible.

    Parameters
    ----------
    bench
        Not yet powered on; nothing else may run it.
    line
        Line to the board's serial port. Its opener closes it, after `stop`.
    others
        What else is served in the same time, such as a turntable.
    held
        Whether the board is still kept in reset, besides for as long as no program has come to a line; asked over and
        over. Without it the board starts at once.
    until_s
        Where its time ends [virtual s].

    Attributes
    ----------
    fault : BoardFault or None
        What ended the firmware. A board with a fault is silent and stays on its line.
    behind_s : float
        How far the board is behind wall time [s].
    busy_s : float
        For how long the host has emulated it [s].
    """

    def __init__(
        self, bench: VirtualBench, line: PortLine, *others: tuple[PortLine, Device],
        held: Callable[[], bool] | None = None, until_s: float = math.inf,
    ) -> None:  # fmt: skip
        self.fault: BoardFault | None = None
        self.behind_s = self.busy_s = 0.0
        self._held, self._until_s = held, until_s
        self._began_s = math.inf
        self._took_s: float | None = None  # once it has ended
        self._bench = bench
        port = SerialPortOfBoard(bench.machine)
        line.queue.kept = port.bytes_queued
        self._served = [_ServedLine(line, port, keeps=True), *(_ServedLine(*other, keeps=False) for other in others)]
        self._clock = threading.Condition()  # guards bench; notified after every step
        self._running = False
        self._longest_step_s = _LONGEST_STEP_S
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

    @property
    def wall_s(self) -> float:
        """For how long the board has run [s], without what a debugger held it."""
        if self._took_s is not None:
            return self._took_s
        return max(0.0, time.monotonic() - self._began_s - self._bench.machine.halted_s)

    @property
    def over(self) -> bool:
        """Whether its time has come to its end."""
        return self.time_s >= self._until_s

    @property
    def running(self) -> bool:
        """Whether the thread runs: not before `start`, after `stop`, or after a fault."""
        return self._running

    def start(self) -> None:
        """Power on, keep the board running, and come back when its firmware listens.

        Raises
        ------
        ConfigError
            When the firmware has nothing to boot from.
        BoardFault
            When the firmware faults before it listens.
        """
        self.power_on()
        with self._clock:
            self._wait_for(START_UP_S)

    def power_on(self) -> None:
        """Power on, keep the board running, and come back at once.

        Raises
        ------
        ConfigError
            When the firmware has nothing to boot from.
        """
        self._bench.machine.boot()
        for each in self._served:
            each.answer()  # what a device says as it is switched on nobody hears
        self._running = True
        self._thread.start()

    def stop(self) -> None:
        """Stop the board's clock for good: its lines stay, silent. Idempotent."""
        with self._clock:
            self._running = False
            self._clock.notify_all()
        if self._thread.is_alive():
            self._thread.join()

    def turn_to(self, pose: Pose, *, known_angle: int | None = None) -> None:
        """Turn the table, and wait until it stands: in wall time.

        Raises
        ------
        BenchError
            When the firmware faults, or the board is stopped, before it does.
        """
        with self._clock:
            self._wait_for(self._bench.begin_turn(pose, known_angle=known_angle))

    def tumble(self, duration_s: float) -> float:
        """Go to where a tumble begins, come back when it begins, and say how long it takes [s]."""
        with self._clock:
            self._wait_for(self._bench.begin_tumble(duration_s))
            return self._bench.tumble_takes_s(duration_s)

    def turn_round(self, turn_deg: float, *, rate_dps: float, after_s: float) -> float:
        """Begin to turn about the vertical in `after_s`, come back at once, and say in how long it will stand [s]."""
        with self._clock:
            return self._bench.turn_round(turn_deg, rate_dps=rate_dps, after_s=after_s)

    def _wait_for(self, time_s: float) -> None:
        self._clock.wait_for(lambda: self.time_s >= time_s or not self._running)
        if self.time_s < time_s:
            raise self.fault or BenchError(f"the board was stopped before its {time_s:.2f} s were over")

    def _run(self) -> None:
        try:
            while self._running and self._in_reset():
                self._wait_for_bytes()
            self._began_s = time.monotonic() - self._bench.machine.halted_s
            while self._running:
                self._wait_for_bytes()
                with self._clock:
                    self._step()
                    self._clock.notify_all()
        finally:
            with self._clock:
                self._took_s = self.wall_s
                self._running = False
                self._clock.notify_all()

    def _in_reset(self) -> bool:
        """Whether the board still waits for somebody to come."""
        with self._clock:
            for each in self._served:
                each.look()
                each.answer()
            return self._held is not None and self._held() and not any(each.came for each in self._served)

    def _wait_for_bytes(self) -> None:
        """Wait until something comes on a line, but no longer than a step."""
        sources = [source for served in self._served for source in served.line.sources()]
        select.select(sources, [], [], _STEP_S)

    def _step(self) -> None:
        for each in self._served:
            each.look()
        if self.wall_s > self.time_s:
            try:
                self._run_until(min(self.wall_s, self.time_s + self._longest_step_s, self._until_s))
            except BoardFault as error:
                self.fault = error
                self._running = False
        # While a debugger holds the processor, the board's clock stands still, and does not fall behind.
        self.behind_s = max(0.0, self.wall_s - self.time_s)
        for each in self._served:
            each.answer()
        if self.over:
            self._running = False

    def _run_until(self, time_s: float) -> None:
        """Let the board run on, and measure how much of that the host can do at a time."""
        since_s, began_s, halted_s = self.time_s, time.monotonic(), self._bench.machine.halted_s
        self._bench.machine.run_until(time_s)
        took_s = time.monotonic() - began_s - (self._bench.machine.halted_s - halted_s)
        self.busy_s += took_s
        share = _LONGEST_STEP_S / max(took_s, 1e-6)
        self._longest_step_s = min(_LONGEST_STEP_S, max(_SHORTEST_STEP_S, share * (self.time_s - since_s)))
