"""``hil://``: a virtual board as a serial port, for any program that uses pyserial."""

from __future__ import annotations

import warnings
from pathlib import Path
from urllib.parse import parse_qs, urlsplit

import serial

from hiltest.boards.bench import VirtualBench
from hiltest.boards.gdb_server import GdbServer
from hiltest.boards.virtual_port import VirtualPort
from hiltest.errors import HiltestError
from hiltest.rig.bench_files import rig_file
from hiltest.rig.rig_file import load_rig

_KEYS = ("base", "firmware", "gdb", "rig", "seed")
_LAST_PORT = 65_535
_LARGEST_WORD = (1 << 32) - 1


class PlaybackWarning(UserWarning):
    """Warning that a board's playback deviated from the recording."""


class Serial(VirtualPort):
    """The port behind ``hil://?rig=R&seed=N&firmware=FILE&base=ADDRESS``; every part may be left out.

    The board is powered on when the port is opened. Its clock advances while the host reads. With ``gdb=3333`` GDB can
    connect to that TCP port, 0 for any free one: see docs/debug.md.

    Attributes
    ----------
    gdb : GdbServer or None
    """

    gdb: GdbServer | None = None
    _bench: VirtualBench | None = None

    def open(self) -> None:
        """Power on the board that the URL describes.

        Raises
        ------
        serial.SerialException
            When the URL, the rig or the firmware is wrong.
        """
        try:
            parameters = _parse_query(self.portstr or "hil://")
            gdb = _number(parameters, "gdb", "TCP port", _LAST_PORT)
            bench = _bench(parameters)
            bench.machine.boot()
            if gdb is not None:
                self.gdb = GdbServer(bench.machine, gdb)
            bench.power_on()
            self.attach(bench.machine)
            self._bench = bench
        except (HiltestError, ValueError) as error:
            self._dismiss_gdb()
            raise serial.SerialException(f"cannot open {self.portstr}: {error}") from error
        super().open()

    def close(self) -> None:
        """Close the port, and disconnect GDB."""
        self._dismiss_gdb()
        if self.is_open and self._bench is not None:
            for sentence in self._bench.said_of_playback:
                warnings.warn(sentence, PlaybackWarning, stacklevel=2)
        super().close()

    def _dismiss_gdb(self) -> None:
        if self.gdb is not None:
            self.gdb.close()
            self.gdb = None


def _parse_query(url: str) -> dict[str, str]:
    parameters = parse_qs(urlsplit(url).query, strict_parsing=True) if "?" in url else {}
    unknown = sorted(set(parameters) - set(_KEYS))
    if unknown:
        raise ValueError(f"{unknown[0]!r} is not a part of a hil:// URL; known: {', '.join(_KEYS)}")
    return {key: values[0] for key, values in parameters.items()}


def _number(parameters: dict[str, str], key: str, name: str, most: int) -> int | None:
    """Return a number from the URL; None if it is absent."""
    if key not in parameters:
        return None
    try:
        number = int(parameters[key], 0)
    except ValueError:
        number = -1
    if not 0 <= number <= most:
        raise ValueError(f"{key}={parameters[key]!r} is no {name}")
    return number


def _bench(parameters: dict[str, str]) -> VirtualBench:
    firmware = parameters.get("firmware")
    return VirtualBench(
        load_rig(rig_file(Path.cwd(), parameters.get("rig"))),
        firmware=Path(firmware) if firmware else None,
        seed=_number(parameters, "seed", "whole number", _LARGEST_WORD),
        base=_number(parameters, "base", "address", _LARGEST_WORD),
    )
