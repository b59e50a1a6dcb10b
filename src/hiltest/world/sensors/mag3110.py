"""MAG3110 three-axis magnetometer, register by register.

Source of the map, modes, rates and limits: NXP data sheet MAG3110 (register address map
0x00-0x11; table of output data rates and oversampling; noise by oversampling ratio). Not
modelled: supply current, the averaging over the conversion time (a
sample is the field at its instant).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from hiltest.world import MagneticDistortion, NoiseSource, Vector, World
from hiltest.world.recorded_motion import Sensed
from hiltest.world.sensors.drift import Drift
from hiltest.world.sensors.register_device import RegisterDevice, signed_byte
from hiltest.world.sensors.register_table import axis_numbers
from hiltest.world.sensors.sampling import Counts, SampledOutput, along_part, limited

DR_STATUS, OUT_X_MSB, OUT_Z_LSB, WHO_AM_I, SYSMOD = 0x00, 0x01, 0x06, 0x07, 0x08
OFF_X_MSB, OFF_Z_LSB, DIE_TEMP, CTRL_REG1, CTRL_REG2 = 0x09, 0x0E, 0x0F, 0x10, 0x11
_IDENTITY = 0xC4

_AC, _TM, _FR = 0x01, 0x02, 0x04  # CTRL_REG1: active, trigger, fast read
_AUTO_RESET, _RAW = 0x80, 0x20  # CTRL_REG2: a magnetic reset before each sample; outputs without the user offset
#: Rms noise at oversampling 16, 32, 64, 128, data sheet [uT].
DATA_SHEET_NOISE_UT = (0.4, 0.35, 0.3, 0.25)
COUNTS_PER_UT = 10.0
_RAW_LIMIT, _CORRECTED_LIMIT, _OFFSET_LIMIT = 20_000, 30_000, 10_000


def output_rate_hz(control1: int) -> float:
    """Return the output data rate of a CTRL_REG1 value: 80 / 2**(DR + OS) [Hz]."""
    return 80.0 / (1 << ((control1 >> 5) + (control1 >> 3 & 3)))


class Mag3110(RegisterDevice):
    """The part at 0x0E, by default fixed to the body as on the sensor shield. Its axes are left-handed.

    Parameters
    ----------
    world
        World of the part.
    distortion
        Distortion between the earth's field and the part; its hard iron includes the part's own zero-flux offset.
    seed
        Noise seed.
    axes
        Axes of the part along x, y and z of the body, such as ``-y``; by default those on the shield.
    noise_ut
        Rms noise per axis at oversampling 16, 32, 64, 128 [uT].
    drift
        Drift of the field at the part [uT].
    die_temperature_offset_degc
        Offset of this part's die temperature, which the manufacturer does not trim.
    """

    temperature_register = DIE_TEMP

    def __init__(
        self,
        world: World,
        distortion: MagneticDistortion,
        *,
        seed: int,
        address: int = 0x0E,
        axes: tuple[str, str, str] | None = None,
        noise_ut: Sequence[float] = DATA_SHEET_NOISE_UT,
        drift: Drift = Drift(),  # noqa: B008 - frozen, so it may be shared
        die_temperature_offset_degc: float = 0.0,
    ) -> None:
        super().__init__(address)
        self._world = world
        self._distortion = distortion
        self._noise_counts = tuple(COUNTS_PER_UT * sigma for sigma in noise_ut)
        self._drift = drift
        self._die_offset_degc = die_temperature_offset_degc
        noise = NoiseSource(seed, f"mag3110@{address:02x}")
        self._output = SampledOutput(
            world,
            noise,
            self._measure,
            full_scale=_RAW_LIMIT,
            quantity=Sensed.MAGNETOMETER,
            body_axes=(-2, -1, 3) if axes is None else axis_numbers(axes),
        )
        self.outputs = (self._output,)
        self._control1 = 0
        self._control2 = 0
        self._auto_reset = 0  # of CTRL_REG2, write-only
        self._offsets = [0, 0, 0]  # register words; the value is in bits 15..1
        self._oversampling = 0
        self._active = False
        self._standby_s: float | None = None  # time at which a part will be in standby after the command

    def settings(self) -> dict[int, int]:
        """Return the present values of the registers that firmware can write, by address."""
        offsets = b"".join(word.to_bytes(2, "big") for word in self._offsets)
        controls = {CTRL_REG1: self._control1, CTRL_REG2: self._auto_reset | self._control2}
        return dict(enumerate(offsets, OFF_X_MSB)) | controls

    def release(self) -> None:
        """End a burst read."""
        self._output.release()

    def interrupt_levels(self, time_s: float) -> tuple[bool, bool]:
        """Return INT1, high from new data until OUT_X_MSB is read; there is no INT2."""
        self.settle(time_s)
        return (bool(self._output.status(time_s) & 0x01), False)

    def next_interrupt_s(self, time_s: float) -> float:
        """Return the next sample's time [s], unless the pin is high already."""
        return math.inf if self.interrupt_levels(time_s)[0] else self._output.next_sample_s(time_s)

    def settle(self, time_s: float) -> None:
        """Enter standby once the current measurement is complete."""
        if self._standby_s is not None and time_s >= self._standby_s:
            self._output.halt(self._standby_s)
            self._active = False
            self._standby_s = None
            self._control1 &= ~_TM

    def following(self, register: int) -> int:
        """Return the next register; fast-read mode skips the low bytes of the output registers."""
        if self._control1 & _FR and register in (OUT_X_MSB, OUT_X_MSB + 2, OUT_X_MSB + 4):
            return register + 2
        return (register + 1) & 0xFF

    def read_register(self, register: int, time_s: float) -> int:
        """Return a register's byte; addresses above the map read 0."""
        if OUT_X_MSB <= register <= OUT_Z_LSB:
            return self._output.read(register - OUT_X_MSB, time_s)
        if OFF_X_MSB <= register <= OFF_Z_LSB:
            axis, low = divmod(register - OFF_X_MSB, 2)
            return self._offsets[axis] >> (0 if low else 8) & 0xFF
        match register:
            case 0x00:
                return self._output.status(time_s)
            case 0x07:
                return _IDENTITY
            case 0x08:
                return 0 if not self._active else 1 if self._control2 & _RAW else 2
            case 0x0F:
                return self._die_temperature(time_s)
            case 0x10:
                return self._control1
            case 0x11:
                return self._control2
        return 0

    def write_register(self, register: int, value: int, time_s: float) -> bool:
        """Write an offset or control register; all others are read-only and ignore it."""
        if OFF_X_MSB <= register <= OFF_Z_LSB:
            axis, low = divmod(register - OFF_X_MSB, 2)
            word = self._offsets[axis]
            self._offsets[axis] = word & 0xFF00 | value & 0xFE if low else value << 8 | word & 0x00FF
        elif register == CTRL_REG1:
            self._write_control1(value, time_s)
        elif register == CTRL_REG2 and not self._active:
            # AUTO_MRST_EN (b7) reads as 0, and Mag_RST (b4) clears itself.
            self._auto_reset, self._control2 = value & _AUTO_RESET, value & _RAW
        return True

    def _write_control1(self, value: int, time_s: float) -> None:
        if self._active and value & _AC and self._standby_s is None:
            return  # in active mode only AC may change
        if self._active and not value & _AC:
            if self._standby_s is None:
                self._standby_s = self._output.next_instant(time_s)
            self._control1 = value & ~_TM
            return
        # In standby, or restarted before standby was reached: the current measurement ends first.
        idle_s = time_s
        if self._standby_s is not None:
            idle_s = self._standby_s
            self._output.halt(idle_s)
            self._active = False
        self._standby_s = None
        self._control1 = value
        if not value & (_AC | _TM):
            return
        rate_hz = output_rate_hz(value)
        self._oversampling = value >> 3 & 3
        self._active = True
        single = not value & _AC
        # A conversion takes one period, so the first sample is not older than that.
        first_s = self._output.begin(rate_hz, first_s=idle_s + 1.0 / rate_hz, single=single)
        if single:
            self._standby_s = first_s
        else:
            self._control1 &= ~_TM

    def _measure(self, instant_s: float, noise: Vector) -> Counts:
        recorded = self._world.recorded(
            Sensed.MAGNETOMETER, instant_s, part="MAG3110", limit=_RAW_LIMIT / COUNTS_PER_UT
        )
        if recorded is None:
            field_ut = self._world.field_at_part_ut(self._distortion, instant_s)
            body_ut = self._drift.apply(field_ut, self._world.temperature_degc(instant_s))
            sigma = self._noise_counts[self._oversampling]
        else:
            body_ut, sigma = recorded, 0.0
        x, y, z = along_part(self._output.body_axes, body_ut)
        return (
            self._word(x, sigma * noise[0], 0),
            self._word(y, sigma * noise[1], 1),
            self._word(z, sigma * noise[2], 2),
        )

    def _word(self, field_ut: float, noise_counts: float, axis: int) -> int:
        raw = limited(field_ut * COUNTS_PER_UT + noise_counts, _RAW_LIMIT)
        if self._control2 & _RAW:
            return raw
        word = self._offsets[axis]
        offset = (word - 0x10000 if word & 0x8000 else word) >> 1
        return limited(raw - limited(offset, _OFFSET_LIMIT), _CORRECTED_LIMIT)

    def _die_temperature(self, time_s: float) -> int:
        instant_s = self._output.held_instant(time_s)
        if instant_s is None:
            return 0
        return signed_byte(self._world.temperature_degc(instant_s) + self._die_offset_degc)
