"""The tables of a rig file, each a dataclass that refuses values out of range.

They are plain dataclasses, so that a rig can be spoken of without pydantic; `hiltest.rig_file`
has pydantic check a file against them.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Literal, TypeAlias

if TYPE_CHECKING:
    from hiltest.angles import Pose

Triple: TypeAlias = tuple[float, float, float]

# What pydantic reads off these dataclasses: no unknown keys, no conversions (an integer is a fine float).
STRICT: dict[str, Any] = {"extra": "forbid", "strict": True, "allow_inf_nan": False}

FITTED_PARTS = ("mag3110", "fxos8700cq", "fxas21002c", "onboard-fxos8700cq")


class RigValueError(ValueError):
    """A value of the rig is out of its range."""

    def __init__(self, key: str, message: str) -> None:
        self.key = key
        super().__init__(message)


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
class SensorChoice:
    """Which sensors are judged, and how noisy the magnetometer is declared to be.

    Attributes
    ----------
    magnetometer_noise_ut : float
        Rms of one axis of one reading; what a fit's residual is held against.
    magnetometer, accelerometer, gyroscope : str or None
        Names as the board's identity gives them; None takes the first that answers.
    """

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT
    magnetometer_noise_ut: float
    magnetometer: str | None = None
    accelerometer: str | None = None
    gyroscope: str | None = None

    def __post_init__(self) -> None:
        require(self.magnetometer_noise_ut >= 0.0, "magnetometer_noise_ut", "must not be negative")


@dataclass(frozen=True, slots=True)
class TurntableSettings:
    """What sets a known angle, and how well [deg]; how long an operator gets to turn the board all round [s].

    Attributes
    ----------
    port : str or None
        Device or pyserial URL of a motor table that speaks Grbl.
    """

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT
    kind: Literal["simulated", "operator", "grbl"]
    uncertainty_deg: float
    tumble_s: float = 45.0
    port: str | None = None

    def __post_init__(self) -> None:
        require(self.uncertainty_deg >= 0.0, "uncertainty_deg", "must not be negative")
        require(0.0 < self.tumble_s <= 600.0, "tumble_s", "must be above 0 and at most 600")
        require((self.kind == "grbl") == (self.port is not None), "port",
                'names the serial port of a turntable of kind "grbl", and only of that')


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
    """

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT
    headings_deg: tuple[float, ...]
    tilts_deg: tuple[tuple[float, float], ...]
    poses: Literal["all", "level"] = "all"
    readings_per_pose: int = 16
    calibration_points: int = 100
    tumble_points: int = 300
    gyroscope_rest_s: float = 2.0

    def __post_init__(self) -> None:
        require(len(self.headings_deg) >= 4, "headings_deg", "needs at least 4 headings, or no worst sector is found")
        require((0.0, 0.0) in self.tilts_deg, "tilts_deg", "must contain the level one, [0, 0]")
        require(all(abs(pitch) < 90.0 for pitch, _ in self.tilts_deg), "tilts_deg",
                "must keep pitch within -90 to 90: beyond, heading turns round")
        require(1 <= self.readings_per_pose <= 512, "readings_per_pose", "must be 1 to 512, as the firmware averages")
        require(self.calibration_points >= 9, "calibration_points", "must be at least 9, the unknowns of an ellipsoid")
        require(self.calibration_points <= self.tumble_points <= 512, "tumble_points",
                "must be from calibration_points to 512, what the firmware stores")
        require(self.gyroscope_rest_s >= 2.0, "gyroscope_rest_s", "must be at least 2")

    def judged_poses(self, which: Literal["all", "level"] | None = None) -> tuple[Pose, ...]:
        """Return the table poses in the order they are judged: tilt by tilt, level first as listed."""
        from hiltest.angles import Pose

        level_only = (which or self.poses) == "level"
        tilts = [tilt for tilt in self.tilts_deg if not level_only or tilt == (0.0, 0.0)]
        return tuple(Pose(heading, pitch, roll) for pitch, roll in tilts for heading in self.headings_deg)


_NO_DRIFT: Triple = (0.0, 0.0, 0.0)


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
    fxos8700cq_zero_flux_ut : (3,)
        What the FXOS8700CQ magnetometers read beyond that.
    mag3110_noise_ut : (4,)
        Rms at oversampling 16, 32, 64, 128.
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
    gyroscope_bias_dps: Triple = (0.0, 0.0, 0.0)
    fxos8700cq_zero_flux_ut: Triple = (0.0, 0.0, 0.0)
    mag3110_noise_ut: tuple[float, float, float, float] = (0.4, 0.35, 0.3, 0.25)
    mounting_yaw_deg: float | None = None
    temperature_degc: float = 25.0
    temperature_end_degc: float | None = None
    temperature_ramp_s: float | None = None
    temperature_time_constant_s: float | None = None
    drift: TemperatureDrift = TemperatureDrift()
    fitted: tuple[str, ...] = FITTED_PARTS

    def __post_init__(self) -> None:
        require(all(sigma >= 0.0 for sigma in self.mag3110_noise_ut), "mag3110_noise_ut", "must not be negative")
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
