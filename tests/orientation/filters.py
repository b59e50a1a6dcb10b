"""The fusion filter in two forms behind one interface, and motions to give it."""

from __future__ import annotations

import ctypes
import math
import subprocess
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hiltest.orientation.fusion import FusionNoise
from hiltest.orientation.quaternions import from_rotation_vector, rotation_ned_from_body
from hiltest.virtual.board.k64f import VirtualK64F

from . import fusion_matrices
from .fusion_matrices import IDENTITY, FusionStatus, product

FIRMWARE = Path(__file__).parents[2] / "firmware_stub"
SOURCE = FIRMWARE / "orientation" / "fusion.c"
Vector = Sequence[float] | NDArray[np.float64]


class Reference:
    """The matrices of the thesis, in float64."""

    def __init__(self, noise: FusionNoise, attitude: Vector = IDENTITY) -> None:
        self._noise = noise
        self._state = fusion_matrices.start(attitude, noise)

    @property
    def attitude(self) -> NDArray[np.float64]:
        return self._state.attitude

    @property
    def covariance(self) -> NDArray[np.float64]:
        return self._state.covariance

    @property
    def sigmas_deg(self) -> NDArray[np.float64]:
        return self._state.standard_deviations_deg()

    def predict(self, rate_dps: Vector, dt_s: float) -> FusionStatus:
        self._state, status = fusion_matrices.predict(self._state, rate_dps, dt_s, self._noise)
        return status

    def update(self, gravity_g: Vector, field: Vector) -> FusionStatus:
        self._state, status = fusion_matrices.update(self._state, gravity_g, field, self._noise)
        return status


class _State(ctypes.Structure):
    _fields_ = (("attitude", ctypes.c_float * 4), ("tilt", ctypes.c_float), ("heading", ctypes.c_float))


class Firmware:
    """The firmware's C, compiled for this machine: float32, and no matrix."""

    def __init__(self, library: ctypes.CDLL, noise: FusionNoise, attitude: Vector = IDENTITY) -> None:
        self._library = library
        self._noise = noise_floats(noise)
        self._state = _State()
        library.fusion_predict.argtypes = [ctypes.c_void_p] * 3 + [ctypes.c_float]
        library.fusion_start(ctypes.byref(self._state), self._noise, floats(attitude))

    @property
    def attitude(self) -> NDArray[np.float64]:
        return np.array(list(self._state.attitude))

    @property
    def sigmas_deg(self) -> NDArray[np.float64]:
        variances = [self._state.tilt, self._state.tilt, self._state.heading]
        return np.degrees(np.sqrt(variances))

    @property
    def raw(self) -> bytes:
        return bytes(self._state)

    def predict(self, rate_dps: Vector, dt_s: float) -> FusionStatus:
        rate = floats([math.radians(value) for value in rate_dps])
        return FusionStatus(self._library.fusion_predict(ctypes.byref(self._state), self._noise, rate, dt_s))

    def update(self, gravity_g: Vector, field: Vector) -> FusionStatus:
        vectors = floats(gravity_g), floats(field)
        return FusionStatus(self._library.fusion_update(ctypes.byref(self._state), self._noise, *vectors))


class OnBoard(Firmware):
    """The shipped firmware's, called on a virtual board that did not boot."""

    def __init__(self, board: VirtualK64F, noise: FusionNoise, attitude: Vector = IDENTITY) -> None:
        noise_t = noise_floats(noise)
        _, tilt_variance, heading_variance, _ = noise_t
        self._board, self._noise_bytes = board, bytes(noise_t)
        # As fusion_start() does, which may be part of its only caller.
        self._bytes = bytearray(floats([*attitude, tilt_variance, heading_variance]))

    @property
    def _state(self) -> _State:
        return _State.from_buffer_copy(self._bytes)

    def predict(self, rate_dps: Vector, dt_s: float) -> FusionStatus:
        rate = bytes(floats([math.radians(value) for value in rate_dps]))
        return self._call("fusion_predict", rate, dt_s)

    def update(self, gravity_g: Vector, field: Vector) -> FusionStatus:
        return self._call("fusion_update", bytes(floats(gravity_g)), bytes(floats(field)))

    def _call(self, function: str, *arguments: bytes | float) -> FusionStatus:
        return FusionStatus(self._board.call(function, self._bytes, self._noise_bytes, *arguments).value)


Filter = Reference | Firmware
FilterMaker = Callable[..., Filter]


def floats(values: Vector) -> ctypes.Array[ctypes.c_float]:
    return (ctypes.c_float * len(values))(*map(float, values))


def noise_floats(noise: FusionNoise) -> ctypes.Array[ctypes.c_float]:
    """fusion_noise_t."""
    squares = [math.radians(item) ** 2 for item in (noise.rate_dps_rthz, noise.tilt_deg, noise.heading_deg)]
    return floats([*squares, noise.gate_g])


def build(gcc: str, folder: Path) -> ctypes.CDLL:
    """Compile the firmware's filter. Undefined behaviour ends the process: nothing a test draws may cause any."""
    library = folder / "fusion.so"
    options = [
        "-std=c11",
        "-O2",
        "-ffp-contract=off",
        "-fno-math-errno",
        "-fshort-enums",
        "-shared",
        "-fPIC",
        "-fsanitize=undefined,float-cast-overflow",
        "-fsanitize-undefined-trap-on-error",
    ]
    warnings = ["-Wall", "-Wextra", "-Wconversion", "-Wdouble-promotion", "-Werror"]
    subprocess.run([gcc, *options, *warnings, f"-I{FIRMWARE}", str(SOURCE), "-o", str(library), "-lm"], check=True)
    loaded = ctypes.CDLL(str(library))
    for name in ("fusion_triad", "fusion_predict", "fusion_update"):
        getattr(loaded, name).restype = ctypes.c_uint8
    return loaded


@dataclass(frozen=True)
class Motion:
    """What perfect sensors on a turning body would see, rates constant within each step."""

    dt_s: float
    attitudes: NDArray[np.float64]  # (n + 1, 4), at the ends of the steps
    rates_dps: NDArray[np.float64]  # (n, 3)
    gravity_g: NDArray[np.float64]  # (n, 3), at the end of each step
    field: NDArray[np.float64]  # (n, 3)


def swaying_motion(seconds: float, *, hz: float = 100.0, dip_deg: float = 60.0, seed: int = 1) -> Motion:
    """Some tens of degrees a second about all axes, there and back and round."""
    generator = np.random.default_rng(seed)
    times = np.arange(round(seconds * hz)) / hz
    rates = np.zeros((len(times), 3))
    for axis in range(3):
        for frequency_hz in generator.uniform(0.02, 0.4, 3):
            rates[:, axis] += 20.0 * np.sin(2 * np.pi * (frequency_hz * times + generator.uniform()))
    dip = math.radians(dip_deg)
    attitudes = [np.array(IDENTITY)]
    for rate in rates:
        attitudes.append(product(attitudes[-1], from_rotation_vector(np.radians(rate) / hz)))
    to_body = [rotation_ned_from_body(attitude).T for attitude in attitudes[1:]]
    north_and_down = np.array([math.cos(dip), 0.0, math.sin(dip)])
    return Motion(
        1.0 / hz,
        np.array(attitudes),
        rates,
        np.array([turn[:, 2] for turn in to_body]),
        np.array([turn @ north_and_down for turn in to_body]),
    )
