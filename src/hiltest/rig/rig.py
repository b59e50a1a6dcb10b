"""The rig: which board, link, turntable, local field, mounting and limits.

A rig is a TOML file; this module is what it means, `hiltest.rig.file.load_rig` reads it. `conditions_sha256`
is one digest of all that its numbers depend on: two runs with the same one can be compared.
Importing it is cheap: numpy, pydantic, world and sensors are imported by the functions
that need them.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from dataclasses import field as dataclass_field
from difflib import get_close_matches
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from hiltest.errors import ConfigError
from hiltest.measurement import Limit, Reference, Tolerance, identify
from hiltest.rig.cycles import CountedFunctions
from hiltest.rig.device import Device
from hiltest.rig.faults import Faults
from hiltest.rig.parts import PARTS, Part, scaled
from hiltest.rig.tables import (
    STRICT,
    BoardPlace,
    Faces,
    LinkSettings,
    LocalField,
    Mounting,
    Procedure,
    SensorChoice,
    Triple,
    TurntableSettings,
    require,
)
from hiltest.rig.world import SimulatedWorld

if TYPE_CHECKING:
    from hiltest.sensors import RegisterDevice
    from hiltest.sensors.faulty_part import FaultyPart
    from hiltest.world import EarthField, World

# What a declared noise may differ from the simulated one by: data sheets give it to about that.
MOST_NOISE_RATIO = 2.0
#: MAG3110 and FXOS8700CQ magnetometer words [counts/uT].
COUNTS_PER_UT = 10.0
# May be edited without a change of any number: names, and the limits and tolerances of numbers.
_TEXTS = ("lines", "path", "sha256", "name", "schema")
_CHECKED_BY = ("limits", "information", "tolerances", "units", "full_only", "cycles")
# Kept in the record beside the digest, because an option of the command line may change them.
_KEPT_APART = ("seed",)
_KEPT_APART_OF = {
    "procedure": ("poses", "cost_reference"), "board": ("port", "timing", "firmware"),
    "field": ("latitude_deg", "longitude_deg", "altitude_m"),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Rig:
    """A bench and the limits of its measurements."""

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT
    schema: Literal[1]
    name: str
    path: Path
    """The file it was read from."""
    board: BoardPlace
    field: LocalField
    turntable: TurntableSettings
    sensors: SensorChoice
    procedure: Procedure
    mounting: Mounting | None = None
    """None when it is not declared: only centred heading errors can then be checked."""
    faces: Faces | None = None
    """None when they are not declared: gravity on a face is then no reference."""
    link: LinkSettings = dataclass_field(default_factory=LinkSettings)
    device: Device | None = None
    """How firmware is understood that does not speak hiltest's protocol; None for firmware that does."""
    seed: int = 1
    """Noise seed, when the command line gives none."""
    world: SimulatedWorld | None = None
    """Present exactly when the board is virtual."""
    faults: Faults | None = None
    """What goes wrong on purpose, on the line to the board or on it."""
    limits: dict[str, Limit] = dataclass_field(default_factory=dict)
    """Limits by measurement name; a value outside is a failure."""
    information: dict[str, Limit] = dataclass_field(default_factory=dict)
    """Shown beside a measurement, without a verdict."""
    tolerances: dict[str, Tolerance] = dataclass_field(default_factory=dict)
    """How far a measurement may move from a baseline, where it is not hiltest's own table that says so."""
    units: dict[str, str] = dataclass_field(default_factory=dict)
    """Units of limits, information and tolerances, by measurement name."""
    full_only: frozenset[str] = frozenset()
    """Names of the limits that only the full set of tests measures."""
    cycles: dict[str, CountedFunctions] = dataclass_field(default_factory=dict)
    """Function of the firmware that each calibrator is, by the calibrator's name: a board that executes the
    firmware counts its calls. One that is not named is looked for as ``magnetometer_NAME``."""
    lines: dict[str, int] = dataclass_field(default_factory=dict, compare=False)
    """Line of the file on which a key stands, by its path with dots."""
    sha256: str = dataclass_field(default="", compare=False)
    """Digest of that file."""

    def __post_init__(self) -> None:
        require((self.world is None) == (self.board.kind != "virtual"), "world",
                'is the truth of a board of kind "virtual": there with it, absent with any other')
        simulated = self.turntable.kind == "simulated"
        require(simulated == (self.board.kind == "virtual"), "turntable",
                'kind "simulated" goes with a board of kind "virtual", "operator" and "grbl" with others')
        require(self.procedure.accelerometer_calibration == "none" or self.faces is not None, "faces",
                'is missing: procedure.accelerometer_calibration "six-position" needs to know how true they are')
        of_board = self.faults.of_board if self.faults else ()
        require(self.world is not None or not of_board, "faults",
                'sensor, held_line and reset happen to a board of kind "virtual" alone')
        sensor = self.faults.sensor if self.faults else None
        require(self.world is None or sensor is None or sensor.part in self.world.fitted, "faults",
                "has a fault of a sensor that world.fitted does not name")
        if self.world is not None and self.magnetometer_part is not None:
            part, world = self.magnetometer_part, self.world
            reading_ut = world.largest_reading_ut(part, self.field.strength_ut)
            range_ut = PARTS[part].magnetometer_range_ut or 0.0
            require(reading_ut < range_ut, "world",
                    f"{' with '.join(('hard_iron_ut', *world.disturbances))} makes {part} read up to {reading_ut:.0f} "
                    f"uT; its axes stop at {range_ut:.0f}")
            self._check_noise("magnetometer_noise_ut", self.sensors.magnetometer_noise_ut, world.noise_ut(part), "uT")
            self._check_noise("gyroscope_noise_mdps_per_rthz", self.sensors.gyroscope_noise_mdps_per_rthz,
                              world.gyroscope_noise_mdps_per_rthz, "mdps/rtHz")

    def _check_noise(self, key: str, declared: float, simulated: float, unit: str) -> None:
        """Refuse a declared noise that is none of this world; a world without noise says nothing of the parts."""
        agrees = simulated == 0.0 or declared / MOST_NOISE_RATIO <= simulated <= declared * MOST_NOISE_RATIO
        require(agrees, "sensors",
                f"{key} declares {declared:g} {unit}, and the world has {simulated:g}: they may differ by a factor of "
                f"{MOST_NOISE_RATIO:g}; the residual of a fit is compared with the declared one")

    @property
    def own_language(self) -> Device | None:
        """How the firmware is understood where it does not speak hiltest's protocol; None where it does."""
        return None if self.device is None or self.device.speaks_our_protocol else self.device

    def where(self, *key: str) -> str:
        """Return ``file:line`` of a key, the file alone where it does not stand in it."""
        line = self.lines.get(".".join(key))
        return str(self.path) if line is None else f"{self.path}:{line}"

    def refuse_playback(self, wanted: str) -> None:
        """Refuse what needs a world that is simulated where a recording is played.

        Raises
        ------
        ConfigError
            With file and line, and what there is instead.
        """
        if self.world is not None and self.world.playback is not None:
            raise ConfigError(
                f"{self.where('world', 'playback')}: world.playback: {wanted} is not offered while a recording is "
                "played: no table turns what it shows, and no known angle judges it. hiltest play shows what firmware "
                "finds from it; hiltest log, device try and serve let it be heard: see docs/playback.md"
            )

    def limits_of(self, suite: Literal["gate", "full"]) -> dict[str, Limit]:
        """Return the limits that a set of tests must measure."""
        excused = self.full_only if suite == "gate" else frozenset()
        return {name: limit for name, limit in self.limits.items() if name not in excused}

    def reference_uncertainty_deg(self, measurement: str) -> float | None:
        """Return how well the reference of a heading measurement is known [deg], None for any other.

        Notes
        -----
        Both that a rig declares are expanded uncertainties with a coverage factor of 2. The turntable's and the
        mounting's are independent, so that their squares add (GUM, JCGM 100:2008, 5.1.2), which keeps the factor. A
        centred error does not contain the mounting, which is the same at every pose. What many poses have in common
        of a table's error is not known, and so no mean over them is taken to be known better.
        """
        kind = identify(measurement).kind
        if kind is None or kind.reference is Reference.NONE:
            return None
        mounted = self.mounting is not None and kind.reference is Reference.MOUNTED
        mounting_deg = self.mounting.uncertainty_deg if self.mounting and mounted else 0.0
        return math.hypot(self.turntable.uncertainty_deg, mounting_deg)

    def guard_band_deg(self, measurement: str) -> float | None:
        """Return the expanded uncertainty that a limit is held against [deg]: that of angles set by hand, or None.

        A simulated table is where it says, and of motors the limits are to allow for what the rig declares.
        """
        return self.reference_uncertainty_deg(measurement) if self.turntable.kind == "operator" else None

    @property
    def magnetometer_part(self) -> str | None:
        """The part of `PARTS` whose magnetometer is under test; None where it is no known one."""
        named, fitted = self.sensors.magnetometer, self.world.fitted if self.world else ()
        for name, part in PARTS.items():
            magnetometer = part.sensors.get("magnetometer")
            if magnetometer is not None and (name in fitted if named is None else named == magnetometer):
                return name
        return None


def refuse_unknown_sensors(rig: Rig, known: Mapping[str, Sequence[str]]) -> None:
    """Refuse a name that is none of those that sensors of its kind have.

    Parameters
    ----------
    known
        Names by the kind's key under ``[sensors]``: of all parts that can be simulated, or of those that firmware has.

    Raises
    ------
    ConfigError
        With file and line.
    """
    for kind, names in known.items():
        given = getattr(rig.sensors, kind)
        if given is not None and given not in names:
            nearest = next(iter(get_close_matches(given, names, n=1)), None)
            hint = f"did you mean {nearest!r}?" if nearest else f"known: {', '.join(names) or 'none'}"
            raise ConfigError(f"{rig.where('sensors', kind)}: sensors.{kind}: no {kind} {given!r}; {hint}")


@dataclass(frozen=True, slots=True)
class WorldTruth:
    """The truth of a simulated world, for the measurements that need it."""

    field: EarthField
    soft_iron: tuple[Triple, Triple, Triple]
    """True field to measured field, body frame."""
    hard_iron_counts: Triple
    """At the magnetometer under test, body frame [counts]."""
    accelerometer_response: tuple[Triple, Triple, Triple]
    """Gravity to what the part reads of it, body frame; `accelerometer_offset_g` comes on top [g]."""
    accelerometer_offset_g: Triple
    gyroscope_bias_dps: Triple
    """Body frame [deg/s]."""
    gyroscope_response: tuple[Triple, Triple, Triple]
    """True rate to felt rate, body frame."""
    mounting_yaw_deg: float


def world_truth(rig: Rig) -> WorldTruth | None:
    """Return the truth of a rig's simulated world, None for a rig that has none."""
    if rig.world is None:
        return None
    x, y, z = rig.world.hard_iron_at_ut(rig.magnetometer_part or "mag3110")
    return WorldTruth(
        field=_earth_field(rig),
        soft_iron=rig.world.soft_iron,
        hard_iron_counts=(COUNTS_PER_UT * x, COUNTS_PER_UT * y, COUNTS_PER_UT * z),
        accelerometer_response=rig.world.accelerometer_response,
        accelerometer_offset_g=scaled(rig.world.accelerometer_offset_mg, 1e-3),
        gyroscope_bias_dps=rig.world.gyroscope_bias_dps,
        gyroscope_response=rig.world.gyroscope_response,
        mounting_yaw_deg=_true_yaw_deg(rig, rig.world),
    )


def build_world(rig: Rig) -> World:
    """Make the world of a virtual board: the same for every seed.

    Raises
    ------
    ValueError
        If the rig has no simulated world.
    """
    from hiltest.world import Temperature, World
    from hiltest.world.disturbances import Disturbances
    from hiltest.world.spiral import Cap

    world, covered = _simulated(rig), rig.turntable.covered
    temperature = Temperature(
        world.temperature_degc, world.temperature_end_degc, world.temperature_ramp_s, world.temperature_time_constant_s
    )
    return World(
        _earth_field(rig), mounting_yaw_deg=_true_yaw_deg(rig, world), temperature=temperature,
        covered=Cap(covered.axis, covered.fraction) if covered else None,
        disturbances=Disturbances(
            current=world.current.in_world() if world.current else None,
            passing=world.passing.in_world() if world.passing else None,
            cable=world.cable.in_world() if world.cable else None,
        ) if world.disturbances else None,
    )


def build_sensors(
    rig: Rig, world: World, seed: int, *, faults_from_s: float = 0.0
) -> dict[str, list[RegisterDevice | FaultyPart]]:
    """Make the parts of a virtual board, by I2C bus.

    Parameters
    ----------
    rig
        Rig with a simulated world.
    world
        Which they measure.
    seed
        Noise seed.
    faults_from_s
        From when the times of the rig's faults count [s since power-on].

    Returns
    -------
    dict
        ``"i2c0"``: what is on the FRDM-K64F itself; ``"i2c1"``: the sensor shield.
    """
    from hiltest.rig.faulty_parts import fitted_part

    truth = _simulated(rig)

    def make(part: Part) -> RegisterDevice:
        return part.make(world, truth, seed, part)

    buses: dict[str, list[RegisterDevice | FaultyPart]] = {"i2c0": [], "i2c1": []}
    for name in truth.fitted:
        buses[f"i2c{PARTS[name].bus}"].append(fitted_part(name, make, rig.faults, began_s=faults_from_s))
    return buses


def _simulated(rig: Rig) -> SimulatedWorld:
    if rig.world is None:
        raise ValueError(f"rig {rig.name} has no simulated world")
    return rig.world


def _earth_field(rig: Rig) -> EarthField:
    from hiltest.world import EarthField

    return EarthField(rig.field.strength_ut, rig.field.dip_deg, rig.field.declination_deg)


def _true_yaw_deg(rig: Rig, world: SimulatedWorld) -> float:
    if world.mounting_yaw_deg is not None:
        return world.mounting_yaw_deg
    return rig.mounting.yaw_deg if rig.mounting else 0.0


def conditions_sha256(rig: Rig) -> str:
    """Return the SHA-256 of everything that a rig's numbers depend on.

    Comments, limits, information, tolerances, names and counted functions do not enter, nor seed and poses, compared by
    themselves, nor the calibrator that costs are shown against, nor the port that a board happens to be on, nor its
    timing profile: cycles carry that; nor the place, which only `hiltest doctor` reads.
    """
    content = _conditions(rig)
    content["link"]["mode"] = "stub"  # a key that is gone: without it no digest would be what it was
    return sha256(json.dumps(content, sort_keys=True, default=str).encode()).hexdigest()


def other_conditions(rig: Rig, other: Rig) -> str:
    """Return the first key that differs of those on which numbers depend, with both values; empty if none does."""
    pairs = [(_conditions(rig), _conditions(other), "")]
    while pairs:
        one, two, place = pairs.pop()
        for key in sorted(one.keys() | two.keys()):
            was, now = one.get(key), two.get(key)
            if isinstance(was, dict) and isinstance(now, dict):
                pairs.append((was, now, f"{place}{key}."))
            elif was != now:
                return f"{place}{key} is {now}, and was {was}"
    return ""


def _conditions(rig: Rig) -> dict[str, Any]:
    content = asdict(rig)
    for key in (*_TEXTS, *_CHECKED_BY, *_KEPT_APART):
        del content[key]
    for table, keys in _KEPT_APART_OF.items():
        for key in keys:
            del content[table][key]
    found: dict[str, Any] = _without_none(content)
    return found


def _without_none(content: Any) -> Any:
    """Leave out keys that are not given, so that a key which a later hiltest adds changes no digest."""
    if isinstance(content, dict):
        return {key: _without_none(value) for key, value in content.items() if value is not None}
    return content
