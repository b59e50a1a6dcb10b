"""A board whose firmware has its own protocol: hiltest listens, or reads its memory, but sends no requests."""

from __future__ import annotations

import hashlib
import math
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol, Self, runtime_checkable

import numpy as np
import serial
from numpy.typing import NDArray

from hiltest.boards.bench import VirtualBench
from hiltest.boards.board import NO_COVERAGE, NO_MEMORY_USE, BoardKind, Stage, Truth
from hiltest.boards.daplink import port_of
from hiltest.boards.faulty_port import with_faults
from hiltest.boards.function_costs import Costs, FunctionCosts
from hiltest.boards.memory_reading import memory_kind
from hiltest.boards.memory_use import seen_memory_use
from hiltest.boards.virtual import truth_of
from hiltest.boards.virtual_port import VirtualPort
from hiltest.errors import (
    ConfigError,
    DeviceSilentError,
    DeviceTimeoutError,
    HiltestError,
    LinkLostError,
    VersionMismatchError,
)
from hiltest.interfaces.kinds import Interface, open_interfaces, sources_of
from hiltest.interfaces.quantities import Moment, Observation, PolledInterface, Quantity, StreamInterface
from hiltest.link.ports import SerialPort, open_port
from hiltest.link.transcript import Direction, Transcript
from hiltest.rig import Rig
from hiltest.rig.device import Device
from hiltest.tape.tape import LIVE, Tape
from hiltest.text import is_text, join_words, legible
from hiltest.virtual.processor.executed_code import ExecutionWatch
from hiltest.virtual.program.elf import load_image

# Duration of one read, and the period at which variables are read from memory.
_SLICE_S = 0.1
_MOST_BYTES = 1 << 16
# Longest silence of the firmware after its declared start before it counts as failed.
_SILENT_S = 5.0
_SHOWN_BYTES = 48
POLLED = "device.polled"
"""Question about the kinds that read the board's memory."""


class CompassBoard:
    """A board whose firmware reports its heading in its own protocol.

    Parameters
    ----------
    port
        Open; the board closes it. One with a ``now()`` has a clock of its own.
    rig
        Rig with a ``[device]`` table.
    interfaces
        Decoders of the firmware's output, by kind.
    description
        One line for people.
    transcript
        Receives every byte, in both directions.

    Attributes
    ----------
    offers : frozenset of Quantity
        Quantities that the firmware may report.
    latest : dict of Quantity to ndarray
        Latest value of each.
    errors : Counter of str
        Errors that it reported, and how often.
    costs : Costs or None
        Costs of the functions that the rig names; None if the board cannot observe them.
    stage : Stage or None
        None if an operator or motors turn the board.
    truth : Truth or None
        None if unknown: "not offered".
    seed : int or None
        Seed of a simulated world.
    firmware : str
        Name of the file that runs, empty if there is none.
    firmware_sha256, compiler_flags, elf_build_id : str or None, str, str
        Facts about that file.
    execution : ExecutionWatch or None
        Instructions that it has executed, if they are recorded.
    may_be_overheard : bool
        Whether to listen while an operator answers; that output is no part of a recording.
    """

    may_be_overheard = True
    kind: BoardKind
    description: str
    costs: Costs | None = None
    stage: Stage | None = None
    truth: Truth | None = None
    seed: int | None = None
    execution: ExecutionWatch | None = None
    firmware: str = ""
    firmware_sha256: str | None = None
    compiler_flags: str = ""
    elf_build_id: str = ""

    def __init__(
        self,
        port: Any,
        rig: Rig,
        interfaces: Mapping[str, Interface],
        *,
        kind: BoardKind,
        description: str,
        transcript: Transcript | None = None,
    ) -> None:
        assert rig.device is not None
        self.rig = rig
        self.device: Device = rig.device
        self.kind = kind
        self.description = description
        self._port = port
        own_clock: Callable[[], float] | None = getattr(port, "now", None)
        self.clock: str = getattr(port, "clock", "virtual" if own_clock else "wall")
        self.now_s: Callable[[], float] = own_clock or time.monotonic
        self._transcript = transcript
        if transcript is not None and not transcript.clock:
            transcript.clock = self.clock
        self.interfaces = interfaces
        self._sources = sources_of(rig, interfaces)
        self.offers = frozenset(self._sources)
        self.latest: dict[Quantity, NDArray[np.float64]] = {}
        self.errors: Counter[str] = Counter()
        self._read_at_s: dict[str, float] = {}
        self._heard = 0
        self._heard_at_s = -math.inf
        self._first = b""

    def begin(self) -> None:
        """Wait for the firmware's first output, and send the commands for its start.

        Raises
        ------
        DeviceSilentError
            When the firmware stays silent.
        VersionMismatchError
            When none of the output can be interpreted.
        """
        self.observe(self.device.start_s)
        self.send(Moment.START)
        began_s = self.now_s()
        while not any(observation.values for observation in self.observe(_SLICE_S)):
            if self.now_s() < began_s + _SILENT_S:
                continue
            if not self._heard:
                raise DeviceSilentError(self.device.start_s + _SILENT_S, self.clock, self.position())
            raise VersionMismatchError(
                self._not_understood(f"{self._heard} bytes arrived, and none could be interpreted")
            )

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

    def _not_understood(self, summary: str) -> str:
        """Return a message with all that helps to find the reason."""
        reasons = [f"it reports {text!r}" for text in self.errors] + list(self.remarks())
        return (
            "; ".join(
                [
                    f"{summary} by [device] kind {', '.join(self.interfaces)}",
                    *reasons,
                    f"its output begins with {self._first_words()}",
                ]
            )
            + f". Check the firmware and the baud rate {self.rig.link.baud}; hiltest listen shows its output"
        )

    def observe(self, seconds: float) -> list[Observation]:
        """Listen for a time of the board's clock [s]; return the observations.

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
            data = self._read(min(_SLICE_S, left_s))
            now_s = self.now_s()
            for kind, interface in self.interfaces.items():
                observations: Sequence[Observation]
                if isinstance(interface, StreamInterface):
                    observations = interface.feed(data, now_s) if data else ()
                else:
                    observations = [interface.read(now_s)] if self._is_due(kind, interface, now_s) else ()
                heard += (self._use_as_source(kind, observation) for observation in observations)
        for observation in heard:
            self.latest.update(observation.values)
        self.errors.update(observation.error for observation in heard if observation.error)
        return heard

    def _is_due(self, kind: str, interface: PolledInterface, now_s: float) -> bool:
        """Return whether to read now: an interface with the heading in every slice, the others once a window."""
        every_s = 0.0 if self._sources.get(Quantity.HEADING) == kind else self.device.window_s
        if now_s < self._read_at_s.get(kind, -math.inf) + every_s - _SLICE_S / 2.0:
            return False
        self._read_at_s[kind] = now_s
        return True

    def send(self, moment: Moment) -> None:
        """Send the commands of a moment."""
        for interface in self.interfaces.values():
            command = interface.commands(moment) if isinstance(interface, StreamInterface) else b""
            if command:
                self._note(Direction.TO_BOARD, command)
                with self._raise_as_lost_link():
                    self._port.write(command)

    def sleep(self, seconds: float) -> None:
        """Wait, by the board's clock [s], and drop the firmware's output."""
        self.observe(seconds)

    def remarks(self) -> tuple[str, ...]:
        """Return remarks on the interpretation of the firmware's output; empty without any."""
        return tuple(
            remark
            for interface in self.interfaces.values()
            if isinstance(interface, _Remarking)
            for remark in interface.remarks()
        )

    def position(self) -> str:
        """Return a description of the firmware's present activity; empty if unknown."""
        position: Callable[[], str] | None = getattr(self._port, "position", None)
        return position() if position else ""

    @property
    def origin(self) -> BoardKind:
        """See `Board.origin`."""
        return self.kind

    @property
    def virtual_seconds(self) -> float | None:
        """Virtual time since power-on; None if time is not virtual."""
        return self.now_s() if self.clock == "virtual" else None

    def memory_use(self) -> Mapping[str, int | str]:
        """See `Board.memory_use`."""
        return NO_MEMORY_USE

    @property
    def firmware_line(self) -> str:
        """Name and build of the firmware, and its interface, for people."""
        build = f" build {self.elf_build_id[:16]}" if self.elf_build_id else ""
        return f"{self.firmware or 'its firmware'}{build}, understood by {', '.join(self.interfaces)}"

    @property
    def core_clock_hz(self) -> int:
        """Clock of the core now; 0 if it is unknown."""
        return 0

    @property
    def cycle_model(self) -> str:
        """Cycle model of counted functions; ``none`` without a counter."""
        return "none"

    def close(self) -> None:
        """Close the port and the debug server."""
        hang_up(self.interfaces)
        self._port.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _read(self, seconds: float) -> bytes:
        with self._raise_as_lost_link():
            if self._port.timeout != seconds:  # because it reconfigures a real port
                self._port.timeout = seconds
            data = bytes(self._port.read(_MOST_BYTES))
        if data:
            self._note(Direction.TO_HOST, data)
            self._heard, self._heard_at_s = self._heard + len(data), self.now_s()
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


class VirtualCompass(CompassBoard):
    """A virtual board whose firmware has its own protocol, in stepped time.

    Parameters
    ----------
    bench
        Board, sensors and world.
    interfaces
        Decoders of the firmware's output, by kind.
    transcript
        Receives every byte, in both directions.
    tape
        Records all questions.
    """

    def __init__(
        self,
        bench: VirtualBench,
        interfaces: Mapping[str, Interface],
        *,
        transcript: Transcript | None = None,
        tape: Tape = LIVE,
    ) -> None:
        self._machine = bench.machine
        port = VirtualPort()
        port.port = "hil://"
        port.attach(bench.machine)
        port.open()
        super().__init__(
            tape.port(lambda: with_faults(port, bench.rig.faults, baud=bench.rig.link.baud)),
            bench.rig,
            on_tape(interfaces, tape),
            kind=BoardKind.VIRTUAL,
            description=f"virtual FRDM-K64F, seed {bench.seed}",
            transcript=transcript,
        )
        self.costs = self._costs = FunctionCosts(bench.machine, bench.rig)
        self.execution = bench.execution
        self.stage, self.seed, self.truth = bench, bench.seed, truth_of(bench.rig)
        image = bench.machine.image
        self.firmware = bench.firmware.name
        self.firmware_sha256 = hashlib.sha256(Path(bench.firmware).read_bytes()).hexdigest()
        self.compiler_flags, self.elf_build_id = image.compiler_flags, image.build_id

    def memory_use(self) -> Mapping[str, int | str]:
        """See `VirtualBoard.memory_use`."""
        return seen_memory_use(self._machine, self._costs.stacks())

    @property
    def core_clock_hz(self) -> int:
        """Clock of the core now."""
        return round(self._machine.clocks.core_hz)

    @property
    def cycle_model(self) -> str:
        """Timing profile of the virtual board."""
        return self._machine.processor.profile.name


def opened_compass(
    rig: Rig,
    *,
    firmware: Path | None,
    port: str | None,
    seed: int | None,
    transcript: Transcript | None,
    base: int | None,
    watches_execution: bool,
    tape: Tape,
) -> CompassBoard:
    """Open the board of a rig whose firmware has its own protocol, without waiting for output.

    Raises
    ------
    BenchError
        When the port cannot be opened.
    """
    url = port or rig.board.port
    virtual = rig.board.kind == "virtual" and (url is None or url.startswith("hil:"))
    if watches_execution and not virtual:
        raise ConfigError(NO_COVERAGE.format(f"on {url}" if url else f"of rig {rig.name}"))
    bench = (
        VirtualBench(rig, firmware=firmware, seed=seed, base=base, watches_execution=watches_execution)
        if virtual
        else None
    )
    image = bench.machine.image if bench else load_image(firmware, base=base) if firmware else None
    interfaces = open_interfaces(rig, {"memory": memory_kind(image, bench.machine if bench else None)})
    try:
        if Quantity.HEADING not in sources_of(rig, interfaces):  # a bad rig is refused before a port is opened
            raise ConfigError(
                f"{rig.where('device', 'kind')}: device.kind: {', '.join(interfaces)} offers no heading, which the "
                "test needs; name it in the rig (docs/compass.md)"
            )
        if bench is not None:
            return VirtualCompass(bench, interfaces, transcript=transcript, tape=tape)
        url = url or port_of()

        def line() -> SerialPort:
            return with_faults(open_port(url, baud=rig.link.baud, rig=rig.name), rig.faults, baud=rig.link.baud)

        return CompassBoard(
            tape.port(line),
            rig,
            on_tape(interfaces, tape),
            kind=BoardKind.REAL,
            description=f"board on {url}",
            transcript=transcript,
        )
    except BaseException:
        hang_up(interfaces)
        raise


def hang_up(interfaces: Mapping[str, Interface]) -> None:
    """Close the connections of interfaces. Idempotent."""
    for interface in interfaces.values():
        if isinstance(interface, _Closable):
            interface.close()


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


def on_tape(interfaces: Mapping[str, Interface], tape: Tape) -> Mapping[str, Interface]:
    """Put polled interfaces on a tape; streams pass it as bytes already."""
    if tape is LIVE:
        return interfaces
    polled = [kind for kind, interface in interfaces.items() if not isinstance(interface, StreamInterface)]
    tape.ask(POLLED, {}, tuple[str, ...], lambda: polled)
    return {
        kind: TapedReadings(tape, kind, interface) if kind in polled else interface
        for kind, interface in interfaces.items()
    }
