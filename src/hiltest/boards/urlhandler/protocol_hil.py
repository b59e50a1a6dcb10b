"""``hil://``: a virtual board as a serial port, for any program that uses pyserial."""

from __future__ import annotations

from pathlib import Path
from urllib.parse import parse_qs, urlsplit

import serial

from hiltest.bench_files import rig_file
from hiltest.boards.bench import VirtualBench
from hiltest.boards.gdb_server import GdbServer
from hiltest.boards.virtual_port import VirtualPort
from hiltest.errors import HiltestError
from hiltest.rig.file import load_rig

_KEYS = ("base", "firmware", "gdb", "rig", "seed")
_LAST_PORT = 65_535


class Serial(VirtualPort):
    """The port behind ``hil://?rig=R&seed=N&firmware=FILE&base=ADDRESS``; every part may be left out.

    The board is powered on when the port is opened. Its clock moves while the host reads.
    With ``gdb=3333`` GDB can come to that TCP port, 0 any free one: see docs/debug.md.

    Attributes
    ----------
    gdb : GdbServer or None
    """

    gdb: GdbServer | None = None

    def open(self) -> None:
        """Power on the board that the URL describes.

        Raises
        ------
        serial.SerialException
            When the URL, the rig or the firmware is wrong.
        """
        try:
            given = _given(self.portstr or "hil://")
            bench = _bench(given)
            bench.machine.boot()
            if "gdb" in given:
                self.gdb = GdbServer(bench.machine, _port(given["gdb"]))
            bench.power_on()
            self.attach(bench.machine)
        except (HiltestError, ValueError) as error:
            raise serial.SerialException(f"cannot open {self.portstr}: {error}") from error
        super().open()

    def close(self) -> None:
        """Close the port, and send GDB away."""
        if self.gdb is not None:
            self.gdb.close()
            self.gdb = None
        super().close()


def _given(url: str) -> dict[str, str]:
    given = parse_qs(urlsplit(url).query, strict_parsing=True) if "?" in url else {}
    unknown = sorted(set(given) - set(_KEYS))
    if unknown:
        raise ValueError(f"{unknown[0]!r} is not a part of a hil:// URL; known: {', '.join(_KEYS)}")
    return {key: values[0] for key, values in given.items()}


def _port(text: str) -> int:
    if not text.isdigit() or int(text) > _LAST_PORT:
        raise ValueError(f"gdb={text!r} is no TCP port")
    return int(text)


def _bench(first: dict[str, str]) -> VirtualBench:
    seed = first.get("seed")
    if seed is not None and not seed.isdigit():
        raise ValueError(f"seed={seed!r} is no whole number")
    firmware, base = first.get("firmware"), first.get("base")
    return VirtualBench(
        load_rig(rig_file(Path.cwd(), first.get("rig"))),
        firmware=Path(firmware) if firmware else None,
        seed=int(seed) if seed else None,
        base=None if base is None else int(base, 0),
    )
