"""Worlds with a known truth, in which calibrators are judged: samples, poses, and the bound of the heading error.

World k of a family is the same on every host, since all draws are those of `hiltest.studies.instances` and
`hiltest.world.noise`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np

from hiltest.calibration.fit import Array, FitStatus, MagnetometerFit
from hiltest.calibration.heading_bound import heading_bound
from hiltest.calibration.quality import sphere_directions
from hiltest.orientation.angles import Pose, rotation_body_from_ned
from hiltest.rig import Rig
from hiltest.rig.bench_files import DEFAULT_RIG, shipped
from hiltest.rig.rig_file import load_rig
from hiltest.studies.instances import Model, draw_instances
from hiltest.world.noise import NoiseSource

WORLDS = 100
"""Number of worlds in each family."""
RESOLUTION_UT = 0.1
"""Resolution of the samples, that of the MAG3110."""
_ACCELEROMETER_NOISE_G = 0.002
_READINGS = 16
_NOISE_UT, _POINTS, _STRETCH = 0.4, 100, 0.1
_TURN_RAD = math.pi * (3.0 - math.sqrt(5.0))  # the golden angle, so that the turns about the field are spread evenly
_WHOLE_SPHERE = 0.0


@dataclass(frozen=True, slots=True)
class Family:
    """A hundred worlds: one of the two default clouds, in which only the noise varies, or one condition varies."""

    name: str
    title: str
    noise_ut: tuple[float, float] = (_NOISE_UT, _NOISE_UT)
    """Noise of one axis of the first and of the last world [uT]; the logarithm is linear in between."""
    points: tuple[int, int] = (_POINTS, _POINTS)
    """Number of points of the first and of the last world, in the same way."""
    stretch: float = _STRETCH
    """Principal gains of the soft iron are uniform within 1 plus or minus this."""
    gap: tuple[float, float] = (_WHOLE_SPHERE, _WHOLE_SPHERE)
    """Share of the sphere that a cap without points takes in the first and in the last world; linear in between."""


RIG = "rig"
"""Default cloud of the default rig: its field, distortion, noise and number of points."""
HALF_SPHERE = "half-sphere"
"""Default cloud in which fits of norms differ: field and distortion of the rig, half the sphere, 1 uT, 300 points."""
DEFAULT_CLOUDS = (RIG, HALF_SPHERE)
FAMILIES = (
    Family(RIG, "the default rig: 100 points over the sphere, 0.4 uT"),
    Family("noise", "noise from 0.2 to 5 uT", noise_ut=(0.2, 5.0)),
    Family("coverage", "a cap without points, up to 70 % of the sphere", gap=(0.0, 0.7)),
    Family("soft-iron", "gains within 20 % of 1", stretch=0.2),
    Family("points", "12 to 1 000 points", points=(12, 1000)),
    Family(HALF_SPHERE, "300 points over half the sphere, 1 uT", (1.0, 1.0), (300, 300), gap=(0.5, 0.5)),
)


@dataclass(frozen=True, eq=False)
class Poses:
    """Known poses at which headings are judged, true vectors in the body frame (x forward, y right, z down)."""

    field_ut: Array
    """Shape (m, 3) [uT]."""
    gravity: Array
    """Shape (m, 3), unit vectors."""

    @cached_property
    def headings_deg(self) -> Array:
        """Return the true headings, shape (m,)."""
        return _headings_deg(self.field_ut, self.gravity)

    def heading_errors_deg(self, soft_iron: Array, hard_iron_ut: Array, readings_ut: Array) -> Array:
        """Return the heading errors of a calibration for the readings at the poses, shape (m, 3) [uT]."""
        corrected = (readings_ut - hard_iron_ut) @ soft_iron.T
        errors = _headings_deg(corrected, self.gravity) - self.headings_deg
        return np.asarray((errors + 180.0) % 360.0 - 180.0)


@dataclass(frozen=True, eq=False)
class World:
    """One world, and the truth about it."""

    family: str
    number: int
    samples_ut: Array
    """Shape (n, 3), body frame, at the sensor's resolution [uT]."""
    accelerations_g: Array
    """Shape (n, 3): gravity at each sample, as a unit vector with noise, positive down."""
    soft_iron: Array
    """Matrix from the field to the field at the sensor [1]; symmetric."""
    hard_iron_ut: Array
    noise_ut: float
    """rms of one axis of a sample, with that of its resolution [uT]."""
    poses: Poses

    @property
    def where(self) -> str:
        """Return the world for messages, such as ``in world noise/17``."""
        return f"in world {self.family}/{self.number}"

    @cached_property
    def clean_readings_ut(self) -> Array:
        """Return readings at the poses without noise, shape (m, 3) [uT]."""
        return np.asarray(self.poses.field_ut @ self.soft_iron.T + self.hard_iron_ut)

    @cached_property
    def readings_ut(self) -> Array:
        """Return readings at the poses, each the mean of 16 samples, shape (m, 3) [uT]."""
        deviation = self.noise_ut / math.sqrt(_READINGS)
        return self.clean_readings_ut + deviation * draw_noise(
            self.number, f"{self.family} poses", len(self.poses.gravity)
        )

    @cached_property
    def bound_deg(self) -> float:
        """Return the bound of the rms heading error of a fit to the norms of the samples."""
        strength_ut = float(np.linalg.norm(self.poses.field_ut[0]))
        to_unit = np.asarray(np.linalg.inv(self.soft_iron) / strength_ut, dtype=np.float64)
        truth = MagnetometerFit(FitStatus.ELLIPSOID, False, 0, to_unit, self.hard_iron_ut)
        return heading_bound(
            truth,
            self.samples_ut,
            field=self.poses.field_ut,
            gravity=self.poses.gravity,
            noise=self.noise_ut,
            readings=np.full(len(self.poses.gravity), _READINGS),
        ).fit_rms_deg


def draw_worlds(family: Family) -> Iterator[World]:
    """Draw the worlds of a family, in order."""
    for number in range(WORLDS):
        yield draw_world(family, number)


@cache
def draw_world(family: Family, number: int) -> World:
    """Draw one world of a family; it is drawn once for all entries.

    Parameters
    ----------
    number
        0 to `WORLDS` - 1.
    """
    rig = default_rig()
    assert rig.world is not None
    share = number / (WORLDS - 1)
    noise_ut = _between(family.noise_ut, share)
    points = round(_between(family.points, share))
    if family.name in DEFAULT_CLOUDS:
        soft_iron, hard_iron_ut = np.array(rig.world.soft_iron), np.array(rig.world.hard_iron_ut)
        directions = sphere_directions(points)
    else:
        model = Model(seed=FAMILIES.index(family), points=points, noise_ut=0.0, stretch=family.stretch, occluded=0.0)
        instance = draw_instances(model, number, 1)
        soft_iron, hard_iron_ut = instance.soft_iron[0], instance.hard_iron_ut[0]
        directions = np.linalg.solve(soft_iron, (instance.points_ut[0] - hard_iron_ut).T).T
        directions /= np.linalg.norm(directions, axis=1)[:, None]
    low, high = family.gap
    if high > _WHOLE_SPHERE:
        directions = _squeeze_out_of_cap(directions, low + (high - low) * share)
    noise = noise_ut * draw_noise(number, f"{family.name} samples", points)
    samples_ut = rig.field.strength_ut * directions @ soft_iron.T + hard_iron_ut + noise
    return World(
        family.name,
        number,
        np.rint(samples_ut / RESOLUTION_UT) * RESOLUTION_UT,
        _gravity(directions, rig.field.dip_deg)
        + _ACCELEROMETER_NOISE_G * draw_noise(number, f"{family.name} gravity", points),
        soft_iron,
        hard_iron_ut,
        math.hypot(noise_ut, RESOLUTION_UT / math.sqrt(12.0)),
        default_poses(),
    )


@cache
def default_rig() -> Rig:
    """Return the default rig of this installation."""
    return load_rig(shipped() / "rigs" / DEFAULT_RIG)


def earth_field_ut() -> Array:
    """Return the field of the default rig, shape (3,), north, east, down [uT]."""
    field = default_rig().field
    dip = math.radians(field.dip_deg)
    return np.asarray(field.strength_ut * np.array([math.cos(dip), 0.0, math.sin(dip)]))


@cache
def default_poses() -> Poses:
    """Return the poses of the default rig."""
    rig = default_rig()
    field = earth_field_ut()
    yaw_deg = rig.mounting.yaw_deg if rig.mounting else 0.0
    rotations = [
        rotation_body_from_ned(Pose(heading_deg + yaw_deg, pitch_deg, roll_deg))
        for pitch_deg, roll_deg in rig.procedure.tilts_deg
        for heading_deg in rig.procedure.headings_deg
    ]
    return Poses(np.array([rotation @ field for rotation in rotations]), np.array([rot[:, 2] for rot in rotations]))


def _between(ends: tuple[float, float], share: float) -> float:
    low, high = ends
    return float(low * (high / low) ** share)


def _squeeze_out_of_cap(directions: Array, gap: float) -> Array:
    """Return directions moved out of a cap about x that takes a share of the sphere."""
    # Equal areas have equal heights (Archimedes): heights are squeezed into the part that is left.
    height = (directions[:, 0] + 1.0) * (1.0 - gap) - 1.0
    across = np.hypot(directions[:, 1], directions[:, 2])
    radius = np.sqrt(np.maximum(1.0 - height**2, 0.0))
    return np.column_stack([height, directions[:, 1:] * (radius / np.maximum(across, 1e-12))[:, None]])


def _gravity(directions: Array, dip_deg: float) -> Array:
    """Return gravity at field directions: at an angle of 90 degrees less the dip to the field, turned about it."""
    beside = np.eye(3)[np.abs(directions).argmin(axis=1)]
    first = np.cross(directions, beside)
    first /= np.linalg.norm(first, axis=1)[:, None]
    second = np.cross(directions, first)
    turns = _TURN_RAD * np.arange(len(directions))
    across = np.cos(turns)[:, None] * first + np.sin(turns)[:, None] * second
    dip = math.radians(dip_deg)
    return np.asarray(math.sin(dip) * directions + math.cos(dip) * across)


def draw_noise(seed: int, source: str, count: int) -> Array:
    """Return standard normal numbers of a named source, shape (count, 3)."""
    noise = NoiseSource(seed, f"judge {source}")
    return np.array([noise.sample(0, index) for index in range(count)])


def _headings_deg(field: Array, gravity: Array) -> Array:
    """Return tilt-compensated headings, shape (m,), clockwise from north."""
    east = np.cross(gravity, field)
    north = np.cross(east, gravity)
    return np.degrees(np.arctan2(east[:, 0], north[:, 0]))
