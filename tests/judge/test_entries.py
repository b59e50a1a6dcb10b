"""What `hiltest judge` can judge: sources, libraries, Python functions and images, and each way in which they fail."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hiltest.errors import BoardFault, ConfigError
from hiltest.judge import host_calibrator
from hiltest.judge.answers import Answer, Outcome, rate
from hiltest.judge.build import header_folder
from hiltest.judge.entries import open_entry
from hiltest.judge.image_calibrator import ImageCalibrator
from hiltest.judge.worlds import FAMILIES, draw_world

WORLD = draw_world(FAMILIES[0], 7)
TEMPLATE = (header_folder() / "template.c").read_text(encoding="utf-8")
MIDDLE = 0.5 * (WORLD.samples_ut.min(axis=0) + WORLD.samples_ut.max(axis=0))
SIGNATURE = "int calibrate(const float samples[][3], int n, float hard_iron[3], float soft_iron[3][3])"
PYTHON = """
import ctypes
import time

import numpy as np


def middle(samples):
    print("a line that is no answer")
    low, high = samples.min(axis=0), samples.max(axis=0)
    return 0.5 * (low + high), np.diag(2.0 / (high - low))


def pairs(samples, accelerations):
    return accelerations[0], np.eye(3)


def refuses(samples):
    return None


def crashes(samples):
    ctypes.string_at(0)


def hangs(samples):
    time.sleep(100)


def raises(samples):
    raise ValueError("two\\nlines")


def leaves(samples):
    raise SystemExit(3)


def shapes(samples):
    return 1.0, np.eye(3)


def lacks(samples):
    return np.eye(3)


def roots(samples):
    return np.zeros(3) + 0j, np.sqrt(np.diag([1.0, 1.0, -1.0]).astype(complex))


def eats(samples):
    return np.zeros(1 << 33)
"""

Write = Callable[..., str]


@pytest.fixture(autouse=True)
def compilers(require_tool: Callable[[str], str]) -> None:
    for tool in ("arm-none-eabi-gcc", "arm-none-eabi-g++", "cc"):
        require_tool(tool)


@pytest.fixture
def write(tmp_path: Path) -> Write:
    """Return a function that writes a source and returns its name."""

    def write_source(text: str, name: str = "mine.c") -> str:
        (tmp_path / name).write_text(text, encoding="utf-8")
        return str(tmp_path / name)

    return write_source


def answer_of(named: str, function: str | None = None) -> Answer:
    with open_entry(named, function) as entry:
        return entry.answer(WORLD)


@pytest.fixture
def python_file(write: Write) -> str:
    return write(PYTHON, "mine.py")


def test_a_source_is_judged_on_the_core_and_timed_on_the_host(write: Write) -> None:
    with open_entry(write(TEMPLATE), None) as entry:
        answer = entry.answer(WORLD)
        assert entry.cycle_model == "cortex-m4-trm/3@sram"
        assert entry.built_by.startswith("arm-none-eabi-gcc ")
        assert entry.flash_bytes is not None
        assert 100 < entry.flash_bytes < 1000
    assert np.abs(answer.hard_iron_ut - MIDDLE).max() < 1e-5  # float32 of 50 uT
    assert answer.band is not None
    assert answer.cycles is not None
    assert answer.band.low <= answer.cycles <= answer.band.high
    assert answer.stack_bytes is not None
    assert answer.host_us is not None
    assert answer.host_us > 0.0
    with open_entry(write(TEMPLATE), None) as entry:
        assert entry.answer(WORLD).cycles == answer.cycles


CPP = (
    '#include "hiltest_judge.h"\n#include <{header}>\n'
    "struct Sum {{ float x = 0; void add(float y) {{ x += {function}(y, 1.0f); }} }};\n"
    f"{SIGNATURE}\n"
    "{{ Sum sum; for (int i = 0; i < n; i++) sum.add(samples[i][0]); hard_iron[0] = sum.x; "
    "for (int i = 0; i < 3; i++) soft_iron[i][i] = 1.0f; return 0; }}\n"
)
SUM_OF_ANGLES = np.arctan2(WORLD.samples_ut[:, 0], 1.0).sum()


def test_cpp_with_a_member_and_a_call_of_the_mathematical_library_is_a_source_too(write: Write) -> None:
    source = write(CPP.format(header="math.h", function="atan2f"), "mine.cpp")
    assert answer_of(source).hard_iron_ut[0] == pytest.approx(SUM_OF_ANGLES, abs=1e-3)  # a float32 sum


def test_cpp_that_needs_its_standard_library_is_compiled_or_told_which_package_has_it(write: Write) -> None:
    source = write(CPP.format(header="cmath", function="std::atan2"), "mine.cpp")
    command = ["arm-none-eabi-g++", "-print-file-name=libstdc++.a"]
    if Path(subprocess.run(command, check=True, capture_output=True, text=True, timeout=60).stdout).parent.name:
        assert answer_of(source).hard_iron_ut[0] == pytest.approx(SUM_OF_ANGLES, abs=1e-3)
    else:
        with pytest.raises(ConfigError, match=r"mine\.cpp.*cmath(.|\n)*libstdc\+\+-arm-none-eabi-newlib"):
            answer_of(source)


def test_an_elf_is_judged_by_the_name_of_its_function(write: Write, tmp_path: Path) -> None:
    source = write(TEMPLATE.replace("int calibrate(", "int fit_ellipsoid("))
    elf = tmp_path / "firmware.elf"
    command = ["arm-none-eabi-gcc", "-mcpu=cortex-m4", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard", "-g", "-O1"]
    command += ["-nostdlib", f"-I{header_folder()}", "-Ttext=0x08000000", "-e", "fit_ellipsoid", source, "-o", str(elf)]
    subprocess.run(command, check=True, timeout=60)
    with open_entry(str(elf), "fit_ellipsoid") as entry:
        assert isinstance(entry, ImageCalibrator)
        assert np.abs(entry.answer(WORLD).hard_iron_ut - MIDDLE).max() < 1e-5
        assert "-O1" in entry.built_by
    with pytest.raises(ConfigError, match="no function 'calibrate'"), open_entry(str(elf), None):
        pass


def test_a_library_of_this_host_is_judged_in_a_process_of_its_own(write: Write, tmp_path: Path) -> None:
    library = tmp_path / "mine.so"
    source = write(TEMPLATE)
    subprocess.run(
        ["cc", "-shared", "-fPIC", f"-I{header_folder()}", source, "-o", str(library)], check=True, timeout=60
    )
    answer = answer_of(str(library))
    assert np.abs(answer.hard_iron_ut - MIDDLE).max() < 1e-5
    assert answer.cycles is None


def test_a_python_function_is_judged_and_what_it_prints_is_no_answer(python_file: str) -> None:
    answer = answer_of(f"{python_file}:middle")
    assert np.abs(answer.hard_iron_ut - MIDDLE).max() < 1e-5
    assert not answer.refused
    assert answer_of(f"{python_file}:refuses").refused
    gravity = WORLD.accelerations_g[0]
    assert np.abs(answer_of(f"{python_file}:pairs").hard_iron_ut - gravity).max() < 1e-6


def test_a_complex_root_is_no_ellipsoid_and_a_complex_zero_is_a_number(python_file: str) -> None:
    answer = answer_of(f"{python_file}:roots")
    assert answer.hard_iron_ut.tolist() == [0.0, 0.0, 0.0]
    assert rate(answer, WORLD).outcome is Outcome.NO_ELLIPSOID


@pytest.mark.parametrize(
    ("function", "message"),
    [
        ("crashes", "ends with SIGSEGV in world rig/7"),
        ("raises", "fails in world rig/7: ValueError: two lines"),
        ("leaves", "fails in world rig/7: SystemExit: 3"),
        ("shapes", r"returned shapes \(\) and \(3, 3\)"),
        ("lacks", "lacks returned no pair of hard iron and soft iron"),
        ("eats", "fails in world rig/7: .*MemoryError"),
        ("missing", "has no attribute 'missing'"),
    ],
)
def test_a_function_that_fails_ends_with_a_sentence_that_names_the_world(
    python_file: str, function: str, message: str
) -> None:
    with pytest.raises(ConfigError, match=message):
        answer_of(f"{python_file}:{function}")


def test_a_function_that_hangs_is_ended(python_file: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(host_calibrator, "TIMEOUT_S", 0.5)
    with pytest.raises(ConfigError, match=r"takes more than 0.5 s in world rig/7"):
        answer_of(f"{python_file}:hangs")


@pytest.mark.parametrize("on_host", [False, True], ids=["core", "host"])
@pytest.mark.parametrize(
    "statement", ["hard_iron[3] = 1.0f;", "((float *)samples)[0] = 7.0f;"], ids=["behind", "input"]
)
def test_a_function_that_writes_outside_its_outputs_has_no_row(
    write: Write, tmp_path: Path, statement: str, on_host: bool
) -> None:
    named = write(f"{SIGNATURE}\n{{ {statement} soft_iron[0][0] = n; return 0; }}\n")
    if on_host:
        library = str(tmp_path / "mine.so")
        subprocess.run(["cc", "-w", "-shared", "-fPIC", named, "-o", library], check=True, timeout=60)
        named = library
    with pytest.raises(ConfigError, match="writes outside hard_iron and soft_iron in world rig/7"):
        answer_of(named)


def test_a_fault_and_a_hang_on_the_core_name_the_world_and_the_place(write: Write) -> None:
    with pytest.raises(BoardFault, match=r"mine.c in world rig/7: .*0xffffff") as fault:
        answer_of(write(f"{SIGNATURE}\n{{ return *(volatile int *)0xffffff00; }}\n"))
    assert fault.value.function == "calibrate"
    assert "mine.c:" in fault.value.location


@pytest.mark.parametrize(
    ("text", "name", "message"),
    [
        ("int calibrate(int n) { return n; }", "mine.c", "calibrate takes 1 arguments"),
        ("int calibrate(", "mine.c", r"cannot compile it:\n.*error"),
        ("int other(void) { return 0; }", "mine.c", r"no function calibrate; .* name one: .*mine\.c:NAME"),
        ("no source", "mine.txt", "is neither a source"),
        ("x = 1", "mine.py", r"name its function, too: .*mine\.py:calibrate"),
    ],
    ids=["one argument", "syntax", "other function", "text", "python"],
)
def test_a_file_that_cannot_be_judged_is_refused(write: Write, text: str, name: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        answer_of(write(text, name))


def test_without_a_compiler_the_message_names_two(write: Write, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "which", lambda *_arguments, **_options: None)
    monkeypatch.setattr("hiltest.judge.build.find_spec", lambda _name: None)
    with pytest.raises(ConfigError, match=r"gcc-arm-none-eabi.*hiltest\[judge\]"):
        answer_of(write(TEMPLATE))
