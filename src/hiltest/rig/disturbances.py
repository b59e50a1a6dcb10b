"""The tables ``[world.current]``, ``[world.passing]`` and ``[world.cable]``: disturbances of the field over time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

from hiltest.rig.toml_tables import StrictTable, Triple, require

if TYPE_CHECKING:
    from hiltest.world.disturbances import Cable, Current, Passing

_LONGEST_S = 1e6
_MOST_ROWS = 10_000
# Nearest distance at which a wire may count as a line, and a magnet as a dipole.
_NEAREST_CABLE_M = 0.005
_NEAREST_MAGNET_M = 0.1
# Largest moment: an airliner has 1e4 A m2, and is detectable at a hundred metres.
_LARGEST_AM2 = 1e6
_FARTHEST_M = 1e5
_FASTEST_MPS = 1e3
_LARGEST_A = 1e5

Row = tuple[float, float]
Place = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True)
class CurrentTable(StrictTable):
    """A current on the board, such as a motor's: see `hiltest.world.disturbances.Current`."""

    field_ut_per_a: Triple
    waveform: tuple[Row, ...]
    repeat_s: float | None = None

    def __post_init__(self) -> None:
        _check_times("waveform", self.waveform)
        require(
            all(abs(current_a) <= _LARGEST_A for _, current_a in self.waveform),
            "waveform",
            f"must be within {_LARGEST_A:g} A",
        )
        lasts_s = self.waveform[-1][0] - self.waveform[0][0]
        require(
            self.repeat_s is None or max(lasts_s, 1e-3) <= self.repeat_s <= _LONGEST_S,
            "repeat_s",
            f"must be at least the {lasts_s:g} s of the waveform, and 0.001 to {_LONGEST_S:g}",
        )

    @property
    def largest_ut(self) -> float:
        """Strongest field that it produces [uT]."""
        return math.hypot(*self.field_ut_per_a) * max(abs(current_a) for _, current_a in self.waveform)

    @property
    def begins_s(self) -> float:
        """Time of its first change [s]."""
        return _first_change_s(self.waveform)

    def make_disturbance(self) -> Current:
        """Return the disturbance for the world."""
        from hiltest.world.disturbances import Current

        return Current(self.field_ut_per_a, self.waveform, self.repeat_s)


@dataclass(frozen=True, slots=True)
class CableTable(StrictTable):
    """A long straight cable that is moved: see `hiltest.world.disturbances.Cable`."""

    current_a: float
    direction: Triple
    places: tuple[Place, ...]

    def __post_init__(self) -> None:
        require(abs(self.current_a) <= _LARGEST_A, "current_a", f"must be within {_LARGEST_A:g} A")
        require(1e-3 <= math.hypot(*self.direction) <= 1e3, "direction", "must have a length of 0.001 to 1000")
        _check_times("places", self.places)
        require(
            all(math.hypot(*place) <= _FARTHEST_M for _, *place in self.places),
            "places",
            f"must be within {_FARTHEST_M:g} m",
        )
        require(
            self._nearest_m >= _NEAREST_CABLE_M,
            "places",
            f"leads the cable past a part at {1e3 * self._nearest_m:.3g} mm, at least {1e3 * _NEAREST_CABLE_M:g} "
            "are needed: it would lie in the part",
        )

    @property
    def _nearest_m(self) -> float:
        across = [_across(place, self.direction) for _, *place in self.places]
        moves = [_from_origin_m(begin, end) for begin, end in pairwise(across)]
        return min([math.hypot(*vector) for vector in across] + moves)

    @property
    def largest_ut(self) -> float:
        """Upper bound of its field minus that at its first position [uT]."""
        from hiltest.world.disturbances import WIRE_UT_M_PER_A

        first_m = math.hypot(*_across(self.places[0][1:], self.direction))
        return WIRE_UT_M_PER_A * abs(self.current_a) * (1.0 / self._nearest_m + 1.0 / first_m)

    @property
    def begins_s(self) -> float:
        """Time of its first motion [s]."""
        return _first_change_s(self.places)

    def make_disturbance(self) -> Cable:
        """Return the disturbance for the world."""
        from hiltest.world.disturbances import Cable

        return Cable(self.current_a, self.direction, self.places)


@dataclass(frozen=True, slots=True)
class PassingTable(StrictTable):
    """A magnet that passes, such as a car: see `hiltest.world.disturbances.Passing`."""

    moment_am2: Triple
    place_m: Triple
    velocity_mps: Triple
    at_s: float

    def __post_init__(self) -> None:
        require(math.hypot(*self.moment_am2) <= _LARGEST_AM2, "moment_am2", f"must be within {_LARGEST_AM2:g} A m2")
        require(math.hypot(*self.place_m) <= _FARTHEST_M, "place_m", f"must be within {_FARTHEST_M:g} m")
        require(
            1e-3 <= math.hypot(*self.velocity_mps) <= _FASTEST_MPS,
            "velocity_mps",
            f"must be 0.001 to {_FASTEST_MPS:g} m/s: a static source is part of [field]",
        )
        require(0.0 <= self.at_s <= _LONGEST_S, "at_s", f"must be 0 to {_LONGEST_S:g}")
        require(
            self.nearest_m >= _NEAREST_MAGNET_M,
            "place_m",
            f"leads it past at {self.nearest_m:.3g} m; at less than {_NEAREST_MAGNET_M:g} m a magnet is no dipole",
        )

    @property
    def nearest_m(self) -> float:
        """Closest distance [m]."""
        return math.hypot(*_across(self.place_m, self.velocity_mps))

    @property
    def largest_ut(self) -> float:
        """Upper bound of its field: on its axis at the closest point [uT]."""
        from hiltest.world.disturbances import DIPOLE_UT_M3_PER_AM2

        return 2.0 * DIPOLE_UT_M3_PER_AM2 * math.hypot(*self.moment_am2) / self.nearest_m**3

    @property
    def begins_s(self) -> float:
        """Time of the approach at which the source is one closest distance away from the closest point [s]."""
        speed_mps = math.hypot(*self.velocity_mps)
        ahead_m = sum(place * speed for place, speed in zip(self.place_m, self.velocity_mps, strict=True)) / speed_mps
        return self.at_s - (ahead_m + 2.0 * self.nearest_m) / speed_mps

    def make_disturbance(self) -> Passing:
        """Return the disturbance for the world."""
        from hiltest.world.disturbances import Passing

        return Passing(self.moment_am2, self.place_m, self.velocity_mps, self.at_s)


def _check_times(key: str, rows: Sequence[Sequence[float]]) -> None:
    require(1 <= len(rows) <= _MOST_ROWS, key, f"needs 1 to {_MOST_ROWS} rows of a time and a value")
    times_s = [row[0] for row in rows]
    require(times_s[0] >= 0.0 and times_s[-1] <= _LONGEST_S, key, f"has times from 0 to {_LONGEST_S:g} s")
    require(
        all(before <= after for before, after in pairwise(times_s)),
        key,
        "goes back in time: each row needs the time of the row before, for a step, or a later one",
    )


def _first_change_s(rows: Sequence[Sequence[float]]) -> float:
    return next((before[0] for before, after in pairwise(rows) if before[1:] != after[1:]), math.inf)


def _across(vector: Sequence[float], direction: Sequence[float]) -> list[float]:
    """Return the part of a vector at right angles to a direction."""
    share = sum(a * b for a, b in zip(vector, direction, strict=True)) / sum(c * c for c in direction)
    return [a - share * b for a, b in zip(vector, direction, strict=True)]


def _from_origin_m(begin: Sequence[float], end: Sequence[float]) -> float:
    """Return the closest distance of a straight move to the origin."""
    way = [b - a for a, b in zip(begin, end, strict=True)]
    square = sum(component * component for component in way)
    gone = -sum(a * b for a, b in zip(begin, way, strict=True)) / square if square else 0.0
    share = min(max(gone, 0.0), 1.0)
    return math.hypot(*(a + share * b for a, b in zip(begin, way, strict=True)))
