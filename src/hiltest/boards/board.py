"""Interface of every board, real or virtual."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, NamedTuple, Protocol, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from hiltest.boards.function_costs import Costs
from hiltest.boards.output_interface import OutputInterface
from hiltest.boards.protocol_interface import ProtocolInterface
from hiltest.errors import FirmwareContradictionError, NotOfferedError
from hiltest.interfaces.quantities import Quantity
from hiltest.link.replies import DPS_PER_COUNT, CostedReply, CostedSteps, Identity, RunCost, SensorInfo, SensorKind
from hiltest.link.request import Request
from hiltest.link.session import Session
from hiltest.measurement import CycleRange
from hiltest.measurement.sensor_registers import Setting, registers_of
from hiltest.orientation.angles import Pose, rotation_body_from_ned
from hiltest.rig import Rig
from hiltest.rig.faults import Faults
from hiltest.virtual.processor.executed_code import ExecutionWatch
from hiltest.world import EarthField, Vector

CALL_CYCLES = 32
"""Cycles by which two counts of a call may differ, because one includes the call or the counter readings around it."""


NO_MEMORY_USE: Mapping[str, int | str] = dict.fromkeys(("flash", "ram", "stack_most"), "")
"""Memory use of a board that cannot observe its firmware."""
NO_REQUEST_COST = "only a virtual board observes the whole request"
NO_COVERAGE = "the board {} does not report executed instructions, which coverage needs: leave out --coverage"


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
        """Return the noise-free magnetometer reading in an attitude of the board, shape (3,) [uT]."""
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
    sensor_names: Mapping[SensorKind, str]
    """Name of the sensor to use for each kind; without a name the first that is present."""
    cycle_model: str | None = None
    """Cycle model of a board on a port, if the rig declares it."""
    gyroscope_density_dps: float = 0.025
    """One-sided noise density of the rate [deg/s/sqrt(Hz)]."""
    functions: Mapping[str, str] = field(default_factory=dict)
    """Function of the firmware for each calibrator that the rig names one for."""
    rig: str = ""
    """Name of the rig."""
    faults: Faults | None = None
    """Injected faults."""
    field_ned_ut: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """The local field in the earth frame."""

    @classmethod
    def select(cls, rig: Rig) -> Declared:
        """Select the declarations of a rig that concern a board."""
        named = {
            SensorKind.MAGNETOMETER: rig.sensors.magnetometer,
            SensorKind.ACCELEROMETER: rig.sensors.accelerometer,
            SensorKind.GYROSCOPE: rig.sensors.gyroscope,
        }
        sensor_names = {kind: name for kind, name in named.items() if name is not None}
        return cls(
            rig.field.strength_ut,
            rig.sensors.magnetometer_noise_ut,
            sensor_names,
            rig.board.cycle_model,
            1e-3 * rig.sensors.gyroscope_noise_mdps_per_rthz,
            {name: entry.functions[0] for name, entry in rig.cycles.items() if entry.ends is None},
            rig.name,
            rig.faults,
            EarthField(rig.field.strength_ut, rig.field.dip_deg).ned_ut,
        )


@dataclass(frozen=True, slots=True)
class RequestCost:
    """Cost of a request, from its last byte to the first byte of the reply."""

    awake_cycles: int
    """Cycles of the core without sleep and interrupts."""
    latency_us: float
    """Time, sleep and interrupts included."""
    masked_us: float
    """Longest time for which interrupts were masked while the core was awake."""


@dataclass(frozen=True, slots=True)
class PartSettings:
    """Registers of one part that firmware can write."""

    name: str
    """Name of the part, such as ``FXOS8700CQ`` or ``onboard-FXOS8700CQ``."""
    bus: int
    address: int
    """I2C module, and the part's 7-bit address."""
    registers: Mapping[int, int]
    """Values by address."""

    def settings(self) -> list[Setting]:
        """Return the registers by name; an unknown register has its address as its name."""
        rows = registers_of(self.name)
        return [
            Setting(self.name, rows[address].name if address in rows else f"0x{address:02X}", value)
            for address, value in sorted(self.registers.items())
        ]


TimedReply = TypeVar("TimedReply", bound=CostedReply)
CostedStepsReply = TypeVar("CostedStepsReply", bound=CostedSteps)
R = TypeVar("R")


class CallCounter(Protocol):
    """Counter of the calls of one function, independent of the firmware's reports."""

    def begin(self) -> None:
        """Forget the calls so far."""

    @property
    def cycles(self) -> Sequence[int]:
        """Cycles of each call since then, from the function's first instruction to its return."""


class Stage(Protocol):
    """A table that turns a board by itself."""

    def turn_to(self, pose: Pose, *, known_angle: int | None = None, face: int | None = None) -> None:
        """Turn the table and return when it stands; the number of a face selects its misalignment in the world."""

    def tumble(self, duration_s: float) -> float:
        """Turn to the first pose of a tumble, start it, and return its duration [s] at once."""

    def sway(self) -> float:
        """Start to turn and tilt from the level table's present heading; return the duration [s] at once."""

    def turn_round(self, turn_deg: float, *, rate_dps: float, after_s: float) -> float:
        """Schedule a turn about the vertical in `after_s`; return the time until the table stands again [s]."""

    @property
    def temperature_degc(self) -> float:
        """True temperature of the board now."""

    @property
    def said_of_playback(self) -> list[str]:
        """Deviations from the recording that is played, in sentences; empty without a recording."""

    @property
    def firmware_clock_began_s(self) -> float:
        """Virtual time at which the firmware's clock began [s]."""

    def write_sensor(self, bus: int, address: int, register: int, value: int) -> None:
        """Write a register of a sensor without the firmware, as another master on the I2C bus would."""


class StepRecorder(Protocol):
    """Recorder of work that runs in steps, each timed by the firmware."""

    def add(self, cycles: Sequence[int], overhead_cycles: int) -> None:
        """Record the steps that were timed last, in order."""

    def band(self) -> CycleRange | None:
        """Return the uncertainty range of all steps together; None if unknown."""


class OnChip(NamedTuple):
    """Facts about the flashed image, which a board cannot report. Same meaning as in `Board`."""

    firmware_sha256: str
    compiler_flags: str
    elf_build_id: str

    def note(self, board: Any) -> None:
        """Add these facts to a board's identity."""
        for name, value in self._asdict().items():
            setattr(board, name, value)


class Board(ABC):
    """A board: virtual, real or replayed, with one interface to its firmware.

    Parameters
    ----------
    interface
        hiltest's protocol, or the decoders of the firmware's own output. The board closes it.
    description
        One line for people.
    declared
        Declarations of the rig.

    Attributes
    ----------
    stage : Stage or None
        None if an operator or motors turn the board.
    truth : Truth or None
        None if unknown: "not offered".
    costs : Costs or None
        Costs of the functions that the rig names, of firmware that answers no requests; None if the board cannot
        observe them.
    firmware : str
        Name of the file that runs, of firmware that answers no requests; empty if there is none.
    firmware_sha256 : str or None
        Digest of the ELF file, if there is one.
    compiler_flags : str
        Compiler flags of all units of that file; empty if they are unknown.
    elf_build_id : str
        GNU build-id note of that file; empty without one.
    seed : int or None
        Seed of a simulated world.
    execution : ExecutionWatch or None
        Instructions that the firmware has executed, if they are recorded.
    """

    kind: BoardKind
    description: str
    stage: Stage | None = None
    truth: Truth | None = None
    costs: Costs | None = None
    firmware: str = ""
    firmware_sha256: str | None = None
    compiler_flags: str = ""
    elf_build_id: str = ""
    seed: int | None = None
    execution: ExecutionWatch | None = None

    def __init__(self, interface: ProtocolInterface | OutputInterface, *, description: str, declared: Declared) -> None:
        self.interface = interface
        self.description = description
        self.declared = declared

    # -- the interface to the firmware ---------------------------------------------------------

    @property
    def answers_requests(self) -> bool:
        """True if the firmware answers hiltest's requests; otherwise hiltest reads what it sends by itself."""
        return isinstance(self.interface, ProtocolInterface)

    @property
    def protocol(self) -> ProtocolInterface:
        """The interface, if it is hiltest's protocol.

        Raises
        ------
        NotOfferedError
            When the firmware answers no requests.
        """
        if isinstance(self.interface, ProtocolInterface):
            return self.interface
        raise NotOfferedError(
            f"the firmware answers no requests, as {self.interface.rig.where('device', 'kind')} says; use "
            "board.output, which has the quantities that it reports"
        )

    @property
    def output(self) -> OutputInterface:
        """The interface, if it decodes the firmware's own output.

        Raises
        ------
        NotOfferedError
            When the firmware speaks only when it is asked.
        """
        if isinstance(self.interface, OutputInterface):
            return self.interface
        raise NotOfferedError(
            f"rig {self.declared.rig} has no [device] table: its firmware reports nothing by itself; use "
            "board.session, which sends requests"
        )

    @property
    def offers(self) -> frozenset[Quantity]:
        """Quantities that the firmware may report."""
        return self.interface.offers

    @property
    def session(self) -> Session:
        """Requests to the firmware, with the errors of `protocol`."""
        return self.protocol.session

    @property
    def identity(self) -> Identity:
        """Identity of the firmware, with the errors of `protocol`."""
        return self.protocol.identity

    @property
    def sensors(self) -> tuple[SensorInfo, ...]:
        """Sensors that the firmware knows, with the errors of `protocol`."""
        return self.protocol.sensors

    def sensor(self, kind: SensorKind) -> SensorInfo:
        """Return the selected sensor of a kind; see `ProtocolInterface.sensor`."""
        return self.protocol.sensor(kind)

    # -- facts -------------------------------------------------------------------------------

    def is_noise_free(self, kind: SensorKind) -> bool:
        """Return whether the true readings of a kind of sensor have no noise."""
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
        """Kind of the board that gave the answers: of a replay, the recorded one."""
        return self.kind

    @property
    def clock(self) -> str:
        """``virtual`` or ``wall``."""
        return self.interface.clock

    @property
    def line_is_exact(self) -> bool:
        """True if the line is free of errors, as a simulated line without faults is."""
        faults = self.declared.faults
        return self.origin is BoardKind.VIRTUAL and (faults is None or not faults.has_line_faults)

    @property
    def sensors_are_sound(self) -> bool:
        """True if its sensors and buses cannot fail: true for a virtual board without such faults in its rig."""
        faults = self.declared.faults
        return self.origin is BoardKind.VIRTUAL and (faults is None or not faults.has_sensor_faults)

    def now_s(self) -> float:
        """Return the time of the board's clock [s]."""
        return self.interface.now_s()

    def sleep(self, seconds: float) -> None:
        """Wait, by the board's clock [s]; output that arrives meanwhile is dropped."""
        self.interface.sleep(seconds)

    @property
    def firmware_line(self) -> str:
        """Name and build of the firmware, for people."""
        if self.answers_requests:
            return self.protocol.firmware_line
        build = f" build {self.elf_build_id[:16]}" if self.elf_build_id else ""
        return f"{self.firmware or 'its firmware'}{build}, understood by {', '.join(self.output.decoders)}"

    @property
    def core_clock_hz(self) -> int:
        """Core clock as the firmware reports it; 0 if it is unknown."""
        return self.identity.core_clock_hz if self.answers_requests else 0

    @property
    @abstractmethod
    def cycle_model(self) -> str:
        """Cycle model of this board's counts, with the placement of the code."""

    @property
    def virtual_seconds(self) -> float | None:
        """Virtual time since power-on; None if time is not virtual."""
        return self.now_s() if self.clock == "virtual" else None

    def memory_use(self) -> Mapping[str, int | str]:
        """Return the bytes that the firmware takes, see `seen_memory_use`, or the reason why they are unknown."""
        return NO_MEMORY_USE

    def delivered_fields(self) -> Mapping[str, list[int]] | None:
        """Return the samples that each magnetometer has delivered so far, by bus and address; None if unknown.

        A value has their number and their sums along x, y and z of the body [count]. Those of an accelerometer have
        the name with ``g`` behind it, and the unit of 1/16384 g; recordings of earlier versions lack them.
        """
        return None

    def delivered_samples(self) -> Mapping[str, NDArray[np.float64]] | None:
        """Return the latest samples that each sensor has delivered, named and in the units of `delivered_fields`.

        Each has the shape (n, 4): time of the board's clock [s], and counts along x, y and z of the body. None if they
        are unknown.
        """
        return None

    def sensor_settings(self) -> Sequence[PartSettings] | None:
        """Return the registers of the parts that run, or that they had at their latest sample; None if unknown."""
        return None

    def true_attitude(self, board_us: int) -> Pose | None:
        """Return the board's attitude at a time of its own clock [us]; None if unknown."""
        return None

    def true_disturbances_ut(self, board_us: int) -> Mapping[str, Vector] | None:
        """Return the field's disturbances at a time of its clock [us], by cause, body frame; None if unknown."""
        return None

    def call_counter(self, calibrator: str) -> CallCounter | None:
        """Return the counter of a calibrator's calls; None if the board cannot observe them."""
        return None

    @property
    def executes_firmware(self) -> bool:
        """True if the board executes every instruction, and so can check the firmware's reports."""
        return False

    def timed(self, request: Request[TimedReply], calibrator: str) -> TimedReply:
        """Send a request that runs a calibrator, and check the cycles that the firmware reports.

        Parameters
        ----------
        request
            Request whose reply has a `cost`.
        calibrator
            Name as in the board's identity.

        Raises
        ------
        FirmwareContradictionError
            When the board counted other cycles in the calibrator's function than the firmware reports, or no call.
        """
        reply, counted = self._send_and_count(request, calibrator)
        if reply.cost is not None:
            _refuse_other_cycles(calibrator, [reply.cost], counted)
        return reply

    def timed_each(self, request: Request[CostedStepsReply], work: str) -> CostedStepsReply:
        """Send a request that runs a function repeatedly, and check the cycles that are reported for each call.

        Parameters
        ----------
        request
            Request whose reply has the `costs` of the first calls; calls that were refused may follow.
        work
            Function to call: a stream calibrator's name and ``.add`` or ``.remove``.

        Raises
        ------
        FirmwareContradictionError
            When the board counted other cycles in these calls than the firmware reports.
        """
        reply, counted = self._send_and_count(request, work)
        if reply.costs:
            _refuse_other_cycles(work, reply.costs, None if counted is None else counted[: len(reply.costs)])
        return reply

    def _send_and_count(self, request: Request[R], work: str) -> tuple[R, Sequence[int] | None]:
        """Send a request; return its reply, and the cycles of each call of a function, None if they are unknown."""
        counter = self.call_counter(work)
        if counter is not None:
            counter.begin()
        reply = self.session.request(request)
        return reply, None if counter is None else list(counter.cycles)

    def unchecked(self, calibrator: str) -> str:
        """Return why the board cannot check the cycles that the firmware reports for the calibrator that just ran.

        Empty if it has checked them, or if the board does not execute the firmware and so cannot count.
        """
        if not self.executes_firmware:
            return ""
        if self.call_counter(calibrator) is None:
            return (
                f"the board cannot count the cycles of {calibrator}: no function has this name; name one under "
                "[cycles] in the rig"
            )
        return ""

    def request_cost(self) -> RequestCost | None:
        """Return the cost of the latest request; None if the board cannot observe it."""
        return None

    def cycle_range(self, cost: RunCost | None, calibrator: str = "") -> CycleRange | None:
        """Return the uncertainty range of the cycles of the run that was just timed; None if unknown.

        Parameters
        ----------
        cost
            Cost as the firmware reports it.
        calibrator
            Calibrator that was timed, to identify the counter readings around its call.
        """
        return None

    def timed_steps(self) -> StepRecorder | None:
        """Start to record work that is timed step by step; None if the board cannot."""
        return None

    def instructions_counted(self, cycles: int) -> int | None:
        """Count the instructions of the code that the firmware has just timed at `cycles`; None if unknown."""
        return None

    def close(self) -> None:
        self.interface.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _refuse_other_cycles(work: str, reported: Sequence[RunCost], counted: Sequence[int] | None) -> None:
    """Raise a FirmwareContradictionError if calls took other cycles than reported, or there was no call."""
    if counted is None:  # the board does not observe them
        return
    if not counted:
        raise FirmwareContradictionError(
            f"the firmware contradicts the board: it reports the cycles of {work}, and its function was not called for "
            "this request. It answers from an earlier call; or the function is inlined: then name another one under "
            "[cycles] in the rig"
        )
    total, calls = sum(cost.cycles for cost in reported), len(counted)
    if abs(sum(counted) - total) > CALL_CYCLES * len(reported):
        raise FirmwareContradictionError(
            f"the firmware contradicts the board: it reports {total} cycles of {work}, and "
            f"the board counted {sum(counted)} in {'its call' if calls == 1 else f'{calls} calls'}"
        )
