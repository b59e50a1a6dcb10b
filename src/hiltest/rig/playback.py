"""The table ``[world.playback]``: a recording that the sensors of a virtual board measure in place of the world."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

from hiltest.rig.tables import STRICT, require
from hiltest.units import conversion, unit_words

#: The sensors of a recording, and the units that their readings are taken to.
UNITS = {"magnetometer": "uT", "accelerometer": "g", "gyroscope": "dps"}
_UNIT = re.compile(r"(?:(?P<factor>[0-9.]+(?:[eE][-+]?[0-9]+)?)\s+)?(?P<word>\S+)")
_AXIS = re.compile(r"[-+]?[xyz]")


@dataclass(frozen=True, slots=True)
class PlayedSensor:
    """Where the readings of a sensor are in a recording, and what they mean."""

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT
    columns: tuple[str, str, str] | None = None
    """Names of the columns, or numbers from 1. None: those whose names say so."""
    unit: str | None = None
    """Unit of the numbers, with a factor where they are counts: ``0.1 uT``. None: the one in the columns' names."""
    axes: str = "x y z"
    """Body axes x (forward), y (right) and z (down), by the sensor's own: ``-y -x -z``. An accelerometer reads
    gravity then, +1 where down is: ``-x -y -z`` for one that lies as the body does and shows +1 g on the axis that
    is up."""

    def __post_init__(self) -> None:
        words = self.axes.split()
        require(all(map(_AXIS.fullmatch, words)) and sorted(word[-1] for word in words) == ["x", "y", "z"], "axes",
                f"{self.axes!r} must be each of x, y and z once, with a sign where it points the other way, such as "
                "'-y -x -z'")

    @property
    def signed_axes(self) -> tuple[tuple[int, int], ...]:
        """For each axis of the body the sensor's axis, 0 to 2, and its sign."""
        return tuple(("xyz".index(word[-1]), -1 if word[0] == "-" else 1) for word in self.axes.split())


@dataclass(frozen=True, slots=True)
class PlaybackFile:
    """A recording, and how it is played; in the file a recording that needs no more is written as a string."""

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT
    file: str
    """A table of readings, or a stream of NXP's packets; relative to the rig's folder."""
    start_s: float | None = None
    """Virtual time from power-on at which its first reading is. None: 3, and for a log of a virtual board by
    ``hiltest log`` its own."""
    resampling: Literal["nearest", "linear"] = "nearest"
    """What a part's sample between two readings is."""
    time: str | None = None
    """Column of time, by name or number; None: the one whose name says so."""
    rate_hz: float | None = None
    """Of a table without a column of time."""
    magnetometer: PlayedSensor = field(default_factory=PlayedSensor)
    accelerometer: PlayedSensor = field(default_factory=PlayedSensor)
    gyroscope: PlayedSensor = field(default_factory=PlayedSensor)

    def __post_init__(self) -> None:
        require(bool(self.file), "file", "names no recording")
        require(self.start_s is None or 0.0 <= self.start_s <= 3600.0, "start_s", "must be 0 to 3600")
        require(self.rate_hz is None or 0.01 <= self.rate_hz <= 1e5, "rate_hz", "must be 0.01 to 100000")
        require(self.rate_hz is None or self.time is None, "rate_hz", "excludes time: one of them says the times")
        for sensor, unit in UNITS.items():
            given = self.sensor(sensor).unit
            require(given is None or factor_of(given, unit) is not None, sensor,
                    f"unit {given!r} is none of {', '.join(unit_words(unit))}; a factor may stand before it, "
                    f"such as '0.1 {unit}'")

    def sensor(self, key: str) -> PlayedSensor:
        """Return what is said of a sensor of `UNITS`."""
        return {"magnetometer": self.magnetometer, "accelerometer": self.accelerometer,
                "gyroscope": self.gyroscope}[key]


def factor_of(written: str, unit: str) -> float | None:
    """Return what one of a unit such as ``0.1 uT`` is in another; None when it is none of that."""
    matched = _UNIT.fullmatch(written.strip())
    known = conversion(matched["word"], unit) if matched else None
    if matched is None or known is None or known.factor == 0.0:
        return None
    try:
        return float(matched["factor"] or 1.0) * known.factor or None
    except ValueError:
        return None


def as_table(world: object) -> object:
    """Return the table of a file with a table for a playback that names the recording alone."""
    if not isinstance(world, dict) or not isinstance(world.get("playback"), str):
        return world
    return {**world, "playback": {"file": world["playback"]}}
