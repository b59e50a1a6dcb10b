"""Firmware with its own output as the interface: hiltest listens, or reads its memory, but sends no requests."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from typing import Any, Protocol, runtime_checkable

import numpy as np
import serial
from numpy.typing import NDArray

from hiltest.boards.memory_reading import memory_kind
from hiltest.errors import (
    ConfigError,
    DeviceSilentError,
    DeviceTimeoutError,
    HiltestError,
    LinkLostError,
    VersionMismatchError,
)
from hiltest.interfaces.kinds import Decoder, feed_decoder, open_interfaces, sources_of
from hiltest.interfaces.line_input import LineInput
from hiltest.interfaces.quantities import Moment, Observation, Quantity, StreamInterface
from hiltest.interfaces.text_interface import TextInterface
from hiltest.link.ports import SerialPort
from hiltest.link.transcript import Direction, Transcript
from hiltest.rig import Rig
from hiltest.rig.device import Device
from hiltest.tape.tape import LIVE, Tape
from hiltest.text import is_text, join_words, legible
from hiltest.virtual.board.virtual_machine import VirtualMachine
from hiltest.virtual.program.elf import FirmwareImage

# Duration of one read, and the period at which variables are read from memory.
_SLICE_S = 0.1
_MOST_BYTES = 1 << 16
# Longest silence of the firmware after its declared start before it counts as failed.
_SILENT_S = 5.0
_SHOWN_BYTES = 48
POLLED = "device.polled"
"""Question about the kinds that read the board's memory."""


class OutputInterface:
    """Firmware that reports its heading by itself, in lines, packets or variables: it has reported something.

    Parameters
    ----------
    port
        Open; the interface closes it. One with a ``now()`` has a clock of its own.
    rig
        Rig with a ``[device]`` table.
    decoders
        Decoders of the firmware's output, by kind.
    transcript
        Receives every byte, in both directions.
    may_be_overheard
        True to listen while an operator answers; that output is no part of a recording.

    Attributes
    ----------
    offers : frozenset of Quantity
        Quantities that the firmware may report.
    latest : dict of Quantity to ndarray
        Latest value of each.
    errors : Counter of str
        Errors that it reported, and how often.

    Raises
    ------
    DeviceSilentError
        When the firmware stays silent.
    VersionMismatchError
        When none of the output can be interpreted.
    """

    def __init__(
        self,
        port: Any,
        rig: Rig,
        decoders: Mapping[str, Decoder],
        *,
        transcript: Transcript | None = None,
        may_be_overheard: bool = True,
    ) -> None:
        assert rig.device is not None
        self.rig = rig
        self.device: Device = rig.device
        self.may_be_overheard = may_be_overheard
        self._port = port
        own_clock: Callable[[], float] | None = getattr(port, "now", None)
        self.clock: str = getattr(port, "clock", "virtual" if own_clock else "wall")
        self.now_s: Callable[[], float] = own_clock or time.monotonic
        self._transcript = transcript
        if transcript is not None and not transcript.clock:
            transcript.clock = self.clock
        self.decoders = decoders
        self._sources = sources_of(rig, decoders)
        self.offers = frozenset(self._sources)
        self.latest: dict[Quantity, NDArray[np.float64]] = {}
        self.errors: Counter[str] = Counter()
        self._read_at_s: dict[str, float] = {}
        self._input = LineInput()
        self._heard_at_s = -math.inf
        self._asked_at_s = -math.inf
        self._is_answered = True
        self._first = b""
        try:
            self._begin()
        except BaseException:
            with suppress(OSError):
                self.close()
            raise

    def _begin(self) -> None:
        """Wait for the firmware's first output, and send the commands for its start."""
        self.observe(self.device.start_s, asks=False)
        self.send(Moment.START)
        began_s = self.now_s()
        while not any(observation.values for observation in self.observe(_SLICE_S)):
            if self.now_s() < began_s + _SILENT_S:
                continue
            if not self._input.count:
                raise DeviceSilentError(self.device.start_s + _SILENT_S, self.clock, self.position())
            is_text = all(isinstance(decoder, TextInterface) for decoder in self.decoders.values())
            remark = self._input.remark(self.now_s(), wrong_speed=self._wrong_speed(), is_text=is_text)
            counted = f"{self._input.count} bytes arrived, and none could be interpreted"
            raise VersionMismatchError(self._not_understood(counted, remark))

    def heading_missing(self, seconds: float, window: Sequence[Observation]) -> HiltestError:
        """Return why an interval brought no heading: the firmware fell silent, or its output has none.

        Parameters
        ----------
        window
            Observations of that interval.
        """
        if self.now_s() - self._heard_at_s > seconds - _SLICE_S:
            return DeviceTimeoutError("a heading", seconds, self.clock, self.position())
        others = sorted({quantity.key for observation in window for quantity in observation.values})
        return VersionMismatchError(
            self._not_understood(
                f"the firmware sends output, but no heading in {seconds:g} s"
                + (f", only {join_words(others, 3)}" if others else "")
            )
        )

    def _wrong_speed(self) -> str:
        speeds: str = getattr(self._port, "wrong_speed", "")
        return speeds

    def _not_understood(self, summary: str, remark: str = "") -> str:
        """Return a message with all that helps to find the reason."""
        reasons = [*([remark] if remark else []), *(f"it reports {text!r}" for text in self.errors), *self.remarks()]
        return (
            "; ".join(
                [
                    f"{summary} by [device] kind {', '.join(self.decoders)}",
                    *reasons,
                    f"its output begins with {self._first_words()}",
                ]
            )
            + f". Check the firmware and the baud rate {self.rig.link.baud}; hiltest listen shows its output"
        )

    def observe(self, seconds: float, *, asks: bool = True) -> list[Observation]:
        """Listen for a time of the board's clock [s]; return the observations.

        Parameters
        ----------
        asks
            True to ask for values, if the firmware reports them only on request.

        Raises
        ------
        LinkLostError
            When the port breaks.
        BoardFault
            When the firmware of a virtual board faults, or hangs.
        """
        end_s = self.now_s() + seconds
        heard: list[Observation] = []
        while (left_s := end_s - self.now_s()) > 1e-9:
            if asks:
                self._ask()
            data = self._read(min(_SLICE_S, left_s))
            now_s = self.now_s()
            for kind, decoder in self.decoders.items():
                observations: Sequence[Observation]
                if isinstance(decoder, StreamInterface):
                    observations = feed_decoder(kind, decoder, data, now_s) if data else ()
                else:
                    observations = [decoder.read(now_s)] if self._is_due(kind, now_s) else ()
                heard += (self._use_as_source(kind, observation) for observation in observations)
                self._is_answered |= any(observation.values for observation in observations)
        for observation in heard:
            self.latest.update(observation.values)
        self.errors.update(observation.error for observation in heard if observation.error)
        return heard

    def _ask(self) -> None:
        """Ask for values, unless an earlier request may still be answered."""
        now_s = self.now_s()
        if self._is_answered or now_s >= self._asked_at_s + self.device.window_s:
            self._asked_at_s, self._is_answered = now_s, False
            self.send(Moment.ASK)

    def _is_due(self, kind: str, now_s: float) -> bool:
        """Return whether to read now: a decoder with the heading in every slice, the others once a window."""
        every_s = 0.0 if self._sources.get(Quantity.HEADING) == kind else self.device.window_s
        if now_s < self._read_at_s.get(kind, -math.inf) + every_s - _SLICE_S / 2.0:
            return False
        self._read_at_s[kind] = now_s
        return True

    def send(self, moment: Moment) -> None:
        """Send the commands of a moment."""
        for decoder in self.decoders.values():
            command = decoder.commands(moment) if isinstance(decoder, StreamInterface) else b""
            if command:
                self._note(Direction.TO_BOARD, command)
                with self._raise_as_lost_link():
                    self._port.write(command)

    def sleep(self, seconds: float) -> None:
        """Wait, by the board's clock [s], and drop the firmware's output."""
        self.observe(seconds, asks=False)

    def remarks(self) -> tuple[str, ...]:
        """Return remarks on the interpretation of the firmware's output; empty without any."""
        return tuple(
            remark
            for decoder in self.decoders.values()
            if isinstance(decoder, _Remarking)
            for remark in decoder.remarks()
        )

    def position(self) -> str:
        """Return a description of the firmware's present activity; empty if unknown."""
        position: Callable[[], str] | None = getattr(self._port, "position", None)
        return position() if position else ""

    def close(self) -> None:
        """Close the port and the debug server."""
        hang_up(self.decoders)
        self._port.close()

    def _read(self, seconds: float) -> bytes:
        with self._raise_as_lost_link():
            if self._port.timeout != seconds:  # because it reconfigures a real port
                self._port.timeout = seconds
            data = bytes(self._port.read(_MOST_BYTES))
        if data:
            self._note(Direction.TO_HOST, data)
            self._input.take(data)
            self._heard_at_s = self.now_s()
            self._first += data[: _SHOWN_BYTES - len(self._first)]
        return data

    @contextmanager
    def _raise_as_lost_link(self) -> Iterator[None]:
        try:
            yield
        except (serial.SerialException, OSError) as error:
            raise LinkLostError(str(self._port.name), str(error)) from error

    def _first_words(self) -> str:
        """Return the first bytes, as text if possible."""
        if is_text(self._first):
            return repr(legible(self._first.decode("utf-8", errors="replace")))
        return f"{self._first.hex(' ')} (hex)"

    def _note(self, direction: Direction, data: bytes) -> None:
        if self._transcript is not None:
            self._transcript.add(self.now_s(), direction, data)

    def _use_as_source(self, kind: str, observation: Observation) -> Observation:
        values = {
            quantity: numbers for quantity, numbers in observation.values.items() if self._sources[quantity] == kind
        }
        return replace(observation, values=values)


def open_output(
    rig: Rig,
    open_line: Callable[[], SerialPort],
    *,
    image: FirmwareImage | None,
    machine: VirtualMachine | None = None,
    transcript: Transcript | None = None,
    tape: Tape = LIVE,
) -> OutputInterface:
    """Open the decoders of a rig, then its port, and wait for the firmware's first output.

    Parameters
    ----------
    rig
        Rig with a ``[device]`` table.
    open_line
        Opens the port.
    image
        The ELF that runs on the board; None if it is unknown.
    machine
        The virtual board, which has not run; None for a real one.
    transcript
        Receives every byte, in both directions.
    tape
        Records all questions.

    Raises
    ------
    ConfigError
        When no decoder offers a heading, or the rig names what does not exist; no port is opened then.
    BenchError, VersionMismatchError
        When the port cannot be opened; and see `OutputInterface`.
    """
    decoders = open_interfaces(rig, {"memory": memory_kind(image, machine)})
    try:
        if Quantity.HEADING not in sources_of(rig, decoders):
            raise ConfigError(
                f"{rig.where('device', 'kind')}: device.kind: {', '.join(decoders)} offers no heading, which the "
                "test needs; name it in the rig (docs/compass.md)"
            )
        port = tape.port(open_line)
        return OutputInterface(
            port, rig, tape_decoders(decoders, tape), transcript=transcript, may_be_overheard=tape is LIVE
        )
    except BaseException:
        hang_up(decoders)
        raise


def hang_up(decoders: Mapping[str, Decoder]) -> None:
    """Close the connections of decoders. Idempotent."""
    for decoder in decoders.values():
        if isinstance(decoder, _Closable):
            decoder.close()


@runtime_checkable
class _Remarking(Protocol):
    def remarks(self) -> tuple[str, ...]: ...


@runtime_checkable
class _Closable(Protocol):
    def close(self) -> None: ...


class TapedReadings:
    """A `PolledInterface` whose readings pass a tape as questions.

    Parameters
    ----------
    kind
        Name of the kind in the rig.
    target
        Interface that reads; None in a replay.
    """

    def __init__(self, tape: Tape, kind: str, target: Any) -> None:
        self._tape, self._kind, self._target = tape, kind, target
        units: Mapping[Quantity, str] = tape.ask(
            f"{kind}.offers",
            {},
            Mapping[Quantity, str],
            lambda: {quantity: quantity.unit for quantity in sorted(target.offers, key=lambda offer: offer.key)},
        )
        self.offers = frozenset(units)

    def read(self, time_s: float) -> Observation:
        """Read all quantities now.

        Raises
        ------
        ConfigError
            When a recording does not have the numbers of a quantity.
        """
        read: Observation = self._tape.ask(f"{self._kind}.read", {}, Observation, lambda: self._target.read(time_s))
        for quantity, numbers in read.values.items():
            if quantity not in self.offers or numbers.shape != (quantity.size,):
                message = f"{self._kind} reads {numbers.size} numbers of {quantity.key}"
                raise ConfigError(f"the recording is damaged: {message}; record the run again")
        return read

    def remarks(self) -> tuple[str, ...]:
        """Return remarks on how the values were read."""
        remarks: tuple[str, ...] = self._tape.ask(
            f"{self._kind}.remarks",
            {},
            tuple[str, ...],
            lambda: self._target.remarks() if isinstance(self._target, _Remarking) else (),
        )
        return remarks

    def close(self) -> None:
        """Close the interface."""
        if isinstance(self._target, _Closable):
            self._target.close()


def tape_decoders(decoders: Mapping[str, Decoder], tape: Tape) -> Mapping[str, Decoder]:
    """Put polled decoders on a tape; streams pass it as bytes already."""
    if tape is LIVE:
        return decoders
    polled = [kind for kind, decoder in decoders.items() if not isinstance(decoder, StreamInterface)]
    tape.ask(POLLED, {}, tuple[str, ...], lambda: polled)
    return {
        kind: TapedReadings(tape, kind, decoder) if kind in polled else decoder for kind, decoder in decoders.items()
    }
