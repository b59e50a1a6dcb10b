"""``hiltest decode``: packets of NXP's sensor fusion, counted or as CSV."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hiltest.commands.options import NumberRange, documented, opened, parsed
from hiltest.errors import BenchError, ConfigError
from hiltest.processes import asked_to_end
from hiltest.session.settings import file_name

if TYPE_CHECKING:
    from hiltest.interfaces.packet_fields import Packet
    from hiltest.interfaces.packet_stream import PacketBatch
    from hiltest.interfaces.packet_summary import StreamSummary

_EXIT_CODES = """
\b
Exit codes:
  0   decoded
  1   no packet arrived
  2   interrupted
  4   usage: an option, a file or a port is wrong
  20  connection lost; earlier packets are printed and written
"""
# Half a day at the line's 11.5 kB/s.


@dataclass(frozen=True, slots=True)
class DecodedKind:
    """A kind of packet."""

    type: int
    title: str
    packets: int
    per_second: float | None
    """Rate by the board's clock; null without time stamps."""


@dataclass(frozen=True, slots=True)
class Decoded:
    """Packets of NXP's sensor fusion."""

    source: str
    """File or port."""
    packets: int
    lost_bytes: int
    missing: int
    resets: int
    """Numbers of packets, of bytes outside of packets, of missing packets by their numbers, and of clock resets."""
    releases: list[str]
    """Releases that send such packets."""
    firmware: int | None
    """Number of the firmware, 720 for 7.20; null if no packet has it."""
    elapsed_s: float
    """Time by the board's clock."""
    kinds: list[DecodedKind]


@click.command(epilog=_EXIT_CODES)
@documented("hiltest.decode/1")
@click.argument("source", metavar="FILE|PORT", callback=parsed(file_name))
@click.option(
    "--csv",
    "csv_file",
    metavar="FILE",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Write a CSV file with one row per packet.",
)
@click.option(
    "--seconds",
    metavar="N",
    type=NumberRange(min=0.0, max=1e9, min_open=True),
    help="Stop listening to a port after this time.  [default: at Ctrl-C]",
)
@click.option(
    "--baud",
    metavar="N",
    type=click.IntRange(min=1),
    default=115_200,
    show_default=True,
    help="Open a port at this baud rate.",
)
def decode(source: str, csv_file: Path | None, seconds: float | None, baud: int) -> tuple[int, Decoded]:
    """Decode the packets of NXP's Sensor Fusion.

    FILE has the received bytes; PORT is a serial device or a pyserial URL. Packets of releases 4.22, 5.00 and 7 are
    decoded: see docs/decode.md.
    """
    summary = _listen(source, csv_file, seconds, baud) if _is_port(source) else _read(source, csv_file)
    return 0 if summary.kinds else 1, Decoded(
        source=source,
        packets=sum(summary.counts.values()),
        lost_bytes=summary.lost_bytes,
        missing=summary.missing,
        resets=summary.clock.resets,
        releases=[str(release) for release in summary.releases()],
        firmware=summary.firmware,
        elapsed_s=summary.clock.elapsed_us / 1e6,
        kinds=[
            DecodedKind(kind.type, kind.title, summary.counts[kind], summary.rate_hz(kind)) for kind in summary.kinds
        ],
    )


def _read(source: str, csv_file: Path | None) -> StreamSummary:
    from hiltest.budgets import PACKETS
    from hiltest.interfaces.packet_stream import batches
    from hiltest.interfaces.packet_summary import summary_of
    from hiltest.json_files import read_bounded

    data = read_bounded(Path(source), PACKETS, otherwise="name a recording of packets")
    summary, release = summary_of(data)
    if csv_file is not None:
        _write(csv_file, summary.kinds, batches(data, release))
    _show(source, summary)
    return summary


def _listen(source: str, csv_file: Path | None, seconds: float | None, baud: int) -> StreamSummary:
    import hiltest.boards  # noqa: F401  hil:// is a port too
    from hiltest.interfaces.packet_stream import PacketDecoder, heard
    from hiltest.interfaces.packet_summary import StreamSummary
    from hiltest.interfaces.packets import KINDS
    from hiltest.link.ports import open_port

    summary, decoder = StreamSummary(), PacketDecoder()

    def counted(came: Iterator[PacketBatch]) -> Iterator[PacketBatch]:
        for batch in came:
            summary.add(batch)
            decoder.release = summary.release()
            yield batch

    port = open_port(source, baud=baud)
    try:
        with asked_to_end() as ending:
            came = counted(heard(port, decoder, seconds=seconds, ended=lambda: bool(ending)))
            if csv_file is not None:
                _write(csv_file, KINDS, came)
            else:
                for _ in came:
                    pass
    except BenchError:
        _show(source, summary)
        raise
    finally:
        port.close()
    _show(source, summary)
    return summary


def _write(csv_file: Path, kinds: Sequence[type[Packet]], came: Iterator[PacketBatch]) -> None:
    from hiltest.interfaces.packet_csv import PacketRows

    rows = PacketRows(kinds)
    with opened(csv_file) as file:
        file.write(rows.header())
        for batch in came:
            file.write(rows.lines(batch))
            file.flush()


def _show(source: str, summary: StreamSummary) -> None:
    """Print a summary of the packets."""
    from hiltest.text import format_count, format_number

    packets = sum(summary.counts.values())
    releases = " or ".join(map(str, summary.releases()))
    click.echo(
        f"{source}: {format_count(packets, 'packet')}"
        + (f" of release {releases}" if releases else "")
        + (f", firmware {summary.firmware / 100:.2f}" if summary.firmware is not None else "")
        + (f", {summary.clock.elapsed_us / 1e6:.1f} s by the board's clock" if summary.clock.elapsed_us else "")
    )
    if packets:
        click.echo(f"type  {'':<25}  {'packets':>11}  per second")
    for kind in summary.kinds:
        rate_hz = summary.rate_hz(kind)
        rate = "-" if rate_hz is None else f"{rate_hz:.1f}"
        click.echo(f"{kind.type:>4}  {kind.title:<25}  {format_number(summary.counts[kind]):>11}  {rate:>10}")
    click.echo(
        f"{format_count(summary.lost_bytes, 'byte')} in no packet, {format_count(summary.missing, 'packet')} missing "
        f"by the packets' numbers, {format_count(summary.clock.resets, 'reset')} of the board's clock"
    )


def _is_port(source: str) -> bool:
    """Return whether a name is that of a port: a URL, a device of this machine, or a terminal."""
    from hiltest.link.ports import list_ports

    if "://" in source or source in list_ports():
        return True
    path = Path(source)
    if not path.exists():
        raise ConfigError(
            f"{source} is neither a file nor a serial port; ports on this machine: {', '.join(list_ports()) or 'none'}"
        )
    if not path.is_char_device():
        return False
    try:
        number = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY)
    except OSError:
        return False  # an attempt to read it as a file reports the reason
    try:
        return os.isatty(number)
    finally:
        os.close(number)
