"""The rig: which board, link, turntable, local field, mounting and limits.

A rig is a TOML file; this module is what it means, `hiltest.rig_file` is how it is read.
Importing it is cheap: numpy, pydantic, world and sensors are imported by the functions
that need them.
"""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import field as dataclass_field
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal, TypeAlias

from hiltest.measurement import Limit

if TYPE_CHECKING:
    from hiltest.angles import Pose
    from hiltest.sensors.fxos8700cq import AccelerometerErrors
    from hiltest.sensors.register_device import RegisterDevice
    from hiltest.world.distortion import MagneticDistortion
    from hiltest.world.earth_field import EarthField
    from hiltest.world.world import World

Triple: TypeAlias = tuple[float, float, float]

# What pydantic reads off these dataclasses: no unknown keys, no conversions (an integer is a fine float).
_STRICT: dict[str, Any] = {"extra": "forbid", "strict": True, "allow_inf_nan": False}

#: MAG3110 and FXOS8700CQ magnetometer words [counts/uT].
COUNTS_PER_UT = 10.0

FITTED_PARTS = ("mag3110", "fxos8700cq", "fxas21002c", "onboard-fxos8700cq")


class RigValueError(ValueError):
    """A value of the rig is out of its range."""

    def __init__(self, key: str, message: str) -> None:
        self.key = key
        super().__init__(message)


def _require(holds: bool, key: str, message: str) -> None:
    if not holds:
        raise RigValueError(key, message)


@dataclass(frozen=True, slots=True)
class BoardPlace:
    """What answers on the link: the virtual board, one on a port, or a recorded session."""

    __pydantic_config__: ClassVar[dict[str, Any]] = _STRICT
    kind: Literal["virtual", "real", "replay"]
    port: str | None = None
    transcript: str | None = None

    def __post_init__(self) -> None:
        _require(self.kind == "real" or self.port is None, "port", 'belongs to a board of kind "real"')
        _require((self.kind == "replay") == (self.transcript is not None), "transcript",
                 'names the recorded session of a board of kind "replay", and only of that')


@dataclass(frozen=True, slots=True)
class LinkSettings:
    """How the board is talked to."""

    __pydantic_config__: ClassVar[dict[str, Any]] = _STRICT
    baud: int = 115_200
    mode: Literal["stub", "fsflk"] = "stub"

    def __post_init__(self) -> None:
        _require(self.baud > 0, "baud", "must be above 0")


@dataclass(frozen=True, slots=True)
class LocalField:
    """The earth's field at the bench: total intensity, dip (down positive), declination (east positive)."""

    __pydantic_config__: ClassVar[dict[str, Any]] = _STRICT
    strength_ut: float
    dip_deg: float
    declination_deg: float = 0.0

    def __post_init__(self) -> None:
        _require(self.strength_ut > 0.0, "strength_ut", "must be above 0")
        _require(abs(self.dip_deg) < 90.0, "dip_deg", "must be within -90 to 90: at a pole there is no heading")
        _require(abs(self.declination_deg) <= 180.0, "declination_deg", "must be within -180 to 180")


@dataclass(frozen=True, slots=True)
class Mounting:
    """How the board sits on the table: board heading = table heading + yaw, known to +-uncertainty."""

    __pydantic_config__: ClassVar[dict[str, Any]] = _STRICT
    yaw_deg: float
    uncertainty_deg: float

    def __post_init__(self) -> None:
        _require(abs(self.yaw_deg) <= 180.0, "yaw_deg", "must be within -180 to 180")
        _require(self.uncertainty_deg >= 0.0, "uncertainty_deg", "must not be negative")


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

    __pydantic_config__: ClassVar[dict[str, Any]] = _STRICT
    magnetometer_noise_ut: float
    magnetometer: str | None = None
    accelerometer: str | None = None
    gyroscope: str | None = None

    def __post_init__(self) -> None:
        _require(self.magnetometer_noise_ut >= 0.0, "magnetometer_noise_ut", "must not be negative")


@dataclass(frozen=True, slots=True)
class TurntableSettings:
    """What sets a known angle, and how well [deg]."""

    __pydantic_config__: ClassVar[dict[str, Any]] = _STRICT
    kind: Literal["simulated", "operator", "motor"]
    uncertainty_deg: float

    def __post_init__(self) -> None:
        _require(self.uncertainty_deg >= 0.0, "uncertainty_deg", "must not be negative")


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

    __pydantic_config__: ClassVar[dict[str, Any]] = _STRICT
    headings_deg: tuple[float, ...]
    tilts_deg: tuple[tuple[float, float], ...]
    poses: Literal["all", "level"] = "all"
    readings_per_pose: int = 16
    calibration_points: int = 100
    tumble_points: int = 300
    gyroscope_rest_s: float = 2.0

    def __post_init__(self) -> None:
        _require(len(self.headings_deg) >= 4, "headings_deg", "needs at least 4 headings, or no worst sector is found")
        _require((0.0, 0.0) in self.tilts_deg, "tilts_deg", "must contain the level one, [0, 0]")
        _require(all(abs(pitch) < 90.0 for pitch, _ in self.tilts_deg), "tilts_deg",
                 "must keep pitch within -90 to 90: beyond, heading turns round")
        _require(1 <= self.readings_per_pose <= 512, "readings_per_pose", "must be 1 to 512, as the firmware averages")
        _require(self.calibration_points >= 9, "calibration_points", "must be at least 9, the unknowns of an ellipsoid")
        _require(self.calibration_points <= self.tumble_points <= 512, "tumble_points",
                 "must be from calibration_points to 512, what the firmware stores")
        _require(self.gyroscope_rest_s >= 2.0, "gyroscope_rest_s", "must be at least 2")

    def judged_poses(self, which: Literal["all", "level"] | None = None) -> tuple[Pose, ...]:
        """Return the table poses in the order they are judged: tilt by tilt, level first as listed."""
        from hiltest.angles import Pose

        level_only = (which or self.poses) == "level"
        tilts = [tilt for tilt in self.tilts_deg if not level_only or tilt == (0.0, 0.0)]
        return tuple(Pose(heading, pitch, roll) for pitch, roll in tilts for heading in self.headings_deg)


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
    fitted : tuple of str
        Which parts are there: see `FITTED_PARTS`.
    """

    __pydantic_config__: ClassVar[dict[str, Any]] = _STRICT
    soft_iron: tuple[Triple, Triple, Triple]
    hard_iron_ut: Triple
    accelerometer_offset_mg: Triple = (0.0, 0.0, 0.0)
    accelerometer_gain_error_percent: Triple = (0.0, 0.0, 0.0)
    gyroscope_bias_dps: Triple = (0.0, 0.0, 0.0)
    fxos8700cq_zero_flux_ut: Triple = (0.0, 0.0, 0.0)
    mag3110_noise_ut: tuple[float, float, float, float] = (0.4, 0.35, 0.3, 0.25)
    mounting_yaw_deg: float | None = None
    temperature_degc: float = 25.0
    fitted: tuple[str, ...] = FITTED_PARTS

    def __post_init__(self) -> None:
        _require(all(sigma >= 0.0 for sigma in self.mag3110_noise_ut), "mag3110_noise_ut", "must not be negative")
        strangers = [part for part in self.fitted if part not in FITTED_PARTS]
        _require(not strangers, "fitted", f"names {strangers}; known parts: {', '.join(FITTED_PARTS)}")


@dataclass(frozen=True, slots=True)
class Rig:
    """A bench and what it must show.

    Attributes
    ----------
    path : Path
        The file it was read from.
    mounting : Mounting or None
        None when nobody declares it: only centred heading errors can then be judged.
    seed : int
        Of the noise, when the command line gives none.
    world : SimulatedWorld or None
        Present exactly when the board is virtual.
    limits : dict of str to Limit
        By measurement name; a value outside is a failure.
    information : dict of str to Limit
        Shown beside a measurement, without a verdict.
    """

    __pydantic_config__: ClassVar[dict[str, Any]] = _STRICT
    schema: Literal[1]
    name: str
    path: Path
    board: BoardPlace
    field: LocalField
    turntable: TurntableSettings
    sensors: SensorChoice
    procedure: Procedure
    mounting: Mounting | None = None
    link: LinkSettings = LinkSettings()
    seed: int = 1
    world: SimulatedWorld | None = None
    limits: dict[str, Limit] = dataclass_field(default_factory=dict)
    information: dict[str, Limit] = dataclass_field(default_factory=dict)

    def __post_init__(self) -> None:
        _require((self.world is None) == (self.board.kind != "virtual"), "world",
                 'is the truth of a board of kind "virtual": there with it, absent with any other')
        simulated = self.turntable.kind == "simulated"
        _require(simulated == (self.board.kind == "virtual"), "turntable",
                 'kind "simulated" goes with a board of kind "virtual", "operator" and "motor" with others')


@dataclass(frozen=True, slots=True)
class WorldTruth:
    """What only a simulated world knows, for the measurements that need it.

    Attributes
    ----------
    field : EarthField
    soft_iron : 3 rows of 3
        True field to measured field, body frame.
    hard_iron_counts : (3,)
        Of the MAG3110, body frame [counts].
    gyroscope_bias_dps : (3,)
        Body frame [deg/s].
    mounting_yaw_deg : float
    """

    field: EarthField
    soft_iron: tuple[Triple, Triple, Triple]
    hard_iron_counts: Triple
    gyroscope_bias_dps: Triple
    mounting_yaw_deg: float


def load_rig(path: Path | str) -> Rig:
    """Read a rig file.

    Raises
    ------
    UnknownKeyError
        If a key is not known, with file, line and the nearest known key.
    ConfigError
        If the file cannot be read, a value is wrong, or a limit is tighter than the
        uncertainty of the reference it is measured against.
    """
    from hiltest.rig_file import read_rig_file

    return read_rig_file(Path(path))


def world_truth(rig: Rig) -> WorldTruth | None:
    """Return the truth of a rig's simulated world, None for a rig that has none."""
    if rig.world is None:
        return None
    x, y, z = rig.world.hard_iron_ut
    return WorldTruth(
        field=_earth_field(rig),
        soft_iron=rig.world.soft_iron,
        hard_iron_counts=(COUNTS_PER_UT * x, COUNTS_PER_UT * y, COUNTS_PER_UT * z),
        gyroscope_bias_dps=rig.world.gyroscope_bias_dps,
        mounting_yaw_deg=_true_yaw_deg(rig, rig.world),
    )


def build_world(rig: Rig) -> World:
    """Make the world of a virtual board: the same for every seed.

    Raises
    ------
    ValueError
        If the rig has no simulated world.
    """
    from hiltest.world.world import World

    world = _simulated(rig)
    return World(
        _earth_field(rig), mounting_yaw_deg=_true_yaw_deg(rig, world), temperature_degc=world.temperature_degc
    )


def build_sensors(rig: Rig, world: World, seed: int) -> dict[str, list[RegisterDevice]]:
    """Make the parts of a virtual board, by I2C bus.

    Parameters
    ----------
    rig : Rig
        With a simulated world.
    world : World
        Which they measure.
    seed : int
        Of their noise.

    Returns
    -------
    dict
        ``"i2c0"``: what is on the FRDM-K64F itself; ``"i2c1"``: the sensor shield.
    """
    from hiltest.sensors.fxas21002c import Fxas21002c
    from hiltest.sensors.fxos8700cq import Fxos8700cq
    from hiltest.sensors.mag3110 import Mag3110
    from hiltest.world.distortion import MagneticDistortion

    truth = _simulated(rig)
    distortion = MagneticDistortion(truth.soft_iron, truth.hard_iron_ut)

    def fxos8700cq(address: int, name: str) -> Fxos8700cq:
        return Fxos8700cq(
            world, _with_zero_flux(distortion, truth.fxos8700cq_zero_flux_ut),
            seed=seed, address=address, name=name, errors=_accelerometer_errors(truth),
        )

    parts: dict[str, tuple[str, RegisterDevice]] = {
        "mag3110": ("i2c1", Mag3110(world, distortion, seed=seed, noise_ut=truth.mag3110_noise_ut)),
        "fxos8700cq": ("i2c1", fxos8700cq(0x1E, "shield")),
        "fxas21002c": ("i2c1", Fxas21002c(world, seed=seed, bias_dps=truth.gyroscope_bias_dps)),
        "onboard-fxos8700cq": ("i2c0", fxos8700cq(0x1D, "onboard")),
    }
    buses: dict[str, list[RegisterDevice]] = {"i2c0": [], "i2c1": []}
    for name in truth.fitted:
        bus, part = parts[name]
        buses[bus].append(part)
    return buses


def _simulated(rig: Rig) -> SimulatedWorld:
    if rig.world is None:
        raise ValueError(f"rig {rig.name} has no simulated world")
    return rig.world


def _earth_field(rig: Rig) -> EarthField:
    from hiltest.world.earth_field import EarthField

    return EarthField(rig.field.strength_ut, rig.field.dip_deg, rig.field.declination_deg)


def _true_yaw_deg(rig: Rig, world: SimulatedWorld) -> float:
    if world.mounting_yaw_deg is not None:
        return world.mounting_yaw_deg
    return rig.mounting.yaw_deg if rig.mounting else 0.0


def _with_zero_flux(distortion: MagneticDistortion, zero_flux_ut: Triple) -> MagneticDistortion:
    from hiltest.world.distortion import MagneticDistortion

    x, y, z = (hard + zero for hard, zero in zip(distortion.hard_iron_ut, zero_flux_ut, strict=True))
    return MagneticDistortion(distortion.soft_iron, (x, y, z))


def _accelerometer_errors(truth: SimulatedWorld) -> AccelerometerErrors:
    from hiltest.sensors.fxos8700cq import AccelerometerErrors

    x, y, z = truth.accelerometer_offset_mg
    gain_x, gain_y, gain_z = truth.accelerometer_gain_error_percent
    return AccelerometerErrors((x / 1000.0, y / 1000.0, z / 1000.0), (gain_x / 100.0, gain_y / 100.0, gain_z / 100.0))
