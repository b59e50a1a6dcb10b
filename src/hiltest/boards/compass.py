"""A board whose firmware speaks its own language: it is listened to, or read from outside, and never asked."""

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
from hiltest.device.kinds import Interface, open_interfaces, sources_of
from hiltest.device.quantities import Moment, Observation, PolledInterface, Quantity, StreamInterface
from hiltest.errors import (
    ConfigError,
    DeviceSilentError,
    DeviceTimeoutError,
    HiltestError,
    LinkLostError,
    VersionMismatchError,
)
from hiltest.link.ports import SerialPort, open_port
from hiltest.link.transcript import Direction, Transcript
from hiltest.replay.tape import LIVE, Tape
from hiltest.rig import Rig
from hiltest.rig.device import Device
from hiltest.text import is_text, join_words, legible
from hiltest.virtual.processor.executed_code import ExecutionWatch
from hiltest.virtual.program.elf import load_image

# How long one read listens: values that are read from outside are read as often.
_SLICE_S = 0.1
_MOST_BYTES = 1 << 16
# Longest that the firmware may stay silent behind its declared start, before it is given up.
_SILENT_S = 5.0
_SHOWN_BYTES = 48
POLLED = "device.polled"
"""Question of the kinds that read from the outside."""


class CompassBoard:
    """A board of which the firmware says, by its own words, where it points.

    Parameters
    ----------
    port
        Open; the board closes it. One with a ``now()`` has a clock of its own.
    rig
        With a ``[device]`` table.
    interfaces
        What understands the firmware, by kind.
    description
        One line for people.
    transcript
        Gets every byte, both ways.

    Attributes
    ----------
    offers : frozenset of Quantity
        What the firmware may say.
    latest : dict of Quantity to ndarray
        What it said last of each.
    errors : Counter of str
        What it reported to be wrong, and how often.
    costs : Costs or None
        Of the functions that the rig names; None where the board cannot see them.
    stage : Stage or None
        None where an operator or motors turn the board.
    truth : Truth or None
        None where it is unknown: "not offered".
    seed : int or None
        Seed of a simulated world.
    firmware : str
        Name of the file that runs, empty where there is none.
    firmware_sha256, compiler_flags, elf_build_id : str or None, str, str
        Of that file.
    execution : ExecutionWatch or None
        What it has executed, where that is kept.
    may_be_overheard : bool
        Whether it may be listened to while an operator is asked: what is heard then is no part of a recording.
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
        self, port: Any, rig: Rig, interfaces: Mapping[str, Interface], *, kind: BoardKind, description: str,
        transcript: Transcript | None = None,
    ) -> None:  # fmt: skip
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
        """Wait until the firmware speaks, and send what is to be sent then.

        Raises
        ------
        DeviceSilentError
            When nothing comes.
        VersionMismatchError
            When nothing of what comes is understood.
        """
        self.observe(self.device.start_s)
        self.send(Moment.START)
        began_s = self.now_s()
        while not any(each.values for each in self.observe(_SLICE_S)):
            if self.now_s() < began_s + _SILENT_S:
                continue
            if not self._heard:
                raise DeviceSilentError(self.device.start_s + _SILENT_S, self.clock, self.position())
            raise VersionMismatchError(self._not_understood(f"{self._heard} bytes came, and nothing was understood"))

    def heading_missing(self, seconds: float, window: Sequence[Observation]) -> HiltestError:
        """Return why a time brought no heading: the firmware fell silent, or what it says is none.

        Parameters
        ----------
        window
            What was said in it.
        """
        if self.now_s() - self._heard_at_s > seconds - _SLICE_S:
            return DeviceTimeoutError("a heading", seconds, self.clock, self.position())
        others = sorted({quantity.key for each in window for quantity in each.values})
        return VersionMismatchError(self._not_understood(
            f"the firmware speaks, and no heading was understood in {seconds:g} s"
            + (f", only {join_words(others, 3)}" if others else "")
        ))

    def _not_understood(self, found: str) -> str:
        """Return what a reader needs to see why."""
        said = [f"it reports {text!r}" for text in self.errors] + list(self.remarks())
        return "; ".join([
            f"{found} by [device] kind {', '.join(self.interfaces)}", *said, f"it began with {self._first_words()}",
        ]) + f". Is it that firmware, and its baud rate {self.rig.link.baud}? hiltest device try shows what it says"

    def observe(self, seconds: float) -> list[Observation]:
        """Listen for a time of the board's clock [s]; return what the firmware said.

        Raises
        ------
        LinkLostError
            When the port breaks.
        BoardFault
            When the firmware of a virtual board faults, or hangs.
        """
        end_s = self.now_s() + seconds
        said: list[Observation] = []
        while (left_s := end_s - self.now_s()) > 1e-9:
            data = self._read(min(_SLICE_S, left_s))
            now_s = self.now_s()
            for kind, interface in self.interfaces.items():
                observations: Sequence[Observation]
                if isinstance(interface, StreamInterface):
                    observations = interface.feed(data, now_s) if data else ()
                else:
                    observations = [interface.read(now_s)] if self._is_due(kind, interface, now_s) else ()
                said += (self._of_source(kind, observation) for observation in observations)
        for each in said:
            self.latest.update(each.values)
        self.errors.update(each.error for each in said if each.error)
        return said

    def _is_due(self, kind: str, interface: PolledInterface, now_s: float) -> bool:
        """Say whether to read now: what gives the heading in every slice, what the firmware believes once a window."""
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
                with self._broken_is_lost():
                    self._port.write(command)

    def sleep(self, seconds: float) -> None:
        """Wait, by the board's clock [s]; what the firmware says meanwhile is dropped."""
        self.observe(seconds)

    def remarks(self) -> tuple[str, ...]:
        """Return what a reader should know of how the firmware was understood; empty where all is plain."""
        return tuple(
            remark for interface in self.interfaces.values() if isinstance(interface, _Remarking)
            for remark in interface.remarks()
        )  # fmt: skip

    def position(self) -> str:
        """Say what the firmware is doing; empty where that is unknown."""
        position: Callable[[], str] | None = getattr(self._port, "position", None)
        return position() if position else ""

    @property
    def origin(self) -> BoardKind:
        """As `Board.origin`."""
        return self.kind

    @property
    def virtual_seconds(self) -> float | None:
        """Virtual time since power-on; None where time is not virtual."""
        return self.now_s() if self.clock == "virtual" else None

    def memory_use(self) -> Mapping[str, int | str]:
        """As `Board.memory_use`."""
        return NO_MEMORY_USE

    @property
    def firmware_line(self) -> str:
        """Name and build of the firmware, and how it is understood, for people."""
        build = f" build {self.elf_build_id[:16]}" if self.elf_build_id else ""
        return f"{self.firmware or 'its firmware'}{build}, understood by {', '.join(self.interfaces)}"

    @property
    def core_clock_hz(self) -> int:
        """Clock of the core now; 0 where it is unknown."""
        return 0

    @property
    def cycle_model(self) -> str:
        """Cycle model of counted functions; ``none`` where nothing counts."""
        return "none"

    def close(self) -> None:
        """Give the port back, and the debug server."""
        hang_up(self.interfaces)
        self._port.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _read(self, seconds: float) -> bytes:
        with self._broken_is_lost():
            if self._port.timeout != seconds:  # which sets up a real port anew
                self._port.timeout = seconds
            data = bytes(self._port.read(_MOST_BYTES))
        if data:
            self._note(Direction.TO_HOST, data)
            self._heard, self._heard_at_s = self._heard + len(data), self.now_s()
            self._first += data[: _SHOWN_BYTES - len(self._first)]
        return data

    @contextmanager
    def _broken_is_lost(self) -> Iterator[None]:
        try:
            yield
        except (serial.SerialException, OSError) as error:
            raise LinkLostError(str(self._port.name), str(error)) from error

    def _first_words(self) -> str:
        """Return the first bytes: as text where they are one."""
        if is_text(self._first):
            return repr(legible(self._first.decode("utf-8", errors="replace")))
        return f"{self._first.hex(' ')} (hex)"

    def _note(self, direction: Direction, data: bytes) -> None:
        if self._transcript is not None:
            self._transcript.add(self.now_s(), direction, data)

    def _of_source(self, kind: str, observation: Observation) -> Observation:
        values = {
            quantity: numbers for quantity, numbers in observation.values.items() if self._sources[quantity] == kind
        }
        return replace(observation, values=values)


class VirtualCompass(CompassBoard):
    """A virtual board whose firmware speaks its own language, in stepped time.

    Parameters
    ----------
    bench
        Board, sensors and world.
    interfaces
        What understands the firmware, by kind.
    transcript
        Gets every byte, both ways.
    tape
        Records what is asked.
    """

    def __init__(
        self, bench: VirtualBench, interfaces: Mapping[str, Interface], *, transcript: Transcript | None = None,
        tape: Tape = LIVE,
    ) -> None:  # fmt: skip
        self._machine = bench.machine
        port = VirtualPort()
        port.port = "hil://"
        port.attach(bench.machine)
        port.open()
        super().__init__(
            tape.port(lambda: with_faults(port, bench.rig.faults, baud=bench.rig.link.baud)), bench.rig,
            on_tape(interfaces, tape), kind=BoardKind.VIRTUAL, description=f"virtual FRDM-K64F, seed {bench.seed}",
            transcript=transcript,
        )  # fmt: skip
        self.costs = self._costs = FunctionCosts(bench.machine, bench.rig)
        self.execution = bench.execution
        self.stage, self.seed, self.truth = bench, bench.seed, truth_of(bench.rig)
        image = bench.machine.image
        self.firmware = bench.firmware.name
        self.firmware_sha256 = hashlib.sha256(Path(bench.firmware).read_bytes()).hexdigest()
        self.compiler_flags, self.elf_build_id = image.compiler_flags, image.build_id

    def memory_use(self) -> Mapping[str, int | str]:
        """As `VirtualBoard.memory_use`."""
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
    rig: Rig, *, firmware: Path | None, port: str | None, seed: int | None, transcript: Transcript | None,
    base: int | None, watches_execution: bool, tape: Tape,
) -> CompassBoard:
    """Open the board of a rig whose firmware speaks its own language, without a word of it yet.

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
        if virtual else None
    )  # fmt: skip
    image = bench.machine.image if bench else load_image(firmware, base=base) if firmware else None
    interfaces = open_interfaces(rig, {"memory": memory_kind(image, bench.machine if bench else None)})
    try:
        if Quantity.HEADING not in sources_of(rig, interfaces):  # all that is wrong is said before a port is opened
            raise ConfigError(
                f"{rig.where('device', 'kind')}: device.kind: {', '.join(interfaces)} offers no heading here, and that "
                "is what is judged; name it in the rig (docs/compass.md)"
            )
        if bench is not None:
            return VirtualCompass(bench, interfaces, transcript=transcript, tape=tape)
        url = url or port_of()

        def line() -> SerialPort:
            return with_faults(open_port(url, baud=rig.link.baud, rig=rig.name), rig.faults, baud=rig.link.baud)

        return CompassBoard(
            tape.port(line), rig, on_tape(interfaces, tape), kind=BoardKind.REAL, description=f"board on {url}",
            transcript=transcript,
        )  # fmt: skip
    except BaseException:
        hang_up(interfaces)
        raise


def hang_up(interfaces: Mapping[str, Interface]) -> None:
    """Let go of what interfaces read through. Idempotent."""
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
    """A `PolledInterface` each of whose readings is a question.

    Parameters
    ----------
    kind
        As the rig names it.
    target
        Reads; None in a replay.
    """

    def __init__(self, tape: Tape, kind: str, target: Any) -> None:
        self._tape, self._kind, self._target = tape, kind, target
        units: Mapping[Quantity, str] = tape.ask(
            f"{kind}.offers", {}, Mapping[Quantity, str],
            lambda: {each: each.unit for each in sorted(target.offers, key=lambda offer: offer.key)},
        )
        self.offers = frozenset(units)

    def read(self, time_s: float) -> Observation:
        """Read all of it now.

        Raises
        ------
        ConfigError
            When a recording holds other than the numbers of a quantity.
        """
        read: Observation = self._tape.ask(f"{self._kind}.read", {}, Observation, lambda: self._target.read(time_s))
        for quantity, numbers in read.values.items():
            if quantity not in self.offers or numbers.shape != (quantity.size,):
                found = f"{self._kind} reads {numbers.size} numbers of {quantity.key}"
                raise ConfigError(f"the recording is damaged: {found}; record the run again")
        return read

    def remarks(self) -> tuple[str, ...]:
        """Return what a reader of the values should know of how they were read."""
        said: tuple[str, ...] = self._tape.ask(
            f"{self._kind}.remarks", {}, tuple[str, ...],
            lambda: self._target.remarks() if isinstance(self._target, _Remarking) else (),
        )
        return said

    def close(self) -> None:
        """Let go of what it reads through."""
        if isinstance(self._target, _Closable):
            self._target.close()


def on_tape(interfaces: Mapping[str, Interface], tape: Tape) -> Mapping[str, Interface]:
    """Let what interfaces read from the outside pass through a tape; what a line says has passed it as bytes."""
    if tape is LIVE:
        return interfaces
    polled = [kind for kind, each in interfaces.items() if not isinstance(each, StreamInterface)]
    tape.ask(POLLED, {}, tuple[str, ...], lambda: polled)
    return {kind: TapedReadings(tape, kind, each) if kind in polled else each for kind, each in interfaces.items()}
