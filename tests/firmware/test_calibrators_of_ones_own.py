"""The page that tells how to add a calibrator does what it says: one C file and one table line."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from hiltest.virtual.board.k64f import VirtualK64F

from ..instances import instance
from .conftest import SHIPPED_ELF

pytestmark = pytest.mark.slow

FIRMWARE = Path(__file__).parents[2] / "firmware_stub"


@pytest.fixture(scope="module")
def extended_firmware(require_tool: Callable[[str], str], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the firmware with the page's example added as the page says."""
    for tool in ("arm-none-eabi-gcc", "cmake"):
        require_tool(tool)
    folder = tmp_path_factory.mktemp("own")
    shutil.copytree(FIRMWARE, folder / "firmware_stub")
    calibration = folder / "firmware_stub" / "calibration"
    blocks = re.findall(r"```c\n(.*?)```", (calibration / "README.md").read_text(), re.DOTALL)
    source, line = (textwrap.dedent(block) for block in blocks)
    (calibration / "my_fit.c").write_text(source)
    table = calibration / "calibrator_table.h"
    head = "#define CALIBRATOR_TABLE(LINE)"
    before, after = table.read_text().split(head)
    first, rest = after.split("\n", 1)
    table.write_text(f"{before}{head}{first}\n{line}{rest}")
    build = ["-S", str(folder / "firmware_stub"), "-B", str(folder / "build"), "-DHILTEST_BUILD_ID=0000000000000000"]
    toolchain = f"-DCMAKE_TOOLCHAIN_FILE={folder / 'firmware_stub' / 'cmake' / 'arm-none-eabi.cmake'}"
    subprocess.run(["cmake", *build, toolchain], check=True, capture_output=True)
    subprocess.run(["cmake", "--build", str(folder / "build")], check=True, capture_output=True)
    return folder / "build" / "hiltest-frdm-k64f.elf"


def test_the_example_of_the_page_builds_and_runs(extended_firmware: Path, board_calibrators: Any) -> None:
    drawn = instance(1, 200, stretch=0.0, covered=(1.0, 1.0))
    board = type(board_calibrators)(VirtualK64F(extended_firmware))
    fit = board.calibrate("mid_range", drawn.points_counts)
    # Of 200 points the outermost is 5 counts (1 % of the radius) inside on average, 35 once in a thousand; noise: 9.
    # Half of such a gap is 25.
    assert abs(fit.hard_iron - 10.0 * drawn.hard_iron_ut).max() <= 25.0
    assert abs(fit.soft_iron[0, 0] * 500.0 - 1.0) < 25.0 / 500.0


def calibrator_count(elf: Path) -> int:
    board = VirtualK64F(elf)
    board.call("magnetometer_empty", 0, 0)  # loads the image
    return board.processor.memory.read(board.image.symbols["calibrator_count"].address, 1)[0]


def test_the_example_is_one_calibrator_more(extended_firmware: Path) -> None:
    assert calibrator_count(extended_firmware) == calibrator_count(SHIPPED_ELF) + 1


def test_a_run_judges_the_example_beside_the_others_and_says_what_it_is_worth(
    extended_firmware: Path, tmp_path: Path
) -> None:
    command = [sys.executable, "-m", "hiltest", "run", "--poses", "level", "--firmware", str(extended_firmware)]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 1, done.stdout + done.stderr
    record = json.loads((tmp_path / "hil-out" / "run.json").read_text())
    assert "mid-range" in record["board"]["calibrators"]
    measured = {measurement["name"]: measurement for measurement in record["measurements"]}
    # The page says that it is held to 2 degrees and is worse than that; the others are as good as without it.
    assert measured["heading.mid-range.max"]["limit"] == {"min": None, "max": 2.0}
    assert measured["heading.mid-range.max"]["outcome"] == "fail"
    assert {measured[f"heading.{name}.max"]["outcome"] for name in ("direct", "corrected", "iterative")} == {"pass"}
    assert measured["cycles.mid-range.total"]["value"] < measured["cycles.direct.total"]["value"]
    # Its heading is red, and the page tells the cause; and it fits samples that no calibrator should.
    failed = {test["id"].rsplit("::")[-1].partition("[")[0] for test in record["tests"] if test["outcome"] != "passed"}
    assert failed == {"test_heading_at_known_angles", "test_a_poor_distribution_of_samples_is_refused"}
    assert re.search(r"heading\.mid-range\.max \S+ deg .* Likely cause: hard-iron error", record["verdict"]["sentence"])
