"""``hiltest device``: what is understood of firmware that does not speak hiltest's protocol."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hiltest.bench_files import rig_file
from hiltest.commands.options import NumberRange, asked_to_end, checked
from hiltest.errors import ConfigError, LinkLostError
from hiltest.settings import file_name

if TYPE_CHECKING:
    from hiltest.boards import VirtualBench
    from hiltest.device.quantities import StreamInterface
    from hiltest.device.trial import Heard, Trial
    from hiltest.link.ports import SerialPort
    from hiltest.rig import Rig

_TRY_EXIT_CODES = """
\b
Exit codes:
  0   values were understood, until --for or Ctrl-C
  1   none was
  4   usage: an option, a port, a rig file or a firmware file is wrong
  20  connection lost; what came before is summed up
"""
_LONGEST_SHOWN = 160


@click.group()
def device() -> None:
    """Show what is understood of what firmware says in its own words."""


@device.command("try", epilog=_TRY_EXIT_CODES)
@click.option("--rig", metavar="R", required=True, callback=checked(file_name),
              help="Rig file with a [device] table, or name of a rig in hil/rigs.")
@click.option("--hil-port", metavar="URL", callback=checked(file_name),
              help="Serial port of a real board: a device or a pyserial URL.  [default: the rig's board]")
@click.option("--firmware", metavar="ELF", callback=checked(file_name), help="Firmware for the virtual board.")
@click.option("--for", "seconds", metavar="SECONDS", type=NumberRange(min=0.0, max=1e9, min_open=True),
              help="How long to listen, by the board's clock.  [default: until Ctrl-C]")
def try_(rig: str, hil_port: str | None, firmware: str | None, seconds: float | None) -> int:
    """Show each line that the board sends, and what is understood of it.

    A line that means nothing has a question mark, and why. What the rig sends at the start is sent; nothing is turned,
    and nothing is judged: see docs/text-compass.md.
    """
    from hiltest.device.trial import Trial
    from hiltest.rig.file import load_rig

    described = load_rig(rig_file(Path.cwd(), rig))
    interfaces = _interfaces(described)
    port, bench = _opened(described, hil_port or described.board.port, firmware)
    trial = Trial(interfaces)
    try:
        _listen(port, trial, [*interfaces.values()], seconds)
    finally:
        port.close()
    for sentence in bench.said_of_playback if bench else ():
        click.echo(sentence, err=True)
    return 0 if trial.values else 1


def _interfaces(rig: Rig) -> dict[str, StreamInterface]:
    """Return what the rig understands of a line."""
    from hiltest.device.kinds import open_interfaces
    from hiltest.device.quantities import StreamInterface

    table = rig.own_language
    if table is None:
        raise ConfigError(f"{rig.path}: its firmware speaks hiltest's protocol; a table [device] says otherwise")
    of_a_line = tuple(kind for kind in table.kinds if kind != "memory")
    spoken = replace(rig, device=replace(table, kind=of_a_line, memory=None, sources={})) if of_a_line else None
    interfaces = open_interfaces(spoken) if spoken else {}
    opened = {kind: each for kind, each in interfaces.items() if isinstance(each, StreamInterface)}
    if not opened:
        raise ConfigError(f"{rig.where('device', 'kind')}: device.kind: nothing of it comes over a line")
    return opened


def _opened(rig: Rig, port: str | None, firmware: str | None) -> tuple[SerialPort, VirtualBench | None]:
    """Open a port, or that of a virtual board, which comes with it."""
    from hiltest.boards import VirtualBench
    from hiltest.boards.virtual_port import VirtualPort
    from hiltest.link.ports import READ_SLICE_S, open_port

    if port is not None:
        if firmware is not None:
            raise ConfigError(f"--firmware is for the virtual board, and this one is on {port}")
        return open_port(port, baud=rig.link.baud), None
    virtual, bench = VirtualPort(), VirtualBench(rig, firmware=Path(firmware) if firmware else None)
    virtual.attach(bench.machine)
    virtual.open()
    virtual.timeout = READ_SLICE_S
    return virtual, bench


def _listen(port: SerialPort, trial: Trial, interfaces: list[StreamInterface], seconds: float | None) -> None:
    """Show what comes for a time, and sum it up."""
    from hiltest.device.quantities import Moment

    now: Callable[[], float] = getattr(port, "now", None) or time.monotonic
    begin_s = now()
    end_s = begin_s + (math.inf if seconds is None else seconds)
    for each in interfaces:
        port.write(each.commands(Moment.START))
    try:
        with asked_to_end() as ending:
            for data in _pieces(port, lambda: now() >= end_s or bool(ending)):
                for heard in trial.take(data, now()):
                    _show(heard)
    finally:
        click.echo("\n".join(["", *trial.summary(now() - begin_s)]))


def _pieces(port: SerialPort, ended: Callable[[], bool]) -> Iterator[bytes]:
    """Yield what comes over a port, a line or what came in some time."""
    import serial

    while not ended():
        try:
            yield port.read_until(b"\n")
        except (serial.SerialException, OSError) as error:
            raise LinkLostError(port.name, str(error)) from error


def _show(heard: Heard) -> None:
    if heard.line:
        click.secho(f"{' ' if heard.understood else '?'} {heard.line[:_LONGEST_SHOWN]}", dim=heard.understood)
    click.secho(f"    {heard.meaning}", fg=None if heard.understood else "yellow")
