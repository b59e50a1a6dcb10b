"""Interface of every board, real or virtual."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from types import TracebackType
from typing import Any, NamedTuple, Protocol, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from hiltest.angles import Pose, rotation_body_from_ned
from hiltest.boards.sample_checks import SampleChecks
from hiltest.errors import (
    DeviceError,
    FirmwareContradictionError,
    HiltestError,
    ProtocolError,
    SensorAbsentError,
)
from hiltest.link.messages import Select, Sensors
from hiltest.link.ports import SerialPort
from hiltest.link.replies import DPS_PER_COUNT, CostedReply, CostedSteps, Identity, RunCost, SensorInfo, SensorKind
from hiltest.link.request import Request
from hiltest.link.session import Session
from hiltest.link.transcript import Transcript
from hiltest.measurement import CycleRange
from hiltest.replay.tape import Tape
from hiltest.rig import Rig
from hiltest.rig.faults import Faults
from hiltest.virtual.processor.executed_code import ExecutionWatch
from hiltest.world import EarthField, Vector

_SHIELD_HINT = (
    "Put the FRDM-FXS-MULTI-B shield on the board, or name sensors that are there in the rig file. "
    "The identity, cycles and link suites need no sensor: pytest hil/suites -k 'identity or cycles or link'."
)


CALL_CYCLES = 32
"""What calling a function, and reading the counter around it, may cost that one of two counts has and the other not."""


NO_MEMORY_USE: Mapping[str, int | str] = dict.fromkeys(("flash", "ram", "stack_most"), "")
"""Of a board that does not see what its firmware takes."""
NO_COVERAGE = "the board {} does not show what it executes, which coverage is made of: leave out --coverage"


class BoardKind(StrEnum):
    """Kind of board on the link."""

    VIRTUAL = "virtual"
    REAL = "real"
    REPLAY = "replay"


@dataclass(frozen=True, slots=True)
class Truth:
    """The true world of a virtual board."""

    soft_iron: NDArray[np.float64]
    """Shape (3, 3). ``sensed_ut = soft_iron @ field_body_ut + hard_iron_ut``, body frame."""
    hard_iron_ut: NDArray[np.float64]
    """Shape (3,). Zero-flux offset of the part included [uT]."""
    field_ut: float
    dip_deg: float
    """Strength and inclination of the earth's field."""
    magnetometer_sigma_ut: float
    accelerometer_sigma_g: float
    """rms noise of one axis of one reading."""
    accelerometer_response: NDArray[np.float64]
    """Shape (3, 3). ``read_g = accelerometer_response @ gravity_g + accelerometer_offset_g``, body frame."""
    accelerometer_offset_g: NDArray[np.float64]
    """Shape (3,)."""
    gyroscope_bias_dps: NDArray[np.float64]
    """Shape (3,). Body frame [deg/s]."""
    gyroscope_response: NDArray[np.float64]
    """Shape (3, 3). ``felt_dps = gyroscope_response @ rate_dps + bias``, body frame."""
    gyroscope_density_dps: float
    """One-sided noise density of the rate [deg/s/sqrt(Hz)]."""

    def read_ut(self, attitude: Pose) -> NDArray[np.float64]:
        """Return what the magnetometer reads in an attitude of the board, without noise, shape (3,) [uT]."""
        field_ned_ut = np.array(EarthField(self.field_ut, self.dip_deg).ned_ut)
        return np.asarray(self.soft_iron @ rotation_body_from_ned(attitude) @ field_ned_ut + self.hard_iron_ut)

    @property
    def gyroscope_matrix(self) -> NDArray[np.float64]:
        """Matrix from counts without bias to rate, the inverse of the response [deg/s/count]."""
        inverse = np.linalg.inv(self.gyroscope_response) * DPS_PER_COUNT
        return np.asarray(inverse, dtype=np.float64)


@dataclass(frozen=True, slots=True)
class Declared:
    """Declarations of the rig file about bench and parts, for any board."""

    field_ut: float
    """Strength of the local field."""
    magnetometer_sigma_ut: float
    """rms noise of one axis of one reading, of the selected part."""
    wanted: Mapping[SensorKind, str]
    """Name of the sensor to use for each kind; without a name the first that is present."""
    cycle_model: str | None = None
    """What the cycle counter of a board on a port counts, when the rig says it."""
    gyroscope_density_dps: float = 0.025
    """One-sided noise density of the rate [deg/s/sqrt(Hz)]."""
    functions: Mapping[str, str] = field(default_factory=dict)
    """Function of the firmware that each calibrator is, where the rig names it."""
    rig: str = ""
    """Name of the rig."""
    faults: Faults | None = None
    """What goes wrong on purpose."""

    @classmethod
    def of(cls, rig: Rig) -> Declared:
        """Take from a rig what a board needs to know of it."""
        named = {
            SensorKind.MAGNETOMETER: rig.sensors.magnetometer,
            SensorKind.ACCELEROMETER: rig.sensors.accelerometer,
            SensorKind.GYROSCOPE: rig.sensors.gyroscope,
        }
        wanted = {kind: name for kind, name in named.items() if name is not None}
        return cls(
            rig.field.strength_ut, rig.sensors.magnetometer_noise_ut, wanted, rig.board.cycle_model,
            1e-3 * rig.sensors.gyroscope_noise_mdps_per_rthz,
            {name: each.functions[0] for name, each in rig.cycles.items() if each.ends is None},
            rig.name,
            rig.faults,
        )


TimedReply = TypeVar("TimedReply", bound=CostedReply)
CostedStepsReply = TypeVar("CostedStepsReply", bound=CostedSteps)
R = TypeVar("R")


class CallCounter(Protocol):
    """Counts the calls of one function of the firmware, whatever the firmware reports of them."""

    def begin(self) -> None:
        """Forget the calls so far."""

    @property
    def cycles(self) -> Sequence[int]:
        """Cycles of each call since then, from the function's first instruction to its return."""


class Stage(Protocol):
    """A table that turns a board by itself."""

    def turn_to(self, pose: Pose, *, known_angle: int | None = None, face: int | None = None) -> None:
        """Turn the table and come back when it stands; the number of a face is for a world whose faces are askew."""

    def tumble(self, duration_s: float) -> float:
        """Go to where a tumble begins, begin it, come back, and say how long it takes [s]."""

    def sway(self) -> float:
        """Begin to turn and tilt from where the level table stands, come back at once; say how long it takes [s]."""

    def turn_round(self, turn_deg: float, *, rate_dps: float, after_s: float) -> float:
        """Begin to turn about the vertical in `after_s`, come back at once, and say in how long it will stand [s]."""

    @property
    def temperature_degc(self) -> float:
        """True temperature of the board now."""

    @property
    def said_of_playback(self) -> list[str]:
        """What was not as in the recording that is played, in sentences; empty without one."""

    @property
    def firmware_clock_began_s(self) -> float:
        """Virtual time at which the firmware's clock began [s]."""

    def write_sensor(self, bus: int, address: int, register: int, value: int) -> None:
        """Write a register of a sensor behind the firmware's back, as another master on the I2C bus would."""


class StepRecorder(Protocol):
    """Records what runs in steps that the firmware times one by one."""

    def add(self, cycles: Sequence[int], overhead_cycles: int) -> None:
        """Record the steps that were timed last, in order."""

    def band(self) -> CycleRange | None:
        """Return the uncertainty range of all steps together; None where it is unknown."""


@dataclass(frozen=True, slots=True)
class LinkTerms:
    """Terms of the link to a board."""

    nonce_seed: int
    """Seed of the nonces of the session."""
    attempts: int
    """How often a request is sent at most."""

    def session(
        self, opened: Callable[[], SerialPort], transcript: Transcript | None, tape: Tape, *,
        made: Callable[..., Session] = Session,
    ) -> Session:
        """Open the session of a board that is there, or the one that is replayed."""
        port = tape.port(opened)
        terms: LinkTerms = tape.ask("link", {}, LinkTerms, lambda: self)
        return made(port, transcript=transcript, nonce_seed=terms.nonce_seed, attempts=terms.attempts)


class OnChip(NamedTuple):
    """What is known of the file that was flashed onto a chip, which a board cannot be asked for: as of `Board`."""

    firmware_sha256: str
    compiler_flags: str
    elf_build_id: str

    def note(self, board: Any) -> None:
        """Let a board say it."""
        for name, value in self._asdict().items():
            setattr(board, name, value)


class Board(ABC):
    """A board that is synchronised, identified and has its sensors selected.

    Parameters
    ----------
    session
        Over an open port. The board closes it.
    description
        One line for people.

    Attributes
    ----------
    stage : Stage or None
        None where an operator or motors turn the board.
    truth : Truth or None
        None where it is unknown: "not offered".
    firmware_sha256 : str or None
        Digest of the ELF file, where there is one.
    compiler_flags : str
        Compiler flags of all units of that file; empty where they are unknown.
    elf_build_id : str
        GNU build-id note of that file; empty without one.
    seed : int or None
        Seed of a simulated world.
    sample_checks : SampleChecks
        Refuses what no sound sensor gives; replies are checked as they come.
    execution : ExecutionWatch or None
        What the firmware has executed, where that is kept.
    """

    kind: BoardKind
    description: str
    stage: Stage | None = None
    truth: Truth | None = None
    firmware_sha256: str | None = None
    compiler_flags: str = ""
    elf_build_id: str = ""
    seed: int | None = None
    execution: ExecutionWatch | None = None

    def __init__(self, session: Session, *, description: str, declared: Declared) -> None:
        self.session = session
        self.description = description
        self.declared = declared
        try:
            session.synchronise()
            self.identity: Identity = session.identify()
            self.sensors: tuple[SensorInfo, ...] = self._select()
            self.sample_checks = SampleChecks(lambda kind: self.sensor(kind).name, self._is_noise_free)
            session.on_reply = self.sample_checks.reply
        except HiltestError as error:
            session.close()
            if isinstance(error, DeviceError):
                raise ProtocolError(f"the first words to the firmware were refused: {error}") from error
            raise

    def _is_noise_free(self, kind: SensorKind) -> bool:
        if self.truth is None:
            return False
        noise = {
            SensorKind.MAGNETOMETER: self.truth.magnetometer_sigma_ut,
            SensorKind.ACCELEROMETER: self.truth.accelerometer_sigma_g,
            SensorKind.GYROSCOPE: self.truth.gyroscope_density_dps,
        }
        return noise[kind] == 0.0

    @property
    def origin(self) -> BoardKind:
        """Kind of the board whose answers these are: its own, or of a replay that of the recorded one."""
        return self.kind

    @property
    def clock(self) -> str:
        """``virtual`` or ``wall``."""
        return self.session.clock

    @property
    def line_is_exact(self) -> bool:
        """Whether the line loses and changes nothing, as a simulated one does that has no faults."""
        faults = self.declared.faults
        return self.origin is BoardKind.VIRTUAL and (faults is None or not faults.of_line)

    @property
    def sensors_are_sound(self) -> bool:
        """Whether its sensors and their buses cannot fail: those of a virtual board, unless its rig says so."""
        faults = self.declared.faults
        return self.origin is BoardKind.VIRTUAL and (faults is None or not faults.of_sensors)

    def now_s(self) -> float:
        """Return the time of the board's clock [s]."""
        return self.session.now()

    def sleep(self, seconds: float) -> None:
        """Wait, by the board's clock [s]."""
        time.sleep(seconds)

    @property
    def firmware_line(self) -> str:
        """Name, version and build of the firmware, for people."""
        return f"{self.identity.name} {self.identity.version} build {self.identity.build_id}"

    @property
    def core_clock_hz(self) -> int:
        """Clock of the core, as the firmware answers it."""
        return self.identity.core_clock_hz

    @property
    @abstractmethod
    def cycle_model(self) -> str:
        """Cycle model of this board's counts, with the placement of the code."""

    @property
    def virtual_seconds(self) -> float | None:
        """Virtual time since power-on; None where time is not virtual."""
        return self.now_s() if self.clock == "virtual" else None

    def memory_use(self) -> Mapping[str, int | str]:
        """Return the bytes that the firmware takes, see `seen_memory_use`, or why they are not known."""
        return NO_MEMORY_USE

    def true_attitude(self, board_us: int) -> Pose | None:
        """Return the board's attitude at a time of its own clock [us]; None where it is unknown."""
        return None

    def true_disturbances_ut(self, board_us: int) -> Mapping[str, Vector] | None:
        """Return what disturbs the field at a time of its own clock [us], by cause, body frame; None where unknown."""
        return None

    def call_counter(self, calibrator: str) -> CallCounter | None:
        """Return what counts the calls of a calibrator; None where the board cannot see them."""
        return None

    @property
    def executes_firmware(self) -> bool:
        """Whether the board sees every instruction, and can count what the firmware reports of itself."""
        return False

    def timed(self, request: Request[TimedReply], calibrator: str) -> TimedReply:
        """Send a request that runs a calibrator, and check the cycles that the firmware reports of it.

        Parameters
        ----------
        request
            Its reply has a `cost`.
        calibrator
            Name as in the board's identity.

        Raises
        ------
        FirmwareContradictionError
            When the board counted other cycles in the calibrator's function than the firmware reports.
        """
        reply, counted = self._counted(request, calibrator)
        if reply.cost is not None:
            _refuse_other_cycles(calibrator, [reply.cost], counted)
        return reply

    def timed_each(self, request: Request[CostedStepsReply], work: str) -> CostedStepsReply:
        """Send a request that runs a function again and again, and check the cycles that are reported of each call.

        Parameters
        ----------
        request
            Its reply has `costs`, of the first calls; others may follow that were refused.
        work
            What is called: a stream calibrator's name and ``.add`` or ``.remove``.

        Raises
        ------
        FirmwareContradictionError
            When the board counted other cycles in these calls than the firmware reports.
        """
        reply, counted = self._counted(request, work)
        if reply.costs:
            _refuse_other_cycles(work, reply.costs, counted[: len(reply.costs)])
        return reply

    def _counted(self, request: Request[R], work: str) -> tuple[R, list[int]]:
        """Send a request; return its reply, and the cycles of each call of a function, if they are seen."""
        counter = self.call_counter(work)
        if counter is not None:
            counter.begin()
        reply = self.session.request(request)
        return reply, list(counter.cycles) if counter is not None else []

    def unchecked(self, calibrator: str) -> str:
        """Say why the board cannot check the cycles that the firmware reports of the calibrator that just ran.

        Empty where it has checked them, and on a board that does not execute the firmware, where nothing else counts.
        """
        if not self.executes_firmware:
            return ""
        counter = self.call_counter(calibrator)
        if counter is None or not counter.cycles:
            why = "its function was not called; it may be inlined" if counter else "no function has its name"
            return f"the board cannot count the cycles of {calibrator}: {why}; name one under [cycles] in the rig"
        return ""

    def cycle_range(self, cost: RunCost | None, calibrator: str = "") -> CycleRange | None:
        """Return the uncertainty range of the cycles of the run that was just timed; None where it is unknown.

        Parameters
        ----------
        cost
            As the firmware reports it.
        calibrator
            What was timed: the board then knows the readings around its call.
        """
        return None

    def timed_steps(self) -> StepRecorder | None:
        """Begin to record what runs in steps that are timed one by one; None where that is unknown."""
        return None

    def instructions_counted(self, cycles: int) -> int | None:
        """Count the instructions of the code that the firmware has just timed at `cycles`; None where unknown."""
        return None

    def sensor(self, kind: SensorKind) -> SensorInfo:
        """Return the selected sensor of a kind.

        Raises
        ------
        SensorAbsentError
            When there is none; names those that answer, and the way out.
        """
        wanted = self.declared.wanted.get(kind)
        for sensor in self.sensors:
            # A board without its shield measures with its own part: not what the rig asks for.
            if sensor.kind is kind and sensor.selected and sensor.present and wanted in (None, sensor.name):
                return sensor
        raise SensorAbsentError(
            wanted if wanted and kind.name.lower() in wanted else f"{kind.name.lower()} {wanted or ''}".strip(),
            [sensor.name for sensor in self.sensors if sensor.present],
            _SHIELD_HINT,
        )

    def close(self) -> None:
        """Give the port back."""
        self.session.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _select(self) -> tuple[SensorInfo, ...]:
        """Select one present sensor of each kind; which are selected is then asked again."""
        known = self.session.request(Sensors())
        for kind in SensorKind:
            wanted = self.declared.wanted.get(kind)
            for sensor in known:
                if sensor.kind is kind and sensor.present and wanted in (None, sensor.name):
                    try:
                        self.session.request(Select(sensor.sensor_id))
                    except DeviceError as error:
                        if not error.is_of_sensors:
                            raise
                        # It is missing then for who needs it; what needs none still runs.
                    break
        return self.session.request(Sensors())


def _refuse_other_cycles(work: str, reported: Sequence[RunCost], counted: Sequence[int]) -> None:
    """Raise a FirmwareContradictionError when calls took other cycles than were reported; without calls none does."""
    total, calls = sum(each.cycles for each in reported), len(counted)
    if calls and abs(sum(counted) - total) > CALL_CYCLES * len(reported):
        raise FirmwareContradictionError(
            f"the firmware contradicts the board: it reports {total} cycles of {work}, and "
            f"the board counted {sum(counted)} in {'its call' if calls == 1 else f'{calls} calls'}"
        )
