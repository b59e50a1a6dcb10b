"""Lines to a motor controller with Grbl 1.1, and its answers."""

from __future__ import annotations

import re
import time
from dataclasses import dataclass

import serial

from hiltest.errors import TurntableError
from hiltest.link.ports import SerialPort

# Startup time: an Arduino restarts when its port is opened, and is silent for 2 s.
_START_S = 6.0
# Timeout of an answer: Grbl answers within some 20 ms; the rest is for networks and busy hosts.
_ANSWER_S = 5.0
# Time without a change of position after which a moving table counts as stuck.
_STALLED_S = 10.0
# Longest duration of a move.
_LONGEST_S = 600.0
_LOOK_EVERY_S = 0.25
_QUIET_S = 0.2

_STATUS = re.compile(r"<([A-Za-z]+)(?::\d+)?\|MPos:(-?\d+(?:\.\d*)?),(-?\d+(?:\.\d*)?),(-?\d+(?:\.\d*)?)(?:\||,|>)")
_SETTING = re.compile(r"\$(\d+)=(-?\d+(?:\.\d*)?)")
_MEANINGS = {
    "error:5": "homing is disabled in the controller ($22)",
    "error:8": "it is not idle",
    "error:9": "it is locked after an alarm; home it with $H, or unlock it with $X if that is safe",
    "error:15": "the angle is beyond the table's travel",
    "error:33": "the angle is beyond the table's travel",
    "ALARM:1": "a limit switch stopped it; check it before you continue",
    "ALARM:2": "the angle is beyond the table's travel ($130 to $132)",
}


@dataclass(frozen=True, slots=True)
class GrblStatus:
    """A status report."""

    state: str
    """``Idle``, ``Run``, ``Hold``, ``Alarm``, ``Home`` and others."""
    position: tuple[float, float, float]
    """Machine position of X, Y, Z."""


class GrblLine:
    """The host's end of the line to a Grbl controller. Every wait has a timeout.

    Parameters
    ----------
    port
        Open port with reads limited to some 50 ms. This object closes it.

    Raises
    ------
    TurntableError
        When no Grbl controller answers on the port.
    """

    def __init__(self, port: SerialPort) -> None:
        self._port = port
        self._partial = b""
        self._owed: list[str] = []  # sent lines that are not answered yet
        try:
            self._synchronise()
        except TurntableError:
            port.close()
            raise

    def ask(self, line: str, *, moving: bool = False) -> list[str]:
        """Send a line and return the answers until ``ok``.

        Parameters
        ----------
        moving
            True if the answer comes at standstill, so that the wait lasts as long as the table turns.

        Raises
        ------
        TurntableError
            When the answer is not ``ok`` or is late, or when the line breaks.
        """
        self._settle()
        self._write(f"{line}\n".encode("ascii"))
        return self._answer(line, moving=moving)

    def begin(self, *lines: str) -> None:
        """Send lines without waiting for their answers; the next `ask` waits for them first."""
        self._settle()
        for line in lines:
            self._write(f"{line}\n".encode("ascii"))
            self._owed.append(line)

    def _settle(self) -> None:
        while self._owed:
            self._answer(self._owed.pop(0), moving=True)

    def _answer(self, line: str, *, moving: bool) -> list[str]:
        """Return the answers until ``ok``."""
        began_s = looked_s = time.monotonic()
        patience_s = _STALLED_S if moving else _ANSWER_S
        gives_up_s = began_s + patience_s
        texts: list[str] = []
        last: GrblStatus | None = None
        while time.monotonic() < min(gives_up_s, began_s + _LONGEST_S):
            for text in self._read():
                if text == "ok":
                    return texts
                self._refuse_trouble(line, text)
                status = _status(text)
                if status is None:
                    texts.append(text)
                elif last is None or status.position != last.position:
                    last, gives_up_s = status, time.monotonic() + patience_s
            if moving and time.monotonic() - looked_s > _LOOK_EVERY_S:
                looked_s = time.monotonic()
                self._write(b"?")
        where = f"; it is in state {last.state} at {last.position}" if last else ""
        raise self._error(
            f"no answer to {line!r} within {patience_s:g} s{where}. Check its power, and that it is not on hold."
        )

    def status(self) -> GrblStatus:
        """Query the table's position.

        Raises
        ------
        TurntableError
            When there is no report in time, or one without machine positions.
        """
        self._settle()
        status = self._report(_ANSWER_S)
        if status is None:
            raise self._error(f"no status report with MPos within {_ANSWER_S:g} s. Set $10=1 in the controller")
        return status

    def settings(self) -> dict[int, float]:
        """Return the controller's settings by number."""
        matches = [_SETTING.match(text) for text in self.ask("$$")]
        return {int(match[1]): float(match[2]) for match in matches if match}

    def close(self) -> None:
        self._port.close()

    def _synchronise(self) -> None:
        """Wait for a controller, and let it finish commands of other programs."""
        if self._report(_START_S) is None:
            raise self._error(
                f"nothing answered '?' as Grbl 1.1 does within {_START_S:g} s. Check that this is the turntable's "
                "port, at 115200 baud, and that $10=1 is set."
            )
        # Terminates a line that another program left unfinished; the answer to it is ignored.
        self._write(b"\n")
        quiet_since_s = began_s = time.monotonic()
        while time.monotonic() - quiet_since_s < _QUIET_S and time.monotonic() - began_s < _START_S:
            if self._read():
                quiet_since_s = time.monotonic()
        if self.status().state != "Alarm":
            self.ask("", moving=True)

    def _report(self, within_s: float) -> GrblStatus | None:
        ends_s = time.monotonic() + within_s
        while time.monotonic() < ends_s:
            self._write(b"?")
            looked_s = time.monotonic()
            while time.monotonic() - looked_s < _LOOK_EVERY_S:
                for text in self._read():
                    status = _status(text)
                    if status is not None:
                        return status
        return None

    def _refuse_trouble(self, line: str, text: str) -> None:
        if text.startswith(("error:", "ALARM:")):
            meaning = _MEANINGS.get(text, "see the list of Grbl 1.1's codes")
            raise self._error(f"{line!r} was answered by {text}: {meaning}")

    def _read(self) -> list[str]:
        """Return the lines that are completed within one read slice."""
        try:
            self._partial += self._port.read_until(b"\n")
        except (serial.SerialException, OSError) as error:
            raise self._error(f"lost: {error}. Check cable and power, then run again") from error
        *lines, self._partial = self._partial.split(b"\n")
        texts = [line.decode("ascii", "replace").strip() for line in lines]
        return [text for text in texts if text]

    def _write(self, data: bytes) -> None:
        try:
            self._port.write(data)
        except (serial.SerialException, OSError) as error:
            raise self._error(f"lost: {error}. Check cable and power, then run again") from error

    def _error(self, message: str) -> TurntableError:
        return TurntableError(f"turntable on {self._port.name}: {message}")


def _status(text: str) -> GrblStatus | None:
    match = _STATUS.match(text)
    return GrblStatus(match[1], (float(match[2]), float(match[3]), float(match[4]))) if match else None
