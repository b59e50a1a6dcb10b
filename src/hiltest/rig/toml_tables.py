"""The tables of a rig file, each a dataclass that refuses values out of range; `hiltest.rig.world` has the world's.

They are plain dataclasses, so that a rig can be used without pydantic; `hiltest.rig.rig_file` validates a file against
them with pydantic.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, Literal, TypeAlias

from hiltest.measurement.sensor_registers import names_setting

if TYPE_CHECKING:
    from hiltest.orientation.angles import Pose

Triple: TypeAlias = tuple[float, float, float]
Axes: TypeAlias = tuple[str, str, str]
"""Axes of a chip along x, y and z of the body, such as ``-y``."""

# Configuration of pydantic: no unknown keys, no conversions (an integer is a valid float).
STRICT: dict[str, Any] = {"extra": "forbid", "strict": True, "allow_inf_nan": False}

# Minimum number of points of the firmware: its fit against gravity refuses fewer as TOO_FEW_POINTS.
DPI_PAIRS_MINIMUM = 300

_LONGEST_RUN_S = 1e6
# Pins of the processor, as a pattern and in words, by `BoardPlace.machine`.
_NUMBER = "([0-9]|[12][0-9]|3[01])"
_PINS: dict[str | None, tuple[str, str]] = {
    None: (f"PT[A-E]{_NUMBER}", "PTA0 to PTE31"),
    "frdm-k64f": (f"PT[A-E]{_NUMBER}", "PTA0 to PTE31"),
    "microbit-v1": (rf"P0\.{_NUMBER}", "P0.0 to P0.31"),
}
_OTHER_PINS = r"P[A-K]([0-9]|1[0-5])", "PA0 to PK15"


class RigValueError(ValueError):
    """Error for a value of the rig that is out of range."""

    def __init__(self, key: str, message: str) -> None:
        self.key = key
        super().__init__(message)


class StrictTable:
    """Base of the tables, which pydantic reads by `STRICT`."""

    __slots__ = ()
    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT


def number_of_points(calibration: str) -> int | None:
    """Return the 100 of ``direct@100``; None for other names."""
    written = re.fullmatch(r"[a-z0-9_-]+@([1-9][0-9]*)", calibration)
    return int(written[1]) if written else None


def require(holds: bool, key: str, message: str) -> None:
    if not holds:
        raise RigValueError(key, message)


def check_axes(axes: Axes | None) -> None:
    """Refuse axes that are not x, y and z in some order; None means none."""
    require(
        axes is None or sorted(axis.removeprefix("-") for axis in axes) == ["x", "y", "z"],
        "axes",
        'must be x, y and z in some order, each with its sign, such as ["-y", "x", "z"]',
    )


def axes_matrix(axes: Axes) -> tuple[tuple[float, ...], ...]:
    """Return the matrix from a chip's axes to the body's."""
    signs = [(-1.0 if axis.startswith("-") else 1.0, axis[-1]) for axis in axes]
    return tuple(tuple(sign * (name == other) for other in "xyz") for sign, name in signs)


def check_span(after_s: float, for_s: float | None = None) -> None:
    """Refuse a start or duration that no run reaches; None means for good."""
    require(0.0 <= after_s <= _LONGEST_RUN_S, "after_s", f"must be 0 to {_LONGEST_RUN_S:g}")
    require(for_s is None or 0.0 < for_s <= _LONGEST_RUN_S, "for_s", f"must be above 0 and at most {_LONGEST_RUN_S:g}")


@dataclass(frozen=True, slots=True)
class BoardPlace(StrictTable):
    """The board on the link: the virtual one, or one on a port."""

    kind: Literal["virtual", "real"]
    machine: str | None = None
    """Board that a virtual one imitates: ``frdm-k64f``, ``microbit-v1``, ``stm32f411-disco``, or a machine file ending
    in ``.toml``, relative to the rig's. None is ``frdm-k64f``."""
    port: str | None = None
    cycle_model: str | None = None
    """Cycle model of a board on a port: ``silicon-dwt``, or the timing profile of a virtual board that is served there.
    It is needed if the port does not show it."""
    timing: str | None = None
    """Timing profile of a virtual board: its name, or a file ending in ``.toml``, relative to the rig's. None is the
    default profile."""
    firmware: str | None = None
    """Firmware of a virtual board if the command line names none: a file, relative to the rig's, or the name of one in
    the package. None is hiltest's own."""

    def __post_init__(self) -> None:
        require(self.kind == "virtual" or self.machine is None, "machine", 'belongs to a board of kind "virtual"')
        require(self.kind == "virtual" or self.timing is None, "timing", 'belongs to a board of kind "virtual"')
        require(self.kind == "virtual" or self.firmware is None, "firmware", 'belongs to a board of kind "virtual"')
        require(self.kind == "real" or self.port is None, "port", 'belongs to a board of kind "real"')
        require(self.kind == "real" or self.cycle_model is None, "cycle_model", 'belongs to a board of kind "real"')
        require(
            self.cycle_model is None or re.fullmatch(r"[a-z0-9/.+-]+", self.cycle_model) is not None,
            "cycle_model",
            'is "silicon-dwt", or the name of a timing profile such as "cortex-m4-trm/3"',
        )


@dataclass(frozen=True, slots=True)
class LinkSettings(StrictTable):
    """Settings of the link."""

    baud: int = 115_200

    def __post_init__(self) -> None:
        require(self.baud > 0, "baud", "must be above 0")


# The axes of the FXOS8700CQ stop at 1200 uT, and a compass needs room for hard iron.
_STRONGEST_FIELD_UT = 1000.0


@dataclass(frozen=True, slots=True)
class LocalField(StrictTable):
    """The earth's field at the bench: total intensity, dip (down positive), declination (east positive)."""

    strength_ut: float
    dip_deg: float
    declination_deg: float = 0.0
    latitude_deg: float | None = None
    longitude_deg: float | None = None
    """Position of the bench, north and east positive: `hiltest doctor` compares the field with the World Magnetic
    Model."""
    altitude_m: float = 0.0
    """Height above sea level."""

    def __post_init__(self) -> None:
        place = {"latitude_deg": (self.latitude_deg, 90.0), "longitude_deg": (self.longitude_deg, 180.0)}
        for key, (value, most) in place.items():
            require(value is None or abs(value) <= most, key, f"must be within -{most:g} to {most:g}")
        require(
            (self.latitude_deg is None) == (self.longitude_deg is None),
            "longitude_deg",
            "and latitude_deg need each other: write both, or neither",
        )
        # Range of the World Magnetic Model.
        require(-1_000.0 <= self.altitude_m <= 850_000.0, "altitude_m", "must be within -1000 to 850000")
        require(self.strength_ut > 0.0, "strength_ut", "must be above 0")
        require(
            self.strength_ut <= _STRONGEST_FIELD_UT,
            "strength_ut",
            f"must be at most {_STRONGEST_FIELD_UT:g}: the Earth's field has 22 to 67 uT, and {self.strength_ut:g} nT "
            f"are {self.strength_ut / 1000.0:g} uT",
        )
        require(abs(self.dip_deg) < 90.0, "dip_deg", "must be within -90 to 90, since headings are undefined at a pole")
        require(abs(self.declination_deg) <= 180.0, "declination_deg", "must be within -180 to 180")


@dataclass(frozen=True, slots=True)
class Mounting(StrictTable):
    """Mounting of the board on the table: board heading = table heading + yaw, known to +-uncertainty (k = 2)."""

    yaw_deg: float
    uncertainty_deg: float

    def __post_init__(self) -> None:
        require(abs(self.yaw_deg) <= 180.0, "yaw_deg", "must be within -180 to 180")
        require(self.uncertainty_deg >= 0.0, "uncertainty_deg", "must not be negative")


@dataclass(frozen=True, slots=True)
class Faces(StrictTable):
    """Uncertainty of the six faces of the board: largest angle between a face and its axis [deg]."""

    uncertainty_deg: float

    def __post_init__(self) -> None:
        require(0.0 < self.uncertainty_deg <= 5.0, "uncertainty_deg", "must be above 0 and at most 5")


# Forty times the density of the supported part; the stillness test then allows 19 deg/s in a window of 0.1 s.
_NOISIEST_MDPS = 1000.0


@dataclass(frozen=True, slots=True)
class SensorPart(StrictTable):
    """A part of ``[[sensors.parts]]``, which is fitted besides those of ``world.fitted``."""

    part: str
    """Name of its model: of hiltest, or of an entry point. A part of the same name in ``world.fitted`` is replaced."""
    name: str | None = None
    """Name on this board, for a second part of one kind; the default is `part`."""
    bus: Literal["i2c0", "i2c1", "spi0", "spi1", "spi2"] = "i2c1"
    address: int | None = None
    """7-bit address on an I2C bus; None for the part's first."""
    chip_select: str | None = None
    """Pin of the processor that selects it on an SPI bus, such as ``PTD0``."""
    companion_address: int | None = None
    companion_chip_select: str | None = None
    """Address and chip select of the further device in its package; None for the model's first address."""
    interrupts: dict[str, str] = field(default_factory=dict)
    """Pins of the processor by pins of the part, such as ``DRDY = "PTB9"``."""
    axes: Axes | None = None
    """Axes of the part along x, y and z of the board, such as ``-y``."""
    magnetometer_noise_ut: float | None = None
    accelerometer_noise_mg: float | None = None
    gyroscope_noise_dps: float | None = None
    """rms noise of one axis of one sample at all settings; None for the data sheet's."""
    magnetometer_offset_ut: Triple | None = None
    accelerometer_offset_mg: Triple | None = None
    gyroscope_bias_dps: Triple | None = None
    """Offsets of this part, body frame, besides those of ``[world]``."""
    magnetometer_offset_ut_per_degc: Triple | None = None
    magnetometer_gain_percent_per_degc: Triple | None = None
    """Drift of the magnetometer above 25 degC, body frame; None for the data sheet's."""

    def __post_init__(self) -> None:
        check_axes(self.axes)
        is_spi = self.bus.startswith("spi")
        require(
            is_spi == (self.chip_select is not None), "chip_select", "belongs to a part on an SPI bus, and only there"
        )
        other = self.companion_chip_select
        require(is_spi or other is None, "companion_chip_select", "belongs to a part on an SPI bus, and only there")
        require(other is None or other != self.chip_select, "companion_chip_select", "is the part's own chip_select")
        for key in ("address", "companion_address"):
            address = getattr(self, key)
            require(not is_spi or address is None, key, "belongs to a part on an I2C bus: leave it out")
            require(address is None or 0x08 <= address <= 0x77, key, "must be 0x08 to 0x77, seven bits")
        for key in ("magnetometer_noise_ut", "accelerometer_noise_mg", "gyroscope_noise_dps"):
            noise = getattr(self, key)
            require(noise is None or noise >= 0.0, key, "must not be negative")

    def check_pins(self, machine: str | None, place: str) -> None:
        """Refuse pins that the processor of a board does not have; `place` is the entry's key."""
        pattern, words = _PINS.get(machine, _OTHER_PINS)
        select, companion_select = [self.chip_select], [self.companion_chip_select]
        for key, pins in (
            ("chip_select", select),
            ("companion_chip_select", companion_select),
            ("interrupts", [*self.interrupts.values()]),
        ):
            strangers = [pin for pin in pins if pin is not None and not re.fullmatch(pattern, pin)]
            message = f"names no pin of the processor: {', '.join(strangers)}; write {words}"
            require(not strangers, f"{place}.{key}", message)


@dataclass(frozen=True, slots=True)
class SensorChoice(StrictTable):
    """The sensors under test, and the declared noise of the magnetometer."""

    magnetometer_noise_ut: float
    """rms noise of one axis of one reading; a fit's residual is compared with it."""
    gyroscope_noise_mdps_per_rthz: float = 25.0
    """One-sided noise density of the rate, from the data sheet, for the test of stillness."""
    magnetometer: str | None = None
    accelerometer: str | None = None
    gyroscope: str | None = None
    """Names as in the board's identity; None for the first that answers."""
    accepted_settings: tuple[str, ...] = ()
    """Settings that the firmware may make although the models of the parts do not carry them out."""
    axes: Axes | None = None
    """Axes of the magnetometer's chip along x, y and z of the board, such as ``-y``, if firmware that reports by itself
    gives raw readings and calibration along the chip's axes."""
    parts: tuple[SensorPart, ...] | None = None
    """Fitted parts besides those of ``world.fitted``."""

    @property
    def chip_to_body(self) -> tuple[tuple[float, ...], ...] | None:
        """Matrix from the chip's axes to the board's; None without `axes`."""
        return None if self.axes is None else axes_matrix(self.axes)

    def __post_init__(self) -> None:
        check_axes(self.axes)
        strangers = [text for text in self.accepted_settings if not names_setting(text)]
        require(
            not strangers,
            "accepted_settings",
            f"names {strangers}; name part, register and value as a run does, such as 'FXAS21002C CTRL_REG0 0x04'",
        )
        require(self.magnetometer_noise_ut >= 0.0, "magnetometer_noise_ut", "must not be negative")
        require(
            0.0 < self.gyroscope_noise_mdps_per_rthz <= _NOISIEST_MDPS,
            "gyroscope_noise_mdps_per_rthz",
            f"must be above 0 and at most {_NOISIEST_MDPS:g}: more noise hides the motion of a hand",
        )


@dataclass(frozen=True, slots=True)
class CoveredPart(StrictTable):
    """Part of the sphere in which a simulated tumble keeps the field.

    Notes
    -----
    A direction is covered when the *true* field, seen in the body frame, comes from it during the tumble. Soft iron
    also moves the measured points; hard iron, which shifts them all, has no effect. A pose is inside if the field's
    direction in it is: with a dip of 62 degrees the field is 28 degrees from body z on a level board, and at most 48
    with 20 degrees of pitch or roll.
    """

    axis: Triple
    """Middle of the part, body frame, of any length: (0, 0, 1) is down, the side of the field on a level board in the
    northern hemisphere."""
    fraction: float
    """Share of the sphere's area: 0.5 is the half around the axis, all within ``acos(1 - 2 fraction)`` of it."""

    def __post_init__(self) -> None:
        require(any(self.axis), "axis", "must not be zero, since it is a direction")
        require(0.0 < self.fraction <= 1.0, "fraction", "must be above 0 and at most 1, the whole sphere")


@dataclass(frozen=True, slots=True)
class TurntableSettings(StrictTable):
    """The turntable that sets a known angle, and its uncertainty [deg]."""

    kind: Literal["simulated", "operator", "grbl"]
    uncertainty_deg: float
    """Expanded uncertainty of its angle, coverage factor 2."""
    tumble_s: float = 45.0
    """Duration of an operator's tumble."""
    port: str | None = None
    """Device or pyserial URL of a motor table with Grbl."""
    fewest_poses: bool | None = None
    """True to measure known angles only until every limit of a heading is decided."""
    covered: CoveredPart | None = None
    """Part of the sphere for a simulated tumble; None for the whole sphere."""
    tumble_poses_deg: tuple[Triple, ...] | None = None
    """Poses of the table (heading, pitch, roll) that a simulated tumble visits in equal times, instead of the sphere:
    the motion that the firmware asks for."""

    def __post_init__(self) -> None:
        require(self.uncertainty_deg >= 0.0, "uncertainty_deg", "must not be negative")
        require(0.0 < self.tumble_s <= 600.0, "tumble_s", "must be above 0 and at most 600")
        require(
            (self.kind == "grbl") == (self.port is not None),
            "port",
            'requires a turntable of kind "grbl"',
        )
        require(
            self.kind == "simulated" or self.covered is None,
            "covered",
            'requires a turntable of kind "simulated"',
        )
        require(
            self.tumble_poses_deg is None or (self.kind == "simulated" and self.covered is None),
            "tumble_poses_deg",
            'requires a turntable of kind "simulated" without covered',
        )
        require(
            self.tumble_poses_deg is None or len(self.tumble_poses_deg) > 1,
            "tumble_poses_deg",
            "needs at least two poses",
        )


@dataclass(frozen=True, slots=True)
class Procedure(StrictTable):
    """The points and poses of a run."""

    headings_deg: tuple[float, ...]
    """Table headings of the known angles."""
    tilts_deg: tuple[tuple[float, float], ...]
    """Tilts of the known angles, each measured at every heading."""
    poses: Literal["all", "level"] = "all"
    """Set of known angles, unless the command line selects one."""
    readings_per_pose: int = 16
    calibration_points: int = 100
    """Number of points of the tumble, which every calibrator of the firmware receives."""
    tumble_points: int = 300
    gyroscope_rest_s: float = 2.0
    """Length of a rest of the gyroscope, before and after a turn."""
    gyroscope_turn_dps: float = 60.0
    """Rate of the table for the gyroscope: 36 to 90, a turn in 10 to 4 s."""
    accelerometer_calibration: Literal["none", "six-position"] = "none"
    """Accelerometer calibration before all headings: none, or the six faces, a second each, fitted on the board."""
    untrimmed_calibrations: tuple[str, ...] = ()
    """Calibrations that are also measured without the accelerometer's: ``direct`` as ``direct-untrimmed``."""
    dpi: Literal["pairs", "none"] = "pairs"
    """True if the magnetometer is also calibrated against gravity, on all pairs of the tumble."""
    gyroscope_calibration: Literal["rest", "turns"] = "turns"
    """Extent of `hiltest calibrate`: the bias only, or turns about all three axes for scale and axes too."""
    further_calibrations: tuple[str, ...] = ()
    """Further runs with the same measurements, each a calibrator and its number of points: ``direct@100``."""
    cost_reference: str = ""
    """Reference calibrator, of which costs are given as multiples; empty for none."""

    def __post_init__(self) -> None:
        require(len(self.headings_deg) >= 4, "headings_deg", "needs at least 4 headings for a worst sector")
        headings_deg = [heading % 360.0 for heading in self.headings_deg]
        for key, values in (("headings_deg", headings_deg), ("tilts_deg", self.tilts_deg)):
            require(len(set(values)) == len(values), key, "repeats a value, whose errors would count twice")
        require((0.0, 0.0) in self.tilts_deg, "tilts_deg", "must contain the level one, [0, 0]")
        require(
            all(abs(pitch) < 90.0 for pitch, _ in self.tilts_deg),
            "tilts_deg",
            "must keep pitch within -90 to 90, where heading is unique",
        )
        require(1 <= self.readings_per_pose <= 512, "readings_per_pose", "must be 1 to 512, as the firmware averages")
        require(self.calibration_points >= 9, "calibration_points", "must be at least 9, the unknowns of an ellipsoid")
        require(
            self.calibration_points <= self.tumble_points <= 512,
            "tumble_points",
            "must be from calibration_points to 512, what the firmware stores",
        )
        require(
            self.dpi == "none" or self.tumble_points >= DPI_PAIRS_MINIMUM,
            "tumble_points",
            f"must be at least {DPI_PAIRS_MINIMUM}, the pairs that the calibration against gravity needs: write "
            'tumble_points = 300, or dpi = "none" beside it to go without',
        )
        require(2.0 <= self.gyroscope_rest_s <= 20.0, "gyroscope_rest_s", "must be 2 to 20")
        require(36.0 <= self.gyroscope_turn_dps <= 90.0, "gyroscope_turn_dps", "must be 36 to 90")
        require(
            self.accelerometer_calibration != "none" or not self.untrimmed_calibrations,
            "untrimmed_calibrations",
            "requires an accelerometer_calibration other than none",
        )
        for written in self.further_calibrations:
            points = number_of_points(written)
            require(
                points is not None and 9 <= points <= self.tumble_points,
                "further_calibrations",
                f"names {written!r}; write a calibrator and its points, 9 to tumble_points, such as direct@100",
            )

    def known_angle_poses(self, which: Literal["all", "level"] | None = None) -> tuple[Pose, ...]:
        """Return the poses of the known angles in order: tilt by tilt, as listed."""
        from hiltest.orientation.angles import Pose

        level_only = (which or self.poses) == "level"
        tilts = [tilt for tilt in self.tilts_deg if not level_only or tilt == (0.0, 0.0)]
        return tuple(Pose(heading, pitch, roll) for pitch, roll in tilts for heading in self.headings_deg)
