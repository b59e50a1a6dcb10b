"""UARTs in the core's library: serial ports with exact bit times, flags and interrupts."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from hiltest.errors import BenchError
from hiltest.virtual.core.library import ffi, lib
from hiltest.virtual.core.machine import Machine
from hiltest.virtual.part.chip import ChipPeripheral
from hiltest.virtual.peripherals.bus import ALL_STEADY
from hiltest.virtual.peripherals.core_device import CoreDevice
from hiltest.virtual.peripherals.sim import ClockGates
from hiltest.virtual.processor.clock import PICOSECONDS, Clock
from hiltest.virtual.processor.cpu import Processor

_BITS_A_BYTE = 10
_C2, _D = 3, 7
_C2_TE_RE = 0x0C
_BAUD_TOLERANCE = 0.03  # as in core/serial.c: beyond it bytes are garbled


class SerialPort(CoreDevice):
    """A UART in the core's library with the far end of its wires (core/serial.c).

    Parameters
    ----------
    add
        Adds it to the machine, with its connections: struct machine_uart of machine.h.
    """

    def __init__(self, machine: Machine, module: ChipPeripheral, add: Callable[..., bool], connections: Any) -> None:
        if not add(machine.handle, module.base, ffi.new("struct machine_uart *", connections)[0]):
            raise MemoryError
        super().__init__(machine, module.name, module.base)
        self.line_baud = 115_200

    @property
    def is_on(self) -> bool:
        """Return whether the firmware has enabled it."""
        raise NotImplementedError

    @property
    def baud(self) -> float:
        """Rate that the firmware has set up [bit/s]."""
        baud: float = lib.machine_uart_baud(self._handle, self.base)
        return baud

    # -- the far end of the wire --------------------------------------------------------------

    @property
    def line_baud(self) -> int:
        """Rate at the far end of the wire [bit/s]."""
        return self._line_baud

    @line_baud.setter
    def line_baud(self, baud: int) -> None:
        self._line_baud = baud
        lib.machine_set_line_baud(self._handle, self.base, baud, round(_BITS_A_BYTE * PICOSECONDS / baud))

    @property
    def wrong_speed(self) -> str:
        """Return a sentence if the firmware uses the line at another rate than its far end; empty otherwise."""
        if not self.is_on or abs(self.baud / self.line_baud - 1.0) <= _BAUD_TOLERANCE:
            return ""
        return describe_speeds(self.name, self.baud, self.line_baud)

    def host_write(self, data: bytes) -> None:
        """Put bytes on the line towards the board, one after the other at line speed.

        Raises
        ------
        BenchError
            If more than 16 MiB are on the line.
        """
        payload = bytes(data)
        if not lib.machine_uart_write(self._handle, self.base, payload, len(payload)):
            raise BenchError(f"{self.name} of the virtual board cannot accept {len(payload)} more bytes at once")

    def host_expect(self, count: int, byte: int) -> None:
        """Set the end of a run with `for_bytes`: `count` unfetched bytes, or a byte with the value `byte`."""
        lib.machine_uart_expect(self._handle, self.base, count, byte)

    @property
    def host_arriving(self) -> int:
        """Bytes of the host that are on the line towards the board."""
        arriving: int = lib.machine_uart_arriving(self._handle, self.base)
        return arriving

    @property
    def answer(self) -> tuple[int, int]:
        """Cycles from the host's latest byte to the board's next one, and those of them that the thread executed."""
        answer = lib.machine_uart_answer(self._handle, self.base)
        return answer.cycles, answer.awake_cycles

    @property
    def host_waiting(self) -> int:
        """Bytes that the board has sent and the host has not fetched."""
        waiting: int = lib.machine_uart_waiting(self._handle, self.base)
        return waiting

    def host_read(self, size: int) -> bytes:
        """Return bytes that the board has sent.

        Raises
        ------
        BenchError
            If bytes were lost because the host has not fetched 16 MiB before them.
        """
        size = min(size, self.host_waiting)
        data = ffi.new("uint8_t[]", size)
        if lib.machine_uart_read(self._handle, self.base, data, size) < 0:
            raise BenchError(f"{self.name} of the virtual board has lost bytes: 16 MiB before them were not fetched")
        return bytes(data)


class Uart(SerialPort):
    """A Kinetis UART.

    Parameters
    ----------
    clock
        The module clock.
    depth
        Capacity of each FIFO [bytes]: 8, or 1 for a module without FIFOs.
    """

    steady = frozenset(ALL_STEADY) - {_D}  # bytes arrive and leave at events; a second read of S1 shows the same flags

    def __init__(
        self, processor: Processor, clocks: ClockGates, clock: Clock, module: ChipPeripheral, *, depth: int = 8
    ) -> None:
        machine = processor.machine
        requests = module.requests[0], module.requests[-1]  # receive and send, which may share one
        clock_numbers = clock.number_in(machine), clocks.time.number_in(machine)
        super().__init__(machine, module, lib.machine_add_uart, (depth, *module.interrupts, *requests, *clock_numbers))

    @property
    def is_on(self) -> bool:
        return bool(self.read(_C2, 1) & _C2_TE_RE)


def describe_speeds(name: str, baud: float, line_baud: int) -> str:
    """Return a sentence about a UART whose firmware has another rate than the line [bit/s]."""
    return (
        f"the firmware runs {name} at {baud:.0f} baud, and the line is read at {line_baud} baud: "
        "set the same speed at both ends (baud under [link] in the rig, or in the firmware)"
    )
