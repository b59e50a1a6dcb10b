"""Readings of a recording, which a board's sensors measure in place of the simulated truth and its noise."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum, StrEnum

import numpy as np
from numpy.typing import NDArray

from hiltest.state import Restorable
from hiltest.world.earth_field import Vector

Reals = NDArray[np.float64]


class Sensed(Enum):
    """What a sensor measures: its name, and the unit of its readings."""

    MAGNETOMETER = ("magnetometer", "uT")
    ACCELEROMETER = ("accelerometer", "g")
    GYROSCOPE = ("gyroscope", "dps")

    def __init__(self, key: str, unit: str) -> None:
        self.key = key
        self.unit = unit


class Resampling(StrEnum):
    """What a sample between two readings is: the nearest of them, the earlier one halfway, or on the line."""

    NEAREST = "nearest"
    LINEAR = "linear"


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """Readings of one sensor."""

    times_s: Reals
    """Shape (n,). Increasing; in a `Playback` virtual time since power-on [s]."""
    readings: Reals
    """Shape (n, 3). Body frame, in the unit of what is sensed; of an accelerometer gravity, +1 where down is."""


class Playback(Restorable):
    """A recording as it is played.

    Parameters
    ----------
    name
        Of the recording, for people.
    tracks
        What was recorded; other sensors measure the simulated world.
    notes
        What was skipped, recognised or assumed in the file, a sentence each.

    Notes
    -----
    Before the first reading of a sensor that one is held, and after the last one that.
    """

    def __init__(
        self, name: str, tracks: Mapping[Sensed, Track], resampling: Resampling = Resampling.NEAREST,
        notes: Sequence[str] = (),
    ) -> None:  # fmt: skip
        self.name = name
        self._notes = notes
        self.tracks = tracks
        self.resampling = resampling
        # Lists: a search in an array takes ten times as long, and there is one for each sample of a part.
        self._times = {sensed: track.times_s.tolist() for sensed, track in tracks.items()}
        self._latest_s: dict[str, float] = {}
        self._saturated: dict[tuple[str, str], int] = {}

    @property
    def begins_s(self) -> float:
        """Virtual time of its first reading [s]."""
        return min(float(track.times_s[0]) for track in self.tracks.values())

    @property
    def ends_s(self) -> float:
        """Virtual time of its last reading [s]."""
        return max(float(track.times_s[-1]) for track in self.tracks.values())

    def reading(self, sensed: Sensed, time_s: float) -> Vector | None:
        """Return what a sensor of the kind measures at an instant of its own; None where nothing was recorded."""
        track = self.tracks.get(sensed)
        if track is None:
            return None
        times = self._times[sensed]
        after = min(max(1, bisect_left(times, time_s)), len(times) - 1)
        before = max(0, after - 1)
        share = (time_s - times[before]) / (times[after] - times[before]) if after > before else 0.0
        share = min(max(0.0, share), 1.0)
        if self.resampling is Resampling.NEAREST:
            share = 1.0 if share > 0.5 else 0.0
        earlier, later = track.readings[before].tolist(), track.readings[after].tolist()
        pairs = zip(earlier, later, strict=True)
        x, y, z = (one + share * (other - one) if share < 1.0 else other for one, other in pairs)
        return (x, y, z)

    def taken(self, part: str, reading: Vector, time_s: float, *, limit: float, limit_words: str) -> None:
        """Note a sample that a part has taken, and whether an axis of it is beyond what the part measures."""
        if time_s <= self._latest_s.get(part, -1.0):
            return  # the part has converted this one before
        self._latest_s[part] = time_s
        if any(abs(each) > limit for each in reading):
            self._saturated[part, limit_words] = self._saturated.get((part, limit_words), 0) + 1

    def described(self) -> str:
        """Say what is played, and when."""
        tracks = ", ".join(
            f"{sensed.key} {len(track.times_s)} readings at {rate_hz(track):.3g} Hz"
            for sensed, track in self.tracks.items()
        )
        return (
            f"playing {self.name} from {self.begins_s:.3f} to {self.ends_s:.3f} s of virtual time, {self.resampling}: "
            f"{tracks}"
        )

    def remarks(self) -> list[str]:
        """Say what was assumed of the file, and what is not as recorded so far.

        That are sensors which are not in it, readings cut, or held after the end.
        """
        others = [sensed.key for sensed in Sensed if sensed not in self.tracks]
        said = [f"{self.name}: {note}" for note in self._notes]
        said += [f"{self.name}: no {' and no '.join(others)} in it: simulated, at rest"] if others else []
        said += [
            f"{self.name}: {count} samples of the {part} were beyond {limit} and are cut there"
            for (part, limit), count in self._saturated.items()
        ]
        latest_s = max(self._latest_s.values(), default=0.0)
        if latest_s > self.ends_s:
            said.append(
                f"{self.name}: over at {self.ends_s:.3f} s of virtual time; its last readings are held since, "
                f"{latest_s - self.ends_s:.3f} s so far"
            )
        return said


def rate_hz(track: Track) -> float:
    """Return the rate of a track's readings [Hz], by the median time between them; 0 of one alone."""
    return 1.0 / float(np.median(np.diff(track.times_s))) if len(track.times_s) > 1 else 0.0
