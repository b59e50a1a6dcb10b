"""``hiltest flash``: write firmware onto a board."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import click

from hiltest.commands.options import ErrorOutput, documented, load_named_rig, parsed, setting_option
from hiltest.session.settings import file_name

_EXIT_CODES = """
\b
Exit codes:
  0   flashed; the new firmware answers, or the output says why it cannot
  4   usage: the image is not for this chip or would lock it; an option, a
      port or a rig file is wrong
  20  no board, a board in use by another process, a failed write (the
      output shows FAIL.TXT), or no answer afterwards
  23  another firmware answers afterwards
"""


@dataclass(frozen=True, slots=True)
class Flashed:
    """Firmware that was flashed."""

    file: str
    """File that was flashed."""
    bytes: int
    """Number of bytes that were written."""
    build_id: str
    """Build of the file; empty if it has none."""
    by: str
    """Method: ``daplink``, by its drive, or ``pyocd``."""
    serial_number: str | None
    port: str | None
    volume: str | None
    """Properties of the board, as far as they are known."""
    answered: str | None
    """Build that the board answered afterwards; null if it was not asked."""
    said: str
    """Description of the firmware that runs now."""


@click.command(epilog=_EXIT_CODES)
@documented("hiltest.flash/1")
@setting_option("rig", fallback="the board that is plugged in")
@setting_option("port")
@click.option(
    "--volume",
    metavar="DIR",
    type=click.Path(path_type=Path, file_okay=False),
    help="Write to the DAPLink drive mounted at this folder.  [default: search for it]",
)
@click.option(
    "--probe", type=click.Choice(["pyocd"]), help="Write with a debug probe instead of the drive; needs hiltest[bench]."
)
@click.option("--force", is_flag=True, help="Write to the folder of --volume even if it is not a USB drive.")
@click.argument("elf", required=False, callback=parsed(file_name))
def flash(
    elf: str | None, rig: str | None, port: str | None, volume: Path | None, probe: str | None, force: bool
) -> tuple[int, Flashed]:
    """Write firmware to an FRDM-K64F and check that it runs.

    ELF may also be Intel HEX or a raw binary (.bin); without it, hiltest's own firmware is flashed. Images for another
    chip, and images that would lock this one, are rejected before anything is written.
    """
    from hiltest.boards import default_firmware
    from hiltest.boards.flashing.flash_image import load_flash_image
    from hiltest.boards.flashing.flashing import find_target
    from hiltest.boards.flashing.flashing import flash as put_on
    from hiltest.session.progress_line import ProgressLine

    if probe and volume:
        raise click.UsageError("--probe does not use the drive: leave out --volume")
    described = load_named_rig(rig) if rig else None
    if elf is None and described is not None and not described.answers_requests:
        raise click.UsageError(f"name the ELF: the firmware of rig {described.name} is not hiltest's own")
    image = load_flash_image(Path(elf) if elf else default_firmware())
    target = find_target(rig=described, port=port, volume=volume, by_probe=bool(probe))
    line = ProgressLine(ErrorOutput(), shown=sys.stderr.isatty(), say=lambda text: click.echo(text, err=True))
    try:
        done = put_on(image, target, by_probe=bool(probe), is_forced=force, progress=line)
    finally:
        line.clear()
    click.echo(done.sentence(image, target))
    return 0, Flashed(
        file=image.image.name,
        bytes=image.size,
        build_id=image.image.build_id,
        by=probe or "daplink",
        serial_number=done.serial_number or None,
        port=target.port,
        volume=str(target.volume) if target.volume and not probe else None,
        answered=done.identity.build_id if done.identity else None,
        said=done.said,
    )
