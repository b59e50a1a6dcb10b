"""Generator of the thesis' calibration problems, with bit-identical results in C and in numpy.

Instance k of a model is a function of (seed, stream, points, k): Philox 4x64-10 (Salmon et al., SC'11) with a counter,
so that workers can share the instances arbitrarily. Angles and noise come from tables with 65 536 intervals; the noise
table is that of `hiltest.world.noise`, with variance .99998 and kurtosis 2.9991, up to 4.3 sigma. All other operations
are + - * / and sqrt, which IEEE 754 rounds uniquely.
"""

from __future__ import annotations

import ctypes
import math
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hiltest.calibration.direct_batch import QuadricBatch, fit_quadrics
from hiltest.calibration.fit import Array, MagnetometerFit
from hiltest.calibration.quality import COUNTS_PER_UT, direction_error_rms_deg, sphere_directions
from hiltest.calibration.sphere import fit_sphere
from hiltest.virtual.core.c_library import INSTANCES_KERNEL, SOURCES, compiled, loaded
from hiltest.world.noise import normal_quantiles

_PARTS = 1 << 16
_QUARTER_TURN = _PARTS // 4
_GRID = 1 << 30  # resolution of cosines, coarser than the differences between mathematical libraries
_DIRECTIONS = sphere_directions(200)
_PARAMETER_COUNTERS = 3
_AT_ONCE = 4096  # instances that numpy processes at a time: 100 MB with 1000 points

Words = NDArray[np.uint64]


@dataclass(frozen=True, slots=True)
class Model:
    """Distribution of instances: ``m = R Q diag Q' b + e + n`` (Mucciaccia, eq. 1)."""

    seed: int
    """Seed, 0 to 2**64 - 1."""
    points: int
    """Points of each instance."""
    noise_ut: float
    """Standard deviation of n on each axis, added after the distortion [uT]."""
    stream: int = 0
    """Instances of two streams are independent of each other."""
    stretch: float = 0.5
    """Soft iron: the eigenvalues are uniform in 1 +- stretch, and the axes Q are a random rotation [1]."""
    occluded: float = 0.5
    """The directions b omit a cap about a random axis; the cap's share of the sphere is uniform from 0 to this [1]."""
    hard_iron_ut: float = 100.0
    """The components of e are uniform from minus to plus this [uT]."""
    field_ut: float = 50.0
    """Field strength R [uT]."""


@dataclass(frozen=True, slots=True, eq=False)
class Instances:
    """Points, and the true parameters."""

    points_ut: Array
    """Measured field [uT], body frame; shape (m, n, 3)."""
    soft_iron: Array
    """Matrix from the earth's field to the field at the sensor [1]; shape (m, 3, 3)."""
    hard_iron_ut: Array
    """Hard iron [uT], body frame; shape (m, 3)."""

    def set_hard_iron(self, length_ut: float) -> Instances:
        """Return the instances with hard iron of the same directions, and one length."""
        hard_iron_ut = length_ut * self.hard_iron_ut / np.linalg.norm(self.hard_iron_ut, axis=-1, keepdims=True)
        return replace(
            self, points_ut=self.points_ut + (hard_iron_ut - self.hard_iron_ut)[:, None], hard_iron_ut=hard_iron_ut
        )

    def counts(self, k: int) -> Array:
        """Return the points of instance k in counts of 0.1 uT, as a sensor reads them, shape (n, 3)."""
        return np.asarray(np.rint(COUNTS_PER_UT * self.points_ut[k]))

    def direction_error_deg(self, k: int, fit: MagnetometerFit, field_ut: float) -> float:
        """Return the rms angle over the sphere between noiseless readings corrected by a fit and the truth [deg]."""
        readings = COUNTS_PER_UT * (field_ut * _DIRECTIONS @ self.soft_iron[k] + self.hard_iron_ut[k])
        return direction_error_rms_deg(fit, readings, _DIRECTIONS)


class _KernelModel(ctypes.Structure):
    """``struct model`` of instances_kernel.c."""

    _fields_ = (
        *((name, ctypes.c_uint64) for name in ("seed", "stream", "points")),
        *((name, ctypes.c_double) for name in ("field", "hard_iron", "stretch", "occluded", "noise")),
        ("quantiles", ctypes.c_void_p),
        ("cosines", ctypes.c_void_p),
    )


@cache
def cosines() -> Array:
    """Return the cosines at the middles of 65 536 parts of a turn, rounded to 2**-30."""
    return np.array([round(math.cos(2 * math.pi * (k + 0.5) / _PARTS) * _GRID) / _GRID for k in range(_PARTS)])


def counted_fit(fit: MagnetometerFit, points: Array) -> MagnetometerFit:
    """Return a fit whose error a study counts: the sphere of the points, shape (n, 3), if the fit was refused."""
    return fit if fit.has_fit else fit_sphere(points)


def draw_instances(model: Model, first: int, count: int) -> Instances:
    """Draw instances `first` to ``first + count - 1`` of a model."""
    parameters, points, heights = _words(model, first, count)
    unit = (parameters >> np.uint64(11)).astype(np.float64) * 2.0**-53
    axes, cap = _rotations(parameters[7]), _rotations(parameters[8])
    e = (1.0 - model.stretch) + (2.0 * model.stretch) * unit[:3]
    iron = [
        [
            axes[i][0] * e[0] * axes[j][0] + axes[i][1] * e[1] * axes[j][1] + axes[i][2] * e[2] * axes[j][2]
            for j in range(3)
        ]
        for i in range(3)
    ]
    hard = 2.0 * model.hard_iron_ut * unit[3:6] - model.hard_iron_ut
    span = 2.0 - 2.0 * (model.occluded * unit[6])

    z = span[:, None] * ((heights + 0.5) * 2.0**-32) - 1.0
    r = np.sqrt(1.0 - z * z)
    part = (points >> np.uint64(48)).astype(np.intp)
    x, y = r * cosines()[part], r * cosines()[(part - _QUARTER_TURN) % _PARTS]
    points_ut = np.empty((count, model.points, 3))
    for i in range(3):
        a, b, c = (
            (model.field_ut * (iron[i][0] * cap[0][j] + iron[i][1] * cap[1][j] + iron[i][2] * cap[2][j]))[:, None]
            for j in range(3)
        )
        draws = (points >> np.uint64(16 * i) & np.uint64(0xFFFF)).astype(np.intp)
        points_ut[..., i] = a * x + b * y + c * z + hard[i][:, None] + model.noise_ut * normal_quantiles()[draws]
    return Instances(points_ut, np.moveaxis(np.array(iron), -1, 0), hard.T)


def _words(model: Model, first: int, count: int) -> tuple[Words, Words, Array]:
    """Return the words of parameters, shape (12, m), and those of points and 32-bit heights, shape (m, n) each."""
    point_counters, height_counters = -(-model.points // 4), -(-model.points // 8)
    counters = _PARAMETER_COUNTERS + point_counters + height_counters
    # numpy increments the counter before it draws, so word 0 of instance k has the counter k * counters + 1.
    start = np.array([first * counters, model.stream, model.points, 0], dtype=np.uint64)
    bits = np.random.Philox(counter=start, key=np.array([model.seed, 0], dtype=np.uint64))
    words = bits.random_raw(4 * counters * count).reshape(count, 4 * counters)
    parts = np.split(words, [4 * _PARAMETER_COUNTERS, 4 * (_PARAMETER_COUNTERS + point_counters)], axis=1)
    halves = np.stack([parts[2] & np.uint64(0xFFFFFFFF), parts[2] >> np.uint64(32)], axis=-1)
    heights = halves.reshape(count, 8 * height_counters)[:, : model.points].astype(np.float64)
    return parts[0].T, parts[1][:, : model.points], heights


def _rotations(words: Words) -> list[list[Array]]:
    """Return uniformly distributed rotations as rows of entries, each of shape (m,)."""
    shifts = (words >> np.uint64(16 * k) & np.uint64(0xFFFF) for k in range(4))
    w, x, y, z = (normal_quantiles()[shift.astype(np.intp)] for shift in shifts)
    norm = np.sqrt(w * w + x * x + y * y + z * z)
    w, x, y, z = w / norm, x / norm, y / norm, z / norm
    return [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]


def non_ellipsoids(model: Model, first: int, count: int) -> int:
    """Count the instances whose least-squares quadric is not an ellipsoid, in numpy."""
    total = 0
    for start in range(first, first + count, _AT_ONCE):
        points_ut = draw_instances(model, start, min(_AT_ONCE, first + count - start)).points_ut
        total += int(np.count_nonzero(~fit_quadrics(points_ut).is_ellipsoid))
    return total


class Kernel:
    """The same functions in C: `instances_kernel.c`."""

    def __init__(self, library: ctypes.CDLL) -> None:
        self._library = library
        library.hiltest_non_ellipsoids.restype = ctypes.c_int64

    def points_ut(self, model: Model, first: int, count: int) -> Array:
        """Return the same points as `draw_instances`, shape (m, n, 3) [uT]."""
        points = np.empty((count, model.points, 3))
        kernel_model = _kernel_model(model)
        self._library.hiltest_draw(
            ctypes.byref(kernel_model), *_uint64(first, count), points.ctypes.data_as(ctypes.c_void_p)
        )
        return points

    def fit_quadrics(self, points: Array) -> QuadricBatch:
        """Fit points, shape (m, n, 3), as `fit_quadrics`."""
        contiguous = np.ascontiguousarray(points, dtype=np.float64)
        rows = np.empty((len(contiguous), 13))
        places = (contiguous.ctypes.data_as(ctypes.c_void_p), *_uint64(len(contiguous), contiguous.shape[1]))
        if self._library.hiltest_fit(*places, rows.ctypes.data_as(ctypes.c_void_p)) < 0:
            raise MemoryError(f"no memory for {contiguous.shape[1]} points")
        return QuadricBatch(rows[:, :9].reshape(-1, 3, 3), rows[:, 9:12], rows[:, 12])

    def non_ellipsoids(self, model: Model, first: int, count: int) -> int:
        """Count the instances whose least-squares quadric is not an ellipsoid."""
        kernel_model = _kernel_model(model)
        total = int(self._library.hiltest_non_ellipsoids(ctypes.byref(kernel_model), *_uint64(first, count)))
        if total < 0:
            raise MemoryError(f"no memory for {model.points} points")
        return total


@cache
def kernel() -> tuple[Kernel | None, str]:
    """Return the kernel in C, which is compiled if necessary, or the reason why it is missing."""
    sources = SOURCES[INSTANCES_KERNEL]
    library, reason = loaded(INSTANCES_KERNEL, sources)
    if library is None and not (reason := compiled(INSTANCES_KERNEL, sources)):
        library, reason = loaded(INSTANCES_KERNEL, sources)
    return (None, reason) if library is None else (Kernel(library), "")


def _kernel_model(model: Model) -> _KernelModel:
    # The pointers stay valid, because the functions cache both tables.
    tables: tuple[Any, ...] = (normal_quantiles().ctypes.data, cosines().ctypes.data)
    return _KernelModel(
        model.seed,
        model.stream,
        model.points,
        model.field_ut,
        model.hard_iron_ut,
        model.stretch,
        model.occluded,
        model.noise_ut,
        *tables,
    )


def _uint64(*numbers: int) -> list[ctypes.c_uint64]:
    return [ctypes.c_uint64(number) for number in numbers]
