"""One GDB at the board: its commands, and the answers to them."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator

from hiltest.boards.gdb_target import memory_description, target_description
from hiltest.budgets import GDB
from hiltest.link.gdb_packets import ACKNOWLEDGED, AGAIN, INTERRUPT, LONGEST, PacketReader, packet
from hiltest.virtual.board.debug_access import DebugAccess
from hiltest.virtual.board.debugger import Debugger, Stop, StopReason, WatchKind
from hiltest.virtual.board.virtual_machine import VirtualMachine

_OK, _UNKNOWN, _REFUSED = b"OK", b"", b"E01"
_SIGNALS = {StopReason.REQUESTED: 2, StopReason.FAULT: 11}  # SIGINT, SIGSEGV; else SIGTRAP
_TRAP = 5
_WATCHES = {b"2": WatchKind.WRITE, b"3": WatchKind.READ, b"4": WatchKind.ACCESS}
_WATCH_NAMES = {WatchKind.WRITE: b"watch", WatchKind.READ: b"rwatch", WatchKind.ACCESS: b"awatch"}
_MOST_POINTS = 256  # breakpoints and watchpoints; a person has a dozen
_LONGEST_WATCH = 4096
_MONITOR = "reset: start the firmware anew, halted\nhalt\ncycles: clock cycles and instructions since power-on\n"
_BREAKPOINTS = (b"0", b"1")
_POINT = re.compile(rb"([0-4]),([0-9a-fA-F]{1,8}),([0-9a-fA-F]{1,8})(?:;.*)?", re.DOTALL)


class GdbSession:
    """A session with one GDB, from construction to `close`.

    Parameters
    ----------
    debugger
        Debugger of that machine, which is halted at once.
    """

    def __init__(self, machine: VirtualMachine, debugger: Debugger) -> None:
        self.over = False
        self._machine, self._debugger = machine, debugger
        self._access = DebugAccess(machine)
        self._reader = PacketReader()
        self._acknowledges = True
        self._goes = False  # whether GDB waits for a stop
        self._last_reply = b""  # last reply, in case GDB asks for it again
        self._repeated = 0  # how often GDB has asked for it
        self._points: set[tuple[bytes, int, int]] = set()
        self._handlers: list[tuple[bytes, Callable[[bytes], bytes]]] = [
            (
                b"qSupported",
                lambda _: (
                    b"PacketSize=%x;qXfer:features:read+;qXfer:memory-map:read+;swbreak+;hwbreak+;"
                    b"vContSupported+;QStartNoAckMode+" % LONGEST
                ),
            ),
            (b"qXfer:features:read:target.xml:", lambda rest: _part(target_description(), rest)),
            (
                b"qXfer:memory-map:read::",
                lambda rest: _part(memory_description(machine.memory, machine.bus.regions()), rest),
            ),
            (b"QStartNoAckMode", self._stop_acknowledging),
            (b"qRcmd,", self._monitor),
            (b"qAttached", lambda _: b"1"),
            (b"qC", lambda rest: _UNKNOWN if rest else b"QC1"),
            (b"qfThreadInfo", lambda _: b"m1"),
            (b"qsThreadInfo", lambda _: b"l"),
            (b"qThreadExtraInfo", lambda _: machine.core_title.encode().hex().encode()),
            (b"qSymbol", lambda _: _OK),
            (b"vCont?", lambda _: b"vCont;c;C;s;S;r"),
            (b"vCont;", self._continue_as),
            (b"vKill", self._kill),
            (b"?", lambda _: self._stop_reply()),
            (b"!", lambda _: _OK),
            (b"H", lambda _: _OK),
            (b"T", lambda _: _OK),
            (b"g", lambda _: self._access.registers().hex().encode()),
            (b"G", self._write_registers),
            (b"p", lambda rest: self._access.register(_register_number(self._access, rest)).hex().encode()),
            (b"P", self._write_register),
            (b"m", self._read),
            (b"M", self._write),
            (b"X", self._write_binary),
            (b"Z", self._set_point),
            (b"z", self._clear_point),
            (b"c", self._continue),
            (b"C", self._continue_after_signal),
            (b"s", self._step),
            (b"S", self._step_after_signal),
            (b"D", self._detach),
            (b"k", self._kill),
            (b"R", lambda _: self._reset()),
        ]
        machine.debugged = True
        with debugger.halted():
            pass

    @property
    def awaits_halt(self) -> bool:
        """True if GDB has resumed the processor, and waits for a halt."""
        return self._goes

    def feed(self, data: bytes) -> bytes:
        """Handle bytes from GDB; return the bytes to send."""
        return b"".join(self.answers(data))

    def answers(self, data: bytes) -> Iterator[bytes]:
        """Handle bytes from GDB; yield the bytes to send, those for each packet by themselves.

        A session ends when an answer is asked for again more often than its budget allows.
        """
        for content in self._reader.feed(data):
            if self.over:
                return
            self._repeated = self._repeated + 1 if content == AGAIN else 0
            if self._repeated > GDB.items:
                self.close()
            elif content == INTERRUPT:
                yield self._interrupt()
            elif content == AGAIN:
                yield self._last_reply
            elif content is None:
                yield AGAIN if self._acknowledges else b""
            else:
                yield ACKNOWLEDGED if self._acknowledges else b""
                yield self._say(self._answer(content))

    def stopped(self) -> bytes:
        """Return the bytes to send after a halt; none if the notice comes late and the processor runs again."""
        if not (self._goes and self._debugger.is_halted):
            return b""
        self._goes = False
        fault = self._debugger.latest.fault
        message = b"" if fault is None else packet(b"O" + f"{fault}\n".encode().hex().encode())
        return message + (self._say(self._stop_reply()) or b"")

    def close(self) -> None:
        """Remove all points and let the board run. Idempotent."""
        if not self.over:
            self.over = True
            self._machine.debugged = False
            self._debugger.clear()
            self._debugger.resume()

    def _say(self, answer: bytes | None) -> bytes:
        if answer is None:  # comes when the processor halts
            return b""
        self._last_reply = packet(answer)
        return self._last_reply

    def _answer(self, content: bytes) -> bytes | None:
        if self._goes and content[:1] not in b"Dk":
            return _REFUSED
        handler = next(((name, function) for name, function in self._handlers if content.startswith(name)), None)
        if handler is None:
            return _UNKNOWN
        name, answer = handler
        try:
            with self._debugger.halted():
                answered = answer(content[len(name) :])
        except Exception:  # a malformed packet gets an error reply and must not end the session
            return _REFUSED
        return None if self._goes else answered

    # -- running ------------------------------------------------------------------------------

    def _go(self, *, step: bool = False, within: range = range(0)) -> bytes:
        self._debugger.resume(step=step, within=within)
        self._goes = True
        return _OK

    def _interrupt(self) -> bytes:
        with self._debugger.halted():
            pass
        return self.stopped()

    def _continue(self, address: bytes) -> bytes:
        self._jump(address)
        return self._go()

    def _step(self, address: bytes) -> bytes:
        self._jump(address)
        return self._go(step=True)

    def _continue_after_signal(self, rest: bytes) -> bytes:
        return self._continue(rest.partition(b";")[2])

    def _step_after_signal(self, rest: bytes) -> bytes:
        return self._step(rest.partition(b";")[2])

    def _jump(self, address: bytes) -> None:
        if address:
            self._access.write_register(15, (int(address, 16) & 0xFFFFFFFF).to_bytes(4, "little"))

    def _continue_as(self, rest: bytes) -> bytes:
        action = rest.partition(b";")[0].partition(b":")[0]
        if action[:1] == b"r":
            begin, end = (int(part, 16) for part in action[1:].split(b","))
            return self._go(step=True, within=range(begin, end))
        if action[:1] not in (b"c", b"C", b"s", b"S"):
            return _REFUSED
        return self._go(step=action[:1] in b"sS")

    def _stop_reply(self) -> bytes:
        stop: Stop = self._debugger.latest
        reply = b"T%02xthread:1;" % _SIGNALS.get(stop.reason, _TRAP)
        if stop.watch is not None:
            reply += b"%s:%x;" % (_WATCH_NAMES[stop.watch], stop.address)
        elif stop.reason is StopReason.BREAKPOINT:
            pc = int.from_bytes(self._access.register(15), "little")
            reply += b"hwbreak:;" if any(kind == b"1" and at == pc for kind, at, _ in self._points) else b"swbreak:;"
        return reply

    # -- registers and memory -----------------------------------------------------------------

    def _write_registers(self, rest: bytes) -> bytes:
        self._access.write_registers(bytes.fromhex(rest.decode("ascii")))
        return _OK

    def _write_register(self, rest: bytes) -> bytes:
        number, _, value = rest.partition(b"=")
        self._access.write_register(int(number, 16), bytes.fromhex(value.decode("ascii")))
        return _OK

    def _read(self, rest: bytes) -> bytes:
        address, size = (int(part, 16) for part in rest.split(b","))
        if not 0 <= size <= (LONGEST - 8) // 2:
            return _REFUSED
        return self._access.read(address, size).hex().encode()

    def _write(self, rest: bytes) -> bytes:
        where, _, data = rest.partition(b":")
        return self._store(where, bytes.fromhex(data.decode("ascii")))

    def _write_binary(self, rest: bytes) -> bytes:
        where, _, data = rest.partition(b":")
        return self._store(where, data)

    def _store(self, where: bytes, data: bytes) -> bytes:
        address, size = (int(part, 16) for part in where.split(b","))
        if size != len(data):
            return _REFUSED
        if data:
            self._access.write(address, data)
        return _OK

    # -- points and the rest ------------------------------------------------------------------

    def _set_point(self, rest: bytes) -> bytes:
        kind, address, size = _point(rest)
        if len(self._points) >= _MOST_POINTS:
            return _REFUSED
        if kind in _WATCHES:
            self._debugger.set_watchpoint(_WATCHES[kind], address, size)
        else:
            self._access.read(address, 2)  # raises an error if there is no code
            self._debugger.set_breakpoint(address)
        self._points.add((kind, address, size))
        return _OK

    def _clear_point(self, rest: bytes) -> bytes:
        kind, address, size = _point(rest)
        self._points.discard((kind, address, size))
        if kind in _WATCHES:
            self._debugger.clear_watchpoint(_WATCHES[kind], address, size)
        elif not any(kind in _BREAKPOINTS and at == address for kind, at, _ in self._points):
            self._debugger.clear_breakpoint(address)
        return _OK

    def _stop_acknowledging(self, _rest: bytes) -> bytes:
        self._acknowledges = False
        return _OK

    def _monitor(self, rest: bytes) -> bytes:
        words = bytes.fromhex(rest.decode("ascii")).decode("ascii", "replace").split() or ["help"]
        if words[0] == "reset":
            self._reset()
            text = f"reset, halted at 0x{int.from_bytes(self._access.register(15), 'little'):08x}\n"
        elif words[0] == "halt":
            text = ""
        elif words[0] == "cycles":
            machine = self._machine
            text = f"{machine.cycles} cycles, {machine.instructions} instructions, {machine.time_s:.9f} s\n"
        else:
            text = _MONITOR
        return text.encode().hex().encode() or _OK

    def _reset(self) -> bytes:
        self._machine.reset()
        return _OK

    def _detach(self, _rest: bytes) -> bytes:
        self._goes = False
        self.close()
        return _OK

    def _kill(self, _rest: bytes) -> bytes:
        self._reset()
        return self._detach(b"")


def _register_number(access: DebugAccess, rest: bytes) -> int:
    number = int(rest, 16)
    access.width(number)
    return number


def _point(rest: bytes) -> tuple[bytes, int, int]:
    """Parse kind, address and size of a breakpoint or watchpoint."""
    match = _POINT.fullmatch(rest)
    if match is None:
        raise ValueError(rest)
    kind, address, size = match[1], int(match[2], 16), int(match[3], 16)
    if kind in _BREAKPOINTS:
        return kind, address & ~1, 2
    if not 0 < size <= _LONGEST_WATCH or address + size > 1 << 32:
        raise ValueError(rest)
    return kind, address, size


def _part(text: str, rest: bytes) -> bytes:
    """Return the requested part of an object: ``offset,length``."""
    offset, length = (int(number, 16) for number in rest.split(b","))
    part = text.encode()[offset : offset + min(length, LONGEST - 8)]
    return (b"m" if offset + len(part) < len(text) else b"l") + part
