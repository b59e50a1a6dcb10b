"""Exceptions of hiltest, by cause: bench, protocol, data or configuration.

The four branches decide the exit code of a run: the bench (20), the wrong
firmware or protocol (23), the configuration (4, pytest's usage error), and data
that cannot support a calibration (an ordinary test failure, 1).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from difflib import get_close_matches

LIKELY_CAUSE = "; likely cause: "
"""Text between a message and the likely cause in it; a sentence with the next step follows the cause."""

NOT_CALIBRATED = "the firmware has not calibrated its magnetometer"
"""Begin of the message on firmware that reports no calibration of its own after the tumbles."""


class HiltestError(Exception):
    """Root of every error that hiltest raises intentionally."""


class BenchError(HiltestError):
    """The bench cannot deliver: port, cable, board, turntable. Exit code 20."""


class ProtocolError(HiltestError):
    """Bytes arrived and have a wrong meaning. Exit code 23."""


class CalibrationError(HiltestError):
    """The data cannot support the requested answer."""


class ConfigError(HiltestError):
    """A file, an option or an argument is wrong. Exit code 4."""


class NothingRecordedError(ConfigError):
    """There is no record: no file, a journal that was removed again, or one that has no first line yet."""


class NotOfferedError(ConfigError):
    """The interface to the firmware does not offer what was asked of the board."""


class PortNotFoundError(ConfigError):
    """The named serial port does not exist; the option is wrong, and the bench may be fine."""

    def __init__(self, requested: str, available: Sequence[str], *, of_virtual_rig: bool = False) -> None:
        self.requested = requested
        self.available = tuple(available)
        ports = ", ".join(self.available) if self.available else "none"
        without = ", or leave the option out for the virtual board" if of_virtual_rig else ""
        super().__init__(
            f"no serial port {requested!r}; ports on this machine: {ports}. Name one of them with --port{without}."
        )


class NoBoardError(BenchError):
    """No board is plugged in, or none with the requested serial number."""

    def __init__(self, requested: str, available: Sequence[str]) -> None:
        self.available = tuple(available)
        boards = ", ".join(available) or "none"
        which = (
            f" whose serial number begins with {requested!r}; boards that are plugged in: {boards}" if requested else ""
        )
        super().__init__(
            f"no FRDM-K64F is plugged in{which}. Plug it in at the USB socket next to its reset button (J26, OpenSDA); "
            "`hiltest ports` lists the ports, and --port selects a board on another one"
        )


class SeveralBoardsError(ConfigError):
    """More than one board is plugged in, and neither rig nor option names one."""

    def __init__(self, available: Sequence[str]) -> None:
        self.available = tuple(available)
        super().__init__(
            f"{len(available)} boards match: {', '.join(available)}. Select one by its serial number: "
            f"--port usb://{available[0]}, or "
            f'port = "usb://{available[0]}" under [board] in the rig'
        )


class PortRefusedError(BenchError):
    """The serial port exists and may not be used."""

    def __init__(self, port: str, reason: str, hint: str) -> None:
        self.port = port
        super().__init__(f"cannot use {port}: {reason}. {hint}")


class FlashError(BenchError):
    """Firmware could not be flashed, or the result is unknown."""


class LinkLostError(BenchError):
    """The link broke while it was in use."""

    def __init__(self, port: str, reason: str) -> None:
        self.port = port
        super().__init__(f"lost {port}: {reason}. Check cable and power, then run again.")


class SyncError(BenchError):
    """Nothing on the port answered the synchronisation nonce."""

    def __init__(self, port: str, heard: bytes, attempts: int, wrong_speed: str = "") -> None:
        self.port = port
        self.heard = heard
        self.attempts = attempts
        heard_text = f"only {len(heard)} other bytes ({heard[:16].hex(' ')})" if heard else "and no other byte"
        advice = "Check that the board runs hiltest's firmware, and the baud rate."
        super().__init__(
            f"no answer to {attempts} synchronisation requests on {port}, {heard_text}. "
            + (f"The cause: {wrong_speed}." if wrong_speed else advice)
        )


class DeviceTimeoutError(BenchError, TimeoutError):
    """The board did not answer a command before its deadline."""

    def __init__(self, command: str, deadline_s: float, clock: str, state: str = "", noise: str = "") -> None:
        self.command = command
        self.clock = clock
        self.state = state
        reason = f": the firmware is {state}" if state else ""
        reason += f". The line is noisy: {noise}. Check cable, ground and baud rate" if noise else ""
        super().__init__(f"no answer to {command} within {deadline_s:g} s ({clock} time){reason}")


class BoardResetError(BenchError):
    """The board was reset during the run: the points and calibrations that it had stored are gone."""

    def __init__(self, carried_out: int, answered: int) -> None:
        self.carried_out = carried_out
        self.answered = answered
        super().__init__(
            f"the board was reset: it executed at least {answered} requests, and counts {carried_out} since its "
            "start. Its stored points and calibrations are lost. Look for a weak supply, a watchdog or a "
            "fault of the firmware, then run again."
        )


class DeviceSilentError(BenchError, TimeoutError):
    """Firmware sends nothing."""

    def __init__(self, seconds: float, clock: str, state: str = "") -> None:
        doing = f"; it is {state}" if state else ""
        super().__init__(
            f"the firmware sent nothing in {seconds:g} s ({clock} time){doing}. Check that it prints on this port "
            "without "
            "requests. For hiltest's own firmware, which waits for requests, use a rig without a [device] table"
        )


class DebugServerError(BenchError):
    """The GDB server of a board cannot be reached, has ended, or answers nonsense."""

    def __init__(self, server: str, reason: str) -> None:
        self.reason = reason
        super().__init__(f"debug server {server}: {reason}")


class SchedulerError(BenchError):
    """The scheduler that shares the work cannot be reached, has no workers, or lost them."""

    def __init__(self, address: str, reason: str) -> None:
        super().__init__(f"scheduler {address}: {reason}")


class SensorAbsentError(BenchError):
    """A sensor that a procedure needs does not answer; procedures without sensors still run."""

    def __init__(self, requested: str, available: Sequence[str], hint: str) -> None:
        self.available = tuple(available)
        sensors = ", ".join(self.available) if self.available else "none"
        super().__init__(f"no {requested} answers on the board; sensors that answer: {sensors}. {hint}")


class SensorFaultError(BenchError):
    """A sensor gives samples that are impossible for a sound one; procedures without it still run."""


class OperatorAbsentError(BenchError):
    """No operator answers to turn the board; tests that need no turning still run."""

    @classmethod
    def asked(cls, question: str) -> OperatorAbsentError:
        """Return the error of a question without an answer; remarks before the request are left out."""
        *_, request = [question, *(line for line in question.splitlines() if not line.lstrip().startswith("Enter"))]
        return cls(
            f"no operator answered at the terminal: {request.strip().rstrip(':.')}. "
            "Run the command at a terminal where an operator can turn the board."
        )


class SnapshotError(BenchError):
    """A virtual board cannot take a snapshot now, or cannot return to one."""


class TurntableError(BenchError):
    """The motor table malfunctions; procedures without turning still run."""


class DivergenceError(BenchError):
    """A replayed run asks a question that the recorded run did not ask, so its recording has no answer.

    Parameters
    ----------
    place, time_s, test
        File and line of the recording at which the two runs differ, its time there by the board's clock [s], and the
        test that was recorded, which is empty before the first.
    """

    def __init__(self, place: str, asked: str, recorded: str, *, time_s: float = 0.0, test: str = "") -> None:
        where = f"{place}, at {time_s:.6f} s" + (f" in {test}" if test else "")
        super().__init__(f"this run differs from the recorded one: {asked}, but {where} {recorded}")


class BoardFault(BenchError):
    """The virtual board's processor had a fault, or hung.

    Attributes
    ----------
    cause : str
        First event, in the processor's terms.
    function, location : str
        Symbol and ``file:line`` of the instruction; empty if the ELF has none.
    registers : dict of str to int
        Core registers at the fault.
    ending : str
        Reaction of the firmware to the fault until it stopped; empty without one.
    """

    def __init__(
        self,
        cause: str,
        *,
        pc: int,
        function: str = "",
        location: str = "",
        registers: dict[str, int] | None = None,
        ending: str = "",
    ) -> None:
        self.cause = cause
        self.pc = pc
        self.function = function
        self.location = location
        self.registers = dict(registers or {})
        self.ending = ending
        state = " ".join(f"{name}=0x{value:08x}" for name, value in self.registers.items())
        first = f"{cause} at {place_of(pc, function, location)}"
        super().__init__((f"{ending}, after: " if ending else "") + first + (f"; {state}" if state else ""))

    def located(self, place: str) -> BoardFault:
        """Return this fault with the place of the judged call before its cause."""
        return BoardFault(**vars(self) | {"cause": f"{place}: {self.cause}"})

    def ended(self, ending: str) -> BoardFault:
        """Return this fault with its ending."""
        return BoardFault(**vars(self) | {"ending": ending})


def remove_registers(message: str) -> str:
    """Return a message without the registers of a `BoardFault`."""
    return re.sub(r";( \w+=0x[0-9a-f]{8})+", "", message)


def place_of(pc: int, function: str, location: str) -> str:
    """Return the position of code: address, function and ``file:line`` as far as they are known."""
    return f"0x{pc:08x}" + (f" in {function}" if function else "") + (f" ({location})" if location else "")


class FrameError(ProtocolError):
    """A frame is damaged: length, check value or escape sequence."""


class SequenceError(ProtocolError):
    """A reply carries the sequence number of another request."""

    def __init__(self, expected: int, got: int) -> None:
        super().__init__(f"reply has sequence number {got}, request had {expected}")


class VersionMismatchError(ProtocolError):
    """The firmware speaks another protocol version, or is another firmware."""


class OtherFirmwareError(VersionMismatchError):
    """Another firmware speaks the right protocol."""


class DeviceError(HiltestError):
    """The firmware answered a command with an error code.

    Attributes
    ----------
    command, status : str
        Names in the protocol.
    """

    def __init__(self, command: str, status: str, hint: str = "") -> None:
        self.command = command
        self.status = status
        super().__init__(f"the board answered {command} with {status}" + (f": {hint}" if hint else ""))

    @property
    def is_of_sensors(self) -> bool:
        """True if a sensor or its bus malfunctioned."""
        return self.status in ("SENSOR_ABSENT", "SENSOR_TIMEOUT", "BUS_ERROR")


class FirmwareContradictionError(HiltestError):
    """An answer of the firmware contradicts its other answers, or the board's observations."""


class PoorCoverageError(CalibrationError):
    """The points do not cover enough of the sphere to fit an ellipsoid."""


class FaceError(CalibrationError):
    """The board lies on another face than it should, moved there, or the faces contradict each other.

    Attributes
    ----------
    faces : tuple of int
        Faces at fault: 0 to 5 are body +x, -x, +y, -y, +z, -z down.
    """

    def __init__(self, message: str, *, faces: Sequence[int]) -> None:
        self.faces = tuple(faces)
        super().__init__(message)


class UnknownKeyError(ConfigError):
    """A configuration file has an unknown key."""

    def __init__(self, key: str, *, where: str, known: Sequence[str]) -> None:
        self.nearest = next(iter(get_close_matches(key, known, n=1, cutoff=0.5)), None)
        super().__init__(f"{where}: unknown key {key!r}; {nearest_hint(key, known, 'known keys')}")


def nearest_hint(name: str, allowed: Sequence[str], heading: str = "known") -> str:
    """Return a hint for a wrong name: the nearest allowed one, or all of them."""
    nearest = next(iter(get_close_matches(name, allowed, n=1, cutoff=0.5)), None)
    return f"did you mean {nearest!r}?" if nearest else f"{heading}: {', '.join(sorted(set(allowed))) or 'none'}"


def board_is_gone(error: BenchError | ProtocolError) -> bool:
    """Return whether an error means that later tests cannot use the board.

    A missing or faulty sensor, operator or table does not: tests that do not need it still run.
    """
    return not isinstance(error, SensorAbsentError | SensorFaultError | OperatorAbsentError | TurntableError)
