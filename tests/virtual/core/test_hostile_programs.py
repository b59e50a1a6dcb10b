"""Random programs cannot make the core read or write outside its machine, nor do what C leaves undefined."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from .inner_library import SOURCES

# Unoptimised, what takes longest is compiling: a thousand programs take four seconds; CI runs for a minute.
PROGRAMS = int(os.environ.get("HILTEST_FUZZED_PROGRAMS", "1000"))
_FLAGS = ("-std=c11", "-g", "-ffp-contract=off", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")


@pytest.fixture(scope="module")
def fuzzer(require_tool: Callable[[str], str], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Compile the core with sanitizers, together with what makes and runs the programs."""
    program = tmp_path_factory.mktemp("fuzz") / "fuzz_programs"
    sources = [*sorted(SOURCES.glob("*.c")), Path(__file__).with_name("fuzz_programs.c")]
    subprocess.run(
        [require_tool("gcc"), *_FLAGS, f"-I{SOURCES}", "-o", program, *sources, "-lm"], check=True, timeout=300
    )
    return program


def run(fuzzer: Path, seed: int, count: int) -> str:
    command = [str(fuzzer), str(seed), str(count)]
    result = subprocess.run(command, capture_output=True, text=True, timeout=60 + count / 10, check=False)
    assert result.returncode == 0, result.stderr[-4000:]
    return result.stdout


@pytest.mark.slow
def test_random_programs_stay_within_the_machine(fuzzer: Path) -> None:
    first = run(fuzzer, 1, PROGRAMS).splitlines()[0]
    programs, instructions = (int(word) for word in first.split() if word.isdigit())
    assert programs == PROGRAMS
    assert instructions > 50 * programs  # a hundred, as most programs fault often


@pytest.mark.ci
def test_a_program_does_the_same_on_arm64(fuzzer: Path, require_tool: Callable[[str], str], tmp_path: Path) -> None:
    program = tmp_path / "fuzz_programs"
    sources = [*sorted(SOURCES.glob("*.c")), Path(__file__).with_name("fuzz_programs.c")]
    compiler = require_tool("aarch64-linux-gnu-gcc")
    flags = ["-std=c11", "-O2", "-ffp-contract=off", "-static"]
    subprocess.run([compiler, *flags, f"-I{SOURCES}", "-o", program, *sources, "-lm"], check=True, timeout=300)
    command = [require_tool("qemu-aarch64"), str(program), "3", "500"]
    result = subprocess.run(command, capture_output=True, text=True, timeout=300, check=True)
    assert result.stdout == run(fuzzer, 3, 500)


@pytest.mark.ci
def test_more_random_programs_stay_within_the_machine(fuzzer: Path) -> None:
    run(fuzzer, 2, 12 * PROGRAMS)
