"""FXAS21002C three-axis gyroscope, register by register.

Source of the map, modes, rates, scales and start-up times: NXP data sheet FXAS21002C.
Not modelled: rate-threshold detection, high-pass filter and self-test; push-pull and open-drain pins are alike.
"""

from __future__ import annotations

import math

from hiltest.state import Restorable
from hiltest.world import NoiseSource, World
from hiltest.world.earth_field import Vector, apply_rows
from hiltest.world.filtered_noise import LowPassedNoise, low_pass_taps
from hiltest.world.recorded_motion import Sensed
from hiltest.world.sensors.drift import Drift
from hiltest.world.sensors.fifo import SampleFifo
from hiltest.world.sensors.register_device import RegisterDevice, signed_byte
from hiltest.world.sensors.sampling import Counts, SampledOutput, saturated_word

STATUS, OUT_X_MSB, OUT_Z_LSB, DR_STATUS, F_STATUS, F_SETUP = 0x00, 0x01, 0x06, 0x07, 0x08, 0x09
F_EVENT, INT_SRC_FLAG, WHO_AM_I, CTRL_REG0, TEMP, CTRL_REG1 = 0x0A, 0x0B, 0x0C, 0x0D, 0x12, 0x13
CTRL_REG2, CTRL_REG3 = 0x14, 0x15
_IDENTITY = 0xD7
_RESET, _ACTIVE, _READY = 0x40, 0x02, 0x01  # CTRL_REG1
_CFG_FIFO, _EN_FIFO, _CFG_DRDY, _EN_DRDY, _ACTIVE_HIGH = 0x80, 0x40, 0x08, 0x04, 0x02  # CTRL_REG2: interrupts
_WRAP_TO_ONE, _FS_DOUBLE = 0x08, 0x01  # CTRL_REG3
_RATES_HZ = (800.0, 400.0, 200.0, 100.0, 50.0, 25.0, 12.5, 12.5)
#: Registers that store their value without any modelled effect.
_PLAIN = frozenset({0x0E, 0x10, 0x11})
#: Counts per deg/s at full scale 2000, 1000, 500, 250 deg/s (62.5 to 7.8125 mdps per count).
_COUNTS_PER_DPS = (16.0, 32.0, 64.0, 128.0)
#: Rate noise density, data sheet, 200 Hz and 64 Hz bandwidth [dps/sqrt(Hz)].
DATA_SHEET_NOISE_DENSITY = 0.025
IDENTITY = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
_BOOT_END, _SRC_FIFO, _SRC_DRDY = 0x08, 0x04, 0x01  # INT_SRC_FLAG; boot end is set as soon as the part answers at all
#: Delay of the registers after power-on or reset [s].
BOOT_S = 0.050
_FROM_STANDBY_S, _FROM_READY_S = 0.060, 0.005


class Fxas21002c(RegisterDevice):
    """The part at 0x20, fixed to the body as on the sensor shield.

    Parameters
    ----------
    world
        World of the part.
    seed
        Noise seed.
    bias_dps
        Zero-rate offset, body frame [deg/s].
    drift
        Drift of the rate, offset included [deg/s].
    noise_density
        One-sided density below the selected low-pass filter [dps/sqrt(Hz)]: the rms is this times the root of the
        bandwidth.
    response
        Gains and misalignment, body frame: matrix from the true to the measured rate, before the offset.
    """

    temperature_register = 0x12

    def __init__(
        self,
        world: World,
        *,
        seed: int,
        address: int = 0x20,
        bias_dps: Vector = (0.0, 0.0, 0.0),
        drift: Drift = Drift(),  # noqa: B008 - frozen, so it may be shared
        noise_density: float = DATA_SHEET_NOISE_DENSITY,
        response: tuple[Vector, Vector, Vector] = IDENTITY,
    ) -> None:
        super().__init__(address)
        self._world = world
        self._bias_dps = bias_dps
        self._drift = drift
        self._noise_density = noise_density
        self._response = response
        self._noise = LowPassedNoise(NoiseSource(seed, f"fxas21002c@{address:02x}"))
        self._output = SampledOutput(
            world,
            self._noise,
            self._measure,
            full_scale=32_767,
            quantity=Sensed.GYROSCOPE,
            body_axes=(-2, -1, -3),
        )
        self.outputs = (self._output,)
        self._fifo = SampleFifo(self._output, has_trigger=False)
        self._control = [0, 0, 0, 0]  # CTRL_REG0..3
        self._plain = dict.fromkeys(_PLAIN, 0)
        self._boot_over_s = BOOT_S

    def parts(self) -> tuple[Restorable, ...]:
        """Return output, noise and FIFO."""
        return (*self.outputs, self._noise, self._fifo)

    def power_up(self, time_s: float) -> None:
        """Boot at a different time than the board."""
        self._boot_over_s = time_s + BOOT_S

    def responds(self, time_s: float) -> bool:
        """Return whether the boot sequence is over."""
        return time_s >= self._boot_over_s

    def settings(self) -> dict[int, int]:
        """Return the present values of the registers that firmware can write, by address."""
        controls = zip((CTRL_REG0, CTRL_REG1, CTRL_REG2, CTRL_REG3), self._control, strict=True)
        return {F_SETUP: self._fifo.setup, **self._plain, **dict(controls)}

    def release(self) -> None:
        """End a burst read."""
        self._output.release()
        self._fifo.release()

    def interrupt_levels(self, time_s: float) -> tuple[bool, bool]:
        """Return INT1 and INT2, to which CTRL_REG2 routes the enabled sources."""
        control, sources = self._control[2], self._interrupts(time_s)
        to_int1 = (_SRC_FIFO if control & _CFG_FIFO else 0) | (_SRC_DRDY if control & _CFG_DRDY else 0)
        active_high = bool(control & _ACTIVE_HIGH)
        return (bool(sources & to_int1) == active_high, bool(sources & ~to_int1) == active_high)

    def next_interrupt_s(self, time_s: float) -> float:
        """Return the next sample's time [s], if an enabled source is not active yet."""
        control = self._control[2]
        enabled = (_SRC_FIFO if control & _EN_FIFO else 0) | (_SRC_DRDY if control & _EN_DRDY else 0)
        return self._output.next_sample_s(time_s) if enabled & ~self._interrupts(time_s) else math.inf

    def following(self, register: int) -> int:
        """Return the next register; after the last output register STATUS, or 0x01 with WRAPTOONE."""
        if register == OUT_Z_LSB:
            return OUT_X_MSB if self._control[3] & _WRAP_TO_ONE else STATUS
        return (register + 1) & 0xFF

    def read_register(self, register: int, time_s: float) -> int:
        """Return a register's byte; reserved addresses read 0."""
        if OUT_X_MSB <= register <= OUT_Z_LSB:
            return (self._fifo if self._fifo.is_on else self._output).read(register - OUT_X_MSB, time_s)
        if CTRL_REG1 <= register <= CTRL_REG3:
            return self._control[register - CTRL_REG1 + 1]
        match register:
            case 0x00:
                return self._fifo.status(time_s) if self._fifo.is_on else self._output.status(time_s)
            case 0x07:
                return 0 if self._fifo.is_on else self._output.status(time_s)
            case 0x08:
                return self._fifo.status(time_s)
            case 0x09:
                return self._fifo.setup
            case 0x0A:
                return self._fifo.event(time_s)
            case 0x0B:
                return _BOOT_END | self._interrupts(time_s)
            case 0x0C:
                return _IDENTITY
            case 0x0D:
                return self._control[0]
            case 0x12:
                return signed_byte(self._world.temperature_degc(time_s))
        return self._plain.get(register, 0)

    def write_register(self, register: int, value: int, time_s: float) -> bool:
        """Write a register; return False (no ACK) for a software reset."""
        if register == CTRL_REG1:
            return self._write_control1(value, time_s)
        active = bool(self._control[1] & _ACTIVE)
        if register == CTRL_REG0 and not active:
            self._control[0] = value
        elif register in (CTRL_REG2, CTRL_REG3) and not active:
            self._control[register - CTRL_REG1 + 1] = value
        elif register == F_SETUP and not active:
            self._fifo.configure(value, time_s)
        elif register in self._plain and not active:
            self._plain[register] = value
        return True

    def _interrupts(self, time_s: float) -> int:
        enabled = self._control[2]
        flags = 0
        if enabled & _EN_DRDY and not self._fifo.is_on and self._output.status(time_s) & 0x08:
            flags |= _SRC_DRDY
        if enabled & _EN_FIFO and self._fifo.event(time_s):
            flags |= _SRC_FIFO
        return flags

    def _write_control1(self, value: int, time_s: float) -> bool:
        if value & _RESET:
            self._reset(time_s)
            return False
        before = self._control[1]
        if before & _ACTIVE and value & _ACTIVE:
            return True  # the rate may change in standby or ready mode only
        self._control[1] = value
        if before & _ACTIVE:
            self._output.halt(time_s)
            self._fifo.halt(time_s)
        elif value & _ACTIVE:
            # Low-pass filter, data sheet: 0.32 of the output rate at BW = 00, half of it a step.
            self._noise.taps = low_pass_taps(0.32 / (1 << (self._control[0] >> 6)))
            rate_hz = _RATES_HZ[value >> 2 & 7]
            settling_s = _FROM_READY_S if before & _READY else _FROM_STANDBY_S
            self._output.begin(rate_hz, first_s=time_s + settling_s + 1.0 / rate_hz)
            self._fifo.begin(time_s)
        return True

    def _reset(self, time_s: float) -> None:
        self._control = [0, 0, 0, 0]
        self._plain = dict.fromkeys(_PLAIN, 0)
        self._output.clear()
        self._fifo.reset()
        self._boot_over_s = time_s + BOOT_S

    def _measure(self, instant_s: float, noise: Vector) -> Counts:
        scale = _COUNTS_PER_DPS[self._control[0] & 3] / (2.0 if self._control[3] & _FS_DOUBLE else 1.0)
        recorded = self._world.recorded(Sensed.GYROSCOPE, instant_s, part="FXAS21002C", limit=32_768 / scale)
        if recorded is None:
            (x, y, z), bias = apply_rows(self._response, self._world.state_at(instant_s).rate_body_dps), self._bias_dps
            felt_dps = (x + bias[0], y + bias[1], z + bias[2])
            x, y, z = self._drift.apply(felt_dps, self._world.temperature_degc(instant_s))
            # rms of white noise before the filter, up to half the output rate.
            sigma = self._noise_density * math.sqrt(0.5 * self._output.rate_hz)
        else:
            (x, y, z), sigma = recorded, 0.0
        # Part axes from body axes: the inverse of body = (-y, -x, -z).
        return (
            saturated_word((-y + sigma * noise[0]) * scale),
            saturated_word((-x + sigma * noise[1]) * scale),
            saturated_word((-z + sigma * noise[2]) * scale),
        )
