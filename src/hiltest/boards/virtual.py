"""The virtual board: the real firmware on an emulated processor, in a simulated world."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property, partial
from pathlib import Path
from types import NoneType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hiltest.boards.bench import VirtualBench, default_firmware
from hiltest.boards.board import Board, BoardKind, Declared, PartSettings, RequestCost, Truth
from hiltest.boards.delivered_samples import DeliveredSamples
from hiltest.boards.faulty_port import add_faults
from hiltest.boards.function_costs import FunctionCosts
from hiltest.boards.memory_use import seen_memory_use
from hiltest.boards.output_interface import OutputInterface, open_output
from hiltest.boards.protocol_interface import LinkTerms, ProtocolInterface
from hiltest.boards.virtual_port import VirtualPort
from hiltest.errors import ConfigError, ProtocolError, VersionMismatchError
from hiltest.link.framing import Frame
from hiltest.link.ports import READ_SLICE_S, SerialPort
from hiltest.link.replies import SAMPLE_RATE_HZ, RunCost, SensorInfo
from hiltest.link.session import ATTEMPTS, Session
from hiltest.link.transcript import Transcript
from hiltest.measurement import CycleRange
from hiltest.orientation.angles import Pose
from hiltest.rig import COUNTS_PER_UT, Rig, world_truth
from hiltest.tape.tape import LIVE, Tape
from hiltest.virtual.calls.call_watch import CallWatch
from hiltest.virtual.counts.cycle_range import TimedSteps, timed_range
from hiltest.virtual.processor.call_summary import Call
from hiltest.virtual.program.elf import FirmwareImage, load_image
from hiltest.world import Vector
from hiltest.world.sensors.fxos8700cq import Fxos8700cqNoise

_CLOCK_TOLERANCE = 0.005  # clocks are often rounded to whole MHz: 20.97 as 21
_ID_DIGITS = 8  # 32 bits, enough to distinguish builds

# Functions of the calibrators whose name differs from their name on the link.
_FUNCTIONS = {"dpi": "fit_pairs", "joint": "fit_jointly"}


class _Session(Session):
    """A session in which each new request clears the records of the one before; a repetition does not."""

    def __init__(self, begin: Callable[[int], None], port: SerialPort, **terms: Any) -> None:
        super().__init__(port, **terms)
        self._begin = begin

    def numbered(self, code: int, payload: bytes) -> Frame:
        """Return a frame under the next sequence number, without sending it."""
        self._begin(code)
        return super().numbered(code, payload)


class _CallCounter:
    """Counter of calls like the firmware's, which reads CYCCNT before and after a call: exceptions included."""

    def __init__(self, watch: CallWatch, function: str) -> None:
        self._watch, self.function = watch, function
        self.begin = watch.begin

    @property
    def calls(self) -> Sequence[Call]:
        """Calls since `begin`."""
        return self._watch.calls(self.function)

    @property
    def stack(self) -> int | None:
        """Bytes of stack that the deepest of all calls took; None if unknown."""
        return self._watch.stack(self.function)

    @property
    def cycles(self) -> Sequence[int]:
        """Cycles of each call."""
        return [call.elapsed for call in self.calls]


class VirtualBoard(Board):
    """A virtual board behind its serial port, in stepped time.

    Parameters
    ----------
    bench
        Board, sensors and world.
    declared
        Declarations of the rig; by default those of the bench's rig.
    transcript
        Receives every byte, in both directions.
    tape
        Records all questions.
    """

    kind = BoardKind.VIRTUAL

    def __init__(
        self,
        bench: VirtualBench,
        *,
        declared: Declared | None = None,
        transcript: Transcript | None = None,
        tape: Tape = LIVE,
    ) -> None:
        self._bench, self._machine = bench, bench.machine
        self._counters: dict[str, _CallCounter] = {}
        self._delivered: DeliveredSamples | None = None
        declared = declared or Declared.select(bench.rig)
        image = bench.machine.image
        self.stage, self.execution = bench, bench.execution
        self.seed, self.truth = bench.seed, truth_of(bench.rig)
        self.firmware_sha256 = hashlib.sha256(Path(bench.firmware).read_bytes()).hexdigest()
        self.elf_build_id = image.build_id
        opening = self._open_protocol if bench.rig.answers_requests else self._open_output
        super().__init__(
            opening(declared, transcript, tape),
            description=f"virtual {bench.machine.title}, seed {bench.seed}",
            declared=declared,
        )
        if self.answers_requests:
            try:
                tape.ask("board.check", {}, NoneType, self._check)
            except ProtocolError:
                self.close()
                raise

    @cached_property
    def compiler_flags(self) -> str:  # type: ignore[override]  # which recordings may set, as any fact
        """Compiler flags, read from the debug information at the first request, which takes 0.3 s."""
        return self._machine.image.compiler_flags

    def _open_protocol(self, declared: Declared, transcript: Transcript | None, tape: Tape) -> ProtocolInterface:
        bench = self._bench
        for calibrator, function in declared.functions.items():
            if function not in bench.machine.image.symbols:
                raise ConfigError(
                    f"{bench.rig.path}: cycles.{calibrator} names {function!r}, and {bench.machine.image.name} has no "
                    "such function; name one of its symbols"
                )
        bench.machine.may_rest = False  # raise at once when no answer can come any more
        bench.power_on()
        port = self._open_port()
        port.timeout = READ_SLICE_S
        # A simulated line loses nothing, so a repeated request would not be answered either.
        terms = LinkTerms(nonce_seed=bench.seed, attempts=1 if declared.faults is None else ATTEMPTS)
        session = terms.session(
            lambda: add_faults(port, declared.faults, baud=bench.rig.link.baud),
            transcript,
            tape,
            session_type=partial(_Session, self._begin_request),
        )
        return ProtocolInterface(
            session, declared.sensor_names, self.is_noise_free, tape=tape, delivered=self._check_deliveries
        )

    def _begin_request(self, code: int) -> None:
        """Clear the records of the previous request: readings of the cycle counter, masks and delivered samples."""
        self._machine.cycle_counter.forget()
        self._machine.processor.core.longest_masked = 0
        self._bench.forget_deliveries()
        if self._delivered is not None:
            self._delivered.begin(code, self._bench.time_s)

    def _check_deliveries(self, sensors: Sequence[SensorInfo]) -> DeliveredSamples:
        bench = self._bench
        self._delivered = DeliveredSamples(
            sensors,
            bench.delivered,
            bench.delivered_temperature,
            lambda board_us: bench.firmware_clock_began_s + 1e-6 * board_us,
        )
        return self._delivered

    def _open_output(self, declared: Declared, transcript: Transcript | None, tape: Tape) -> OutputInterface:
        rig = self._bench.rig
        self.costs = self._costs = FunctionCosts(self._machine, rig)
        self.firmware = self._bench.firmware.name
        return open_output(
            rig,
            lambda: add_faults(self._open_port(), declared.faults, baud=rig.link.baud),
            image=self._machine.image,
            machine=self._machine,
            transcript=transcript,
            tape=tape,
        )

    def _open_port(self) -> VirtualPort:
        port = VirtualPort()
        port.port = "hil://"
        port.attach(self._machine)
        port.open()
        return port

    def _check(self) -> None:
        """Refuse firmware whose own statements contradict the board's observations."""
        refuse_forged_build(self.identity.build_id, self._machine.image)
        refuse_wrong_clock(self.identity.core_clock_hz, self._machine.clocks.core_hz)

    @property
    def core_clock_hz(self) -> int:
        """Core clock as the firmware reports it, or as it is now if the firmware answers no requests."""
        return super().core_clock_hz or round(self._machine.clocks.core_hz)

    @property
    def cycle_model(self) -> str:
        """Name and version of the timing profile with the placement of the code, if known; or nothing."""
        profile: str = self._machine.processor.profile.name
        if not self.answers_requests:
            return profile
        return f"{profile}@{self.identity.placement}" if self.identity.cycle_source else "none"

    def sleep(self, seconds: float) -> None:
        """Let virtual time pass [s]."""
        if self.answers_requests:
            self._machine.run_until(self._machine.time_s + seconds)
        else:
            super().sleep(seconds)

    def memory_use(self) -> Mapping[str, int | str]:
        """Return the firmware's flash and RAM use, and its deepest stacks so far [byte]."""
        if not self.answers_requests:
            return seen_memory_use(self._machine, self._costs.stacks())
        calls = {name: (counter.function, counter.stack) for name, counter in self._counters.items() if "." not in name}
        return seen_memory_use(self._machine, calls)

    def delivered_fields(self) -> Mapping[str, list[int]]:
        """Return the number and the sums of the samples that magnetometers and accelerometers have delivered so far."""
        return self._bench.delivered_fields()

    def delivered_samples(self) -> Mapping[str, NDArray[np.float64]]:
        """Return the latest samples that magnetometers and accelerometers have delivered, with their times."""
        return self._bench.delivered_samples()

    def sensor_settings(self) -> Sequence[PartSettings]:
        """Return the registers of the parts that run, or that they had at their latest sample."""
        return self._bench.sensor_settings()

    def true_attitude(self, board_us: int) -> Pose | None:
        """Return the board's attitude at a time of its own clock [us]; None while a recording is played."""
        return None if self.truth is None else self._bench.attitude_at(board_us)

    def true_disturbances_ut(self, board_us: int) -> Mapping[str, Vector] | None:
        """Return the disturbances of the field at a time of its own clock [us], by cause; None for a recording."""
        return None if self.truth is None else self._bench.disturbances_at_ut(board_us)

    def instructions_counted(self, cycles: int) -> int | None:
        """Count the instructions between the two latest readings of CYCCNT that lie `cycles` apart."""
        return self._machine.cycle_counter.instructions_between(cycles)

    @property
    def executes_firmware(self) -> bool:
        """True, because it emulates the processor."""
        return True

    def call_counter(self, calibrator: str) -> _CallCounter | None:
        """Return the counter of a calibrator's calls; None if the firmware has no function of its name."""
        of_a_stream = "." in calibrator  # as in direct-stream.add
        own = calibrator.replace("-", "_").replace(".", "_")
        name = _FUNCTIONS.get(calibrator) or (own if of_a_stream else f"magnetometer_{own}")
        function = self.declared.functions.get(calibrator, name)
        if function not in self._machine.image.symbols:
            return None
        if calibrator not in self._counters:
            self._counters[calibrator] = _CallCounter(self._machine.watch_calls([function]), function)
        return self._counters[calibrator]

    def request_cost(self) -> RequestCost:
        """Return the cost of the latest request."""
        cycles, awake_cycles = self._machine.uart0.answer
        us_per_cycle = 1e6 / self._machine.clocks.core_hz
        masked = self._machine.processor.core.longest_masked
        return RequestCost(awake_cycles, cycles * us_per_cycle, masked * us_per_cycle)

    def cycle_range(self, cost: RunCost | None, calibrator: str = "") -> CycleRange | None:
        """Reprice the code between two readings of CYCCNT, with each row of the timing profile varied."""
        if cost is None:
            return None
        counter, profile = self._machine.cycle_counter, self._machine.processor.profile
        calls = call_counter.calls if calibrator and (call_counter := self.call_counter(calibrator)) else ()
        call = (calls[-1].entered, calls[-1].returned) if calls else None
        executed = counter.executed_in(cost.cycles, cost.overhead_cycles, call)
        return timed_range(profile, self.cycle_model, cost.cycles, executed)

    def timed_steps(self) -> TimedSteps:
        """Start to record work that is timed step by step."""
        return TimedSteps(self._machine.cycle_counter, self._machine.processor.profile, self.cycle_model)


def refuse_forged_build(answered: str, image: FirmwareImage) -> None:
    """Raise a VersionMismatchError if the firmware reports the build id of another ELF than the running one.

    Without a GNU build-id note only the id of the packaged firmware is known, which has such a note.
    """
    if image.build_id:
        if len(answered) < _ID_DIGITS or not image.build_id.startswith(answered.lower()):
            raise VersionMismatchError(
                f"{image.name}: its GNU build-id note has build {image.build_id}, and the firmware answers "
                f"{answered!r}; answer the note's first {_ID_DIGITS} digits or more, or link with -Wl,--build-id=none"
            )
    elif answered == load_image(default_firmware()).build_id:
        raise VersionMismatchError(
            f"{image.name}: the firmware answers build {answered}, that of the packaged firmware, but is another "
            "file; give each build its own id"
        )


def refuse_wrong_clock(answered_hz: int, core_hz: float) -> None:
    """Raise a VersionMismatchError if the firmware reports another core clock than it has set up."""
    if abs(answered_hz / core_hz - 1.0) > _CLOCK_TOLERANCE:
        raise VersionMismatchError(
            f"the firmware answers a core clock of {answered_hz / 1e6:g} MHz, and the core runs at "
            f"{core_hz / 1e6:g}; answer the clock of the MCG and the SIM's dividers, on which times and budgets depend"
        )


def truth_of(rig: Rig) -> Truth | None:
    truth = world_truth(rig)
    if truth is None or rig.world is None or rig.world.playback is not None:
        return None
    return Truth(
        soft_iron=np.array(truth.soft_iron),
        hard_iron_ut=np.array(truth.hard_iron_counts) / COUNTS_PER_UT,
        field_ut=truth.field.strength_ut,
        dip_deg=truth.field.dip_deg,
        magnetometer_sigma_ut=rig.magnetometer_under_test.magnetometer_noise_ut(rig.world),
        accelerometer_sigma_g=Fxos8700cqNoise().accelerometer_g(SAMPLE_RATE_HZ),
        accelerometer_response=np.array(truth.accelerometer_response),
        accelerometer_offset_g=np.array(truth.accelerometer_offset_g),
        gyroscope_bias_dps=np.array(truth.gyroscope_bias_dps),
        gyroscope_response=np.array(truth.gyroscope_response),
        gyroscope_density_dps=1e-3 * rig.world.gyroscope_noise_mdps_per_rthz,
    )
