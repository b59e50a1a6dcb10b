"""A part whose registers are a table: the base of the models."""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import replace
from functools import partial
from typing import ClassVar

from hiltest.state import Restorable
from hiltest.world import NoiseSource, Vector
from hiltest.world.recorded_motion import Sensed
from hiltest.world.sensors.drift import Drift
from hiltest.world.sensors.register_device import RegisterDevice
from hiltest.world.sensors.register_table import OutputRow, RegisterTable, axis_numbers
from hiltest.world.sensors.sampling import Counts, SampledOutput, along_part
from hiltest.world.sensors.sensor_setup import SensorSetup

#: Counts of a unit in `SampledOutput.delivered`: those of MAG3110 and FXOS8700CQ.
_DELIVERED_COUNTS = {Sensed.MAGNETOMETER: 10.0, Sensed.ACCELEROMETER: 16_384.0, Sensed.GYROSCOPE: 1.0}
_NOTHING: Vector = (0.0, 0.0, 0.0)


class TableSensor(RegisterDevice):
    """Bus, register file, sampling and noise of a part; a model adds the meaning of its settings.

    A subclass sets `table` to ``read_table(__file__)`` and defines `rate_hz`, `counts_per_unit` and `noise`; the other
    methods below have defaults. They are asked after every write to a register, so that they need no state.
    """

    table: ClassVar[RegisterTable]
    companion_models: ClassVar[tuple[type[TableSensor], ...]] = ()
    """Models of the further devices in the same package, which are created with the same setup."""
    temperature_register = -1

    def __init__(self, setup: SensorSetup) -> None:
        super().__init__(self.table.addresses[0] if setup.address is None else setup.address)
        self.setup = setup
        self.pins = self.table.pins
        tag = f"{setup.name or self.table.part.lower()}@{self.address:02x}"
        self._rows = {row.quantity: row for row in self.table.outputs}
        self.outputs = tuple(self._make_output(row, f"{tag}/{row.quantity.key}") for row in self.table.outputs)
        # Output and byte of its words by address; no byte for its status. The first output with an address has it.
        self._sources: dict[int, tuple[SampledOutput, int | None]] = {}
        for output, row in reversed(list(zip(self.outputs, self.table.outputs, strict=True))):
            if row.status is not None:
                self._sources[row.status] = output, None
            self._sources |= {row.first + place: (output, place) for place in range(6)}
        self._stored = dict(self.table.values)
        self._running: dict[Sensed, tuple[float, bool]] = {}
        self._single_end_s: dict[Sensed, float] = {}
        self._answers_from_s = self.table.boot_s
        self._increments = True
        self._awaiting_command = self._reads = False
        inner = replace(setup, address=setup.companion_address)
        self.companions = tuple(model(inner) for model in self.companion_models)
        self._follow_settings(0.0)

    @classmethod
    def every_output(cls) -> tuple[OutputRow, ...]:
        """Return the outputs of the part and its companions."""
        return sum((model.table.outputs for model in (cls, *cls.companion_models)), ())

    @classmethod
    def every_pin(cls) -> tuple[str, ...]:
        """Return the interrupt pins of the part and its companions."""
        return sum((model.table.pins for model in (cls, *cls.companion_models)), ())

    def parts(self) -> tuple[Restorable, ...]:
        """Return the outputs and companions."""
        return (*self.outputs, *self.companions)

    # -- defined by a model ---------------------------------------------------------------------

    @abstractmethod
    def rate_hz(self, quantity: Sensed) -> float:
        """Return the output data rate by the present settings [Hz]; 0 while it does not measure."""

    @abstractmethod
    def counts_per_unit(self, quantity: Sensed) -> float:
        """Return the sensitivity by the present settings [counts per uT, g or dps]."""

    @abstractmethod
    def noise(self, quantity: Sensed) -> float | Vector:
        """Return the rms noise of an axis, or of each, by the present settings [unit of the quantity]."""

    def is_single(self, quantity: Sensed) -> bool:
        """Return whether the settings ask for one measurement only."""
        return False

    def finish_single(self, quantity: Sensed) -> None:
        """Change the settings at the end of the only measurement, which must end `is_single`."""

    def first_sample_s(self, quantity: Sensed) -> float:
        """Return the time from the start of measuring to the first sample [s]: a period."""
        return 1.0 / self.rate_hz(quantity)

    def added(self, quantity: Sensed) -> Vector:
        """Return the present addition to a reading, such as a self-test's, along the sensor's axes [unit]."""
        return _NOTHING

    def words(self, quantity: Sensed, reading: Vector) -> Counts:
        """Return the output words of a reading along the sensor's axes [unit]."""
        scale, full_scale = self.counts_per_unit(quantity), self._rows[quantity].full_scale
        x, y, z = (max(-full_scale - 1, min(full_scale, round(value * scale))) for value in reading)
        return x, y, z

    def computed(self, register: str, time_s: float) -> int | None:
        """Return the value of a register that the part computes; None for its stored value."""
        return None

    def written(self, register: str, value: int, time_s: float) -> None:
        """Act on a written register, whose bits are stored already."""

    def locate(self, register: int) -> int:
        """Return the address in the table of a register on the bus, which differs if the part has banks."""
        return register

    def interrupt_levels(self, time_s: float) -> tuple[bool, ...]:
        """Return the levels of the table's pins: True is high."""
        return (False,) * len(self.pins)

    # -- for a model ----------------------------------------------------------------------------

    def field(self, meaning: str) -> int:
        """Return the value of the bits with a meaning."""
        address, mask, shift = self.table.fields[meaning]
        return (self._stored[address] & mask) >> shift

    def set_field(self, meaning: str, value: int) -> None:
        """Set the bits with a meaning."""
        field = self.table.fields[meaning]
        self._stored[field.address] = self._stored[field.address] & ~field.mask | value << field.shift & field.mask

    def output(self, quantity: Sensed) -> SampledOutput:
        """Return the output of a quantity."""
        return next(output for output in self.outputs if output.quantity is quantity)

    def is_ready(self, quantity: Sensed, time_s: float) -> bool:
        """Return whether a sample is there of which no axis has been read."""
        return self.output(quantity).status(time_s) & 0x07 == 0x07

    def reset(self, time_s: float) -> None:
        """Return to the state after a reset by software."""
        self._stored = dict(self.table.values)
        for output in self.outputs:
            output.clear()
        self._running.clear()
        self._single_end_s.clear()
        self._answers_from_s = time_s + self.table.reset_s
        self._follow_settings(time_s)

    # -- the bus --------------------------------------------------------------------------------

    def power_up(self, time_s: float) -> None:
        """Boot at a different time than the board."""
        self._answers_from_s = time_s + self.table.boot_s
        self._running.clear()
        self._follow_settings(time_s)

    def responds(self, time_s: float) -> bool:
        """Return whether boot or reset are over."""
        return time_s >= self._answers_from_s

    def settings(self) -> dict[int, int]:
        """Return the present values of the registers that firmware can write, by address."""
        return {address: self._stored[address] for address, mask in self.table.writable.items() if mask}

    def release(self) -> None:
        """End a burst read."""
        for output in self.outputs:
            output.release()

    def point_to(self, pointer: int) -> None:
        """Set the register pointer from a byte on the I2C bus."""
        self._pointer = pointer & self.table.pointer
        self._increments = not self.table.increment or bool(pointer & self.table.increment)

    def following(self, register: int) -> int:
        """Return the next register of a burst."""
        return (register + 1) & 0xFF if self._increments else register

    def following_write(self, register: int) -> int:
        """Return the register that a burst of writes moves on to."""
        return self.following(register)

    def select(self, time_s: float) -> None:
        """Begin a transfer over SPI: chip select becomes active."""
        self.settle(time_s)
        self.release()
        self._awaiting_command = True

    def exchange(self, value: int, time_s: float) -> int:
        """Exchange a byte over SPI; the first one has the address."""
        if self._awaiting_command:
            self._awaiting_command = self._awaiting_pointer = False
            self._reads = bool(value & self.table.spi_read)
            self._pointer = value & ~(self.table.spi_read | self.table.spi_increment)
            self._increments = not self.table.spi_increment or bool(value & self.table.spi_increment)
            return 0xFF
        if self._reads:
            return self.read(time_s)
        self.write(value, time_s)
        return 0xFF

    def next_interrupt_s(self, time_s: float) -> float:
        """Return the time of the next sample, or of the end of a measurement [s]."""
        return min((output.next_sample_s(time_s) for output in self.outputs), default=math.inf)

    def settle(self, time_s: float) -> None:
        """End measurements that are complete."""
        for quantity, end_s in list(self._single_end_s.items()) if self._single_end_s else ():
            if time_s >= end_s:
                del self._single_end_s[quantity]
                self.finish_single(quantity)
                self._follow_settings(end_s)

    def read_register(self, register: int, time_s: float) -> int:
        """Return a register's byte; addresses that the table lacks read 0."""
        address = self.locate(register)
        output, place = self._sources.get(address, (None, None))
        if output is not None:
            return (
                output.status(time_s) if place is None else output.read(place, time_s, low_first=self.table.low_first)
            )
        name, place = self.table.words.get(address, ("", 0))
        value = self.computed(name, time_s) if name else 0
        return self._stored[address] if value is None else value >> 8 * place & 0xFF

    def write_register(self, register: int, value: int, time_s: float) -> bool:
        """Write the writable bits of a register."""
        address = self.locate(register)
        mask = self.table.writable.get(address, 0)
        if not mask:
            return True
        for output in self.outputs:
            output.convert_latest(time_s)
        changed_bits = mask & ~self.table.clearing[address] & ~self.table.resetting[address]
        self._stored[address] = self._stored[address] & ~changed_bits | value & changed_bits
        if value & self.table.resetting[address]:
            self.reset(time_s)
            return True
        self.written(self.table.names[address], value, time_s)
        self._follow_settings(time_s)
        return True

    # -- measuring ------------------------------------------------------------------------------

    def _make_output(self, row: OutputRow, tag: str) -> SampledOutput:
        along_body, in_package = axis_numbers(self.setup.axes), axis_numbers(row.axes)
        # An accelerometer measures the force that holds it: +1 g along its axis that points up.
        sign = -1 if row.quantity is Sensed.ACCELEROMETER else 1
        x, y, z = (sign * (1 if axis > 0 else -1) * in_package[abs(axis) - 1] for axis in along_body)
        gain = row.gain_percent_per_degc / 100.0
        return SampledOutput(
            self.setup.world,
            NoiseSource(self.setup.seed, tag),
            partial(self._measure, row, Drift(gain_per_degc=(gain, gain, gain)), (x, y, z)),
            full_scale=row.full_scale,
            quantity=row.quantity,
            body_axes=(x, y, z),
        )

    def _follow_settings(self, time_s: float) -> None:
        """Start and stop the outputs as the settings ask."""
        for output in self.outputs:
            quantity = output.quantity
            rate_hz = self.rate_hz(quantity)
            output.weight = _DELIVERED_COUNTS[quantity] / self.counts_per_unit(quantity)
            plan = rate_hz, bool(rate_hz) and self.is_single(quantity)
            if plan == self._running.get(quantity, (0.0, False)):
                continue
            self._running[quantity] = plan
            self._single_end_s.pop(quantity, None)
            output.halt(time_s)
            if rate_hz:
                first_s = time_s + self.first_sample_s(quantity)
                sample_s = output.begin(rate_hz, first_s=first_s, single=plan[1])
                if plan[1]:
                    self._single_end_s[quantity] = sample_s

    def _measure(
        self, row: OutputRow, drift: Drift, body_axes: tuple[int, int, int], instant_s: float, noise: Vector
    ) -> Counts:
        quantity, setup = row.quantity, self.setup
        body = setup.world.recorded(quantity, instant_s, part=self.table.part, limit=row.range)
        sigma: float | Vector = 0.0
        if body is None:
            body, rms = setup.felt(quantity, instant_s, drift), setup.noise.get(quantity)
            sigma = self.noise(quantity) if rms is None else rms
        x, y, z = along_part(body_axes, body)
        x_rms, y_rms, z_rms = sigma if isinstance(sigma, tuple) else (sigma, sigma, sigma)
        more = self.added(quantity)
        return self.words(
            quantity,
            (x + x_rms * noise[0] + more[0], y + y_rms * noise[1] + more[1], z + z_rms * noise[2] + more[2]),
        )
