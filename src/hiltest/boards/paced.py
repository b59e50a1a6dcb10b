"""A virtual board that runs by itself, never ahead of wall time, behind byte streams.

In stepped time (`hiltest.boards.virtual_port`) the clock stands still unless the host reads. A program that opens a
real serial port cannot drive this clock, so the board has to run on its own.
"""

from __future__ import annotations

import math
import select
import threading
import time
from collections.abc import Callable
from typing import Protocol, Self

from hiltest.boards.bench import START_UP_S, VirtualBench
from hiltest.boards.served_lines import PortLine
from hiltest.errors import BenchError, BoardFault
from hiltest.interfaces.line_input import LineInput
from hiltest.orientation.angles import Pose
from hiltest.virtual.board.machine_chip import SerialLine
from hiltest.virtual.board.virtual_machine import VirtualMachine

# Period at which the board is run [s]: no longer than a reply of 20 bytes takes on the line.
_STEP_S = 0.002
# A board that fell behind catches up in pieces, so that its lines are served in between. Length of a piece in virtual
# time [s]; shorter if the host needs longer for it.
_LONGEST_STEP_S = 0.02
_SHORTEST_STEP_S = 0.0002
# Line time that may be queued at once, and that is still delivered of a disconnected program [s]: together with the
# bytes on the wire, the next program is served well within a second.
QUEUED_S = 0.25
_BITS_A_BYTE = 10
# A program that opens a port drops bytes that arrived before: until this time has passed or the program sends
# something, nothing is sent to it [s].
_OPENING_S = 0.25
# Output that is saved for the first program on a line [byte]: 5 s at 115 200 baud.
_KEPT_BYTES = 1 << 16


class LineDevice(Protocol):
    """A device on a line whose clock is the bench's."""

    def room(self) -> int:
        """Number of bytes that it can take now."""

    def hear(self, data: bytes) -> None:
        """Take bytes from the line."""

    def say(self) -> bytes:
        """Return the bytes that it has sent by now."""


class SerialPortOfBoard:
    """A UART of the board as a device; takes bytes no faster than a serial line brings them.

    Parameters
    ----------
    uart
        UART of the board; by default UART0.

    Attributes
    ----------
    input : LineInput
        Count of the bytes that the board has sent.
    """

    def __init__(self, machine: VirtualMachine, uart: SerialLine | None = None) -> None:
        self._machine = machine
        self._uart = uart or machine.uart0
        self.input = LineInput()
        self._heard_by_s = 0.0  # virtual time at which everything taken so far will have arrived

    @property
    def bytes_queued(self) -> int:
        """Bytes that the line transfers in `QUEUED_S`."""
        return max(1, round(QUEUED_S * self._uart.line_baud / _BITS_A_BYTE))

    def room(self) -> int:
        """Return room for one read as soon as the last one has nearly arrived; 0 before the firmware listens."""
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
        """Fetch the bytes that the board has sent."""
        uart = self._uart
        data = uart.host_read(uart.host_waiting) if uart.host_waiting else b""
        self.input.take(data)
        return data


class _ServedLine:
    """A line with the device at its end.

    Parameters
    ----------
    keeps
        True if the device's output before the first program connects is saved for it; otherwise it is lost.
    """

    def __init__(self, line: PortLine, device: LineDevice, *, keeps: bool) -> None:
        self.line = line
        self._keeps = keeps
        self._device = device
        self._saved_output = bytearray()
        self._since_s = math.inf  # time at which the present program was first seen
        self.came = False  # whether a program has been connected long enough, or has sent bytes

    def look(self) -> None:
        """Check whether a program is connected, and take its bytes."""
        data = self.line.receive(self._device.room())
        now_s = time.monotonic()
        self._since_s = min(self._since_s, now_s) if self.line.connected else math.inf
        self.came = self.came or now_s - self._since_s >= _OPENING_S or self.line.queue.used
        if data:
            self._device.hear(data)

    def answer(self) -> None:
        """Send the saved output, and the device's output after it."""
        output = self._device.say()
        if not self._keeps or (self.came and not self._saved_output):
            self.line.send(output)
            return
        self._saved_output += output[: _KEPT_BYTES - len(self._saved_output)]
        if self.came:
            del self._saved_output[: self.line.send(bytes(self._saved_output))]


class PacedBench:
    """Run a virtual bench in a thread, in pace with wall time, its serial line open to other programs.

    Cycles are those of the virtual processor, as always. The arrival times of bytes depend on the host:
    runs in paced time are not reproducible.

    Parameters
    ----------
    bench
        Not yet powered on; nothing else may run it.
    line
        Line to the board's serial port. Its opener closes it, after `stop`.
    others
        Other devices on the same clock, such as a turntable.
    held
        Returns whether the board is still held in reset; it also stays in reset until a program connects to a line.
        Without it the board starts at once.
    until_s
        End of its time [virtual s].

    Attributes
    ----------
    fault : BoardFault or None
        Fault that ended the firmware. A board with a fault is silent and stays on its line.
    behind_s : float
        Delay of the board behind wall time [s].
    input : LineInput
        Count of the bytes that the board has sent on its serial port.
    busy_s : float
        Host time spent on emulation [s].
    """

    def __init__(
        self,
        bench: VirtualBench,
        line: PortLine,
        *others: tuple[PortLine, LineDevice],
        held: Callable[[], bool] | None = None,
        until_s: float = math.inf,
    ) -> None:
        self.fault: BoardFault | None = None
        self.behind_s = self.busy_s = 0.0
        self._held, self._until_s = held, until_s
        self._began_s = math.inf
        self._took_s: float | None = None  # set at the end
        self._bench = bench
        port = SerialPortOfBoard(bench.machine)
        self.input = port.input
        line.queue.keep_limit = port.bytes_queued
        self._served = [_ServedLine(line, port, keeps=True), *(_ServedLine(*other, keeps=False) for other in others)]
        self._clock = threading.Condition()  # guards bench; notified after every step
        self._running = False
        self._longest_step_s = _LONGEST_STEP_S
        self._thread = threading.Thread(target=self._run, name="hiltest-paced", daemon=True)

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    @property
    def time_s(self) -> float:
        """Virtual seconds since power-on."""
        return self._bench.machine.time_s

    @property
    def wall_s(self) -> float:
        """Wall time that the board has run [s], without time halted by a debugger."""
        if self._took_s is not None:
            return self._took_s
        return max(0.0, time.monotonic() - self._began_s - self._bench.machine.halted_s)

    @property
    def over(self) -> bool:
        """True if its time has ended."""
        return self.time_s >= self._until_s

    @property
    def running(self) -> bool:
        """True if the thread runs: not before `start`, after `stop`, or after a fault."""
        return self._running

    def start(self) -> None:
        """Power on, keep the board running, and return when its firmware listens.

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
        """Power on, keep the board running, and return at once.

        Raises
        ------
        ConfigError
            When the firmware has nothing to boot from.
        """
        self._bench.machine.boot()
        for line in self._served:
            line.answer()  # output at power-on is dropped
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
        """Turn to the first pose of a tumble, return when it begins, with its duration [s]."""
        with self._clock:
            self._wait_for(self._bench.begin_tumble(duration_s))
            return self._bench.tumble_takes_s(duration_s)

    def turn_round(self, turn_deg: float, *, rate_dps: float, after_s: float) -> float:
        """Schedule a turn about the vertical in `after_s`; return the time until the table stands again [s]."""
        with self._clock:
            return self._bench.turn_round(turn_deg, rate_dps=rate_dps, after_s=after_s)

    def _wait_for(self, time_s: float) -> None:
        self._clock.wait_for(lambda: self.time_s >= time_s or not self._running)
        if self.time_s < time_s:
            raise self.fault or BenchError(f"the board was stopped before its {time_s:.2f} s were over")

    def _run(self) -> None:
        try:
            while self._running and self._is_in_reset():
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

    def _is_in_reset(self) -> bool:
        """Return whether the board still waits for a program to connect."""
        with self._clock:
            for line in self._served:
                line.look()
                line.answer()
            return self._held is not None and self._held() and not any(line.came for line in self._served)

    def _wait_for_bytes(self) -> None:
        """Wait until bytes arrive on a line without a backlog, but no longer than a step."""
        lines = [served.line for served in self._served if not served.line.queue.backlog]
        sources = [source for line in lines for source in line.sources()]
        select.select(sources, [], [], _STEP_S)

    def _step(self) -> None:
        for line in self._served:
            line.look()
        if self.wall_s > self.time_s:
            try:
                self._run_until(min(self.wall_s, self.time_s + self._longest_step_s, self._until_s))
            except BoardFault as error:
                self.fault = error
                self._running = False
        # While a debugger holds the processor, the board's clock stands still, and does not fall behind.
        self.behind_s = max(0.0, self.wall_s - self.time_s)
        for line in self._served:
            line.answer()
        if self.over:
            self._running = False

    def _run_until(self, time_s: float) -> None:
        """Run the board, and adapt the length of a piece to the host's speed."""
        since_s, began_s, halted_s = self.time_s, time.monotonic(), self._bench.machine.halted_s
        self._bench.machine.run_until(time_s)
        took_s = time.monotonic() - began_s - (self._bench.machine.halted_s - halted_s)
        self.busy_s += took_s
        share = _LONGEST_STEP_S / max(took_s, 1e-6)
        self._longest_step_s = min(_LONGEST_STEP_S, max(_SHORTEST_STEP_S, share * (self.time_s - since_s)))
