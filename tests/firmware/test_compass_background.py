"""The sample compass' calibration on this machine: which points it keeps, and what it does when the iron changes."""

from __future__ import annotations

import ctypes
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

Reals = NDArray[np.float64]

FIRMWARE = Path(__file__).parents[2] / "firmware_stub"
SOURCES = [
    "compass/background.c",
    *(
        f"calibration/{name}.c"
        for name in [
            "adjusted_moments",
            "closed_form",
            "direct",
            "fit_result",
            "moments",
            "normal_equations",
            "point_range",
            "quadric",
            "square_root",
        ]
    ),
]
SPACING, POINTS, A_MINUTE = 120.0, 256, 4800  # counts, points and samples, as in background.c
RADIUS, NOISE = 485.0, 4.0  # counts


class Background(ctypes.Structure):
    """`background_t` of compass.h."""

    _fields_ = (
        ("points", ctypes.c_int16 * 3 * POINTS),
        ("taken_at", ctypes.c_uint32 * POINTS),
        ("count", ctypes.c_uint32),
        ("changes", ctypes.c_uint32),
        ("samples", ctypes.c_uint32),
        ("hard_iron", ctypes.c_float * 3),
        ("soft_iron", ctypes.c_float * 9),
        ("strength", ctypes.c_float),
        ("error_percent", ctypes.c_float),
    )


@pytest.fixture(scope="module")
def library(require_tool: Callable[[str], str], tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    built = tmp_path_factory.mktemp("compass") / "background.so"
    options = [
        "-std=c11",
        "-O2",
        "-ffp-contract=off",
        "-fshort-enums",
        "-shared",
        "-fPIC",
        "-Wall",
        "-Wextra",
        "-Wconversion",
        "-Werror",
    ]
    # Undefined behaviour ends the process.
    options += ["-fsanitize=undefined,float-cast-overflow", "-fsanitize-undefined-trap-on-error"]
    sources = [str(FIRMWARE / source) for source in SOURCES]
    subprocess.run([require_tool("gcc"), *options, f"-I{FIRMWARE}", *sources, "-o", str(built), "-lm"], check=True)
    return ctypes.CDLL(str(built))


class Compass:
    """A compass in a field with some iron, turned at random."""

    def __init__(self, library: ctypes.CDLL) -> None:
        self._library = library
        self.strength = RADIUS
        self.state = Background(soft_iron=(1, 0, 0, 0, 1, 0, 0, 0, 1), error_percent=100.0)
        self.hard_iron: Reals = np.array([24.0, -22.0, 40.0])
        self._random = np.random.default_rng(3)

    def sample(self, direction: Reals) -> None:
        field = self.strength * direction / np.linalg.norm(direction)
        noisy = field + self.hard_iron + self._random.normal(0.0, NOISE, 3)
        self.take(np.rint(noisy).astype(np.int16))

    def take(self, counts: NDArray[np.int16]) -> None:
        self._library.background_take(ctypes.byref(self.state), (ctypes.c_int16 * 3)(*counts.tolist()))

    def turn(self, samples: int) -> None:
        for direction in self._random.normal(size=(samples, 3)):
            self.sample(direction)

    @property
    def points(self) -> Reals:
        return np.array(self.state.points, dtype=np.float64)[: self.state.count]

    @property
    def centre_error(self) -> float:
        return float(np.linalg.norm(np.array(self.state.hard_iron) - self.hard_iron))


@pytest.fixture
def compass(library: ctypes.CDLL) -> Compass:
    return Compass(library)


def test_points_lie_apart_and_cover_the_sphere(compass: Compass) -> None:
    compass.turn(3000)
    apart = np.linalg.norm(compass.points[:, None] - compass.points[None], axis=-1)
    assert apart[~np.eye(len(apart), dtype=bool)].min() >= SPACING
    directions = compass.points - compass.hard_iron
    # Nowhere on the sphere is a point further than the spacing and some noise: it would have been kept.
    others = np.random.default_rng(1).normal(size=(500, 3))
    others *= RADIUS / np.linalg.norm(others, axis=1, keepdims=True)
    assert np.linalg.norm(others[:, None] - directions[None], axis=-1).min(axis=1).max() < SPACING + 20.0


def test_a_calibration_comes_and_grows_better(compass: Compass) -> None:
    while compass.state.strength == 0.0:
        compass.turn(1)
    first = compass.state.count
    compass.turn(3000)
    assert compass.state.count > 2 * first
    assert compass.centre_error < 2.0  # of 485 counts, of which a degree is 8.5
    assert compass.state.strength == pytest.approx(RADIUS, rel=0.01)
    assert compass.state.error_percent == pytest.approx(100 * NOISE / RADIUS, rel=0.3)


@pytest.mark.parametrize("strength", [220.0, 670.0])
def test_it_works_in_the_weakest_and_the_strongest_field_of_the_earth(compass: Compass, strength: float) -> None:
    compass.strength = strength
    # As a product is turned: the sphere from one pole to the other, and not at random.
    for turned in np.linspace(0.0, 1.0, 2000):
        down, angle = 1.0 - 2.0 * turned, 60.0 * turned
        across = np.sqrt(1.0 - down * down)
        compass.sample(np.array([across * np.cos(angle), across * np.sin(angle), down]))
    assert compass.state.count < POINTS
    # Rms over clouds: the noise times the square root of 3 / n on each of three axes.
    assert compass.centre_error < 2.5 * 3.0 * NOISE / np.sqrt(compass.state.count)
    assert compass.state.strength == pytest.approx(strength, rel=0.02)


def test_turning_about_the_vertical_alone_calibrates_nothing(compass: Compass) -> None:
    for angle in np.linspace(0.0, 20.0 * np.pi, 4000):
        compass.sample(np.array([np.cos(angle), np.sin(angle), 1.9]))
    assert (compass.state.strength, list(compass.state.hard_iron)) == (0.0, [0.0, 0.0, 0.0])


@pytest.mark.parametrize("change", [400.0, 40.0])
def test_when_the_iron_changes_a_new_calibration_comes(compass: Compass, change: float) -> None:
    compass.turn(2000)
    compass.hard_iron = compass.hard_iron + np.array([change, 0.0, 0.0])
    compass.turn(2 * A_MINUTE)
    assert compass.centre_error < 3.0


def test_something_magnetic_that_passes_by_leaves_nothing(compass: Compass) -> None:
    compass.turn(300)
    compass.take(np.array([4000, 0, 0], dtype=np.int16))
    compass.turn(2000)
    assert compass.centre_error < 2.0


def test_no_samples_whatever_make_it_fail(compass: Compass) -> None:
    for counts in np.random.default_rng(2).integers(-32768, 32768, (3000, 3)):
        compass.take(counts.astype(np.int16))
    for counts in ([0, 0, 0], [32767] * 3, [-32768] * 3):
        for _ in range(200):
            compass.take(np.array(counts, dtype=np.int16))
    assert np.isfinite([*compass.state.hard_iron, *compass.state.soft_iron, compass.state.strength]).all()
