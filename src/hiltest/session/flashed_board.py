"""A session whose board is flashed before it is opened."""

from __future__ import annotations

from hashlib import sha256
from typing import TYPE_CHECKING

import pytest

from hiltest.errors import BenchError, ConfigError, ProtocolError
from hiltest.session.progress_line import progress_of

if TYPE_CHECKING:
    from hiltest.session.bench_session import HilSession


def open_flashed(hil: HilSession) -> list[str]:
    """Flash the firmware of a session onto its board and open the board; return the actions in sentences.

    A board that could not be flashed is lost: the first test that needs it is charged with it. The record names the
    flashed file as the board's ELF.

    Raises
    ------
    pytest.UsageError
        If the board is virtual, the image is refused, or for the reasons of `HilSession.open`; nothing is flashed then.
    """
    from hiltest.boards import OnChip
    from hiltest.boards.bench import firmware_of
    from hiltest.boards.flashing.flash_image import load_flash_image
    from hiltest.boards.flashing.flashing import find_target, flash

    if hil.hands_out or hil.is_worker:
        raise pytest.UsageError("--flash needs a single process: leave out -n")
    for name in ("coverage", "replay"):
        if getattr(hil.settings, name) is not None:
            other = hil.settings.sources[name]
            raise pytest.UsageError(f"--flash needs a real board, which {other} excludes: leave one of them out")
    actions = []
    try:
        file = hil.settings.firmware or firmware_of(hil.rig)
        if hil.settings.base is not None:
            raise ConfigError("--flash writes a raw binary to address 0: leave out --base, or use ELF or Intel HEX")
        image = load_flash_image(file)
        target = find_target(rig=hil.rig, port=hil.settings.port)
        hil.open(with_board=False)
        done = flash(image, target, progress=progress_of(hil.config))
        actions = [done.sentence(image, target)]
        digest = sha256(file.read_bytes()).hexdigest()
        hil.on_chip = OnChip(digest, image.image.compiler_flags, image.image.build_id)
    except ConfigError as error:
        raise pytest.UsageError(str(error)) from error
    except (BenchError, ProtocolError) as error:
        hil.trouble = error
    if hil.rig.answers_requests:  # other firmware needs the ELF, since it reads variables by name
        hil.settings = hil.settings._replace(firmware=None)
    hil.open(with_board=True)
    return actions
