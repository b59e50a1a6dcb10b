"""An independent emulator executes the kernels in the same number of instructions.

All calibrators and streaming calibrators of the shipped firmware, `dpi`, the tilt-compensated heading and steps of the
attitude filter, and two programs of integers. The fits of accelerometer and gyroscope are not among them.
"""

from __future__ import annotations

import json
import re
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from hiltest.virtual.board.k64f import VirtualK64F
from hiltest.virtual.program.elf import FirmwareImage, load_image

from ..dpi_instances import dpi_instance

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
STUB = ROOT / "firmware_stub"
PROGRAMS = Path(__file__).parent / "programs"
CLOUDS = ROOT / "fixtures" / "clouds"
FIRMWARE = ROOT / "src" / "hiltest" / "firmware"
MANIFEST = json.loads((FIRMWARE / "manifest.json").read_text())
TRACED = re.compile(r"^Trace \d+: \S+ \[[0-9a-f]+/([0-9a-f]+)/", re.M)

# What is executed at least, and over which points. A hundred of them cost at least 70 instructions each in moments
# alone, or 50 of two points a word, packing included. The streams run over 301 points: 451 steps of 180, or 301 of 50
# and three solvers of at least 20 000, or 903 slices, none below 50. Of 300 pairs `dpi` makes 300 rows of 159
# multiplications and sums; a heading is at least 150 instructions, two steps of the filter 250.
PAIRS = "pairs"


FUNCTIONS = load_image(FIRMWARE / "hiltest-frdm-k64f.elf").symbols
CALIBRATORS = [name for name in FUNCTIONS if name.startswith("magnetometer_")]
STREAMS = [name.removesuffix("_add") for name in FUNCTIONS if name.endswith("_stream_add")]

# A calibrator that is not listed below does more than the empty one.
KERNELS = dict.fromkeys(CALIBRATORS, (3, "full_sphere")) | {
    "magnetometer_direct": (7000, "full_sphere"),
    "magnetometer_direct_fast": (5500, "full_sphere"),
    "magnetometer_corrected": (7000, "full_sphere"),
    "magnetometer_iterative": (7000, "full_sphere"),
    "magnetometer_empty": (3, "full_sphere"),
    "kernel_direct_stream": (451 * 180, "odd_count"),
    "kernel_iterative_stream": (3 * 20_000 + 301 * 50, "odd_count"),
    "kernel_iterative_stream_sliced": (903 * 50, "odd_count"),
    "kernel_dpi": (300 * 159, PAIRS),
    "kernel_tilt_heading": (300 * 150, PAIRS),
    "kernel_attitude_filter": (300 * 250, PAIRS),
    "kernel_sort": (301 * 8 * 5, "odd_count"),  # a heap of 301 is 8 deep
    "kernel_interpreter": (301 * 8, "odd_count"),
}


def _rows(points: NDArray[np.int64]) -> str:
    return ", ".join("{{{}, {}, {}}}".format(*point) for point in points.tolist())


def cloud_source(name: str) -> str:
    """Return points, and the accelerometer's readings with them, as C."""
    if name == PAIRS:
        drawn = dpi_instance(1, 300, dip_deg=60.0)
        points, accelerometer = drawn.magnetometer.astype(np.int64), drawn.accelerometer.astype(np.int64)
    else:
        points = np.array(json.loads((CLOUDS / f"{name}.json").read_text())["points"])
        accelerometer = np.zeros((1, 3), dtype=np.int64)
    extremes = np.array([points.min(axis=0), points.max(axis=0)])
    return (
        '#include "calibration/magnetometer_calibrator.h"\n'
        "extern const int16_t cloud_accelerometer[][3];\n"
        f"const int16_t cloud[][3] = {{{_rows(points)}}};\n"
        f"const int16_t cloud_accelerometer[][3] = {{{_rows(accelerometer)}}};\n"
        f"const magnetometer_points_t cloud_points = {{cloud, {len(points)}, {_rows(extremes)}, 0, 0}};\n"
    )


FLAGS = [flag for flag in MANIFEST["flags"].split() if not flag.startswith(("-W", "-fstack", "-fcallgraph"))]
FLAGS += [f"-I{STUB}", f"-I{STUB / 'calibration'}"]


@pytest.fixture(scope="module")
def firmware(require_tool: Callable[[str], str], tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Object files of the firmware's calibration and orientation, with the firmware's flags."""
    folder = tmp_path_factory.mktemp("firmware")
    sources = sorted([*(STUB / "calibration").glob("*.[cS]"), *(STUB / "orientation").glob("*.c")])
    compiler = require_tool("arm-none-eabi-gcc")
    subprocess.run([compiler, *FLAGS, "-c", *map(str, sources)], cwd=folder, check=True, timeout=60)
    return [str(path) for path in sorted(folder.glob("*.o"))]


@pytest.fixture
def build_kernel(tmp_path: Path, firmware: list[str], require_tool: Callable[[str], str]) -> Callable[[str], Path]:
    """Return a function that links one kernel of the firmware, with the firmware's flags, into RAM."""
    compiler = require_tool("arm-none-eabi-gcc")

    def build(kernel: str) -> Path:
        cloud = tmp_path / "cloud.c"
        cloud.write_text(cloud_source(KERNELS[kernel][1]))
        elf = tmp_path / f"{kernel}.elf"
        names = ("one_kernel", "stream_kernels", "pair_kernels", "integer_kernels")
        programs = [str(PROGRAMS / f"{name}.c") for name in names]
        subprocess.run(
            [
                compiler,
                *FLAGS,
                f"-DKERNEL={kernel}",
                "-nostartfiles",
                f"-Wl,-T,{PROGRAMS / 'ram.ld'}",
                *firmware,
                *programs,
                str(cloud),
                "-lm",
                "-o",
                str(elf),
            ],
            check=True,
            timeout=60,
        )
        return elf

    return build


def executed_by_qemu(qemu: str, image: FirmwareImage, folder: Path) -> int:
    """Return how many instructions a program's run_kernel takes; after_kernel comes right behind, and ends QEMU."""
    log = folder / "trace"
    # One instruction a translation block, and a line in the trace for each that is entered.
    subprocess.run(
        [
            qemu,
            "-M",
            "mps2-an386",
            "-nographic",
            "-semihosting",
            "-singlestep",
            "-d",
            "exec,nochain",
            "-D",
            str(log),
            "-kernel",
            image.name,
        ],
        check=True,
        timeout=120,
        stdin=subprocess.DEVNULL,
        capture_output=True,
    )
    begin, end = (image.symbols[name].address for name in ("run_kernel", "after_kernel"))
    addresses = [int(address, 16) for address in TRACED.findall(log.read_text())]
    return addresses.index(end) - addresses.index(begin) - 1  # without the branch to after_kernel


@pytest.mark.parametrize("kernel", KERNELS)
def test_qemu_executes_as_many_instructions(
    kernel: str, build_kernel: Callable[[str], Path], require_tool: Callable[[str], str], tmp_path: Path
) -> None:
    board = VirtualK64F(build_kernel(kernel))
    executed = executed_by_qemu(require_tool("qemu-system-arm"), board.image, tmp_path)
    assert board.call("run_kernel").instructions == executed
    # The kernel did its work: the fit is there, not an early refusal.
    print(f"{kernel}: {executed} instructions")
    assert executed > KERNELS[kernel][0]


def test_no_stream_calibrator_is_left_out() -> None:
    assert {f"kernel_{name}" for name in STREAMS} - set(KERNELS) == {"kernel_empty_stream"}
