"""The attitude filter in two forms behind one interface: the float64 reference, and the firmware's C."""

from __future__ import annotations

import ctypes
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hiltest.orientation.attitude_filter import AttitudeFilter, AttitudeFilterStatus

from .filters import FIRMWARE, Vector, floats

FilterMaker = Callable[..., "AttitudeFilter | FirmwareFilter"]
ORIENTATION = FIRMWARE / "orientation"


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
    sources = [str(ORIENTATION / name) for name in ("attitude_filter.c", "fusion.c")]
    subprocess.run([gcc, *options, *warnings, f"-I{FIRMWARE}", *sources, "-o", str(library), "-lm"], check=True)
    loaded = ctypes.CDLL(str(library))
    for name in ("update", "turn", "correct"):
        getattr(loaded, f"attitude_filter_{name}").restype = ctypes.c_uint8
    return loaded
