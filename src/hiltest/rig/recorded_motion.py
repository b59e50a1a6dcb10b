"""The table ``[world.playback]``: a recording that a virtual board's sensors measure instead of the world."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import Literal

from hiltest.measurement.units import conversion, unit_words
from hiltest.rig.toml_tables import StrictTable, require

#: The sensors of a recording, and the units of their converted readings.
UNITS = {"magnetometer": "uT", "accelerometer": "g", "gyroscope": "dps"}
_UNIT = re.compile(r"(?:(?P<factor>[0-9.]+(?:[eE][-+]?[0-9]+)?)\s+)?(?P<word>\S+)")
_AXIS = re.compile(r"[-+]?[xyz]")


@dataclass(frozen=True, slots=True)
class PlayedSensor(StrictTable):
    """Columns, unit and axes of a sensor's readings in a recording."""

    columns: tuple[str, str, str] | None = None
    """Names of the columns, or numbers from 1; None to recognise them by their names."""
    unit: str | None = None
    """Unit of the numbers, with a factor for counts: ``0.1 uT``; None for the unit in the columns' names."""
    axes: str = "x y z"
    """Body axes x (forward), y (right) and z (down), by the sensor's own: ``-y -x -z``. An accelerometer reads
    gravity then, +1 for down: ``-x -y -z`` for one with the body's orientation that shows +1 g on the upward axis."""

    def __post_init__(self) -> None:
        words = self.axes.split()
        require(
            all(map(_AXIS.fullmatch, words)) and sorted(word[-1] for word in words) == ["x", "y", "z"],
            "axes",
            f"{self.axes!r} must be x, y and z in any order, with a minus for the opposite direction, such as "
            "'-y -x -z'",
        )

    @property
    def signed_axes(self) -> tuple[tuple[int, int], ...]:
        """Sensor's axis, 0 to 2, and its sign, for each axis of the body."""
        return tuple(("xyz".index(word[-1]), -1 if word[0] == "-" else 1) for word in self.axes.split())


@dataclass(frozen=True, slots=True)
class PlaybackFile(StrictTable):
    """A recording and its playback; in the file a recording without further keys may be a string."""

    file: str
    """Path of a table of readings, or of a stream of NXP's packets; relative to the rig's folder."""
    start_s: float | None = None
    """Virtual time from power-on of its first reading; None for 3, or for the own time of a virtual board's ``hiltest
    log``."""
    resampling: Literal["nearest", "linear"] = "nearest"
    """Interpolation between two readings."""
    time: str | None = None
    """Column of time, by name or number; None to recognise it by its name."""
    rate_hz: float | None = None
    """Rate of a table without a column of time."""
    magnetometer: PlayedSensor = field(default_factory=PlayedSensor)
    accelerometer: PlayedSensor = field(default_factory=PlayedSensor)
    gyroscope: PlayedSensor = field(default_factory=PlayedSensor)

    def __post_init__(self) -> None:
        require(bool(self.file), "file", "has no recording")
        require(self.start_s is None or 0.0 <= self.start_s <= 3600.0, "start_s", "must be 0 to 3600")
        require(self.rate_hz is None or 0.01 <= self.rate_hz <= 1e5, "rate_hz", "must be 0.01 to 100000")
        require(self.rate_hz is None or self.time is None, "rate_hz", "excludes time: leave one of them out")
        for sensor, unit in UNITS.items():
            written_unit = self.sensor(sensor).unit
            require(
                written_unit is None or factor_of(written_unit, unit) is not None,
                sensor,
                f"unit {written_unit!r} is none of {', '.join(unit_words(unit))}; a factor may stand before it, "
                f"such as '0.1 {unit}'",
            )

    def sensor(self, key: str) -> PlayedSensor:
        """Return the settings of a sensor of `UNITS`."""
        return {"magnetometer": self.magnetometer, "accelerometer": self.accelerometer, "gyroscope": self.gyroscope}[
            key
        ]


def factor_of(written: str, unit: str) -> float | None:
    """Return the factor from a unit such as ``0.1 uT`` to another; None if they are incompatible."""
    matched = _UNIT.fullmatch(written.strip())
    convert = conversion(matched["word"], unit) if matched else None
    if matched is None or convert is None or convert.factor == 0.0:
        return None
    try:
        return float(matched["factor"] or 1.0) * convert.factor or None
    except ValueError:
        return None


def as_table(world: object) -> object:
    """Return the table of a file with a string for a playback replaced by a table."""
    if not isinstance(world, dict) or not isinstance(world.get("playback"), str):
        return world
    return {**world, "playback": {"file": world["playback"]}}
