"""FXOS8700CQ accelerometer and magnetometer, register by register.

Source of the map, modes, rates, scales and limits: NXP data sheet FXOS8700CQ. Not modelled: the embedded event
functions (their registers read back the written value, so nothing ends the FIFO's trigger mode) and sleep; push-pull
and open-drain pins are alike. Interpretation: MAX, MIN and the automatic hard-iron calibration are of the field without
offsets, since a middle of corrected samples would not be their offset.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from functools import partial
from typing import TypeAlias

from hiltest.state import Restorable
from hiltest.world import MagneticDistortion, NoiseSource, Vector, World
from hiltest.world.recorded_motion import Sensed
from hiltest.world.sensors.accelerometer_errors import AccelerometerErrors
from hiltest.world.sensors.drift import Drift
from hiltest.world.sensors.extremes import Extremes
from hiltest.world.sensors.fifo import SampleFifo
from hiltest.world.sensors.register_device import RegisterDevice, signed_byte
from hiltest.world.sensors.sampling import Counts, Measure, SampledOutput, limited

STATUS, OUT_X_MSB, OUT_Z_LSB, F_SETUP = 0x00, 0x01, 0x06, 0x09
SYSMOD, INT_SOURCE, WHO_AM_I, XYZ_DATA_CFG = 0x0B, 0x0C, 0x0D, 0x0E
CTRL_REG1, CTRL_REG2, CTRL_REG3, CTRL_REG4, CTRL_REG5, OFF_X, OFF_Z = 0x2A, 0x2B, 0x2C, 0x2D, 0x2E, 0x2F, 0x31
M_DR_STATUS, M_OUT_X_MSB, M_OUT_Z_LSB, CMP_X_MSB, CMP_Z_LSB = 0x32, 0x33, 0x38, 0x39, 0x3E
M_OFF_X_MSB, M_OFF_Z_LSB, TEMP, M_CTRL_REG1, M_CTRL_REG2, M_CTRL_REG3 = 0x3F, 0x44, 0x51, 0x5B, 0x5C, 0x5D
MAX_X_MSB, MIN_Z_LSB, M_INT_SRC = 0x45, 0x50, 0x5E
_IDENTITY = 0xC7
_ACTIVE, _F_READ, _LOW_NOISE = 0x01, 0x02, 0x04  # CTRL_REG1
_RESET = 0x40  # CTRL_REG2
_ACTIVE_HIGH = 0x02  # CTRL_REG3
_FIFO_EVENT, _DATA_READY = 0x40, 0x01  # CTRL_REG4 enables them, INT_SOURCE shows them; M_INT_SRC has the second
_CALIBRATES, _ONE_SHOT = 0x80, 0x20  # M_CTRL_REG1
_HYBRID_AUTO_INCREMENT, _EXTREMES_OFF, _RESET_EXTREMES = 0x20, 0x10, 0x04  # M_CTRL_REG2
_WITHOUT_OFFSETS = 0x80  # M_CTRL_REG3
# Stored bits of each register, without self-clearing ones.
_KEPT = {CTRL_REG2: 0xBF, M_CTRL_REG1: 0x9F, M_CTRL_REG2: 0x3B}
_READ_ONLY = frozenset(
    {*range(0x00, 0x09), 0x0B, 0x0C, 0x0D, 0x16, 0x1E, 0x22, *range(0x32, 0x3F), *range(0x45, 0x52), 0x53, 0x5E}
)
_LAST_REGISTER = 0x78

_Table: TypeAlias = tuple[tuple[float, tuple[int, ...]], ...]

_SINGLE_RATES_HZ = (800.0, 400.0, 200.0, 100.0, 50.0, 12.5, 6.25, 1.5625)
_HYBRID_RATES_HZ = (400.0, 200.0, 100.0, 50.0, 25.0, 6.25, 3.125, 0.78125)
# Number of magnetometer samples averaged per output, by rate and M_CTRL_REG1's OS field. Rates that only the hybrid
# mode has use the row of the next faster listed one, like its code in single mode.
_OVERSAMPLING = (
    (800.0, (2, 2, 2, 2, 2, 2, 2, 2)),
    (400.0, (2, 2, 2, 2, 2, 2, 2, 4)),
    (200.0, (2, 2, 2, 2, 2, 2, 4, 8)),
    (100.0, (2, 2, 2, 2, 2, 4, 8, 16)),
    (50.0, (2, 2, 2, 2, 4, 8, 16, 32)),
    (12.5, (2, 2, 4, 8, 16, 32, 64, 128)),
    (6.25, (4, 4, 8, 16, 32, 64, 128, 256)),
    (1.5625, (16, 16, 32, 64, 128, 256, 512, 1024)),
)
# Number of accelerometer samples averaged per output, by rate and CTRL_REG2's MODS field: normal, low noise and low
# power, high resolution, low power. Rates that only the hybrid mode has use a row as above.
_ACCELEROMETER_OVERSAMPLING = (
    (800.0, (2, 2, 2, 2)),
    (400.0, (4, 4, 4, 2)),
    (200.0, (4, 4, 8, 2)),
    (100.0, (4, 4, 16, 2)),
    (50.0, (4, 4, 32, 2)),
    (12.5, (16, 4, 128, 2)),
    (6.25, (32, 8, 256, 4)),
    (1.5625, (128, 32, 1024, 16)),
)
_HIGH_RESOLUTION = 2
# Noise without the low-noise mode, relative to that with it: 126 to 99 ug/sqrt(Hz) of the MMA8451Q, whose accelerometer
# has the same modes; the data sheet of the FXOS8700CQ has one figure.
_WITHOUT_LOW_NOISE = 126.0 / 99.0
_MAGNETOMETER_LIMIT = 12_000  # +-1200 uT
_COUNTS_PER_UT = 10.0
_ACCELEROMETER_COUNTS_PER_G = 4096.0  # 14-bit counts at 2 g full scale
_OFFSET_STEP_G = 0.002
_CONVERSIONS_HZ = 1600.0  # of the magnetometer: two at 800 Hz
_TEMPERATURE_STEP_DEGC = 0.96
_RESET_S = 0.001


@dataclass(frozen=True, slots=True)
class Fxos8700cqNoise:
    """Noise of the part, by default the data sheet's."""

    accelerometer_density_g: float = 126e-6
    """Front page, at 200 Hz bandwidth [g/sqrt(Hz)]; taken as that of high resolution in the low-noise mode."""
    magnetometer_ut: tuple[float, float] = (1.5, 0.3)
    """rms noise per axis at oversampling 2 and 32 [uT]; a power law between them, constant above 32."""

    def accelerometer_g(self, rate_hz: float, *, mode: int = _HIGH_RESOLUTION, low_noise: bool = True) -> float:
        """Return the rms noise of one axis of the accelerometer [g].

        The bandwidth of high resolution is half the output rate; a mode that averages fewer samples has white noise.

        Parameters
        ----------
        rate_hz
            Output rate.
        mode
            CTRL_REG2's MODS field, 0 to 3.
        low_noise
            CTRL_REG1's low-noise bit.
        """
        samples = _row(_ACCELEROMETER_OVERSAMPLING, rate_hz)
        excess = math.sqrt(samples[_HIGH_RESOLUTION] / samples[mode]) * (1.0 if low_noise else _WITHOUT_LOW_NOISE)
        return self.accelerometer_density_g * math.sqrt(rate_hz / 2.0) * excess


class Fxos8700cq(RegisterDevice):
    """The part at 0x1E on the shield, or 0x1D on the board itself.

    Parameters
    ----------
    world
        World of the part.
    distortion
        Distortion between the earth's field and the magnetometer, its zero-flux offset included.
    seed
        Noise seed.
    name
        Distinguishes the noise of two such parts.
    errors
        Errors of the accelerometer.
    magnetometer_drift
        Drift of its reading, the offset included [uT].
    """

    temperature_register = 0x51

    def __init__(
        self,
        world: World,
        distortion: MagneticDistortion,
        *,
        seed: int,
        address: int = 0x1E,
        name: str = "fxos8700cq",
        errors: AccelerometerErrors = AccelerometerErrors(),  # noqa: B008
        magnetometer_drift: Drift = Drift(),  # noqa: B008 - frozen, so it may be shared
        noise: Fxos8700cqNoise = Fxos8700cqNoise(),
    ) -> None:
        super().__init__(address)
        self._world = world
        self._distortion = distortion
        self._errors = errors
        self._magnetometer_drift = magnetometer_drift
        self._noise = noise
        self._name = f"{name} FXOS8700CQ"
        tag = f"{name}@{address:02x}"
        self._accelerometer = SampledOutput(
            world,
            NoiseSource(seed, f"{tag}/accelerometer"),
            self._measure_gravity,
            full_scale=8191 << 2,
            quantity=Sensed.ACCELEROMETER,
            body_axes=(2, 1, 3),
        )
        self._magnetometer = SampledOutput(
            world,
            NoiseSource(seed, f"{tag}/magnetometer"),
            self._measure_field,
            full_scale=_MAGNETOMETER_LIMIT,
            quantity=Sensed.MAGNETOMETER,
            body_axes=(-2, -1, -3),
        )
        self.outputs = (self._accelerometer, self._magnetometer)
        self._fifo = SampleFifo(self._accelerometer, has_trigger=True)
        self._extremes = Extremes(self._magnetometer, self._field_conversion)
        self._registers = bytearray(_LAST_REGISTER + 1)
        self._answers_from_s = 0.0
        self._one_shot_s = 0.0  # time at which a single measurement of the field is complete
        self._sigma_ut = self._sigma_g = 0.0  # of the modes when it became active

    def parts(self) -> tuple[Restorable, ...]:
        """Return outputs, FIFO and extremes."""
        return (*self.outputs, self._fifo, self._extremes)

    def responds(self, time_s: float) -> bool:
        """Return whether the part answers: always, except in the millisecond of a software reset."""
        return time_s >= self._answers_from_s

    def settings(self) -> dict[int, int]:
        """Return the present values of the registers that firmware can write, by address."""
        return {address: value for address, value in enumerate(self._registers) if address not in _READ_ONLY}

    def release(self) -> None:
        """End a burst read."""
        self._accelerometer.release()
        self._magnetometer.release()
        self._fifo.release()

    def interrupt_levels(self, time_s: float) -> tuple[bool, bool]:
        """Return INT1 and INT2: CTRL_REG5 routes a source to INT1 or INT2; CTRL_REG3 sets the active level."""
        sources, to_int1 = self._interrupts(time_s), self._registers[CTRL_REG5]
        active_high = bool(self._registers[CTRL_REG3] & _ACTIVE_HIGH)
        return (bool(sources & to_int1) == active_high, bool(sources & ~to_int1) == active_high)

    def next_interrupt_s(self, time_s: float) -> float:
        """Return the next sample's time [s], if an enabled source is not active yet."""
        enabled = self._registers[CTRL_REG4] & (_FIFO_EVENT | _DATA_READY)
        if not enabled & ~self._interrupts(time_s):
            return math.inf
        return min(self._accelerometer.next_sample_s(time_s), self._magnetometer.next_sample_s(time_s))

    def following(self, register: int) -> int:
        """Return the next register; F_READ skips low bytes; 0x06 leads to 0x01 (FIFO), 0x33 (hybrid burst) or 0x00."""
        at_end = register == OUT_Z_LSB
        if self._registers[CTRL_REG1] & _F_READ and register in (OUT_X_MSB, OUT_X_MSB + 2, OUT_X_MSB + 4):
            if register != OUT_X_MSB + 4:
                return register + 2
            at_end = True
        if not at_end:
            return (register + 1) & 0xFF
        if self._fifo.is_on:
            return OUT_X_MSB
        joined = self._hybrid and self._registers[M_CTRL_REG2] & _HYBRID_AUTO_INCREMENT
        return M_OUT_X_MSB if joined else STATUS

    def read_register(self, register: int, time_s: float) -> int:
        """Return a register's byte; addresses above the map read 0."""
        if OUT_X_MSB <= register <= OUT_Z_LSB:
            return (self._fifo if self._fifo.is_on else self._accelerometer).read(register - OUT_X_MSB, time_s)
        if M_OUT_X_MSB <= register <= M_OUT_Z_LSB:
            return self._magnetometer.read(register - M_OUT_X_MSB, time_s)
        if CMP_X_MSB <= register <= CMP_Z_LSB:
            return self._read_aligned(register, time_s)
        if MAX_X_MSB <= register <= MIN_Z_LSB:
            self._follow_extremes(time_s)
            return self._extremes.read(register - MAX_X_MSB)
        if M_OFF_X_MSB <= register <= M_OFF_Z_LSB:
            self._load_offsets(time_s)
        match register:
            case 0x00:
                return self._read_status(time_s)
            case 0x0B:
                return self._registers[CTRL_REG1] & _ACTIVE
            case 0x0C:
                return self._interrupts(time_s)
            case 0x0D:
                return _IDENTITY
            case 0x32:
                return self._magnetometer.status(time_s)
            case 0x5E:
                return _DATA_READY if self._magnetometer.status(time_s) & 0x08 else 0
            case 0x51:
                return self._die_temperature(time_s)
            case 0x5B if time_s < self._one_shot_s:
                return self._registers[M_CTRL_REG1] | _ONE_SHOT
        return self._registers[register] if register <= _LAST_REGISTER else 0

    def write_register(self, register: int, value: int, time_s: float) -> bool:
        """Write a register; return False (no ACK) for a software reset."""
        if register > _LAST_REGISTER or register in _READ_ONLY:
            return True
        if register == CTRL_REG2 and value & _RESET:
            self._reset(time_s)
            return False
        if register == CTRL_REG1:
            self._write_control1(value, time_s)
        elif (active := self._registers[CTRL_REG1] & _ACTIVE) and register != M_CTRL_REG1:
            return True  # the register map's notes: settings but M_CTRL_REG1 change in standby only
        else:
            stored = value & _KEPT.get(register, 0xFF)
            is_new_mode = active and stored != self._registers[register]
            if is_new_mode:
                self._halt(time_s)
            is_low_offset = M_OFF_X_MSB <= register <= M_OFF_Z_LSB and (register - M_OFF_X_MSB) % 2
            self._registers[register] = stored & 0xFE if is_low_offset else stored
            if register == F_SETUP:
                self._fifo.configure(value, time_s)
            elif register == M_CTRL_REG2 and value & _RESET_EXTREMES:
                self._extremes.restart(time_s)
            elif is_new_mode:
                self._begin(time_s)
            elif register == M_CTRL_REG1 and value & _ONE_SHOT and not active:  # it measures in standby
                self._measure_once(time_s)
        return True

    def _follow_extremes(self, time_s: float) -> None:
        if self._has_extremes:
            self._extremes.take_in(time_s)
            if self._world.playback is not None:  # it counts the samples that a part has taken
                self._extremes.compare()
        else:
            self._extremes.skip(time_s)

    @property
    def _has_extremes(self) -> bool:
        return not self._registers[M_CTRL_REG2] & _EXTREMES_OFF

    @property
    def _calibrates(self) -> bool:
        return bool(self._registers[M_CTRL_REG1] & _CALIBRATES)

    def _load_offsets(self, time_s: float) -> None:
        """Load M_OFF as at the end of the latest sample, if the part calibrates itself."""
        if self._calibrates:
            tick = self._magnetometer.latest(time_s) + 1
            middle = self._extremes.middle_before(tick, compares=self._has_extremes)
            self._registers[M_OFF_X_MSB : M_OFF_Z_LSB + 1] = struct.pack(">3h", *(2 * word for word in middle))

    def _read_status(self, time_s: float) -> int:
        if not self._fifo.is_on:
            return self._accelerometer.status(time_s)
        status = self._fifo.status(time_s)
        self._fifo.acknowledge()
        return status

    def _interrupts(self, time_s: float) -> int:
        # INT_SOURCE. With the FIFO on, the FIFO reports ready acceleration.
        enabled = self._registers[CTRL_REG4]
        if not enabled:
            return 0
        ready = self._magnetometer.status(time_s)
        if not self._fifo.is_on:
            ready |= self._accelerometer.status(time_s)
        flags = (_DATA_READY if ready & 0x08 else 0) | (_FIFO_EVENT if self._fifo.pending(time_s) else 0)
        return flags & enabled

    @property
    def _hybrid(self) -> bool:
        return self._registers[M_CTRL_REG1] & 3 == 3

    def _write_control1(self, value: int, time_s: float) -> None:
        was_active = self._registers[CTRL_REG1] & _ACTIVE
        if was_active and value & _ACTIVE:
            return  # in active mode only a change to standby is possible
        self._registers[CTRL_REG1] = value
        if was_active:
            self._halt(time_s)
        elif value & _ACTIVE:
            self._begin(time_s)

    def _halt(self, time_s: float) -> None:
        self._accelerometer.halt(time_s)
        self._magnetometer.halt(time_s)
        self._fifo.halt(time_s)
        self._follow_extremes(time_s)
        self._load_offsets(time_s)

    def _begin(self, time_s: float) -> None:
        mode = self._registers[M_CTRL_REG1] & 3
        rates_hz = _HYBRID_RATES_HZ if self._hybrid else _SINGLE_RATES_HZ
        rate_hz = rates_hz[self._registers[CTRL_REG1] >> 3 & 7]
        # Data sheet: turn-on time from standby 2/ODR + 1 ms.
        first_s = time_s + 2.0 / rate_hz + 0.001
        self._accelerometer.weight = 1 << self._full_scale
        if mode != 1:
            low_noise = bool(self._registers[CTRL_REG1] & _LOW_NOISE)
            self._sigma_g = self._noise.accelerometer_g(
                rate_hz, mode=self._registers[CTRL_REG2] & 3, low_noise=low_noise
            )
            self._accelerometer.begin(rate_hz, first_s=first_s)
        self._fifo.begin(time_s)
        if mode in (1, 3):
            self._begin_field(rate_hz, oversampling(rate_hz, self._field_oversampling), time_s, first_s=first_s)

    def _measure_once(self, time_s: float) -> None:
        """Measure the field once in standby, with the oversampling of the present rate."""
        samples = oversampling(_SINGLE_RATES_HZ[self._registers[CTRL_REG1] >> 3 & 7], self._field_oversampling)
        rate_hz = _CONVERSIONS_HZ / samples
        first_s = time_s + 1.0 / rate_hz + 0.001
        self._one_shot_s = self._begin_field(rate_hz, samples, time_s, first_s=first_s, single=True)

    def _begin_field(
        self, rate_hz: float, samples: int, time_s: float, *, first_s: float, single: bool = False
    ) -> float:
        """Begin to measure the field; return the time of the first sample [s]."""
        self._follow_extremes(time_s)  # of a single measurement before
        self._load_offsets(time_s)
        self._sigma_ut = noise_at_oversampling(samples, self._noise.magnetometer_ut)
        sample_s = self._magnetometer.begin(rate_hz, first_s=first_s, single=single)
        self._extremes.skip(time_s)
        if self._calibrates:
            self._extremes.follow_middle(time_s)
        return sample_s

    def _die_temperature(self, time_s: float) -> int:
        """Return TEMP, which the part renews with each sample of the field."""
        instant_s = self._magnetometer.held_instant(time_s)
        if instant_s is None:
            return 0
        return signed_byte(self._world.temperature_degc(instant_s) / _TEMPERATURE_STEP_DEGC)

    @property
    def _field_oversampling(self) -> int:
        return self._registers[M_CTRL_REG1] >> 2 & 7

    def _reset(self, time_s: float) -> None:
        self._registers = bytearray(_LAST_REGISTER + 1)
        self._accelerometer.clear()
        self._magnetometer.clear()
        self._fifo.reset()
        self._extremes.restart(time_s)
        self._answers_from_s = time_s + _RESET_S

    def _read_aligned(self, register: int, time_s: float) -> int:
        # CMP_*: the acceleration at the magnetometer's instant; reading it clears no flag.
        instant_s = self._magnetometer.held_instant(time_s)
        if instant_s is None or not self._hybrid:
            return 0
        axis, low = divmod(register - CMP_X_MSB, 2)
        word = self._accelerometer.word_at(instant_s, axis)
        return word >> (0 if low else 8) & 0xFF

    def _measure_gravity(self, instant_s: float, noise: Vector) -> Counts:
        recorded = self._world.recorded(
            Sensed.ACCELEROMETER, instant_s, part=f"{self._name} accelerometer", limit=2.0 * (1 << self._full_scale)
        )
        if recorded is None:
            true_g = self._world.state_at(instant_s).gravity_body_g
            x, y, z = self._errors.apply(true_g, self._world.temperature_degc(instant_s))
            sigma_g = self._sigma_g
        else:
            (x, y, z), sigma_g = recorded, 0.0
        # Part axes from body axes: the inverse of body = (y, x, z).
        return (
            self._gravity_word(y + sigma_g * noise[0], 0),
            self._gravity_word(x + sigma_g * noise[1], 1),
            self._gravity_word(z + sigma_g * noise[2], 2),
        )

    @property
    def _full_scale(self) -> int:
        return min(self._registers[XYZ_DATA_CFG] & 3, 2)

    def _gravity_word(self, acceleration_g: float, axis: int) -> int:
        offset = self._registers[OFF_X + axis]
        offset_g = _OFFSET_STEP_G * (offset - 256 if offset & 0x80 else offset)
        count = round((acceleration_g + offset_g) * _ACCELEROMETER_COUNTS_PER_G / (1 << self._full_scale))
        return max(-8192, min(8191, count)) << 2  # 14 bits, left-justified

    def _measure_field(self, instant_s: float, noise: Vector) -> Counts:
        return self._field_counts(self._sigma_ut, self._offsets(instant_s), instant_s, noise)

    def _field_conversion(self) -> Measure:
        return partial(self._field_counts, self._sigma_ut, (0, 0, 0))

    def _offsets(self, instant_s: float) -> Counts:
        """Return the offsets that are subtracted from a sample [counts]."""
        if self._registers[M_CTRL_REG3] & _WITHOUT_OFFSETS:
            return (0, 0, 0)
        if self._calibrates:
            tick = round(instant_s * self._magnetometer.rate_hz)
            return self._extremes.middle_before(tick, compares=self._has_extremes)
        x, y, z = struct.unpack(">3h", self._registers[M_OFF_X_MSB : M_OFF_Z_LSB + 1])
        return (x >> 1, y >> 1, z >> 1)

    def _field_counts(self, sigma_ut: float, offsets: Counts, instant_s: float, noise: Vector) -> Counts:
        recorded = self._world.recorded(
            Sensed.MAGNETOMETER,
            instant_s,
            part=f"{self._name} magnetometer",
            limit=_MAGNETOMETER_LIMIT / _COUNTS_PER_UT,
        )
        if recorded is None:
            field_ut = self._world.field_at_part_ut(self._distortion, instant_s)
            x, y, z = self._magnetometer_drift.apply(field_ut, self._world.temperature_degc(instant_s))
            sigma = sigma_ut
        else:
            (x, y, z), sigma = recorded, 0.0
        # Part axes from body axes: the inverse of body = (-y, -x, -z).
        return (
            _field_word(-y + sigma * noise[0], offsets[0]),
            _field_word(-x + sigma * noise[1], offsets[1]),
            _field_word(-z + sigma * noise[2], offsets[2]),
        )


def _field_word(field_ut: float, offset: int) -> int:
    return limited(limited(field_ut * _COUNTS_PER_UT, _MAGNETOMETER_LIMIT) - offset, 32_767)


def oversampling(rate_hz: float, code: int) -> int:
    """Return the magnetometer's oversampling ratio at an output rate for an OS code 0..7."""
    return _row(_OVERSAMPLING, rate_hz)[code]


def _row(table: _Table, rate_hz: float) -> tuple[int, ...]:
    """Return the row of the lowest listed rate that is not below an output rate."""
    return min(listed for listed in table if listed[0] >= rate_hz)[1]


def noise_at_oversampling(samples: int, noise_ut: tuple[float, float]) -> float:
    """Return the rms noise of an output averaged over `samples` conversions [uT].

    A power law through the two given points (oversampling 2 and 32): 1.5 and 0.3 uT make it 1.0, 0.67 and 0.45 at 4, 8
    and 16. Above 32 it does not improve.
    """
    at_2, at_32 = noise_ut
    if at_2 <= 0.0 or at_32 <= 0.0:
        return 0.0
    exponent = math.log(at_32 / at_2) / math.log(32 / 2)
    # Rounded, because logarithms and powers may differ in the last bit between hosts.
    return float(round(at_2 * (min(samples, 32) / 2) ** exponent, 6))
