"""``hiltest ports``: list the boards that are plugged in, and the reasons why other serial ports are not used."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import click

from hiltest.commands.options import documented
from hiltest.text import legible

if TYPE_CHECKING:
    from hiltest.boards.daplink import OtherPort, UsbBoard

_NONE_FOUND = """\
no FRDM-K64F is plugged in. Check that
  - the cable is in the connector next to the reset button (J26, OpenSDA), not in the K64F's own (J22);
  - the cable carries data: many cables only charge. `lsusb -d 0d28:` shows the board, with any driver;
  - the board's interface chip runs DAPLink (https://daplink.io): an unused port below may be the board."""


@dataclass(frozen=True, slots=True)
class PluggedBoard:
    """A board; keys are null if missing or unknown."""

    serial_number: str
    usb_id: str
    product: str
    port: str | None
    volume: str | None
    daplink_version: str | None


@dataclass(frozen=True, slots=True)
class UnusedPort:
    """Another serial port."""

    port: str | None
    usb_id: str | None
    serial_number: str | None
    product: str | None
    reason: str
    """Reason why the port is not used."""


@dataclass(frozen=True, slots=True)
class Ports:
    """Boards that are plugged in, and the other serial ports."""

    boards: list[PluggedBoard]
    others: list[UnusedPort]


@click.command()
@documented("hiltest.ports/1")
def ports() -> tuple[int, Ports]:
    """List serial ports and the boards that are plugged in.

    A board is recognised by the USB id of its DAPLink, 0d28:0204, and a serial number that begins with 0240, DAPLink's
    id of the FRDM-K64F. Select a board with --port usb://SERIAL; the first digits of SERIAL are enough.
    """
    from hiltest.boards.daplink import plugged_in

    plugged = plugged_in()
    if plugged.boards:
        _print_boards(plugged.boards)
    else:
        click.echo(_NONE_FOUND)
    if plugged.others:
        _print_others(plugged.others)
    boards = [
        PluggedBoard(
            serial_number=board.serial_number,
            usb_id=board.usb_id,
            product=board.product,
            port=str(board.port) if board.port else None,
            volume=str(board.volume.path) if board.volume else None,
            daplink_version=(board.volume.interface_version or None) if board.volume else None,
        )
        for board in plugged.boards
    ]
    others = [
        UnusedPort(
            port=str(port.port) if port.port else None,
            usb_id=port.device.usb_id if port.device else None,
            serial_number=port.device.serial_number if port.device else None,
            product=port.device.product if port.device else None,
            reason=port.not_taken,
        )
        for port in plugged.others
    ]
    return 0, Ports(boards, others)


def _print_boards(boards: Sequence[UsbBoard]) -> None:
    rows = []
    for board in boards:
        unmounted = f"{board.disks[0]}, not mounted" if board.disks else "none"
        volume, version = (board.volume.path, board.volume.interface_version) if board.volume else (unmounted, "")
        rows.append((board.serial_number, str(board.port or "none"), str(volume), version or "unknown"))
    _print_rows(("serial number", "port", "volume", "DAPLink"), rows)


def _print_others(others: Sequence[OtherPort]) -> None:
    click.echo("\nnot used:")
    rows = [(str(port.port or "none"), port.device.product if port.device else "", port.not_taken) for port in others]
    _print_rows(("port", "device", "why"), rows)


def _print_rows(head: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> None:
    """Print columns; lines longer than the terminal are not cut, so that they can be copied."""
    widths = [max(len(row[column]) for row in (head, *rows)) for column in range(len(head))]
    for row in (head, *rows):
        click.echo("  ".join(legible(cell).ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())
