"""Firmware with one thing wrong: the real command must end red, by the right name, within its deadline.

Each case is the project's own firmware with one edit, built with the cross compiler and run on the virtual board.
They share one copy of the sources and its build folder: of each, only what includes the edited file is compiled.
"""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

REPOSITORY = Path(__file__).parents[2]
WALL_LIMIT_S = 120  # a run takes a few seconds; nothing may wait for ever
# What these causes show in, and the gyroscope, which is measured before the headings are.
SUITES = ("--", "-k", "identity or accelerometer or gyroscope or heading or dpi")


@dataclass(frozen=True)
class Ended:
    """How a run of the command ended."""

    exit_code: int
    output: str
    record: dict[str, Any]

    def measurement(self, name: str) -> dict[str, Any] | None:
        return next((entry for entry in self.record["measurements"] if entry["name"] == name), None)

    def value(self, name: str) -> float:
        entry = self.measurement(name)
        assert entry is not None, f"{name} is not in the record"
        return float(entry["value"])


RunEdited = Callable[..., Ended]


@pytest.fixture(scope="module")
def copy_of_the_firmware(tmp_path_factory: pytest.TempPathFactory, require_tool: Callable[[str], str]) -> Path:
    """The firmware's sources, built in `build` beside them."""
    require_tool("arm-none-eabi-gcc")
    require_tool("cmake")
    folder = tmp_path_factory.mktemp("firmware")
    stub = folder / "firmware_stub"
    shutil.copytree(REPOSITORY / "firmware_stub", stub, ignore=shutil.ignore_patterns("__pycache__"))
    command = [sys.executable, str(stub / "build.py"), "--build", str(folder / "build"), "--out", str(folder / "elf")]
    subprocess.run(command, check=True, capture_output=True, timeout=WALL_LIMIT_S)
    return stub


@pytest.fixture
def run_edited(tmp_path: Path, copy_of_the_firmware: Path) -> RunEdited:
    """Return a function that edits the firmware, builds it, and runs ``hiltest run`` with it."""

    def build(elf: Path) -> None:
        build = copy_of_the_firmware.parent / "build"
        subprocess.run(["cmake", "--build", str(build)], check=True, capture_output=True, timeout=WALL_LIMIT_S)
        shutil.copyfile(build / "hiltest-frdm-k64f.elf", elf)

    def run(file: str, old: str, new: str, *, rig: str = "virtual-k64f") -> Ended:
        source = copy_of_the_firmware / file
        text = source.read_text()
        assert text.count(old) == 1, f"{file}: the line to edit is there {text.count(old)} times"
        source.write_text(text.replace(old, new))
        try:
            build(tmp_path / "edited.elf")
        finally:
            source.write_text(text)
        out = tmp_path / "out"
        command = [sys.executable, "-m", "hiltest", "run", "--poses", "level", "--out", str(out)]
        command += ["--rig", rig, "--firmware", str(tmp_path / "edited.elf"), *SUITES]
        done = subprocess.run(command, capture_output=True, text=True, timeout=WALL_LIMIT_S, cwd=tmp_path)
        record = json.loads((out / "run.json").read_text())
        return Ended(done.returncode, done.stdout + done.stderr, record)

    return run


def test_three_degrees_added_to_every_heading_are_a_constant_offset(run_edited: RunEdited) -> None:
    ended = run_edited(
        "orientation/tilt_heading.c",
        "atan2f(side, ahead) * DEGREES_PER_RADIAN;",
        "atan2f(side, ahead) * DEGREES_PER_RADIAN + 3.0f;",
    )
    assert ended.exit_code == 1, ended.output
    assert "constant offset" in ended.output
    # The bias of the default rig itself is within 0.12 degrees over seeds; 0.3 is more than twice that.
    assert ended.value("heading.direct.bias") == pytest.approx(3.0, abs=0.3)


def test_a_swapped_magnetometer_axis_is_red(run_edited: RunEdited) -> None:
    ended = run_edited(
        "sensors/axes.c",
        "    body[0] = negated(sensor[1]);\n    body[1] = negated(sensor[0]);\n    body[2] = limited(sensor[2]);",
        "    body[0] = negated(sensor[0]);\n    body[1] = negated(sensor[1]);\n    body[2] = limited(sensor[2]);",
    )
    assert ended.exit_code == 1, ended.output
    assert ended.value("heading.direct.max") > 45


@pytest.mark.parametrize(
    ("file", "old", "new", "refused"),
    [
        # Of gravity: its sign.
        ("calibration/dpi_sums.c", "    return row[0] * a[0] + row[1] * a[1] + row[2] * a[2] + at_zero;",
         "    return -(row[0] * a[0] + row[1] * a[1] + row[2] * a[2] + at_zero);", "MIRRORED"),
        # Of the magnetometer: two axes.
        ("calibration/dpi_sums.c",
         ".u = {(float)(m[0] - anchor[0]), (float)(m[1] - anchor[1]), (float)(m[2] - anchor[2])},",
         ".u = {(float)(m[1] - anchor[1]), (float)(m[0] - anchor[0]), (float)(m[2] - anchor[2])},", "MIRRORED"),
        # Of the dip: degrees taken for radians, and 62 radians are a dip of -48 degrees.
        ("app/dpi_commands.c", "sinf(dip_deg / DEGREES_PER_RADIAN)", "sinf(dip_deg)", "MIRRORED"),
    ],
    ids=["the sign of gravity", "a swapped axis", "the dip in another unit"],
)
def test_a_calibration_against_gravity_with_a_mistake_is_refused_by_name(
    run_edited: RunEdited, file: str, old: str, new: str, refused: str
) -> None:
    ended = run_edited(file, old, new)
    assert ended.exit_code == 1, ended.output
    assert f"dpi of 300 rows: {refused}" in ended.output
    assert ended.measurement("fit.dpi.residual") is None


def test_gravity_in_another_unit_is_red(run_edited: RunEdited) -> None:
    ended = run_edited(
        "calibration/dpi_sums.c",
        "    return row[0] * a[0] + row[1] * a[1] + row[2] * a[2] + at_zero;",
        "    return 9.80665f * (row[0] * a[0] + row[1] * a[1] + row[2] * a[2] + at_zero);",
    )
    assert ended.exit_code == 1, ended.output
    # The heading does not depend on it. But 9.8 times the sine of 62 degrees is no sine.
    assert ended.value("fit.dpi.dip") == pytest.approx(90.0)
    assert "fit.dpi.dip" in ended.output


def test_axes_of_gravity_in_a_circle_make_every_heading_wrong(run_edited: RunEdited) -> None:
    ended = run_edited(
        "calibration/dpi_sums.c",
        ".a = {(float)a[0], (float)a[1], (float)a[2]},", ".a = {(float)a[1], (float)a[2], (float)a[0]},",
    )
    assert ended.exit_code == 1, ended.output
    assert ended.value("fit.dpi.rotation_left") == pytest.approx(120.0, abs=1.0)
    assert ended.value("heading.dpi.max") > 45


@pytest.mark.parametrize(
    ("file", "old", "new"),
    [
        (
            "calibration/accelerometer_calibration.c",
            "const float x = counts[0] - calibration->offset[0];",
            "const float x = counts[0] + calibration->offset[0];",
        ),
        (
            "calibration/accelerometer_calibration.c",
            "const float x = counts[0] - calibration->offset[0];",
            "const float x = counts[0] - calibration->offset[1];",
        ),
        (
            "app/accelerometer_commands.c",
            "    slot_set_accelerometer(slot, &calibration);",
            "    for (int i = 0; i < 3; i++) {\n"
            "        calibration.offset[i] *= 1000.0f * ACCELEROMETER_G_PER_COUNT;\n"
            "    }\n"
            "    slot_set_accelerometer(slot, &calibration);",
        ),
    ],
    ids=["sign", "axis", "unit"],
)
def test_an_accelerometer_calibration_of_the_wrong_sign_axis_or_unit_is_red(
    run_edited: RunEdited, file: str, old: str, new: str
) -> None:
    ended = run_edited(file, old, new, rig="virtual-k64f-untrimmed")
    assert ended.exit_code == 1, ended.output
    # 20 mg that stay, or come twice, on one axis alone: 1.1 degrees of tilt at least, times tan(62).
    assert ended.value("heading.direct.max") > 2.0
    assert ended.value("accelerometer.tilt_error") > 0.3
    assert ended.value("accelerometer.six_position.offset_error") < 1.2  # the fit itself is right


GYROSCOPE_AXES = """void axes_gyroscope(const int16_t sensor[3], int16_t body[3])
{
    body[0] = negated(sensor[1]);
    body[1] = negated(sensor[0]);
    body[2] = negated(sensor[2]);
"""


@pytest.mark.parametrize(
    ("file", "old", "new", "felt"),
    [
        ("sensors/axes.c", GYROSCOPE_AXES, GYROSCOPE_AXES.replace("negated(sensor[2])", "limited(sensor[2])"),
         r"\(.*, .*, -36\d\) deg"),
        ("sensors/axes.c", GYROSCOPE_AXES, GYROSCOPE_AXES.replace("sensor[1]", "sensor[2]", 1).replace(
            "[2] = negated(sensor[2])", "[2] = negated(sensor[1])"), r"\(\+36\d, .*, .*\) deg"),
        # The part's range doubled, which halves its counts.
        ("sensors/fxas21002.c", "CTRL_REG3_WRAP_TO_ONE 0x08u", "CTRL_REG3_WRAP_TO_ONE 0x09u",
         r"\(.*, .*, \+18\d\) deg"),
    ],
    ids=["sign", "axis", "unit"],
)  # fmt: skip
def test_a_gyroscope_of_wrong_sign_axis_or_unit_is_red(
    run_edited: RunEdited, file: str, old: str, new: str, felt: str
) -> None:
    ended = run_edited(file, old, new)
    assert ended.exit_code == 1, ended.output
    told = " ".join(ended.output.split())
    assert re.search(rf"felt {felt} about x, y, z where \+360 about z", told), ended.output
    assert ended.measurement("gyroscope.scale_error.z") is None


def test_firmware_that_hangs_is_a_lost_bench_with_all_measured_before_kept(run_edited: RunEdited) -> None:
    ended = run_edited(
        "orientation/tilt_heading.c",
        "    float g[3], b[3];",
        "    float g[3], b[3];\n    for (;;) {\n    }",
    )
    assert ended.exit_code == 20, ended.output
    assert "hang" in ended.output
    assert "tilt_heading" in ended.output
    assert ended.measurement("heading.direct.max") is None or ended.measurement("heading.direct.max")["value"] is None
    assert ended.value("gyroscope.bias_error") < 0.1


def test_firmware_that_faults_is_a_lost_bench_that_names_the_line(run_edited: RunEdited) -> None:
    ended = run_edited(
        "orientation/tilt_heading.c",
        "    float g[3], b[3];",
        "    float g[3], b[3];\n    *(volatile int *)0x30000000 = 1;",
    )
    assert ended.exit_code == 20, ended.output
    assert "write to unmapped address 0x30000000" in ended.output
    assert "tilt_heading.c:" in ended.output
    assert ended.value("gyroscope.bias_error") < 0.1


def test_firmware_at_another_baud_rate_is_a_lost_bench(run_edited: RunEdited) -> None:
    ended = run_edited("boards/frdm_k64f/uart.c", "#define BAUD_DIVISOR 65u", "#define BAUD_DIVISOR 60u")
    assert ended.exit_code == 20, ended.output
    assert "synchronisation" in ended.output


def test_firmware_that_answers_garbage_is_a_lost_bench(run_edited: RunEdited) -> None:
    # Bytes arrive at the right pace, and none of their check sums holds.
    ended = run_edited(
        "protocol/message.c",
        "write_u32(&trailer, crc32(body, checked));",
        "write_u32(&trailer, ~crc32(body, checked));",
    )
    assert ended.exit_code == 20, ended.output
    assert "synchronisation" in ended.output
    assert ended.measurement("heading.direct.max") is None


def test_firmware_of_another_name_is_the_wrong_firmware(run_edited: RunEdited) -> None:
    ended = run_edited("boards/frdm_k64f/board.c", '.name = "hiltest-frdm-k64f"', '.name = "blinky"')
    assert ended.exit_code == 23, ended.output
    assert "blinky" in ended.output
    assert "hiltest-frdm-k64f" in ended.output


def test_another_protocol_version_is_the_wrong_firmware(run_edited: RunEdited) -> None:
    ended = run_edited("protocol/message.h", "#define PROTOCOL_VERSION 4u", "#define PROTOCOL_VERSION 5u")
    assert ended.exit_code == 23, ended.output
    assert "protocol" in ended.output
