"""A virtual board's UART as a pyserial port, in stepped time.

The virtual clock advances only inside `read`: however slow or fast the host is, the same calls give the same bytes at
the same virtual times. Timeouts are virtual.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import serial
from serial.serialutil import SerialBase

# Period at which a read without a timeout checks for bytes.
_ENDLESS_SLICE_S = 1.0
_MOST_BYTES = 1 << 30  # more than any single read


class UartPort(Protocol):
    """The host's end of a virtual UART."""

    @property
    def host_waiting(self) -> int:
        """Number of bytes that have arrived from the board."""

    @property
    def wrong_speed(self) -> str:
        """Sentence about a line whose ends have different speeds; empty otherwise."""

    def host_write(self, data: bytes) -> None:
        """Send bytes to the board; they arrive at the pace of the line."""

    def host_read(self, size: int) -> bytes:
        """Take bytes that have arrived from the board."""

    def host_expect(self, count: int, byte: int) -> None:
        """Set the stop of a run for bytes: `count` bytes that are not taken, or a byte of this value."""


class Machine(Protocol):
    """Interface of a virtual board to its port."""

    @property
    def time_s(self) -> float:
        """Virtual seconds since power-on."""

    @property
    def uart0(self) -> UartPort:
        """The debug serial port."""

    def position(self) -> str:
        """Return a description of the firmware's present activity."""

    def unanswered_part(self) -> str:
        """Return a sentence about a part that was asked while it was booting; or nothing."""

    def run_until(self, time_s: float, *, wake: Callable[[], bool] | None = None, for_bytes: bool = False) -> None:
        """Let the board run until a time, or until `wake` says so after bytes arrived that were expected."""


class VirtualPort(SerialBase):  # type: ignore[misc]  # pyserial publishes no types
    """A serial port of a virtual machine, which runs while the host reads.

    Subclasses, or the caller, give it a machine by `attach` before `open`.
    """

    _machine: Machine | None = None

    def attach(self, machine: Machine) -> None:
        """Set the machine at the far end."""
        self._machine = machine
        self._arrived = bytearray()

    @property
    def machine(self) -> Machine:
        """The far end."""
        if self._machine is None or not self.is_open:
            raise serial.PortNotOpenError()
        return self._machine

    def open(self) -> None:
        """Open the port; the far end must be attached."""
        if self._machine is None:
            raise serial.SerialException("no machine is attached to this port")
        self.is_open = True

    def close(self) -> None:
        """Close the port; the machine stays as it is."""
        self.is_open = False

    def now(self) -> float:
        """Return virtual seconds since power-on."""
        return self.machine.time_s

    def position(self) -> str:
        """Return a description of the firmware's activity, of a wrong speed, and of a part that did not answer."""
        remarks = self.machine.uart0.wrong_speed, self.machine.unanswered_part()
        return "; ".join([self.machine.position(), *filter(None, remarks)])

    @property
    def wrong_speed(self) -> str:
        """Sentence of `Uart.wrong_speed`."""
        return self.machine.uart0.wrong_speed

    @property
    def in_waiting(self) -> int:
        """Bytes that can be read without waiting; asking does not move the clock."""
        self._take()
        return len(self._arrived)

    def read(self, size: int = 1) -> bytes:
        """Return up to `size` bytes, fewer on a (virtual) timeout."""
        self._run(lambda: len(self._arrived) >= size, size)
        return self._give(size)

    def read_until(self, expected: bytes = b"\n", size: int | None = None) -> bytes:
        """Return bytes up to and including `expected`, fewer at `size` or on a timeout."""
        most = _MOST_BYTES if size is None else size
        self._run(lambda: expected in self._arrived or len(self._arrived) >= most, most, *expected[-1:])
        at = self._arrived.find(expected)
        end = len(self._arrived) if at < 0 else at + len(expected)
        return self._give(end if size is None else min(end, size))

    def write(self, data: bytes) -> int:
        """Send bytes; they arrive while the host reads."""
        payload = bytes(data)
        self.machine.uart0.host_write(payload)
        return len(payload)

    def flush(self) -> None:
        """Do nothing: bytes leave as the virtual clock moves."""

    def reset_input_buffer(self) -> None:
        """Drop the bytes that have arrived."""
        self._take()
        self._arrived.clear()

    def reset_output_buffer(self) -> None:
        """Do nothing: written bytes are on their way."""

    @property
    def cts(self) -> bool:
        """Clear to send: the line has no flow control."""
        return True

    @property
    def dsr(self) -> bool:
        """Data set ready."""
        return True

    @property
    def ri(self) -> bool:
        """Ring indicator."""
        return False

    @property
    def cd(self) -> bool:
        """Carrier detect."""
        return True

    def _take(self) -> None:
        uart = self.machine.uart0
        if uart.host_waiting:
            self._arrived += uart.host_read(uart.host_waiting)

    def _give(self, count: int) -> bytes:
        data = bytes(self._arrived[:count])
        del self._arrived[:count]
        return data

    def _run(self, enough: Callable[[], bool], size: int, last: int = -1) -> None:
        """Run until `enough` holds, checked after `size` bytes or after a byte of the value `last`."""
        machine = self.machine

        def arrived() -> bool:
            self._take()
            machine.uart0.host_expect(min(size - len(self._arrived), _MOST_BYTES), last)
            return enough()

        if arrived():
            return
        if self.timeout is not None:
            machine.run_until(machine.time_s + self.timeout, wake=arrived, for_bytes=True)
            return
        while not arrived():
            machine.run_until(machine.time_s + _ENDLESS_SLICE_S, wake=arrived, for_bytes=True)

    # Programs may set line parameters; a virtual line ignores them and uses the board's.
    def _reconfigure_port(self, *_: Any) -> None:
        pass

    def _update_rts_state(self) -> None:
        pass

    def _update_dtr_state(self) -> None:
        pass

    def _update_break_state(self) -> None:
        pass
