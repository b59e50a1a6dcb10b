"""The rig: which board, link, turntable, local field, mounting and limits.

A rig is a TOML file; this module defines its content, `hiltest.rig.rig_file.load_rig` reads it. `conditions_sha256` is
a digest of all conditions that its numbers depend on: two runs with the same digest can be compared. Importing it is
cheap: numpy, pydantic, world and sensors are imported by the functions that need them.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from dataclasses import field as dataclass_field
from difflib import get_close_matches
from glob import glob
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from hiltest.errors import ConfigError
from hiltest.measurement import Limit, Reference, Tolerance, identify
from hiltest.rig.cycles import CountedFunctions
from hiltest.rig.device import Device
from hiltest.rig.faults import Faults
from hiltest.rig.parts import PARTS, Part, fitted_parts, scaled
from hiltest.rig.recorded_motion import PlaybackFile
from hiltest.rig.toml_tables import (
    BoardPlace,
    Faces,
    LinkSettings,
    LocalField,
    Mounting,
    Procedure,
    SensorChoice,
    StrictTable,
    Triple,
    TurntableSettings,
    require,
)
from hiltest.rig.world import SimulatedWorld

if TYPE_CHECKING:
    from hiltest.world import EarthField, World
    from hiltest.world.sensors import RegisterDevice
    from hiltest.world.sensors.faulty_part import FaultyPart

# Largest relative difference of a declared noise from the simulated one: about the precision of data sheets.
MOST_NOISE_RATIO = 2.0
#: MAG3110 and FXOS8700CQ magnetometer words [counts/uT].
COUNTS_PER_UT = 10.0
# Keys that do not affect any number: names, and the limits and tolerances of numbers.
_TEXTS = ("lines", "path", "sha256", "name", "schema")
_CHECKED_BY = ("limits", "information", "tolerances", "units", "full_only", "cycles")
# Keys that are recorded separately from the digest, because a command line option may change them.
_KEPT_APART = ("seed",)
_KEPT_APART_OF = {
    "procedure": ("poses", "cost_reference"),
    "board": ("port", "timing", "firmware"),
    "field": ("latitude_deg", "longitude_deg", "altitude_m"),
    "sensors": ("accepted_settings",),
}


@dataclass(frozen=True, slots=True)
class Rig(StrictTable):
    """A bench and the limits of its measurements."""

    schema: Literal[1]
    name: str
    path: Path
    """File that it was read from."""
    board: BoardPlace
    field: LocalField
    turntable: TurntableSettings
    sensors: SensorChoice
    procedure: Procedure
    mounting: Mounting | None = None
    """Mounting; None if undeclared: only centred heading errors can then be checked."""
    faces: Faces | None = None
    """Faces; None if undeclared: gravity on a face is then not a reference."""
    link: LinkSettings = dataclass_field(default_factory=LinkSettings)
    device: Device | None = None
    """Interface to firmware without hiltest's protocol; None for firmware with it."""
    seed: int = 1
    """Noise seed if the command line has none."""
    world: SimulatedWorld | None = None
    """Simulated world, present exactly if the board is virtual."""
    faults: Faults | None = None
    """Injected faults, of the line to the board or of the board."""
    limits: dict[str, Limit] = dataclass_field(default_factory=dict)
    """Limits by measurement name; a value outside is a failure."""
    information: dict[str, Limit] = dataclass_field(default_factory=dict)
    """Values to show beside a measurement, without a verdict."""
    tolerances: dict[str, Tolerance] = dataclass_field(default_factory=dict)
    """Tolerances of measurements against a baseline that replace hiltest's own."""
    units: dict[str, str] = dataclass_field(default_factory=dict)
    """Units of limits, information and tolerances, by measurement name."""
    full_only: frozenset[str] = frozenset()
    """Names of the limits that only the full set of tests measures."""
    cycles: dict[str, CountedFunctions] = dataclass_field(default_factory=dict)
    """Function of each calibrator in the firmware, by the calibrator's name: a board that executes the firmware counts
    its calls. The default is ``magnetometer_NAME``."""
    lines: dict[str, int] = dataclass_field(default_factory=dict, compare=False)
    """Line of each key in the file, by its path with dots."""
    sha256: str = dataclass_field(default="", compare=False)
    """Digest of the file."""

    def __post_init__(self) -> None:
        require(
            (self.world is None) == (self.board.kind != "virtual"),
            "world",
            'is required for a board of kind "virtual", and not allowed for others',
        )
        simulated = self.turntable.kind == "simulated"
        require(
            simulated == (self.board.kind == "virtual"),
            "turntable",
            'kind "simulated" requires a board of kind "virtual", kinds "operator" and "grbl" another board',
        )
        require(
            self.procedure.accelerometer_calibration == "none" or self.faces is not None,
            "faces",
            'is missing: procedure.accelerometer_calibration "six-position" needs their accuracy',
        )
        require(
            not self.turntable.fewest_poses or (self.answers_requests and self.mounting is not None),
            "turntable.fewest_poses",
            "requires firmware that answers hiltest's requests, and a declared mounting",
        )
        of_board = self.faults.board_faults if self.faults else ()
        require(
            self.world is not None or not of_board,
            "faults",
            'sensor, held_line and reset require a board of kind "virtual"',
        )
        sensor = self.faults.sensor if self.faults else None
        require(
            self.world is not None or self.sensors.parts is None,
            "sensors.parts",
            'requires a board of kind "virtual": a real one has its parts',
        )
        for index, entry in enumerate(self.sensors.parts or ()):
            entry.check_pins(self.board.machine, f"sensors.parts.{index}")
        parts = self.parts
        require(
            self.world is None or sensor is None or sensor.part in parts,
            "faults.sensor.part",
            f"is none of {', '.join(parts)}: name a part of world.fitted or of sensors.parts",
        )
        if sensor is not None and sensor.part in parts:
            is_replaced = sensor.fault == "other part" and parts[sensor.part].chip_select is not None
            require(not is_replaced, "faults.sensor.fault", '"other part" is possible on an I2C bus only')
        name = self.magnetometer_part
        if self.world is not None and name is not None:
            part, world = self.magnetometer_under_test, self.world
            reading_ut = world.largest_reading_ut(part, self.field.strength_ut)
            range_ut = part.magnetometer_range_ut or 0.0
            require(
                reading_ut < range_ut,
                "world",
                f"{' with '.join(('hard_iron_ut', *world.disturbances))} makes {name} read up to {reading_ut:.0f} "
                f"uT; its axes stop at {range_ut:.0f}",
            )
            noise_ut = part.magnetometer_noise_ut(world)
            self._check_noise("magnetometer_noise_ut", self.sensors.magnetometer_noise_ut, noise_ut, "uT")
            self._check_noise(
                "gyroscope_noise_mdps_per_rthz",
                self.sensors.gyroscope_noise_mdps_per_rthz,
                world.gyroscope_noise_mdps_per_rthz,
                "mdps/rtHz",
            )

    def _check_noise(self, key: str, declared: float, simulated: float, unit: str) -> None:
        """Refuse a declared noise that differs from this world's; a world without noise is not compared."""
        agrees = simulated == 0.0 or declared / MOST_NOISE_RATIO <= simulated <= declared * MOST_NOISE_RATIO
        require(
            agrees,
            "sensors",
            f"{key} declares {declared:g} {unit}, and the world has {simulated:g}: the largest allowed ratio is "
            f"{MOST_NOISE_RATIO:g}, since the residual of a fit is compared with the declared noise",
        )

    @property
    def answers_requests(self) -> bool:
        """True if the firmware answers hiltest's requests; otherwise ``[device]`` says how to understand its output."""
        return self.device is None or self.device.speaks_our_protocol

    def where(self, *key: str) -> str:
        """Return ``file:line`` of a key; only the file if it does not have the key."""
        line = self.lines.get(".".join(key))
        return str(self.path) if line is None else f"{self.path}:{line}"

    def refuse_playback(self, feature: str) -> None:
        """Refuse a feature that needs a simulated world if a recording is played.

        Raises
        ------
        ConfigError
            If a recording is played; the message has file, line and the alternative.
        """
        if self.world is not None and self.world.playback is not None:
            raise ConfigError(
                f"{self.where('world', 'playback')}: world.playback: {feature} is not possible with a recording, "
                "which has no turntable and no known angle. hiltest play shows the results of firmware; hiltest log, "
                "listen and serve also play it: see docs/playback.md"
            )

    def playing(self, recording: Path) -> Rig:
        """Return the rig of a virtual board with a recording in place of its world."""
        assert self.world is not None
        playback = PlaybackFile(str(recording.resolve()))
        return replace(self, world=replace(self.world, playback=playback, current=None, passing=None, cable=None))

    def motion_recordings(self) -> dict[str, Path]:
        """Return the files of ``world.motion_recordings`` by name; empty if the rig has none.

        Raises
        ------
        ConfigError
            If there is no file of a name.
        """
        folder = self.path.parent
        files: dict[str, Path] = {}
        for name in (self.world and self.world.motion_recordings) or ():
            matches = sorted(glob(name, root_dir=folder))
            if not matches:
                place = self.where("world", "motion_recordings")
                raise ConfigError(f"{place}: world.motion_recordings: no file {name!r} in {folder}; correct its name")
            files |= {match: folder / match for match in matches}
        return files

    def limits_of(self, suite: Literal["gate", "full"]) -> dict[str, Limit]:
        """Return the limits that a set of tests must measure."""
        excused = self.full_only if suite == "gate" else frozenset()
        return {name: limit for name, limit in self.limits.items() if name not in excused}

    def reference_uncertainty_deg(self, measurement: str) -> float | None:
        """Return the uncertainty of a heading measurement's reference [deg]; None for any other.

        Notes
        -----
        A rig declares expanded uncertainties with a coverage factor of 2. The turntable's and the mounting's are
        independent, so that their squares add (GUM, JCGM 100:2008, 5.1.2), which keeps the factor. A centred error does
        not contain the mounting, which is the same at every pose. The correlation of a table's error between poses is
        unknown, so a mean over poses is not assumed to be more certain.
        """
        kind = identify(measurement).kind
        if kind is None or kind.reference is Reference.NONE:
            return None
        mounted = self.mounting is not None and kind.reference is Reference.MOUNTED
        mounting_deg = self.mounting.uncertainty_deg if self.mounting and mounted else 0.0
        return math.hypot(self.turntable.uncertainty_deg, mounting_deg)

    def guard_band_deg(self, measurement: str) -> float | None:
        """Return the expanded uncertainty to add to a limit [deg]: that of angles set by hand, or None.

        A simulated table is exact, and the limits must allow for the declared uncertainty of motors.
        """
        return self.reference_uncertainty_deg(measurement) if self.turntable.kind == "operator" else None

    @property
    def parts(self) -> dict[str, Part]:
        """The fitted parts of a virtual board by name; empty for another board."""
        return fitted_parts(self.world, self.sensors.parts) if self.world is not None else {}

    @property
    def magnetometer_part(self) -> str | None:
        """Name of the part whose magnetometer is under test, fitted or of `PARTS`; None if unknown."""
        named, fitted = self.sensors.magnetometer, self.parts
        for name, part in {**PARTS, **fitted}.items():
            magnetometer = part.sensors.get("magnetometer")
            if magnetometer is not None and (name in fitted if named is None else named == magnetometer):
                return name
        return None

    @property
    def magnetometer_under_test(self) -> Part:
        """The part whose magnetometer is under test; the MAG3110 if it is unknown."""
        return {**PARTS, **self.parts}[self.magnetometer_part or "mag3110"]


def refuse_unknown_sensors(rig: Rig, names_by_kind: Mapping[str, Sequence[str]]) -> None:
    """Refuse a name that no sensor of its kind has.

    Parameters
    ----------
    names_by_kind
        Names by the kind's key under ``[sensors]``: of all simulated parts, or of the firmware's.

    Raises
    ------
    ConfigError
        If the name is unknown; the message has file and line.
    """
    for kind, names in names_by_kind.items():
        name = getattr(rig.sensors, kind)
        if name is not None and name not in names:
            nearest = next(iter(get_close_matches(name, names, n=1)), None)
            hint = f"did you mean {nearest!r}?" if nearest else f"known: {', '.join(names) or 'none'}"
            raise ConfigError(f"{rig.where('sensors', kind)}: sensors.{kind}: no {kind} {name!r}; {hint}")


@dataclass(frozen=True, slots=True)
class WorldTruth:
    """The truth of a simulated world, for the measurements that need it."""

    field: EarthField
    soft_iron: tuple[Triple, Triple, Triple]
    """Matrix from true to measured field, body frame."""
    hard_iron_counts: Triple
    """Hard iron at the magnetometer under test, body frame [counts]."""
    accelerometer_response: tuple[Triple, Triple, Triple]
    """Matrix from gravity to the part's reading, body frame, without `accelerometer_offset_g` [g]."""
    accelerometer_offset_g: Triple
    gyroscope_bias_dps: Triple
    """Bias of the gyroscope, body frame [deg/s]."""
    gyroscope_response: tuple[Triple, Triple, Triple]
    """Matrix from true to measured rate, body frame."""
    mounting_yaw_deg: float


def world_truth(rig: Rig) -> WorldTruth | None:
    """Return the truth of a rig's simulated world; None for a rig without one."""
    if rig.world is None:
        return None
    x, y, z = rig.world.hard_iron_at_ut(rig.magnetometer_under_test)
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
    """Create the world of a virtual board, which is the same for every seed.

    Raises
    ------
    ValueError
        If the rig has no simulated world.
    """
    from hiltest.orientation.angles import Pose
    from hiltest.world import Temperature, World
    from hiltest.world.disturbances import Disturbances
    from hiltest.world.spiral import Cap

    world, covered = _simulated_world(rig), rig.turntable.covered
    temperature = Temperature(
        world.temperature_degc, world.temperature_end_degc, world.temperature_ramp_s, world.temperature_time_constant_s
    )
    return World(
        _earth_field(rig),
        mounting_yaw_deg=_true_yaw_deg(rig, world),
        temperature=temperature,
        covered=Cap(covered.axis, covered.fraction) if covered else None,
        tumble_poses=[Pose(*angles) for angles in rig.turntable.tumble_poses_deg or ()],
        disturbances=Disturbances(
            current=world.current.make_disturbance() if world.current else None,
            passing=world.passing.make_disturbance() if world.passing else None,
            cable=world.cable.make_disturbance() if world.cable else None,
        )
        if world.disturbances
        else None,
    )


def build_parts(
    rig: Rig, world: World, seed: int, *, faults_from_s: float = 0.0
) -> dict[str, RegisterDevice | FaultyPart]:
    """Create the parts of a virtual board, by name.

    Parameters
    ----------
    rig
        Rig with a simulated world.
    world
        World that the parts measure.
    seed
        Noise seed.
    faults_from_s
        Origin of the times of the rig's faults [s since power-on].

    """
    from hiltest.rig.faulty_parts import fitted_part

    truth = _simulated_world(rig)

    def make(part: Part) -> RegisterDevice:
        return part.make(world, truth, seed, part)

    return {name: fitted_part(name, part, make, rig.faults, began_s=faults_from_s) for name, part in rig.parts.items()}


def _simulated_world(rig: Rig) -> SimulatedWorld:
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

    The digest excludes comments, limits, information, tolerances, names and counted functions; seed and poses, which
    are compared separately; the reference calibrator of costs; the port of a board; its timing profile, which cycles
    carry; the place, which only `hiltest doctor` reads; and accepted settings of sensors.
    """
    content = _conditions(rig)
    content["link"]["mode"] = "stub"  # a removed key, which preserves earlier digests
    return sha256(json.dumps(content, sort_keys=True, default=str).encode()).hexdigest()


def other_conditions(rig: Rig, other: Rig) -> str:
    """Return the first different key that numbers depend on, with both values; empty if all are equal."""
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
    conditions: dict[str, Any] = _drop_none(content)
    return conditions


def _drop_none(content: Any) -> Any:
    """Remove keys without a value, so that a key of a later version does not change digests."""
    if isinstance(content, dict):
        return {key: _drop_none(value) for key, value in content.items() if value is not None}
    return [_drop_none(row) for row in content] if isinstance(content, tuple) else content
