"""MMA8653FC three-axis accelerometer, register by register.

Source of the map, rates, scales and limits: NXP data sheet MMA8653FC. The noise is the 99 ug/sqrt(Hz) of the MMA8453Q
(data sheet, rev. 7), which also has ten bits. Not modelled: the embedded event functions (their registers read back the
written value), sleep, the modes of resolution, and the self-test.
"""

from __future__ import annotations

import math

from hiltest.world import NoiseSource, Vector, World
from hiltest.world.recorded_motion import Sensed
from hiltest.world.sensors.fxos8700cq import AccelerometerErrors
from hiltest.world.sensors.register_device import RegisterDevice
from hiltest.world.sensors.sampling import Counts, SampledOutput, along_part

STATUS, OUT_X_MSB, OUT_Z_LSB, SYSMOD, INT_SOURCE, WHO_AM_I, XYZ_DATA_CFG = 0x00, 0x01, 0x06, 0x0B, 0x0C, 0x0D, 0x0E
CTRL_REG1, CTRL_REG2, CTRL_REG3, CTRL_REG4, CTRL_REG5, OFF_X, OFF_Z = 0x2A, 0x2B, 0x2C, 0x2D, 0x2E, 0x2F, 0x31
_IDENTITY = 0x5A
_ACTIVE, _F_READ, _RESET, _ACTIVE_HIGH, _DATA_READY = 0x01, 0x02, 0x40, 0x02, 0x01
_WRITABLE = (XYZ_DATA_CFG, 0x11, 0x12, 0x15, 0x17, 0x18, *range(0x29, OFF_Z + 1))
_RATES_HZ = (800.0, 400.0, 200.0, 100.0, 50.0, 12.5, 6.25, 1.5625)
_COUNTS_PER_G = 256.0  # at 2 g full scale
_LARGEST, _SPARE_BITS = 511, 6  # ten bits, left-justified in two bytes
_OFFSET_STEP_G = 0.00196
_NOISE_DENSITY_G = 99e-6
_RESET_S = 0.001
#: Axes of the part along x, y and z of the body when its axes are the body's: gravity is opposite to what it measures.
ALIGNED = (-1, -2, -3)


class Mma8653(RegisterDevice):
    """The part at 0x1D.

    Parameters
    ----------
    world
        World of the part.
    seed
        Noise seed.
    body_axes
        Axes of the part along gravity in x, y and z of the body, see `SampledOutput`.
    errors
        Errors of the accelerometer.
    noise_density_g
        Noise of the whole measurement chain [g/sqrt(Hz)].
    """

    def __init__(
        self,
        world: World,
        *,
        seed: int,
        address: int = 0x1D,
        body_axes: tuple[int, int, int] = ALIGNED,
        errors: AccelerometerErrors = AccelerometerErrors(),  # noqa: B008 - frozen, so it may be shared
        noise_density_g: float = _NOISE_DENSITY_G,
    ) -> None:
        super().__init__(address)
        self._world = world
        self._errors = errors
        self._noise_density_g = noise_density_g
        self._sigma_g = 0.0
        self._output = SampledOutput(
            world,
            NoiseSource(seed, f"mma8653@{address:02x}"),
            self._measure,
            full_scale=_LARGEST << _SPARE_BITS,
            quantity=Sensed.ACCELEROMETER,
            body_axes=body_axes,
        )
        self.outputs = (self._output,)
        self._registers = bytearray(0x100)
        self._answers_from_s = 0.0

    temperature_register = -1  # it has none

    def responds(self, time_s: float) -> bool:
        """Return whether the part answers: always, except in the millisecond of a software reset."""
        return time_s >= self._answers_from_s

    def settings(self) -> dict[int, int]:
        """Return the present values of the registers that firmware can write, by address."""
        return {address: self._registers[address] for address in _WRITABLE}

    def release(self) -> None:
        """End a burst read."""
        self._output.release()

    def interrupt_levels(self, time_s: float) -> tuple[bool, bool]:
        """Return INT1 and INT2: CTRL_REG5 routes new data to INT1 or INT2; CTRL_REG3 sets the active level."""
        source, to_int1 = self._interrupts(time_s), self._registers[CTRL_REG5] & _DATA_READY
        active_high = bool(self._registers[CTRL_REG3] & _ACTIVE_HIGH)
        return (bool(source & to_int1) == active_high, bool(source & ~to_int1) == active_high)

    def next_interrupt_s(self, time_s: float) -> float:
        """Return the next sample's time [s], if its interrupt is enabled and not active yet."""
        waits = self._registers[CTRL_REG4] & _DATA_READY & ~self._interrupts(time_s)
        return self._output.next_sample_s(time_s) if waits else math.inf

    def _interrupts(self, time_s: float) -> int:
        """Return INT_SOURCE."""
        ready = _DATA_READY if self._output.status(time_s) & 0x08 else 0
        return ready & self._registers[CTRL_REG4]

    def following(self, register: int) -> int:
        """Return the next register; fast-read mode skips the low bytes, and 0x06 leads to 0x00."""
        if self._registers[CTRL_REG1] & _F_READ and register in (OUT_X_MSB, OUT_X_MSB + 2, OUT_X_MSB + 4):
            return register + 2 if register != OUT_X_MSB + 4 else STATUS
        return STATUS if register == OUT_Z_LSB else (register + 1) & 0xFF

    def read_register(self, register: int, time_s: float) -> int:
        """Return a register's byte; addresses above the map read 0."""
        if OUT_X_MSB <= register <= OUT_Z_LSB:
            return self._output.read(register - OUT_X_MSB, time_s)
        match register:
            case 0x00:
                return self._output.status(time_s)
            case 0x0B:
                return self._registers[CTRL_REG1] & _ACTIVE
            case 0x0C:
                return self._interrupts(time_s)
            case 0x0D:
                return _IDENTITY
        return self._registers[register]

    def write_register(self, register: int, value: int, time_s: float) -> bool:
        """Write a register, if the part is in standby; return False (no ACK) for a software reset."""
        if register not in _WRITABLE:
            return True
        if register == CTRL_REG2 and value & _RESET:
            self._registers = bytearray(0x100)
            self._output.clear()
            self._answers_from_s = time_s + _RESET_S
            return False
        if register == CTRL_REG1:
            self._write_control1(value, time_s)
        elif not self._registers[CTRL_REG1] & _ACTIVE:
            self._registers[register] = value
        return True

    def _write_control1(self, value: int, time_s: float) -> None:
        was_active = self._registers[CTRL_REG1] & _ACTIVE
        if was_active and value & _ACTIVE:
            return  # in active mode only a change to standby is possible
        self._registers[CTRL_REG1] = value
        if was_active:
            self._output.halt(time_s)
        elif value & _ACTIVE:
            rate_hz = _RATES_HZ[value >> 3 & 7]
            self._sigma_g = self._noise_density_g * math.sqrt(rate_hz / 2.0)
            self._output.range = self._full_scale
            # Data sheet: turn-on time from standby 2/ODR + 1 ms.
            self._output.begin(rate_hz, first_s=time_s + 2.0 / rate_hz + 0.001)

    @property
    def _full_scale(self) -> int:
        return min(self._registers[XYZ_DATA_CFG] & 3, 2)

    def _measure(self, instant_s: float, noise: Vector) -> Counts:
        limit_g = 2.0 * (1 << self._full_scale)
        recorded = self._world.recorded(Sensed.ACCELEROMETER, instant_s, part="MMA8653", limit=limit_g)
        if recorded is None:
            true_g = self._world.state_at(instant_s).gravity_body_g
            body_g = self._errors.apply(true_g, self._world.temperature_degc(instant_s))
            sigma_g = self._sigma_g
        else:
            body_g, sigma_g = recorded, 0.0
        x, y, z = along_part(self._output.body_axes, body_g)
        return (
            self._word(x + sigma_g * noise[0], 0),
            self._word(y + sigma_g * noise[1], 1),
            self._word(z + sigma_g * noise[2], 2),
        )

    def _word(self, acceleration_g: float, axis: int) -> int:
        offset = self._registers[OFF_X + axis]
        offset_g = _OFFSET_STEP_G * (offset - 256 if offset & 0x80 else offset)
        count = round((acceleration_g + offset_g) * _COUNTS_PER_G / (1 << self._full_scale))
        return max(-_LARGEST - 1, min(_LARGEST, count)) << _SPARE_BITS
