"""An independent emulator executes every calibrator in the same number of instructions."""

from __future__ import annotations

import json
import re
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from hiltest.virtual.k64f import VirtualK64F

ROOT = Path(__file__).parents[2]
STUB = ROOT / "firmware_stub"
PROGRAMS = Path(__file__).parent / "programs"
CLOUDS = ROOT / "fixtures" / "clouds"
MANIFEST = json.loads((ROOT / "src" / "hiltest" / "firmware" / "manifest.json").read_text())
TRACED = re.compile(r"^Trace \d+: \S+ \[[0-9a-f]+/([0-9a-f]+)/", re.M)

# A hundred points cost at least 70 instructions each in moments alone. The streams run over 301 points: 451 steps of
# 180, or 301 of 50 and three solvers of at least 20 000, or 903 slices, none below 50.
MINIMUM = {
    "magnetometer_direct": 7000,
    "magnetometer_direct_fast": 5500,
    "magnetometer_corrected": 7000,
    "magnetometer_iterative": 7000,
    "magnetometer_empty": 3,
    "kernel_direct_stream": 451 * 180,
    "kernel_iterative_stream": 3 * 20_000 + 301 * 50,
    "kernel_iterative_stream_sliced": 903 * 50,
}


def cloud_source(name: str) -> str:
    cloud = json.loads((CLOUDS / f"{name}.json").read_text())
    rows = ", ".join("{{{}, {}, {}}}".format(*point) for point in cloud["points"])
    low, high = ("{{{}, {}, {}}}".format(*cloud[side]) for side in ("minimum", "maximum"))
    return (
        '#include "calibration/magnetometer_calibrator.h"\n'
        f"const int16_t cloud[][3] = {{{rows}}};\n"
        f"const magnetometer_points_t cloud_points = {{cloud, {len(cloud['points'])}, {low}, {high}, 0}};\n"
    )


@pytest.fixture
def build_kernel(tmp_path: Path, require_tool: Callable[[str], str]) -> Callable[[str], Path]:
    """Return a function that links one kernel of the firmware, with the firmware's flags, into RAM."""
    compiler = require_tool("arm-none-eabi-gcc")

    def build(kernel: str) -> Path:
        cloud = tmp_path / "cloud.c"
        cloud.write_text(cloud_source("odd_count" if kernel.startswith("kernel_") else "full_sphere"))
        elf = tmp_path / f"{kernel}.elf"
        flags = [flag for flag in MANIFEST["flags"].split() if not flag.startswith(("-W", "-fstack", "-fcallgraph"))]
        sources = [*sorted((STUB / "calibration").glob("*.[cS]")), PROGRAMS / "one_kernel.c",
                   PROGRAMS / "stream_kernels.c", cloud]
        subprocess.run(
            [compiler, *flags, f"-DKERNEL={kernel}", f"-I{STUB}", f"-I{STUB / 'calibration'}", "-nostartfiles",
             f"-Wl,-T,{PROGRAMS / 'ram.ld'}", *map(str, sources), "-lm", "-o", str(elf)],
            check=True, timeout=60,
        )  # fmt: skip
        return elf

    return build


@pytest.mark.parametrize("kernel", MINIMUM)
def test_qemu_executes_as_many_instructions(
    kernel: str, build_kernel: Callable[[str], Path], require_tool: Callable[[str], str], tmp_path: Path
) -> None:
    qemu = require_tool("qemu-system-arm")
    elf, log = build_kernel(kernel), tmp_path / "trace"
    # One instruction a translation block, and a line in the trace for each that is entered.
    subprocess.run(
        [qemu, "-M", "mps2-an386", "-nographic", "-semihosting", "-singlestep", "-d", "exec,nochain",
         "-D", str(log), "-kernel", str(elf)],
        check=True, timeout=120, stdin=subprocess.DEVNULL, capture_output=True,
    )  # fmt: skip
    board = VirtualK64F(elf)
    begin, end = (board.image.symbols[name].address for name in ("run_kernel", "after_kernel"))
    addresses = [int(address, 16) for address in TRACED.findall(log.read_text())]
    executed = addresses.index(end) - addresses.index(begin) - 1  # without the branch to after_kernel
    assert board.call("run_kernel").instructions == executed
    # The kernel did its work: the fit is there, not an early refusal.
    assert executed > MINIMUM[kernel]
