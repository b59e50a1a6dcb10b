"""``usb://SERIAL``: the serial port of the board that is plugged in with that serial number, or its beginning."""

from __future__ import annotations

import serial

from hiltest.boards.daplink import port_of


def serial_class_for_url(url: str) -> tuple[str, type[serial.Serial]]:
    """Return the device of the board, and pyserial's class that opens it; ``usb://`` alone means the only board.

    Raises
    ------
    BenchError
        When there is no such board, or it has no serial port.
    SeveralBoardsError
        When there are several.
    """
    return port_of(url.partition("://")[2].strip("/")), serial.Serial
