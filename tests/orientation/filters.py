"""The attitude filter in two forms behind one interface, the float64 reference and the firmware's C, and motions."""

from __future__ import annotations

import ctypes
import math
import subprocess
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hiltest.orientation.attitude_filter import AttitudeFilter, AttitudeFilterStatus
from hiltest.orientation.quaternions import rotation_ned_from_body

from .quaternion_algebra import from_rotation_vector, product

FIRMWARE = Path(__file__).parents[2] / "firmware_stub"
ORIENTATION = FIRMWARE / "orientation"
Vector = Sequence[float] | NDArray[np.float64]
FilterMaker = Callable[..., "AttitudeFilter | FirmwareFilter"]


def floats(values: Vector) -> ctypes.Array[ctypes.c_float]:
    return (ctypes.c_float * len(values))(*map(float, values))


class FilterState(ctypes.Structure):
    """attitude_filter_t."""

    _fields_ = (
        ("attitude", ctypes.c_float * 4),
        ("bias_rad_s", ctypes.c_float * 3),
        ("tilt_rate", ctypes.c_float * 2),
        ("field", ctypes.c_float * 2),
        ("age_s", ctypes.c_float),
        ("uncorrected_s", ctypes.c_float),
        ("started", ctypes.c_bool),
    )


class FirmwareFilter:
    """The firmware's C in float32, compiled for this machine."""

    def __init__(self, library: ctypes.CDLL, bias_rad_s: Vector = (0.0, 0.0, 0.0)) -> None:
        self._library = library
        self.state = FilterState()
        library.attitude_filter_init(ctypes.byref(self.state), floats(bias_rad_s))

    @property
    def attitude(self) -> NDArray[np.float64]:
        copy = floats([0.0] * 4)
        self._library.attitude_filter_attitude(ctypes.byref(self.state), copy)
        return np.array(list(copy))

    def update(self, rate_rad_s: Vector, gravity_g: Vector, field: Vector, dt_s: float) -> AttitudeFilterStatus:
        vectors = floats(rate_rad_s), floats(gravity_g), floats(field)
        return AttitudeFilterStatus(
            self._library.attitude_filter_update(ctypes.byref(self.state), *vectors, ctypes.c_float(dt_s))
        )

    def turn(self, rate_rad_s: Vector, dt_s: float) -> AttitudeFilterStatus:
        return AttitudeFilterStatus(
            self._library.attitude_filter_turn(ctypes.byref(self.state), floats(rate_rad_s), ctypes.c_float(dt_s))
        )

    def correct(self, gravity_g: Vector, field: Vector) -> AttitudeFilterStatus:
        return AttitudeFilterStatus(
            self._library.attitude_filter_correct(ctypes.byref(self.state), floats(gravity_g), floats(field))
        )


def build(gcc: str, folder: Path) -> ctypes.CDLL:
    """Compile the firmware's filter. Undefined behaviour ends the process: nothing a test draws may cause any."""
    library = folder / "attitude_filter.so"
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
    sources = [str(ORIENTATION / name) for name in ("attitude_filter.c", "triad.c")]
    subprocess.run([gcc, *options, *warnings, f"-I{FIRMWARE}", *sources, "-o", str(library), "-lm"], check=True)
    loaded = ctypes.CDLL(str(library))
    for name in ("update", "turn", "correct"):
        getattr(loaded, f"attitude_filter_{name}").restype = ctypes.c_uint8
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
    attitudes = [np.array([0.0, 0.0, 0.0, 1.0])]
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
