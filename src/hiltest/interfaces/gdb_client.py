"""A client of the GDB remote protocol: it halts a processor, reads its memory, and resumes it.

Every wait has a timeout, and any bytes from a server lead to an answer or a `DebugServerError`.
"""

from __future__ import annotations

import re
from contextlib import suppress
from dataclasses import dataclass
from typing import Self

from hiltest.errors import DebugServerError
from hiltest.interfaces.gdb_wire import Wire
from hiltest.link.gdb_packets import ACKNOWLEDGED, AGAIN, INTERRUPT, PacketReader, packet

_ANSWER_S = 3.0  # a probe answers in milliseconds
_TRIES = 3  # attempts for a packet that was damaged on its way
_SMALLEST_PACKET, _LARGEST_READ = 64, 1024
_USUAL_PACKET = 400  # packet size of servers that do not report theirs
_CORE_REGISTERS, _SP, _LR, _PC = 16, 13, 14, 15
_STOP = re.compile(rb"[TS]([0-9a-fA-F]{2}).*", re.DOTALL)
_REFUSAL = re.compile(rb"E[0-9a-fA-F]{2}|E\..*", re.DOTALL)
_SHOWN = 40
_CONSOLE_KEPT = 2000


class MemoryRefusedError(DebugServerError):
    """Refusal of the server to read an address."""


@dataclass(frozen=True, slots=True)
class Registers:
    """Stack pointer, return address and program counter of a halted processor; bit 0 of addresses is kept."""

    sp: int
    lr: int
    pc: int


class GdbClient:
    """One connection to a GDB server; the processor is halted behind it.

    Parameters
    ----------
    wire
        The client closes it.
    answer_s
        Longest wait for an answer.

    Attributes
    ----------
    running : bool
        True if the processor was resumed and has not halted.
    console : str
        Latest console output of the server.

    Raises
    ------
    DebugServerError
        When there is no GDB server behind the wire.
    """

    def __init__(self, wire: Wire, *, answer_s: float = _ANSWER_S) -> None:
        self.running = False
        self.console = ""
        self._wire, self._answer_s = wire, answer_s
        self._reader = PacketReader(runs=True)
        self._arrived: list[bytes | None] = []
        self._acknowledges = True
        self._hardware = True  # whether the server has hardware breakpoints, which code in flash needs
        try:
            self._begin()
        except BaseException:
            wire.close()
            raise

    def _begin(self) -> None:
        self._wire.send(ACKNOWLEDGED)
        features = self.ask(b"qSupported:swbreak+;hwbreak+")
        size = re.search(rb"PacketSize=([0-9a-fA-F]{1,8})(?:;|$)", features)
        room = max(int(size[1], 16) if size else _USUAL_PACKET, _SMALLEST_PACKET)
        self._most = min((room - 4) // 2, _LARGEST_READ)
        if b"QStartNoAckMode+" in features and self.ask(b"QStartNoAckMode") == b"OK":
            self._acknowledges = False
        self._signal(self.ask(b"?"))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def name(self) -> str:
        """Name of the server in messages."""
        return self._wire.name

    def now(self) -> float:
        """Return the time that timeouts use [s]: virtual on a virtual board."""
        return self._wire.now()

    def close(self) -> None:
        """Let the processor run, and disconnect. Idempotent."""
        if not self.running:
            with suppress(DebugServerError):
                self.go_on()
        self._wire.close()

    # -- packets ------------------------------------------------------------------------------

    def ask(self, content: bytes) -> bytes:
        """Send a command and return the answer.

        Raises
        ------
        DebugServerError
            When there is no answer in time, or an invalid one.
        """
        self._wire.send(packet(content))
        deadline_s, again = self.now() + self._answer_s, 0
        while True:
            answer = self._next(deadline_s)
            if answer is None:
                raise self._error(
                    f"does not answer {_display_text(content)} within {self._answer_s:g} s; check that its probe is "
                    "connected and the board powered"
                )
            if answer == AGAIN and again < _TRIES:
                again += 1
                self._wire.send(packet(content))
            elif answer != AGAIN and (content == b"?" or not _STOP.fullmatch(answer)):
                return answer  # a late stop reply after an interrupt is not the answer

    def _next(self, deadline_s: float) -> bytes | None:
        """Return the next packet that is not console output; None on a timeout."""
        damaged = 0
        while True:
            while self._arrived:
                content = self._arrived.pop(0)
                if content is None:
                    damaged += 1
                    if not self._acknowledges or damaged > _TRIES:
                        raise self._error("sends damaged packets; check that it is a GDB server, and the port")
                    self._wire.send(AGAIN)
                elif content == AGAIN:
                    return content
                elif content != INTERRUPT:
                    if self._acknowledges:
                        self._wire.send(ACKNOWLEDGED)
                    if not self._is_console(content):
                        return content
            left_s = deadline_s - self.now()
            data = self._wire.receive(left_s) if left_s > 0.0 else b""
            if not data:
                return None
            self._arrived += self._reader.feed(data)

    def _is_console(self, content: bytes) -> bool:
        """Store the text of a console packet; return whether the packet is one."""
        if content[:1] != b"O" or content == b"OK":
            return False
        try:
            text = bytes.fromhex(content[1:].decode("ascii")).decode("utf-8", "replace")
        except ValueError:
            return False
        self.console = (self.console + text)[-_CONSOLE_KEPT:]
        return True

    def _error(self, reason: str) -> DebugServerError:
        console = f" (output: {self.console.strip()[-200:]})" if self.console.strip() else ""
        return DebugServerError(self.name, reason + console)

    def _nonsense(self, content: bytes, answer: bytes) -> DebugServerError:
        if _REFUSAL.fullmatch(answer):
            return self._error(f"refuses {_display_text(content)} ({_display_text(answer)}); check its output")
        return self._error(
            f"answers {_display_text(content)} with {_display_text(answer)}; is it a GDB server, and the port "
            "the right one?"
        )

    # -- memory and registers -----------------------------------------------------------------

    def read(self, address: int, size: int) -> bytes:
        """Read memory of the halted processor.

        Raises
        ------
        MemoryRefusedError
            When there is no memory at the address.
        DebugServerError
            When the server is gone or its answer is invalid.
        """
        data = b""
        while len(data) < size:
            at, size_left = address + len(data), min(size - len(data), self._most)
            command = b"m%x,%x" % (at, size_left)
            answer = self.ask(command)
            if _REFUSAL.fullmatch(answer):
                raise MemoryRefusedError(
                    self.name, f"refuses to read {size_left} bytes at 0x{at:08x}; check that this ELF runs on the board"
                )
            part = _bytes(answer)
            if not part or len(part) > size_left:
                raise self._nonsense(command, answer)
            data += part
        return data

    def write(self, address: int, data: bytes) -> None:
        """Write memory of the halted processor."""
        for begin in range(0, len(data), self._most // 2):
            part = data[begin : begin + self._most // 2]
            self._command(b"M%x,%x:%s" % (address + begin, len(part), part.hex().encode()))

    def registers(self) -> Registers:
        """Read the registers of a call: SP, LR and PC."""
        answer = self.ask(b"g")
        values = _bytes(answer.lower().replace(b"x", b"0"))  # x stands for an unknown digit
        if values is None or len(values) < 4 * _CORE_REGISTERS:
            raise self._nonsense(b"g", answer)
        if b"x" in answer[8 * _SP : 8 * _CORE_REGISTERS].lower():
            raise self._error("does not know the registers SP, LR and PC; check that the processor is halted")
        words = [int.from_bytes(values[4 * n : 4 * n + 4], "little") for n in range(_CORE_REGISTERS)]
        return Registers(words[_SP], words[_LR], words[_PC])

    def _command(self, content: bytes) -> None:
        answer = self.ask(content)
        if answer != b"OK":
            raise self._nonsense(content, answer)

    # -- running ------------------------------------------------------------------------------

    def set_breakpoint(self, address: int) -> None:
        """Set a breakpoint at an address: in hardware, or in software if the server has no other."""
        answer = self.ask(b"Z%d,%x,2" % (1 if self._hardware else 0, address & ~1))
        if answer == b"" and self._hardware:
            self._hardware = False
            answer = self.ask(b"Z0,%x,2" % (address & ~1))
        if answer != b"OK":
            raise self._error(
                f"sets no breakpoint at 0x{address & ~1:08x} ({_display_text(answer)}); free a breakpoint of the "
                "processor, which other debuggers may use"
            )

    def clear_breakpoint(self, address: int) -> None:
        """Clear a breakpoint."""
        self._command(b"z%d,%x,2" % (1 if self._hardware else 0, address & ~1))

    def go_on(self) -> None:
        """Let the halted processor run."""
        self._wire.send(packet(b"c"))
        self.running = True

    def step(self) -> None:
        """Run one instruction."""
        self._wire.send(packet(b"s"))
        self.running = True
        if self.wait_for_halt(self._answer_s) is None:
            raise self._error(f"takes more than {self._answer_s:g} s for one instruction; reset the board")

    def wait_for_halt(self, timeout_s: float) -> int | None:
        """Wait until the processor halts; return the signal of the halt, or None on a timeout."""
        answer = self._next(self.now() + timeout_s)
        if answer == AGAIN:
            raise self._error("did not understand c or s; check that it is a GDB server, and the port")
        return None if answer is None else self._signal(answer)

    def halt(self) -> None:
        """Halt the processor, if it runs."""
        if self.running:
            self._wire.send(INTERRUPT)
            if self.wait_for_halt(self._answer_s) is None:
                raise self._error(
                    f"does not halt the processor within {self._answer_s:g} s; check that the board is powered"
                )

    def run_for(self, seconds: float) -> None:
        """Let the processor run for a time, and halt it."""
        self.go_on()
        if self.wait_for_halt(seconds) is None:
            self.halt()

    def _signal(self, answer: bytes) -> int:
        stop = _STOP.fullmatch(answer)
        if stop is None:
            raise self._nonsense(b"?", answer)
        self.running = False
        return int(stop[1], 16)


def _bytes(digits: bytes) -> bytes | None:
    """Return the bytes of hexadecimal digits; None for other text."""
    try:
        return bytes.fromhex(digits.decode("ascii")) if b" " not in digits else None
    except ValueError:
        return None


def _display_text(content: bytes) -> str:
    text = content[:_SHOWN].decode("ascii", "backslashreplace")
    return repr(text + ("..." if len(content) > _SHOWN else ""))
