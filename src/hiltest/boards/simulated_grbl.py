"""A virtual board's turntable behind the protocol of a motor table, Grbl 1.1.

X is heading, Y pitch, Z roll, in degrees: stock Grbl has these three letters and no others, and a table with one motor
has it on X. F is in degrees per minute. docs/serve.md explains Grbl's answers; commands that this table does not
support are refused with Grbl's error numbers.
"""

from __future__ import annotations

import re
from collections.abc import Callable

from hiltest.boards.gcode import AXES, GcodeError, Modals, Refusal, read_block
from hiltest.boards.table_axes import HOME, TableAxes
from hiltest.world import Vector
from hiltest.world.motion import TURN_SPEED_DPS

BANNER = "\r\nGrbl 1.1h ['$' for help]\r\n"
HELP = "[HLP:$$ $G $I $X $H ~ ! ? ctrl-x]"
#: A target further away is refused [deg]: a hundred turns, 5 minutes on the way.
FURTHEST_DEG = 36_000.0
#: Maximum characters of a line, and of waiting lines, as in Grbl; excess characters are lost.
LINE_LENGTH, BUFFER_LENGTH = 80, 128
#: Bytes of a line of 115 200 baud in the 2 ms of a step of `hiltest.boards.paced`.
STEP_BYTES = 24

_RESET, _STATUS, _HOLD, _RESUME = 0x18, ord("?"), ord("!"), ord("~")
_ENDS = b"\r\n"
_RESET_IN_MOTION = 3  # alarm number
_COOLANT = {"M8": True, "M08": True, "M9": False, "M09": False}  # on, off
_COMMENT = re.compile(r"\([^)]*\)?|;.*")
_SETTINGS = [
    "$10=1",
    "$13=0",
    "$20=0",
    "$21=0",
    "$22=1",
    *(f"$11{axis}={60.0 * TURN_SPEED_DPS:.3f}" for axis in range(3)),
    *(f"$13{axis}={FURTHEST_DEG:.3f}" for axis in range(3)),
]


class GrblTable:
    """The turntable at its serial line: it receives bytes, moves the axes, and answers.

    Parameters
    ----------
    about
        Text about the board on the table, for ``$I``.
    reset
        Resets the board: the table's coolant output (M8) is wired to its reset pin.

    Notes
    -----
    ``ok`` for a move means that it waits its turn, as in Grbl; ``G4 P0`` is answered when all moves
    are over. A line that cannot be taken yet is answered when it is, and the lines behind it wait.
    """

    def __init__(self, axes: TableAxes, *, about: str, reset: Callable[[], None]) -> None:
        self._axes = axes
        self._reset_board = reset
        self._about = about
        self._out = bytearray(BANNER.encode())
        self._alarm = False
        self._heard = bytearray()
        self._line = bytearray()
        self._unsent = 0  # bytes of answers that a line would still transfer
        self._after_cr = False
        self._modals = Modals()
        self._done: Callable[[], bool] | None = None

    def room(self) -> int:
        """Return the bytes of a step, or 0 while answers of earlier steps are still on the line to the host."""
        return 0 if self._unsent > BUFFER_LENGTH else STEP_BYTES

    def hear(self, data: bytes) -> None:
        """Execute real-time commands at once, and queue the rest."""
        reported = False
        for byte in data:
            if byte == _RESET:
                self._reset()
            elif byte == _STATUS:
                if not reported:  # as in Grbl, one report for all requests that come together
                    self._say(self._status())
                reported = True
            elif byte == _HOLD:
                self._axes.hold()
            elif byte == _RESUME:
                self._axes.resume()
            elif (0x20 <= byte < 0x7F or byte in _ENDS) and len(self._heard) < BUFFER_LENGTH:
                self._heard.append(byte)
            self._execute_queued()

    def say(self) -> bytes:
        """Finish completed moves, start waiting ones, and return the answers."""
        self._axes.advance()
        self._execute_queued()
        output = bytes(self._out)
        self._unsent = max(0, self._unsent + len(output) - STEP_BYTES)
        self._out.clear()
        return output

    # -- lines --------------------------------------------------------------------------------

    def _execute_queued(self) -> None:
        """Execute queued lines until one cannot be answered yet."""
        while True:
            if self._done is not None:
                if not self._done():
                    return
                self._done = None
                self._say("ok")
            if not self._heard:
                return
            self._take(self._heard.pop(0))

    def _take(self, byte: int) -> None:
        """Take one character; CR, LF, and CR LF each end one line."""
        after_cr, self._after_cr = self._after_cr, byte == 0x0D
        if byte == 0x0A and after_cr:
            return
        if byte not in _ENDS:
            self._line.append(byte)
            del self._line[LINE_LENGTH + 1 :]  # enough to see that it is too long
            return
        line, self._line = self._line, bytearray()
        try:
            self._done = self._execute(line.decode("ascii"))
        except GcodeError as error:
            self._say(str(error))

    def _execute(self, written: str) -> Callable[[], bool]:
        """Execute a line; the result says when it may be answered."""
        if len(written) > LINE_LENGTH:
            raise GcodeError(Refusal.LINE_OVERFLOW)
        line = _COMMENT.sub("", written).replace(" ", "").upper()
        if not line or line == "%":
            return _always
        if line.startswith("$"):
            return self._system(line)
        if self._alarm:
            raise GcodeError(Refusal.LOCKED)
        if line in _COOLANT:
            if _COOLANT[line]:
                self._reset_board()
            return _always
        return self._move(line)

    def _move(self, line: str) -> Callable[[], bool]:
        block = read_block(line, self._modals)
        since = self._axes.last_target_deg if block.modals.relative else HOME
        target = self._target(block.axes, since)
        self._modals = block.modals
        axes, feed_dpm = self._axes, block.modals.feed_dpm if block.modals.motion == 1 else None

        def begun() -> bool:
            """Put the movement into the queue; return whether there was room."""
            if not block.axes:
                return True
            if axes.full:
                return False
            axes.add(target, feed_dpm=feed_dpm)
            return True

        return begun if block.dwell_s is None else _sequence(self._dwell(block.dwell_s), begun)

    def _target(self, words: dict[str, float], since: Vector) -> Vector:
        planned = self._axes.last_target_deg
        heading, pitch, roll = (
            since[index] + words[axis] if axis in words else planned[index] for index, axis in enumerate(AXES)
        )
        if max(abs(heading), abs(pitch), abs(roll)) > FURTHEST_DEG:
            raise GcodeError(Refusal.INVALID_TARGET)
        return heading, pitch, roll

    def _dwell(self, seconds: float) -> Callable[[], bool]:
        axes = self._axes
        ends_s: list[float] = []

        def over() -> bool:
            if axes.busy:
                return False
            if not ends_s:
                ends_s.append(axes.time_s + seconds)
            return axes.time_s >= ends_s[0]

        return over

    def _system(self, line: str) -> Callable[[], bool]:
        if line == "$H":
            if not self._alarm:  # a table that decelerates after a reset homes from its resting position
                self._require_rest()
            self._alarm = False
            self._axes.home()
            return lambda: not self._axes.homing
        if line == "$X":
            if self._alarm:
                self._alarm = False
                self._say("[MSG:Caution: Unlocked]")
        elif line == "$$":
            self._require_rest()
            self._say(*_SETTINGS)
        elif line == "$I":
            self._require_rest()
            self._say(f"[VER:1.1h.20190825:{self._about}]", "[OPT:,15,128]")
        elif line == "$G":
            self._say(self._modes())
        elif line == "$":
            self._say(HELP)
        else:
            raise GcodeError(Refusal.UNKNOWN_SYSTEM_COMMAND)
        return _always

    def _require_rest(self) -> None:
        if self._axes.busy or self._axes.held:
            raise GcodeError(Refusal.NOT_IDLE)

    # -- reports and reset --------------------------------------------------------------------

    def _status(self) -> str:
        angles, rate_dps = self._axes.now()
        where = ",".join(f"{angle:.3f}" for angle in angles)
        return f"<{self._state()}|MPos:{where}|F:{60.0 * rate_dps:.0f}>"

    def _state(self) -> str:
        axes = self._axes
        if self._alarm:
            return "Alarm"
        if axes.held:
            return "Hold:1" if axes.turning else "Hold:0"
        if axes.homing:
            return "Home"
        return "Run" if axes.busy else "Idle"

    def _modes(self) -> str:
        modals = self._modals
        distance = "G91" if modals.relative else "G90"
        return f"[GC:G{modals.motion} G54 G17 G21 {distance} G94 F{modals.feed_dpm or 0.0:.0f}]"

    def _reset(self) -> None:
        """Handle Ctrl-X: reset all state but the position, and lock if a real table could have lost that."""
        in_motion = self._axes.turning
        self._axes.stop()
        self._heard.clear()
        self._line.clear()
        self._modals = Modals()
        self._done = None
        if in_motion:
            self._alarm = True
            self._say(f"ALARM:{_RESET_IN_MOTION}")
        self._out += BANNER.encode()
        if self._alarm:
            self._say("[MSG:'$H'|'$X' to unlock]")

    def _say(self, *lines: str) -> None:
        for line in lines:
            self._out += f"{line}\r\n".encode()


def _always() -> bool:
    return True


def _sequence(first: Callable[[], bool], then: Callable[[], bool]) -> Callable[[], bool]:
    """Return a condition that is met once `first` and then `then` is."""
    return lambda: first() and then()
