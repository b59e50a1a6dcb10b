"""Readings of a recording, which a board's sensors measure instead of the simulated truth and its noise."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum, StrEnum

import numpy as np
from numpy.typing import NDArray

from hiltest.orientation.motion_recording import MotionRecording
from hiltest.state import Restorable
from hiltest.world.earth_field import Vector

Reals = NDArray[np.float64]


class Sensed(Enum):
    """Measured quantity of a sensor: its name, and the unit of its readings."""

    MAGNETOMETER = ("magnetometer", "uT")
    ACCELEROMETER = ("accelerometer", "g")
    GYROSCOPE = ("gyroscope", "dps")

    def __init__(self, key: str, unit: str) -> None:
        self.key = key
        self.unit = unit


class Resampling(StrEnum):
    """Interpolation between two readings: the nearest one, the earlier one halfway between, or linear."""

    NEAREST = "nearest"
    LINEAR = "linear"


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """Readings of one sensor."""

    times_s: Reals
    """Shape (n,). Increasing times; in a `Playback` virtual time since power-on [s]."""
    readings: Reals
    """Shape (n, 3). Readings in the body frame, in the quantity's unit; for an accelerometer gravity, +1 for down."""


class Playback(Restorable):
    """A recording during its playback.

    Parameters
    ----------
    name
        Name of the recording, for people.
    tracks
        Recorded sensors; other sensors measure the simulated world.
    notes
        Remarks on skipped, recognised or assumed content of the file, one sentence each.
    motion
        The recording with its true attitudes, if it has any.

    Notes
    -----
    The first and last readings of a sensor extend before and after the recording.
    """

    def __init__(
        self,
        name: str,
        tracks: Mapping[Sensed, Track],
        resampling: Resampling = Resampling.NEAREST,
        notes: Sequence[str] = (),
        motion: MotionRecording | None = None,
    ) -> None:
        self.name = name
        self.motion = motion
        self._notes = notes
        self.tracks = tracks
        self.resampling = resampling
        # Lists, because a search in an array takes ten times as long, and each sample of a part needs one.
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
        """Return the reading of a sensor of the kind at its sampling instant; None if it was not recorded."""
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
        """Register a sample that a part has taken, and whether one of its axes exceeds the part's range."""
        if time_s <= self._latest_s.get(part, -1.0):
            return  # the part has already converted this sample
        self._latest_s[part] = time_s
        if any(abs(component) > limit for component in reading):
            self._saturated[part, limit_words] = self._saturated.get((part, limit_words), 0) + 1

    def described(self) -> str:
        """Describe the recording and its time."""
        tracks = ", ".join(
            f"{sensed.key} {len(track.times_s)} readings at {rate_hz(track):.3g} Hz"
            for sensed, track in self.tracks.items()
        )
        return (
            f"playing {self.name} from {self.begins_s:.3f} to {self.ends_s:.3f} s of virtual time, {self.resampling}: "
            f"{tracks}"
        )

    def remarks(self) -> list[str]:
        """Return remarks on assumptions about the file, and on deviations from it so far.

        Deviations are missing sensors, clipped readings, and readings held after the end.
        """
        others = [sensed.key for sensed in Sensed if sensed not in self.tracks]
        texts = [f"{self.name}: {note}" for note in self._notes]
        texts += [f"{self.name}: no {' and no '.join(others)} in it: simulated, at rest"] if others else []
        texts += [
            f"{self.name}: {count} samples of the {part} were beyond {limit} and are cut there"
            for (part, limit), count in self._saturated.items()
        ]
        latest_s = max(self._latest_s.values(), default=0.0)
        if latest_s > self.ends_s:
            texts.append(
                f"{self.name}: over at {self.ends_s:.3f} s of virtual time; its last readings are held since, "
                f"{latest_s - self.ends_s:.3f} s so far"
            )
        return texts


def rate_hz(track: Track) -> float:
    """Return the rate of a track's readings [Hz], by the median time between them; 0 for a single one."""
    return 1.0 / float(np.median(np.diff(track.times_s))) if len(track.times_s) > 1 else 0.0
