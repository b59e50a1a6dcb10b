"""The world of a virtual board in a rig file: the truth that its parts measure, and the fitted parts."""

from __future__ import annotations

import math
from dataclasses import dataclass

from hiltest.rig.disturbances import CableTable, CurrentTable, PassingTable
from hiltest.rig.parts import PARTS, Part
from hiltest.rig.recorded_motion import PlaybackFile
from hiltest.rig.toml_tables import StrictTable, Triple, require

# Smallest volume of the parallelepiped of a soft iron's rows, relative to the box with the same edges.
_SMALLEST_VOLUME = 1e-3

_NO_DRIFT: Triple = (0.0, 0.0, 0.0)
_NO_CROSS_AXIS: tuple[Triple, Triple, Triple] = (_NO_DRIFT, _NO_DRIFT, _NO_DRIFT)


def _relative_volume(rows: tuple[Triple, Triple, Triple]) -> float:
    """Return the determinant of a matrix whose rows are scaled to 1; 0 if one of them is zero."""
    edges = math.prod(math.hypot(*row) for row in rows)
    (a, b, c), (d, e, f), (g, h, i) = rows
    return (a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)) / edges if edges else 0.0


@dataclass(frozen=True, slots=True)
class TemperatureDrift(StrictTable):
    """Change of the parts' readings per degree above 25 degC, body frame; 0 by default."""

    mag3110_gain_percent_per_degc: Triple = _NO_DRIFT
    """Typical 0.1, data sheet."""
    fxos8700cq_gain_percent_per_degc: Triple = _NO_DRIFT
    fxos8700cq_zero_flux_ut_per_degc: Triple = _NO_DRIFT
    """Change of the magnetometer; typical 0.1 % and 0.8 uT, data sheet."""
    accelerometer_offset_mg_per_degc: Triple = _NO_DRIFT
    """Typical 0.2, data sheet."""
    gyroscope_bias_dps_per_degc: Triple = _NO_DRIFT


@dataclass(frozen=True, slots=True)
class SimulatedWorld(StrictTable):
    """The truth of a virtual board's world, body frame NED. Noise alone depends on the seed."""

    soft_iron: tuple[Triple, Triple, Triple]
    """Matrix from the true field to the field at the parts."""
    hard_iron_ut: Triple
    """Hard iron at the MAG3110, the part's zero-flux offset included."""
    accelerometer_offset_mg: Triple = (0.0, 0.0, 0.0)
    accelerometer_gain_error_percent: Triple = (0.0, 0.0, 0.0)
    accelerometer_cross_axis_percent: tuple[Triple, Triple, Triple] = _NO_CROSS_AXIS
    """Cross-axis sensitivity of each axis to the other two; 0 on the diagonal, which has the gain error."""
    face_errors_deg: tuple[Triple, ...] = ()
    """Misalignment of each face, +x, -x, +y, -y, +z, -z down: turns of the board about its x, y and z."""
    gyroscope_bias_dps: Triple = (0.0, 0.0, 0.0)
    gyroscope_response: tuple[Triple, Triple, Triple] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    """Gains and misalignment: matrix from the true to the measured rate, before the bias."""
    gyroscope_noise_mdps_per_rthz: float = 25.0
    """One-sided noise density below the part's low-pass filter."""
    fxos8700cq_zero_flux_ut: Triple = (0.0, 0.0, 0.0)
    """Additional hard iron of the FXOS8700CQ magnetometers."""
    mag3110_noise_ut: tuple[float, float, float, float] = (0.4, 0.35, 0.3, 0.25)
    """rms noise at oversampling 16, 32, 64, 128."""
    fxos8700cq_noise_ut: tuple[float, float] = (1.5, 0.3)
    """rms noise of its magnetometer at oversampling 2 and 32; at 8, which the firmware sets, it is their geometric
    mean."""
    mounting_yaw_deg: float | None = None
    """True mounting yaw; None for the declared one, or 0 if undeclared."""
    temperature_degc: float = 25.0
    """Temperature at power-on, and constant unless an end is given."""
    temperature_end_degc: float | None = None
    """Final temperature, reached linearly within `temperature_ramp_s`, or exponentially with
    `temperature_time_constant_s`."""
    temperature_ramp_s: float | None = None
    temperature_time_constant_s: float | None = None
    drift: TemperatureDrift = TemperatureDrift()
    """Effect of the temperature on the readings."""
    fitted: tuple[str, ...] = tuple(PARTS)
    """Fitted parts: see `PARTS`."""
    mirrored: bool | None = None
    """True if the soft iron intentionally mirrors the field; otherwise that is refused as a wrong sign."""
    playback: PlaybackFile | None = None
    """Recording that the parts measure instead of this world."""
    motion_recordings: tuple[str, ...] | None = None
    """Recordings of motion with true attitudes that the attitude filter follows in the full set of tests, each on a
    board of its own: names relative to the rig's folder, with ``*`` for many."""
    current: CurrentTable | None = None
    passing: PassingTable | None = None
    cable: CableTable | None = None
    """Disturbances of the field over time: a current on the board, a passing magnet, a moved cable."""

    def __post_init__(self) -> None:
        require(
            self.playback is None or not self.disturbances,
            "playback",
            f"has its own field: {', '.join(self.disturbances)} cannot disturb it",
        )
        require(self.motion_recordings != (), "motion_recordings", "names no recording: leave it out")
        require(all(sigma >= 0.0 for sigma in self.mag3110_noise_ut), "mag3110_noise_ut", "must not be negative")
        require(all(sigma >= 0.0 for sigma in self.fxos8700cq_noise_ut), "fxos8700cq_noise_ut", "must not be negative")
        require(self.gyroscope_noise_mdps_per_rthz >= 0.0, "gyroscope_noise_mdps_per_rthz", "must not be negative")
        require(
            all(self.accelerometer_cross_axis_percent[axis][axis] == 0.0 for axis in range(3)),
            "accelerometer_cross_axis_percent",
            "has a number on its diagonal: use accelerometer_gain_error_percent for gains",
        )
        require(len(self.face_errors_deg) in (0, 6), "face_errors_deg", "needs a row for each of the six faces")
        self._check_temperature()
        volume = _relative_volume(self.soft_iron)
        require(
            abs(volume) >= _SMALLEST_VOLUME,
            "soft_iron",
            "is singular: it maps every field into a plane, which no calibration can correct",
        )
        require(
            volume > 0.0 or bool(self.mirrored),
            "soft_iron",
            "mirrors the field: its determinant is negative; write mirrored = true beside it if that is intended",
        )
        strangers = [part for part in self.fitted if part not in PARTS]
        require(not strangers, "fitted", f"names {strangers}; known parts: {', '.join(PARTS)}")

    def _check_temperature(self) -> None:
        courses = {
            "temperature_ramp_s": self.temperature_ramp_s,
            "temperature_time_constant_s": self.temperature_time_constant_s,
        }
        durations = {key: duration_s for key, duration_s in courses.items() if duration_s is not None}
        require(
            (self.temperature_end_degc is None) == (not durations),
            "temperature_end_degc",
            "requires temperature_ramp_s or temperature_time_constant_s",
        )
        require(
            len(durations) < 2,
            "temperature_ramp_s",
            "excludes temperature_time_constant_s: leave one of them out",
        )
        for key, duration_s in durations.items():
            require(duration_s > 0.0, key, "must be above 0")

    @property
    def disturbances(self) -> dict[str, CurrentTable | PassingTable | CableTable]:
        """Disturbances of the field over time, by cause."""
        tables = {"current": self.current, "passing": self.passing, "cable": self.cable}
        return {cause: table for cause, table in tables.items() if table is not None}

    @property
    def accelerometer_response(self) -> tuple[Triple, Triple, Triple]:
        """Matrix from gravity to the accelerometer's reading, before its offset: 3 rows of 3."""
        rows = []
        for axis, (gain, row) in enumerate(
            zip(self.accelerometer_gain_error_percent, self.accelerometer_cross_axis_percent, strict=True)
        ):
            x, y, z = (float(other == axis) + (gain if other == axis else row[other]) / 100.0 for other in range(3))
            rows.append((x, y, z))
        return rows[0], rows[1], rows[2]

    def hard_iron_at_ut(self, part: Part) -> Triple:
        """Return the constant field at the magnetometer of a part, its zero-flux offset included [uT]."""
        offset_ut = part.magnetometer_offset_ut(self)
        x, y, z = (hard + zero for hard, zero in zip(self.hard_iron_ut, offset_ut, strict=True))
        return (x, y, z)

    def largest_reading_ut(self, part: Part, strength_ut: float) -> float:
        """Return the largest reading of any axis of a magnetometer in any attitude, without noise [uT].

        The strongest fields of all disturbances add up along this axis.
        """
        hard_iron = self.hard_iron_at_ut(part)
        outside_ut = strength_ut + (self.passing.largest_ut if self.passing else 0.0)
        own_ut = sum(disturbance.largest_ut for disturbance in (self.current, self.cable) if disturbance is not None)
        return own_ut + max(
            abs(hard) + outside_ut * math.hypot(*row) for hard, row in zip(hard_iron, self.soft_iron, strict=True)
        )
