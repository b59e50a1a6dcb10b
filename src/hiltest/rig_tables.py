"""The tables of a rig file, each a dataclass that refuses values out of range.

They are plain dataclasses, so that a rig can be spoken of without pydantic; `hiltest.rig_file`
has pydantic check a file against them.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Literal, TypeAlias

if TYPE_CHECKING:
    from hiltest.angles import Pose

Triple: TypeAlias = tuple[float, float, float]

# What pydantic reads off these dataclasses: no unknown keys, no conversions (an integer is a fine float).
STRICT: dict[str, Any] = {"extra": "forbid", "strict": True, "allow_inf_nan": False}

# Where an axis of a magnetometer stops [uT], data sheets: the MAG3110's words, its own zero-flux offset of up
# to 1000 uT in them, at 20 000 counts; the FXOS8700CQ at its full scale.
MAGNETOMETER_RANGE_UT = {"mag3110": 2000.0, "fxos8700cq": 1200.0, "onboard-fxos8700cq": 1200.0}
# By the names that the packaged firmware gives them.
MAGNETOMETER_PARTS = {
    "MAG3110": "mag3110",
    "FXOS8700CQ magnetometer": "fxos8700cq",
    "on-board FXOS8700CQ magnetometer": "onboard-fxos8700cq",
}

# What the firmware asks for at least, or its fit of them against gravity is refused as TOO_FEW_POINTS.
DPI_PAIRS_MINIMUM = 300

FITTED_PARTS = ("mag3110", "fxos8700cq", "fxas21002c", "onboard-fxos8700cq")


class RigValueError(ValueError):
    """A value of the rig is out of its range."""

    def __init__(self, key: str, message: str) -> None:
        self.key = key
        super().__init__(message)


def number_of_points(calibration: str) -> int | None:
    """Return the 100 of ``direct@100``; None of what is not written so."""
    written = re.fullmatch(r"[a-z0-9_-]+@([1-9][0-9]*)", calibration)
    return int(written[1]) if written else None


def require(holds: bool, key: str, message: str) -> None:
    if not holds:
        raise RigValueError(key, message)


@dataclass(frozen=True, slots=True)
class BoardPlace:
    """What answers on the link: the virtual board, one on a port, or a recorded session.

    Attributes
    ----------
    cycle_model : str or None
        What the cycle counter of a board on a port counts: ``silicon-dwt``, or the timing profile of a
        virtual board that is served there. Needed where the port alone does not tell.
    """

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT
    kind: Literal["virtual", "real", "replay"]
    port: str | None = None
    transcript: str | None = None
    cycle_model: str | None = None

    def __post_init__(self) -> None:
        require(self.kind == "real" or self.port is None, "port", 'belongs to a board of kind "real"')
        require(self.kind == "real" or self.cycle_model is None, "cycle_model", 'belongs to a board of kind "real"')
        require(self.cycle_model is None or re.fullmatch(r"[a-z0-9/.-]+", self.cycle_model) is not None, "cycle_model",
                'is "silicon-dwt", or the name of a timing profile such as "cortex-m4-trm/1"')
        require((self.kind == "replay") == (self.transcript is not None), "transcript",
                'names the recorded session of a board of kind "replay", and only of that')


@dataclass(frozen=True, slots=True)
class LinkSettings:
    """How the board is talked to."""

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT
    baud: int = 115_200
    mode: Literal["stub", "fsflk"] = "stub"

    def __post_init__(self) -> None:
        require(self.baud > 0, "baud", "must be above 0")


@dataclass(frozen=True, slots=True)
class LocalField:
    """The earth's field at the bench: total intensity, dip (down positive), declination (east positive)."""

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT
    strength_ut: float
    dip_deg: float
    declination_deg: float = 0.0

    def __post_init__(self) -> None:
        require(self.strength_ut > 0.0, "strength_ut", "must be above 0")
        require(abs(self.dip_deg) < 90.0, "dip_deg", "must be within -90 to 90: at a pole there is no heading")
        require(abs(self.declination_deg) <= 180.0, "declination_deg", "must be within -180 to 180")


@dataclass(frozen=True, slots=True)
class Mounting:
    """How the board sits on the table: board heading = table heading + yaw, known to +-uncertainty."""

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT
    yaw_deg: float
    uncertainty_deg: float

    def __post_init__(self) -> None:
        require(abs(self.yaw_deg) <= 180.0, "yaw_deg", "must be within -180 to 180")
        require(self.uncertainty_deg >= 0.0, "uncertainty_deg", "must not be negative")


@dataclass(frozen=True, slots=True)
class Faces:
    """How true the six faces are that the board is put on: none is further from its axis than this [deg]."""

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT
    uncertainty_deg: float

    def __post_init__(self) -> None:
        require(0.0 < self.uncertainty_deg <= 5.0, "uncertainty_deg", "must be above 0 and at most 5")


# Forty times what the part here has; a window of 0.1 s is then still up to 19 deg/s.
_NOISIEST_MDPS = 1000.0


@dataclass(frozen=True, slots=True)
class SensorChoice:
    """Which sensors are judged, and how noisy the magnetometer is declared to be.

    Attributes
    ----------
    magnetometer_noise_ut : float
        Rms of one axis of one reading; what a fit's residual is held against.
    gyroscope_noise_mdps_per_rthz : float
        One-sided density of the rate's noise, data sheet; what stillness is judged by.
    magnetometer, accelerometer, gyroscope : str or None
        Names as the board's identity gives them; None takes the first that answers.
    """

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT
    magnetometer_noise_ut: float
    gyroscope_noise_mdps_per_rthz: float = 25.0
    magnetometer: str | None = None
    accelerometer: str | None = None
    gyroscope: str | None = None

    def __post_init__(self) -> None:
        require(self.magnetometer_noise_ut >= 0.0, "magnetometer_noise_ut", "must not be negative")
        require(0.0 < self.gyroscope_noise_mdps_per_rthz <= _NOISIEST_MDPS, "gyroscope_noise_mdps_per_rthz",
                f"must be above 0 and at most {_NOISIEST_MDPS:g}: with more, a board in a hand would count as still")


@dataclass(frozen=True, slots=True)
class CoveredPart:
    """The part of the sphere that a simulated tumble shows the field from.

    Attributes
    ----------
    axis : (3,)
        Middle of the part, body frame, of any length: (0, 0, 1) is down, where the field of the
        northern hemisphere is while the board is level.
    fraction : float
        Of the sphere's area: 0.5 is the half around the axis, all within ``acos(1 - 2 fraction)`` of it.

    Notes
    -----
    A direction is covered when the *true* field, seen in the body frame, comes from it during the tumble.
    Soft iron bends the points that the sensor gives by as much as it bends any other; hard iron, which
    shifts them all, does not enter. A pose is inside when the field's direction in it is: with a dip of 62 degrees
    the field is 28 degrees from body z on a level board, and at most 48 with 20 degrees of pitch or roll.
    """

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT
    axis: Triple
    fraction: float

    def __post_init__(self) -> None:
        require(any(self.axis), "axis", "must not be zero: it is a direction")
        require(0.0 < self.fraction <= 1.0, "fraction", "must be above 0 and at most 1, all of the sphere")


@dataclass(frozen=True, slots=True)
class TurntableSettings:
    """What sets a known angle, and how well [deg].

    Attributes
    ----------
    tumble_s : float
        How long an operator gets to turn the board all round.
    port : str or None
        Device or pyserial URL of a motor table that speaks Grbl.
    covered : CoveredPart or None
        What a simulated tumble is confined to; None is all of the sphere.
    """

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT
    kind: Literal["simulated", "operator", "grbl"]
    uncertainty_deg: float
    tumble_s: float = 45.0
    port: str | None = None
    covered: CoveredPart | None = None

    def __post_init__(self) -> None:
        require(self.uncertainty_deg >= 0.0, "uncertainty_deg", "must not be negative")
        require(0.0 < self.tumble_s <= 600.0, "tumble_s", "must be above 0 and at most 600")
        require((self.kind == "grbl") == (self.port is not None), "port",
                'names the serial port of a turntable of kind "grbl", and only of that')
        require(self.kind == "simulated" or self.covered is None, "covered",
                'confines a tumble of kind "simulated"; another is turned by somebody else')


@dataclass(frozen=True, slots=True)
class Procedure:
    """Which points and poses make a run.

    Attributes
    ----------
    headings_deg : tuple of float
        Table headings of the judged poses.
    tilts_deg : tuple of (pitch, roll)
        Each tilt is judged at every heading.
    poses : {"all", "level"}
        Which are judged when the command line does not say.
    calibration_points : int
        Of the tumble, that every calibrator of the firmware gets.
    gyroscope_rest_s : float
        Length of a rest of the gyroscope, before and after a turn.
    gyroscope_turn_dps : float
        How fast the table turns for the gyroscope: 36 to 90, a turn in 10 to 4 s.
    accelerometer_calibration : {"none", "six-position"}
        What comes before all headings: nothing, or the six faces, a second each, fitted on the board.
    untrimmed_calibrations : tuple of str
        Calibrations that are judged once more, without that of the accelerometer: ``direct`` as
        ``direct-untrimmed``.
    dpi : {"pairs", "none"}
        Whether the magnetometer is calibrated against gravity too, on all pairs of the tumble.
    gyroscope_calibration : {"rest", "turns"}
        What `hiltest calibrate` does: find the bias alone, or turn about all three axes for scale and axes, too.
    further_calibrations : tuple of str
        Runs beside these, judged alike, each a calibrator and the points it gets: ``direct@100``.
    """

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT
    headings_deg: tuple[float, ...]
    tilts_deg: tuple[tuple[float, float], ...]
    poses: Literal["all", "level"] = "all"
    readings_per_pose: int = 16
    calibration_points: int = 100
    tumble_points: int = 300
    gyroscope_rest_s: float = 2.0
    gyroscope_turn_dps: float = 60.0
    accelerometer_calibration: Literal["none", "six-position"] = "none"
    untrimmed_calibrations: tuple[str, ...] = ()
    dpi: Literal["pairs", "none"] = "pairs"
    gyroscope_calibration: Literal["rest", "turns"] = "turns"
    further_calibrations: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        require(len(self.headings_deg) >= 4, "headings_deg", "needs at least 4 headings, or no worst sector is found")
        require((0.0, 0.0) in self.tilts_deg, "tilts_deg", "must contain the level one, [0, 0]")
        require(all(abs(pitch) < 90.0 for pitch, _ in self.tilts_deg), "tilts_deg",
                "must keep pitch within -90 to 90: beyond, heading turns round")
        require(1 <= self.readings_per_pose <= 512, "readings_per_pose", "must be 1 to 512, as the firmware averages")
        require(self.calibration_points >= 9, "calibration_points", "must be at least 9, the unknowns of an ellipsoid")
        require(self.calibration_points <= self.tumble_points <= 512, "tumble_points",
                "must be from calibration_points to 512, what the firmware stores")
        require(self.dpi == "none" or self.tumble_points >= DPI_PAIRS_MINIMUM, "tumble_points",
                f"must be at least {DPI_PAIRS_MINIMUM}, the pairs that the calibration against gravity needs: write "
                'tumble_points = 300, or dpi = "none" beside it to go without')
        require(2.0 <= self.gyroscope_rest_s <= 20.0, "gyroscope_rest_s", "must be 2 to 20")
        require(36.0 <= self.gyroscope_turn_dps <= 90.0, "gyroscope_turn_dps", "must be 36 to 90")
        require(self.accelerometer_calibration != "none" or not self.untrimmed_calibrations, "untrimmed_calibrations",
                "has nothing to leave out while accelerometer_calibration is none")
        for written in self.further_calibrations:
            points = number_of_points(written)
            require(points is not None and 9 <= points <= self.tumble_points, "further_calibrations",
                    f"names {written!r}; write a calibrator and its points, 9 to tumble_points, such as direct@100")

    def judged_poses(self, which: Literal["all", "level"] | None = None) -> tuple[Pose, ...]:
        """Return the table poses in the order they are judged: tilt by tilt, level first as listed."""
        from hiltest.angles import Pose

        level_only = (which or self.poses) == "level"
        tilts = [tilt for tilt in self.tilts_deg if not level_only or tilt == (0.0, 0.0)]
        return tuple(Pose(heading, pitch, roll) for pitch, roll in tilts for heading in self.headings_deg)


_NO_DRIFT: Triple = (0.0, 0.0, 0.0)
_NO_CROSS_AXIS: tuple[Triple, Triple, Triple] = (_NO_DRIFT, _NO_DRIFT, _NO_DRIFT)


@dataclass(frozen=True, slots=True)
class TemperatureDrift:
    """How much the parts' readings change for each degree above 25 degC, body frame: nothing unless stated.

    Attributes
    ----------
    mag3110_gain_percent_per_degc : (3,)
        Typical 0.1, data sheet.
    fxos8700cq_gain_percent_per_degc, fxos8700cq_zero_flux_ut_per_degc : (3,)
        Of the magnetometer; typical 0.1 % and 0.8 uT, data sheet.
    accelerometer_offset_mg_per_degc : (3,)
        Typical 0.2, data sheet.
    gyroscope_bias_dps_per_degc : (3,)
    """

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT
    mag3110_gain_percent_per_degc: Triple = _NO_DRIFT
    fxos8700cq_gain_percent_per_degc: Triple = _NO_DRIFT
    fxos8700cq_zero_flux_ut_per_degc: Triple = _NO_DRIFT
    accelerometer_offset_mg_per_degc: Triple = _NO_DRIFT
    gyroscope_bias_dps_per_degc: Triple = _NO_DRIFT


@dataclass(frozen=True, slots=True)
class SimulatedWorld:
    """The truth of a virtual board's world, body frame NED. Noise alone depends on the seed.

    Attributes
    ----------
    soft_iron : 3 rows of 3
        Takes the true field to the field at the parts.
    hard_iron_ut : (3,)
        Added to it at the MAG3110, the part's zero-flux offset included.
    mounting_yaw_deg : float or None
        True mounting yaw; None is the declared one, or 0 when none is declared.
    accelerometer_cross_axis_percent : 3 rows of 3
        What each axis reads of the other two; nothing on the diagonal, where the gain error is.
    face_errors_deg : 6 rows of 3, or empty
        How each face is askew, +x, -x, +y, -y, +z, -z down: turns of the board about its x, y and z.
    gyroscope_response : 3 rows of 3
        Gains and misalignment: takes the true rate to the felt one, before the bias.
    gyroscope_noise_mdps_per_rthz : float
        One-sided density below the part's low-pass filter.
    fxos8700cq_zero_flux_ut : (3,)
        What the FXOS8700CQ magnetometers read beyond that.
    mag3110_noise_ut : (4,)
        Rms at oversampling 16, 32, 64, 128.
    fxos8700cq_noise_ut : (2,)
        Rms of its magnetometer at oversampling 2 and 32; at 8, which the firmware sets, it is their
        geometric mean.
    temperature_degc : float
        Of the board at power-on, and ever after unless it has an end.
    temperature_end_degc : float or None
        Where the temperature goes and stays: in a straight line within `temperature_ramp_s`,
        or with `temperature_time_constant_s` as things warm up.
    drift : TemperatureDrift
        What temperature does to the readings.
    fitted : tuple of str
        Which parts are there: see `FITTED_PARTS`.
    """

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT
    soft_iron: tuple[Triple, Triple, Triple]
    hard_iron_ut: Triple
    accelerometer_offset_mg: Triple = (0.0, 0.0, 0.0)
    accelerometer_gain_error_percent: Triple = (0.0, 0.0, 0.0)
    accelerometer_cross_axis_percent: tuple[Triple, Triple, Triple] = _NO_CROSS_AXIS
    face_errors_deg: tuple[Triple, ...] = ()
    gyroscope_bias_dps: Triple = (0.0, 0.0, 0.0)
    gyroscope_response: tuple[Triple, Triple, Triple] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    gyroscope_noise_mdps_per_rthz: float = 25.0
    fxos8700cq_zero_flux_ut: Triple = (0.0, 0.0, 0.0)
    mag3110_noise_ut: tuple[float, float, float, float] = (0.4, 0.35, 0.3, 0.25)
    fxos8700cq_noise_ut: tuple[float, float] = (1.5, 0.3)
    mounting_yaw_deg: float | None = None
    temperature_degc: float = 25.0
    temperature_end_degc: float | None = None
    temperature_ramp_s: float | None = None
    temperature_time_constant_s: float | None = None
    drift: TemperatureDrift = TemperatureDrift()
    fitted: tuple[str, ...] = FITTED_PARTS

    def __post_init__(self) -> None:
        require(all(sigma >= 0.0 for sigma in self.mag3110_noise_ut), "mag3110_noise_ut", "must not be negative")
        require(all(sigma >= 0.0 for sigma in self.fxos8700cq_noise_ut), "fxos8700cq_noise_ut", "must not be negative")
        require(self.gyroscope_noise_mdps_per_rthz >= 0.0, "gyroscope_noise_mdps_per_rthz", "must not be negative")
        require(all(self.accelerometer_cross_axis_percent[axis][axis] == 0.0 for axis in range(3)),
                "accelerometer_cross_axis_percent",
                "has a number on its diagonal: that is accelerometer_gain_error_percent")
        require(len(self.face_errors_deg) in (0, 6), "face_errors_deg", "needs a row for each of the six faces")
        self._check_temperature()
        strangers = [part for part in self.fitted if part not in FITTED_PARTS]
        require(not strangers, "fitted", f"names {strangers}; known parts: {', '.join(FITTED_PARTS)}")

    def _check_temperature(self) -> None:
        courses = {
            "temperature_ramp_s": self.temperature_ramp_s,
            "temperature_time_constant_s": self.temperature_time_constant_s,
        }
        given = {key: duration_s for key, duration_s in courses.items() if duration_s is not None}
        require((self.temperature_end_degc is None) == (not given), "temperature_end_degc",
                "goes with temperature_ramp_s or temperature_time_constant_s: how the temperature gets there")
        require(len(given) < 2, "temperature_ramp_s",
                "excludes temperature_time_constant_s: one of them says the course")
        for key, duration_s in given.items():
            require(duration_s > 0.0, key, "must be above 0")

    @property
    def accelerometer_response(self) -> tuple[Triple, Triple, Triple]:
        """Gravity to what the accelerometer reads of it, before its offset: 3 rows of 3."""
        rows = []
        for axis, (gain, row) in enumerate(
            zip(self.accelerometer_gain_error_percent, self.accelerometer_cross_axis_percent, strict=True)
        ):
            x, y, z = (float(other == axis) + (gain if other == axis else row[other]) / 100.0 for other in range(3))
            rows.append((x, y, z))
        return rows[0], rows[1], rows[2]

    def hard_iron_at_ut(self, part: str) -> Triple:
        """Return the constant field at a magnetometer of `FITTED_PARTS`, its zero-flux offset included [uT]."""
        if part == "mag3110":
            return self.hard_iron_ut
        x, y, z = (hard + zero for hard, zero in zip(self.hard_iron_ut, self.fxos8700cq_zero_flux_ut, strict=True))
        return (x, y, z)

    def largest_reading_ut(self, part: str, strength_ut: float) -> float:
        """Return the largest reading of any axis of a magnetometer in any attitude, without noise [uT]."""
        hard_iron = self.hard_iron_at_ut(part)
        return max(
            abs(hard) + strength_ut * math.hypot(*row) for hard, row in zip(hard_iron, self.soft_iron, strict=True)
        )
