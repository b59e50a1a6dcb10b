"""A virtual board in its world: firmware, sensors, and turntable."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import zip_longest
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from hiltest.boards.board import PartSettings
from hiltest.boards.delivered_samples import Samples
from hiltest.errors import ConfigError
from hiltest.interfaces.sensor_files.recorded_motion import load_playback
from hiltest.json_files import read_json
from hiltest.link.replies import SensorInfo
from hiltest.orientation.angles import Pose
from hiltest.rig import Rig, build_parts, build_world
from hiltest.rig.board_faults import span_of
from hiltest.rig.faults import Faults
from hiltest.virtual.board.described_machine import DescribedMachine
from hiltest.virtual.board.k64f import VirtualK64F
from hiltest.virtual.board.microbit_v1 import VirtualMicrobit
from hiltest.virtual.board.virtual_machine import BoardSnapshot, VirtualMachine
from hiltest.virtual.model.profile_file import DEFAULT_PROFILE, SUFFIX, place_of
from hiltest.virtual.peripherals.i2c_bus import HeldLine
from hiltest.virtual.peripherals.rcm import ResetSource
from hiltest.virtual.processor.executed_code import ExecutionWatch
from hiltest.virtual.program.elf import load_image
from hiltest.world import Vector
from hiltest.world.faces import askew
from hiltest.world.motion import MOVE_GRID_S, MotionSegment
from hiltest.world.recorded_motion import Sensed
from hiltest.world.sensors import RegisterDevice
from hiltest.world.sensors.faulty_part import FaultyPart
from hiltest.world.sensors.sampling import SampledOutput
from hiltest.world.sway import SWAY_S, Sway

#: Time from power-on until the firmware listens and its sensors are set up [s]: the gyroscope alone boots for 60 ms.
START_UP_S = 0.2
#: Duration of a tumble in which the cost of functions is seen [virtual s]; it takes some seconds of a computer.
TUMBLE_S = 20.0
Word = TypeVar("Word", np.int64, np.float64)
_RESETS = {"button": ResetSource.PIN, "brown-out": ResetSource.POWER_ON}


def default_firmware() -> Path:
    """Return the prebuilt ELF that ships in the package."""
    return Path(__file__).parents[1] / "firmware" / "hiltest-frdm-k64f.elf"


def packaged_build_id() -> str:
    """Return the build of the ELF that ships in the package."""
    manifest = default_firmware().with_name("manifest.json")
    return str(read_json(manifest, otherwise="install hiltest again").content["build_id"])


def firmware_of(rig: Rig) -> Path:
    """Return the firmware of a rig: the file that it names, beside the rig or in the package, or hiltest's own.

    Raises
    ------
    ConfigError
        When there is no such file.
    """
    named, shipped = rig.board.firmware, default_firmware().parent
    if named is None and not rig.answers_requests:
        raise ConfigError(
            f"{rig.path}: names no firmware under test: name it with --firmware ELF, or as board.firmware. The "
            "packaged firmware does not fit a rig with a [device] table"
        )
    if named is None:
        return default_firmware()
    for file in (rig.path.parent / named, shipped / named):
        if file.is_file():
            return file
    ours = ", ".join(sorted(path.name for path in shipped.glob("*.elf")))
    raise ConfigError(
        f"{rig.where('board', 'firmware')}: board.firmware: no file {named!r} beside the rig, and none of that name "
        f"comes with hiltest: {ours}"
    )


def _timing_profile(rig: Rig) -> str:
    """Return the name or file of the timing profile; a relative path is relative to the rig's file."""
    named = rig.board.timing or DEFAULT_PROFILE
    if named.endswith(SUFFIX):
        return str(rig.path.parent / named)
    try:
        place_of(named)
    except ConfigError as error:
        raise ConfigError(f"{rig.path}: board.timing: {error}") from error
    return named


def _put_faults_on(machine: VirtualMachine, faults: Faults | None) -> None:
    """Apply the faults that belong to the board and not to one of its sensors."""
    if faults and faults.held_line:
        held = faults.held_line
        machine.hold_line(held.bus, HeldLine(held.line, *span_of(held, START_UP_S)))
    if faults and faults.reset:
        machine.reset_at(START_UP_S + faults.reset.after_s, _RESETS[faults.reset.by])


def _turn_to_body(words: NDArray[Word], output: SampledOutput) -> NDArray[Word]:
    """Return words along the axes of the part, shape (..., 3), along those of the body."""
    axes = np.array(output.body_axes)
    return np.asarray(words[..., np.abs(axes) - 1] * np.sign(axes).astype(words.dtype))


class BenchSnapshot(NamedTuple):
    """State of a bench at one moment; `VirtualBench.snapshot` takes it."""

    board: BoardSnapshot
    world: Any


class VirtualBench:
    """The board, sensors, world and table of a rig with a simulated world.

    Parameters
    ----------
    rig
        Rig of a virtual board.
    firmware
        ELF, Intel HEX or raw binary to run; by default the rig's, or the prebuilt one.
    seed
        Noise seed; by default the rig's.
    base
        Address of a raw binary.
    flash_file
        File that keeps the flash contents between runs.
    watches_execution
        True to record the instructions that the firmware executes.

    Attributes
    ----------
    machine : VirtualMachine
    execution : ExecutionWatch or None
        Record of the executed instructions.
    firmware : Path
    seed : int
    playback : Playback or None
        Recording that the sensors measure; the table has then no effect on them.

    Raises
    ------
    ConfigError
        When the rig has no simulated world, or the firmware cannot be loaded.
    """

    def __init__(
        self,
        rig: Rig,
        *,
        firmware: Path | None = None,
        seed: int | None = None,
        base: int | None = None,
        flash_file: Path | None = None,
        watches_execution: bool = False,
    ) -> None:
        if rig.world is None:
            raise ConfigError(
                f"rig {rig.name} ({rig.path}) is of a {rig.board.kind} board, which has no simulated world. "
                "Name its port with --port, or choose a rig of a virtual board."
            )
        self.rig = rig
        self.firmware = firmware or firmware_of(rig)
        self.seed = rig.seed if seed is None else seed
        self._world = build_world(rig)
        self._world.playback = self.playback = load_playback(rig)
        self._named = build_parts(rig, self._world, self.seed, faults_from_s=START_UP_S)
        self._places = rig.parts
        self._parts: dict[tuple[str, int | str], RegisterDevice | FaultyPart] = {}
        i2c: dict[str, list[RegisterDevice | FaultyPart]] = {"i2c0": [], "i2c1": []}
        spi: dict[str, dict[str, RegisterDevice | FaultyPart]] = {"spi0": {}, "spi1": {}, "spi2": {}}
        for name, place in self._places.items():
            for at, kind, device in zip_longest(place.places, place.kinds, self._devices(name)):
                # The AK09916 behind an ICM-20948 on an SPI bus has no place of its own.
                self._parts[place.bus, at or f"{place.chip_select} {kind}"] = device
                if isinstance(at, int):
                    i2c[place.bus].append(device)
                elif at is not None:
                    spi[place.bus][at] = device
        self.machine = self._make_machine(i2c, spi, base=base, flash_file=flash_file)
        for uart in self.machine.uarts:
            uart.line_baud = rig.link.baud
        self.execution = ExecutionWatch(self.machine.processor) if watches_execution else None
        _put_faults_on(self.machine, rig.faults)
        self.machine.seed = self.seed
        self.machine.set_temperature(lambda: self.temperature_degc)
        for name, place in self._places.items():
            for device in self._devices(name):
                pins = {pin: wire for pin, wire in place.interrupts.items() if pin in device.pins}
                if pins:
                    self.machine.connect_interrupts(place.bus, device, pins)

    def _devices(self, name: str) -> tuple[RegisterDevice | FaultyPart, ...]:
        """Return a part and the further devices in its package."""
        part = self._named[name]
        return part, *part.companions

    def _make_machine(
        self,
        i2c: Mapping[str, Sequence[RegisterDevice | FaultyPart]],
        spi: Mapping[str, Mapping[str, RegisterDevice | FaultyPart]],
        *,
        base: int | None,
        flash_file: Path | None,
    ) -> VirtualMachine:
        """Make the board of the rig with its parts."""
        rig = self.rig
        if rig.board.machine == "microbit-v1":
            if flash_file is not None:
                raise ConfigError(f"{flash_file}: the virtual micro:bit stores no flash in a file; omit it")
            strangers = [name for name, place in self._places.items() if place.bus != "i2c0"]
            if strangers:
                raise ConfigError(
                    f'{rig.path}: {", ".join(strangers)}: the micro:bit has one bus: write bus = "i2c0" in '
                    "[[sensors.parts]], and fitted = [] under [world]"
                )
            profile = _timing_profile(rig) if rig.board.timing else None
            image = load_image(self.firmware, base=base, core="cortex-m0")
            return VirtualMicrobit(image, i2c=i2c["i2c0"], profile=profile)
        if rig.board.machine not in (None, "frdm-k64f"):
            return self._make_described_machine(i2c, spi, base=base, flash_file=flash_file)
        return VirtualK64F(
            load_image(self.firmware, base=base),
            i2c0=i2c["i2c0"],
            i2c1=i2c["i2c1"],
            spi0=spi["spi0"],
            spi1=spi["spi1"],
            spi2=spi["spi2"],
            profile=_timing_profile(rig),
            # All registers that the packaged firmware uses are modelled, so an access to any other is a bug.
            strict=self.firmware == default_firmware(),
            flash_file=flash_file,
        )

    def _make_described_machine(
        self,
        i2c: Mapping[str, Sequence[RegisterDevice | FaultyPart]],
        spi: Mapping[str, Mapping[str, RegisterDevice | FaultyPart]],
        *,
        base: int | None,
        flash_file: Path | None,
    ) -> VirtualMachine:
        """Make the board of a machine file; the path of a file is relative to the rig's."""
        rig, name = self.rig, str(self.rig.board.machine)
        if flash_file is not None:
            raise ConfigError(f"{flash_file}: the virtual {name} stores no flash in a file; omit it")
        machine = str(rig.path.parent / name) if name.endswith(SUFFIX) else name
        profile = _timing_profile(rig) if rig.board.timing else None
        return DescribedMachine(machine, load_image(self.firmware, base=base), i2c=i2c, spi=spi, profile=profile)

    def snapshot(self) -> BenchSnapshot:
        """Take a snapshot of the board and of the world with its table; see `VirtualMachine.snapshot`."""
        return BenchSnapshot(self.machine.snapshot(), self._world.state())

    def restore(self, snapshot: BenchSnapshot) -> None:
        """Restore a snapshot of this bench, which undoes all moves of the table since then."""
        self.machine.restore(snapshot.board)
        self._world.restore(snapshot.world)

    @property
    def time_s(self) -> float:
        """Virtual seconds since power-on."""
        return self.machine.time_s

    def power_on(self) -> None:
        """Start the firmware, and let virtual time run until it listens."""
        self.machine.run_until(START_UP_S)

    def turn_to(self, pose: Pose, *, known_angle: int | None = None, face: int | None = None) -> None:
        """Turn the table, and let virtual time run until it stands; the world may define a face as misaligned."""
        errors_deg = self.rig.world.face_errors_deg if self.rig.world and face is not None else ()
        pose = askew(pose, errors_deg[face]) if errors_deg and face is not None else pose
        self.machine.run_until(self.begin_turn(pose, known_angle=known_angle))

    def tumble(self, duration_s: float) -> float:
        """Turn to the first pose of a tumble, start it, and return its duration [s] at once."""
        self.machine.run_until(self.begin_tumble(duration_s))
        return self.tumble_takes_s(duration_s)

    def turn_round(self, turn_deg: float, *, rate_dps: float, after_s: float) -> float:
        """Schedule a turn about the vertical in `after_s`; return the time until the table stands again [s]."""
        now_s = self.machine.time_s
        return self._world.turn_round(turn_deg, rate_dps=rate_dps, time_s=now_s + after_s) - now_s

    def run_in_tumble(self) -> None:
        """Switch the board on, and run its firmware through `TUMBLE_S` of a tumble."""
        self.power_on()
        self.begin_tumble(TUMBLE_S)
        self.machine.run_until(self.time_s + TUMBLE_S)

    def tumble_takes_s(self, duration_s: float) -> float:
        """Return the actual duration of a tumble that should take `duration_s` [s]."""
        return self._world.tumble_takes_s(duration_s)

    def sway(self) -> float:
        """Start to turn and tilt from the level table's present heading; return the duration [s] at once."""
        begin_s = self.next_move_s()
        steps = round(begin_s / MOVE_GRID_S) + round(SWAY_S / MOVE_GRID_S)
        heading_deg = self._world.state_at(begin_s).pose.heading_deg - self._world.mounting_yaw_deg
        self.begin_move(Sway(begin_s, steps * MOVE_GRID_S, heading_deg))
        return SWAY_S

    @property
    def said_of_playback(self) -> list[str]:
        """Deviations from the recording that is played, in sentences; empty without a recording."""
        return self.playback.remarks() if self.playback else []

    @property
    def temperature_degc(self) -> float:
        """True temperature of the board now."""
        return self._world.temperature_degc(self.machine.time_s)

    def write_sensor(self, bus: int, address: int, register: int, value: int) -> None:
        """Write a register of a sensor without the firmware, as another master on the I2C bus would."""
        part, now_s = self._parts[f"i2c{bus}", address], self.machine.time_s
        part.start(False, now_s)
        part.write(register, now_s)
        part.write(value, now_s)
        part.stop(now_s)
        self.machine.update_interrupts()

    def forget_deliveries(self) -> None:
        """Forget the samples and registers that the sensors have delivered so far."""
        for part in self._parts.values():
            part.transferred.clear()
            for output in part.outputs:
                output.deliveries.clear()

    def delivered(self, sensor: SensorInfo) -> Samples:
        """Return the samples that a sensor has delivered since then, in the body frame."""
        part = self._parts[f"i2c{sensor.bus}", sensor.address]
        output = next(output for output in part.outputs if output.quantity.name == sensor.kind.name)
        rows = list(output.deliveries)
        words = np.array([row.words for row in rows], np.int64).reshape(-1, 3)
        return Samples(
            _turn_to_body(words, output),
            np.array([row.number for row in rows], np.int64),
            np.array([row.instant_s for row in rows]),
            np.array([row.time_s for row in rows]),
            1.0 / output.rate_hz,
        )

    def delivered_fields(self) -> dict[str, list[int]]:
        """Return the number and the sums of the samples that the parts have delivered since power-on."""
        return {
            name: [
                round(output.delivered[0]),
                *_turn_to_body(np.array(output.delivered[1:]).round().astype(np.int64), output).tolist(),
            ]
            for name, output in self._fields_of_earth()
        }

    def delivered_samples(self) -> dict[str, NDArray[np.float64]]:
        """Return the latest samples that the parts have delivered, with their times."""
        samples = {}
        for name, output in self._fields_of_earth():
            counts = np.array([row.words for row in output.deliveries], np.float64).reshape(-1, 3) * output.weight
            times_s = np.array([row.time_s for row in output.deliveries])
            samples[name] = np.column_stack([times_s, _turn_to_body(counts, output)])
        return samples

    def _fields_of_earth(self) -> Iterator[tuple[str, SampledOutput]]:
        """Return the magnetometers and accelerometers that have delivered samples, by bus and address."""
        for (bus, place), part in self._parts.items():
            for output in part.outputs:
                if output.quantity is not Sensed.GYROSCOPE and output.delivered[0]:
                    unit = " g" if output.quantity is Sensed.ACCELEROMETER else ""
                    address = f"{bus}:{place}" if isinstance(place, str) else f"{bus[-1]}:{place:02x}"
                    yield f"{address}{unit}", output

    def delivered_temperature(self, sensor: SensorInfo) -> int | None:
        """Return the temperature byte that a sensor's part has delivered since then; None without one."""
        part = self._parts[f"i2c{sensor.bus}", sensor.address]
        return part.transferred.get(part.temperature_register)

    def sensor_settings(self) -> list[PartSettings]:
        """Return the registers of the parts that run, or that they had at their latest sample."""
        settings = []
        for part_name, place in self._places.items():
            for kind, device in zip(place.kinds, self._devices(part_name), strict=True):
                if any(row.delivered[0] or math.isfinite(row.next_sample_s(self.time_s)) for row in device.outputs):
                    name = f"{place.prefix}{kind}"
                    settings.append(PartSettings(name, place.number, device.address, device.sampled_settings()))
        return settings

    @property
    def firmware_clock_began_s(self) -> float:
        """Virtual time at which the firmware's clock, channel 0 of the PIT, started: soon after power-on or reset."""
        if not isinstance(self.machine, VirtualK64F):
            raise ConfigError(f"{self.rig.path}: only firmware of the FRDM-K64F has hiltest's clock")
        return self.machine.timers.enabled_s(0)

    def attitude_at(self, board_us: int) -> Pose:
        """Return the board's true attitude at a time of the firmware's clock [us]."""
        return self._world.state_at(self.firmware_clock_began_s + 1e-6 * board_us).pose

    def disturbances_at_ut(self, board_us: int) -> dict[str, Vector]:
        """Return the disturbances of the field at a time of the firmware's clock [us], by cause, body frame."""
        if self._world.disturbances is None:
            return {}
        time_s = self.firmware_clock_began_s + 1e-6 * board_us
        return self._world.disturbances.fields_by_cause_ut(time_s, self._world.state_at(time_s).pose)

    def next_move_s(self) -> float:
        """Return the earliest start of a move that is planned now [virtual s]."""
        return self._world.hold(time_s=self.machine.time_s)

    def begin_move(self, move: MotionSegment) -> None:
        """Start a planned move; the clock does not advance."""
        self._world.follow(move)

    def begin_turn(self, pose: Pose, *, known_angle: int | None = None) -> float:
        """Start a turn, and return its end [virtual s]; the clock does not advance."""
        return self._world.turn_to(pose, time_s=self.machine.time_s, known_angle=known_angle)

    def begin_tumble(self, duration_s: float) -> float:
        """Start a tumble, and return the time of its first pose [virtual s]; the clock does not advance."""
        self._world.tumble(time_s=self.machine.time_s, duration_s=duration_s)
        return self._world.last_move_start_s
