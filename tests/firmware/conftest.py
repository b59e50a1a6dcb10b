"""Two ways to run the firmware's calibrators: compiled for this machine, and on the virtual board."""

from __future__ import annotations

import ctypes
import struct
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray

import hiltest
from hiltest.calibration import FitStatus, MagnetometerFit
from hiltest.virtual.board.k64f import VirtualK64F
from hiltest.virtual.calls.calling import CallResult

from .bench import COSTS_BY
from .streams import BoardStream, HostStream, Stream

FIRMWARE = Path(__file__).parents[2] / "firmware_stub"
CALIBRATION = FIRMWARE / "calibration"
CALIBRATORS = (
    "direct",
    "direct-fast",
    "corrected",
    "iterative",
    "inverse-iteration",
    "li",
    "gauss-newton",
    "gradient-descent",
)
PROGRAMS = Path(__file__).parent / "programs"
SHIPPED_ELF = Path(hiltest.__file__).parent / "firmware" / "hiltest-frdm-k64f.elf"

# magnetometer_fit_t, the same on both: -fshort-enums on the host is what the target's ABI does.
FIT = struct.Struct("<BBH13f")


def _function(calibrator: str) -> str:
    return f"magnetometer_{calibrator.replace('-', '_')}"


def _unpack_fit(packed: bytes) -> MagnetometerFit:
    status, is_sphere, iterations, *floats = FIT.unpack(packed)
    soft_iron, hard_iron = np.array(floats[:9]).reshape(3, 3), np.array(floats[9:12])
    return MagnetometerFit(FitStatus(status), bool(is_sphere), iterations, soft_iron, hard_iron, floats[12])


def _prepare(
    points: ArrayLike, iterations: int = 0, low: ArrayLike | None = None, high: ArrayLike | None = None
) -> tuple[NDArray[np.int16], bytes]:
    """Return the points as the firmware stores them, and what follows their address in magnetometer_points_t."""
    counts = np.ascontiguousarray(points, dtype="<i2")
    low = map(int, counts.min(axis=0) if low is None else np.asarray(low))
    high = map(int, counts.max(axis=0) if high is None else np.asarray(high))
    return counts, struct.pack("<H6hH", len(counts), *low, *high, iterations)


class HostCalibrators:
    """The calibration sources as a shared library of this machine."""

    def __init__(self, library: ctypes.CDLL) -> None:
        self._library = library

    def calibrate(
        self,
        name: str,
        points: ArrayLike,
        *,
        iterations: int = 0,
        low: ArrayLike | None = None,
        high: ArrayLike | None = None,
    ) -> MagnetometerFit:
        """Calibrate; `low` and `high` stand for the points' range."""
        counts, rest = _prepare(points, iterations, low, high)
        fit = ctypes.create_string_buffer(FIT.size)
        getattr(self._library, _function(name))(struct.pack("P", counts.ctypes.data) + rest, fit)
        return _unpack_fit(fit.raw)

    def moments(self, points: ArrayLike, anchor: list[int]) -> list[float]:
        counts, rest = _prepare(points)
        sums = (ctypes.c_float * 35)()
        self._library.moments_sum(struct.pack("P", counts.ctypes.data) + rest, (ctypes.c_int32 * 3)(*anchor), sums)
        return list(sums)


class BoardCalibrators:
    """The shipped firmware's calibrators, called on a virtual board that did not boot."""

    # In SRAM_U behind everything the image uses, below the stack.
    POINTS, ARGUMENT, ANCHOR, RESULT = 0x20020000, 0x20028000, 0x20028020, 0x20028040

    def __init__(self, board: VirtualK64F) -> None:
        self._board = board
        end = max(segment.run_address + segment.run_size for segment in board.image.segments)
        assert end <= self.POINTS

    def _place(self, points: ArrayLike, iterations: int = 0) -> None:
        counts, rest = _prepare(points, iterations)
        memory = self._board.processor.memory
        memory.write(self.POINTS, counts.tobytes())
        memory.write(self.ARGUMENT, struct.pack("<I", self.POINTS) + rest)

    def cost(self, name: str, points: ArrayLike, *, iterations: int = 0) -> CallResult:
        self._place(points, iterations)
        return self._board.call(_function(name), self.ARGUMENT, self.RESULT)

    def calibrate(self, name: str, points: ArrayLike) -> MagnetometerFit:
        self.cost(name, points)
        return _unpack_fit(self._board.processor.memory.read(self.RESULT, FIT.size))

    def moments(self, points: ArrayLike, anchor: list[int]) -> list[float]:
        self._place(points)
        memory = self._board.processor.memory
        memory.write(self.ANCHOR, struct.pack("<3i", *anchor))
        self._board.call("moments_sum", self.ARGUMENT, self.ANCHOR, self.RESULT)
        return list(struct.unpack("<35f", memory.read(self.RESULT, 35 * 4)))


@pytest.fixture(scope="session")
def host_library(require_tool: Callable[[str], str], tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    """The calibration sources, compiled for this machine."""
    library = tmp_path_factory.mktemp("calibrators") / "calibrators.so"
    options = ["-std=c11", "-O2", "-ffp-contract=off", "-fno-math-errno", "-fshort-enums", "-shared", "-fPIC"]
    warnings = ["-Wall", "-Wextra", "-Wconversion", "-Wdouble-promotion", "-Werror"]
    # Undefined behaviour ends the process: whatever points a test draws, there must be none.
    options += ["-fsanitize=undefined,float-cast-overflow", "-fsanitize-undefined-trap-on-error"]
    sources = sorted(str(path) for path in CALIBRATION.glob("*.c"))
    command = [require_tool("gcc"), *options, *warnings, *sources, "-o", str(library), "-lm"]
    subprocess.run(command, check=True)
    return ctypes.CDLL(str(library))


@pytest.fixture(scope="session")
def build_program(
    require_tool: Callable[[str], str], tmp_path_factory: pytest.TempPathFactory
) -> Callable[[str], Path]:
    """Return a function that builds one of `programs` with the firmware's drivers of board and sensors into an ELF."""
    board = FIRMWARE / "boards" / "frdm_k64f"
    drivers = [*sorted(board.glob("*.c")), *sorted((FIRMWARE / "sensors").glob("*.c"))]

    def build(program: str) -> Path:
        elf = tmp_path_factory.mktemp("program") / "program.elf"
        command = [
            require_tool("arm-none-eabi-gcc"),
            "-mcpu=cortex-m4",
            "-mthumb",
            "-mfpu=fpv4-sp-d16",
            "-mfloat-abi=hard",
            "-std=c11",
            "-O2",
            "-g",
            "-Wall",
            "-Wextra",
            "-Wconversion",
            "-Werror",
            "-ffunction-sections",
            "-fdata-sections",
            "-fno-tree-loop-distribute-patterns",
            f"-I{FIRMWARE}",
            "-nostartfiles",
            f"-T{board / 'frdm_k64f.ld'}",
            "-Wl,--gc-sections",
            str(PROGRAMS / program),
            *map(str, drivers),
            "-lm",
            "-o",
            str(elf),
        ]
        subprocess.run(command, check=True, timeout=120)
        return elf

    return build


@pytest.fixture(scope="session")
def host_calibrators(host_library: ctypes.CDLL) -> HostCalibrators:
    return HostCalibrators(host_library)


@pytest.fixture(scope="session")
def board_calibrators() -> BoardCalibrators:
    return BoardCalibrators(VirtualK64F(SHIPPED_ELF, profile=COSTS_BY))


@pytest.fixture(scope="session", params=["host", "board"])
def calibrators(request: pytest.FixtureRequest) -> HostCalibrators | BoardCalibrators:
    result: HostCalibrators | BoardCalibrators = request.getfixturevalue(f"{request.param}_calibrators")
    return result


@pytest.fixture(scope="session")
def host_stream(host_library: ctypes.CDLL) -> Callable[[str], Stream]:
    """Return a function that makes a stream calibrator by its name."""
    return lambda name: HostStream(name, host_library)


@pytest.fixture(scope="session")
def board_stream() -> Callable[[str], BoardStream]:
    """Return a function that makes a stream calibrator by its name; one at a time is on the board."""
    board = VirtualK64F(SHIPPED_ELF, profile=COSTS_BY)
    return lambda name: BoardStream(name, board)


@pytest.fixture(scope="session", params=["host", "board"])
def stream(request: pytest.FixtureRequest) -> Callable[[str], Stream]:
    result: Callable[[str], Stream] = request.getfixturevalue(f"{request.param}_stream")
    return result
