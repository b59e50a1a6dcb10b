"""``hiltest listen``: interpretation of firmware that does not speak hiltest's protocol."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hiltest.commands.options import NumberRange, documented, load_named_rig, setting_option
from hiltest.errors import ConfigError, LinkLostError
from hiltest.processes import asked_to_end

if TYPE_CHECKING:
    from hiltest.boards import VirtualBench
    from hiltest.interfaces.memory_interface import MemoryInterface
    from hiltest.interfaces.quantities import StreamInterface
    from hiltest.interfaces.trial import Heard, Trial
    from hiltest.link.ports import SerialPort
    from hiltest.rig import Rig
    from hiltest.rig.device import Device

_EXIT_CODES = """
\b
Exit codes:
  0   at least one value was interpreted
  1   no value was interpreted
  4   usage: an option, a port, a rig file or a firmware file is wrong
  20  connection lost; the summary covers the time before
"""
_LONGEST_SHOWN = 160
_MEMORY = "memory"
_LOOK_EVERY_S = 1.0
_WITHOUT_PORT_S = 0.1


@dataclass(frozen=True, slots=True)
class QuantityRate:
    """How often a quantity came."""

    values: int
    """Number of values."""
    per_second: float | None
    """Rate by the board's clock; null if it is unknown."""


@dataclass(frozen=True, slots=True)
class Understood:
    """Interpretation of firmware that reports by itself."""

    seconds: float
    """Duration of listening, by the board's clock."""
    understood: int
    not_understood: int
    """Numbers of lines, packets or readings."""
    remark: str
    """Reason why no value was interpreted: a wrong speed, silence, or no line end; empty if there is another one."""
    quantities: dict[str, QuantityRate]


@click.command(epilog=_EXIT_CODES)
@documented("hiltest.device-try/1")
@setting_option("rig", required=True)
@setting_option("port")
@setting_option(
    "firmware", help="Run this firmware on the virtual board, or read the variables of this ELF.", fallback="the rig's"
)
@click.option(
    "--seconds",
    metavar="N",
    type=NumberRange(min=0.0, max=1e9, min_open=True),
    help="Stop after this time by the board's clock.  [default: at Ctrl-C]",
)
def listen(rig: str, port: str | None, firmware: Path | None, seconds: float | None) -> tuple[int, Understood]:
    """Show how hiltest interprets the output of foreign firmware.

    Each line of text is shown with its interpretation; lines that could not be interpreted are marked with a question
    mark and the reason. If the interface is your own, only the values are shown. The rig's commands for the start are
    sent, the board is not turned, and there is no verdict: see docs/text-compass.md. Variables are read once a second,
    from the virtual board or over the GDB server that the rig names; they need --firmware.
    """
    from hiltest.interfaces.trial import Trial

    described = load_named_rig(rig)
    table = _table(described)
    interfaces = _interfaces(described, table)
    opened = _open_connection(described, interfaces, port or described.board.port, firmware)
    if described.faults is not None and opened.port is not None:
        click.echo(f"injected faults: {described.faults}", err=True)
    try:
        trial = Trial(
            interfaces,
            opened.memory,
            {name: value.paths for name, value in table.memory.values.items()} if table.memory else {},
        )
        listened_s = _listen(opened, trial, [*interfaces.values()], seconds)
    finally:
        opened.close()
    if opened.bench is not None:
        for sentence in (*opened.bench.said_of_playback, opened.bench.machine.unanswered_part()):
            if sentence:
                click.echo(sentence, err=True)
    rates = {quantity.key: QuantityRate(count, trial.rate_hz(quantity)) for quantity, count in trial.values.items()}
    remark = trial.remark(listened_s, opened.wrong_speed)
    return int(not trial.values), Understood(listened_s, trial.understood, trial.not_understood, remark, rates)


def _table(rig: Rig) -> Device:
    if rig.device is not None and not rig.answers_requests:
        return rig.device
    lines = rig.path.read_text(encoding="utf-8").splitlines()
    if any(line.lstrip("# ").startswith("[device]") for line in lines if line.startswith("#")):
        raise ConfigError(
            f"{rig.path}: its table [device] is a comment: remove the # from it, from its kind, and from each correct "
            "line below, with its unit"
        )
    raise ConfigError(f"{rig.path}: its firmware speaks hiltest's protocol; for other firmware add a table [device]")


def _interfaces(rig: Rig, table: Device) -> dict[str, StreamInterface]:
    """Return the interfaces that interpret the bytes on the line, according to the rig."""
    from hiltest.interfaces.kinds import open_interfaces
    from hiltest.interfaces.quantities import StreamInterface

    of_a_line = tuple(kind for kind in table.kinds if kind != _MEMORY)
    spoken = replace(rig, device=replace(table, kind=of_a_line, memory=None, sources={})) if of_a_line else None
    interfaces = open_interfaces(spoken) if spoken else {}
    opened = {kind: interface for kind, interface in interfaces.items() if isinstance(interface, StreamInterface)}
    if not opened and table.memory is None:
        raise ConfigError(f"{rig.where('device', 'kind')}: device.kind: none of these kinds uses a serial line")
    return opened


@dataclass(frozen=True, slots=True)
class _Connection:
    """A port, its virtual board and the reader of variables, as far as they exist."""

    port: SerialPort | None
    bench: VirtualBench | None = None
    memory: MemoryInterface | None = None

    @property
    def now(self) -> Callable[[], float]:
        """The board's clock, or else the host's."""
        return getattr(self.port, "now", None) or time.monotonic

    @property
    def wrong_speed(self) -> str:
        """Sentence about a line whose ends have different speeds; empty if they are equal or unknown."""
        return self.bench.machine.uart0.wrong_speed if self.bench is not None else ""

    def close(self) -> None:
        """Close the port and the debug server."""
        if self.memory is not None:
            self.memory.close()
        if self.port is not None:
            self.port.close()


def _open_connection(
    rig: Rig, interfaces: dict[str, StreamInterface], port: str | None, firmware: Path | None
) -> _Connection:
    """Open a port, or a virtual board with its port, and the reader of variables if the rig has one."""
    from hiltest.boards import VirtualBench
    from hiltest.boards.daplink import port_of
    from hiltest.boards.faulty_port import add_faults
    from hiltest.boards.memory_reading import memory_kind
    from hiltest.boards.virtual_port import VirtualPort
    from hiltest.link.ports import READ_SLICE_S, open_port
    from hiltest.virtual.program.elf import load_image

    assert rig.device is not None
    reads_memory = rig.device.memory is not None
    if port is None and rig.board.kind == "real" and interfaces:
        port = port_of()
    if port is None and (rig.board.kind == "virtual" or interfaces):
        virtual, bench = VirtualPort(), VirtualBench(rig, firmware=firmware)
        memory = memory_kind(bench.machine.image, bench.machine)(rig) if reads_memory else None
        virtual.attach(bench.machine)
        virtual.open()
        virtual.timeout = READ_SLICE_S
        return _Connection(add_faults(virtual, rig.faults, baud=rig.link.baud), bench, memory)
    if firmware is not None and not reads_memory:
        raise ConfigError(f"--firmware is for the virtual board, and this board is on {port}: leave it out")
    line: SerialPort | None = None
    if port is not None and interfaces:
        line = add_faults(open_port(port, baud=rig.link.baud, rig=rig.name), rig.faults, baud=rig.link.baud)
    try:
        is_read = reads_memory and (firmware is not None or line is None)
        return _Connection(
            line, None, memory_kind(load_image(firmware) if firmware else None, None)(rig) if is_read else None
        )
    except BaseException:
        if line is not None:
            line.close()
        raise


def _listen(opened: _Connection, trial: Trial, interfaces: list[StreamInterface], seconds: float | None) -> float:
    """Show the input for some time, print a summary, and return the duration."""
    from hiltest.interfaces.quantities import Moment

    now = opened.now
    begin_s = now()
    end_s = begin_s + (math.inf if seconds is None else seconds)
    for interface in interfaces:
        if opened.port is not None:
            opened.port.write(interface.commands(Moment.START))
    look_s = begin_s + min(_LOOK_EVERY_S, (end_s - begin_s) / 2.0)  # start-up code has not set all variables yet
    try:
        with asked_to_end() as ending:
            for data in _read_pieces(opened.port, lambda: now() >= end_s or bool(ending)):
                for heard in trial.take(data, now()):
                    _show(heard)
                if now() >= look_s:
                    look_s = now() + _LOOK_EVERY_S
                    for heard in trial.look(now()):
                        _show(heard)
    finally:
        listened_s = now() - begin_s
        click.echo("\n".join(["", *trial.summary(listened_s, opened.wrong_speed)]))
    return listened_s


def _read_pieces(port: SerialPort | None, ended: Callable[[], bool]) -> Iterator[bytes]:
    """Yield input from a port, by lines or after a time-out; without a port, nothing at intervals."""
    import serial

    while not ended():
        try:
            if port is None:
                time.sleep(_WITHOUT_PORT_S)
            yield port.read_until(b"\n") if port is not None else b""
        except (serial.SerialException, OSError) as error:
            raise LinkLostError(port.name if port is not None else "", str(error)) from error


def _show(heard: Heard) -> None:
    if heard.line:
        click.secho(f"{' ' if heard.understood else '?'} {heard.line[:_LONGEST_SHOWN]}", dim=heard.understood)
    click.secho(f"    {heard.meaning}", fg=None if heard.understood else "yellow")
