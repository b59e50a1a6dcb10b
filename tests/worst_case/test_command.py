"""``hiltest profile worst``: what it finds, keeps, replays and refuses."""

from __future__ import annotations

import json
import os
import pty
import signal
import subprocess
import sys
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from tests.command_files import run
from tests.virtual.conftest import FLAGS, PROGRAMS

from hiltest.studies.worst_case.worst_input import load_worst_case
from hiltest.virtual.board.k64f import VirtualK64F
from hiltest.virtual.calls.buffers import Address, Structure

SOURCE = """
#include <stdint.h>
int main(void) { return 0; }
int set_bits(uint32_t n) {
    int k = 0;
    for (; n; n &= n - 1) k++;
    return k;
}
void sort(int16_t *values, int count) {
    for (int i = 1; i < count; i++)
        for (int k = i; k > 0 && values[k - 1] > values[k]; k--) {
            int16_t other = values[k];
            values[k] = values[k - 1];
            values[k - 1] = other;
        }
}
int guarded(int n) {
    for (volatile int k = 0; k < n; k++) {}
    return n > 100 ? -1 : n;
}
float halvings(float x) {
    float k = 0.0f;
    for (; x > 1.0f; x *= 0.5f) k += 1.0f;
    return k;
}
struct row { const int16_t *values; uint16_t count; };
int sum(const struct row *row) {
    int total = 0;
    for (int k = 0; k < row->count; k++) total += row->values[k];
    return total;
}
int faulty(int n) { return n > 50 ? *(volatile int *)0x50000000 : n; }
"""


@pytest.fixture
def build(tmp_path: Path, require_tool: Callable[[str], str]) -> Callable[..., Path]:
    """Return a function that compiles the program, with flags."""
    compiler = require_tool("arm-none-eabi-gcc")
    (tmp_path / "program.c").write_text(SOURCE)

    def built(name: str, *flags: str) -> Path:
        elf = tmp_path / name
        command = [compiler, *FLAGS, *flags, str(PROGRAMS / "start.S"), str(tmp_path / "program.c"), "-o", str(elf)]
        subprocess.run(command, check=True, timeout=60)
        return elf

    return built


@pytest.fixture
def elf(build: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return build("program.elf")


def worst(elf: Path, *words: str) -> int:
    return run("profile", "worst", "--firmware", str(elf), "--out", "worst.json", *words)


def cycles_of(elf: Path, function: str, *arguments: object) -> int:
    return VirtualK64F(elf).call(function, *arguments).cycles  # type: ignore[arg-type]


@pytest.mark.parametrize("seed", ["1", "2"])
def test_the_input_with_the_most_set_bits_is_found_exactly(elf: Path, seed: str) -> None:
    assert worst(elf, "set_bits", "0..65535", "--calls", "900", "--seed", seed) == 0
    case = load_worst_case(Path("worst.json"))
    assert case.arguments == ("65535",)
    assert case.cycles == cycles_of(elf, "set_bits", 65535)
    assert case.points == ()


def test_the_order_that_a_sort_takes_longest_for_is_found(elf: Path) -> None:
    assert worst(elf, "sort", "int16:7:-9..9", "7", "--calls", "900") == 0
    case = load_worst_case(Path("worst.json"))
    numbers = [int(part) for part in case.arguments[0].removeprefix("int16:").split(",")]
    assert len(numbers) == 7
    assert all(left > right for left, right in pairwise(numbers))
    assert case.cycles == cycles_of(elf, "sort", np.arange(7, 0, -1, dtype=np.int16), 7)


def test_a_float_is_searched_between_its_ends(elf: Path) -> None:
    assert worst(elf, "halvings", "0.5..1000.0", "--calls", "300") == 0
    case = load_worst_case(Path("worst.json"))
    assert 512.0 < float(case.arguments[0]) <= 1000.0
    assert case.cycles == cycles_of(elf, "halvings", 1000.0)


def test_numbers_in_the_members_of_a_struct_are_searched(elf: Path) -> None:
    assert worst(elf, "sum", "ptr:int16:4:-9..9+uint16:1..4", "--calls", "50") == 0
    case = load_worst_case(Path("worst.json"))
    row = Structure(Address(np.zeros(4, np.int16)), np.array([4], np.uint16))
    assert case.arguments[0].endswith("+uint16:4")
    assert case.cycles == cycles_of(elf, "sum", row)


def test_only_what_returns_a_success_is_a_worst_case(elf: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert worst(elf, "guarded", "0..200", "--returns", "0..100", "--calls", "900") == 0
    case = load_worst_case(Path("worst.json"))
    assert (case.arguments, case.cycles) == (("100",), cycles_of(elf, "guarded", 100))
    most = f"refused calls at most {cycles_of(elf, 'guarded', 200):,}".replace(",", " ")
    assert most in capsys.readouterr().out
    Path("worst.json").unlink()
    assert worst(elf, "guarded", "0..200", "--returns", "1000", "--calls", "50") == 1
    assert not Path("worst.json").exists()


def test_a_replay_takes_the_same_cycles_and_says_when_the_build_is_another(
    elf: Path, build: Callable[..., Path], capsys: pytest.CaptureFixture[str]
) -> None:
    assert worst(elf, "set_bits", "0..255", "--calls", "900") == 0
    cycles = load_worst_case(Path("worst.json")).cycles
    capsys.readouterr()
    assert run("profile", "worst", "--replay", "worst.json", "--firmware", str(elf)) == 0
    told = capsys.readouterr().out
    assert told == f"set_bits(255): {cycles} cycles (cortex-m4-trm/3@flash), the saved count\n"
    other = build("other.elf", "-O0")
    assert run("profile", "worst", "--replay", "worst.json", "--firmware", str(other)) == 0
    told = capsys.readouterr().out
    assert told.startswith(f"set_bits(255): {cycles_of(other, 'set_bits', 255)} cycles")
    assert f"; saved were {cycles} (cortex-m4-trm/3@flash) of another build, program.elf" in told


def test_other_cycles_of_the_same_build_are_an_error(elf: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert worst(elf, "set_bits", "0..255", "--calls", "100") == 0
    kept = json.loads(Path("worst.json").read_text())
    Path("worst.json").write_text(json.dumps(kept | {"cycles": kept["cycles"] + 1}))
    assert run("profile", "worst", "--replay", "worst.json", "--firmware", str(elf)) == 1
    assert "of the same build" in capsys.readouterr().out


def test_a_function_that_faults_names_the_arguments(elf: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert worst(elf, "faulty", "0..100", "--calls", "200") == 20
    assert "faulty was called with " in capsys.readouterr().err


def test_a_point_set_of_a_calibrator_is_found_and_replays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    texts = []
    for _ in range(2):
        assert run("profile", "worst", "iterative", "--calls", "60", "--seed", "4", "--points", "40") == 0
        texts.append(Path("hil-out/worst-iterative.json").read_text())
    assert texts[0] == texts[1]
    case = load_worst_case(Path("hil-out/worst-iterative.json"))
    assert 9 <= len(case.points) <= 40
    capsys.readouterr()
    assert run("profile", "worst", "--replay", "hil-out/worst-iterative.json") == 0
    assert capsys.readouterr().out.endswith(" cycles (cortex-m4-trm/3@sram), the saved count\n")


@pytest.mark.slow
def test_an_interrupted_search_keeps_the_worst_so_far(elf: Path, tmp_path: Path) -> None:
    screen, terminal = pty.openpty()
    words = ["--firmware", str(elf), "set_bits", "0..255", "--seconds", "60", "--out", str(tmp_path / "w.json")]
    process = subprocess.Popen(
        [sys.executable, "-m", "hiltest", "worst", *words], stdout=subprocess.PIPE, stderr=terminal, text=True
    )
    shown = b""
    while b"cycles so far" not in shown:
        shown += os.read(screen, 1000)
    process.send_signal(signal.SIGINT)
    told, _ = process.communicate(timeout=30)
    assert process.returncode == 2
    assert "saved in" in told
    assert load_worst_case(tmp_path / "w.json").calls >= 1
    os.close(screen)
    os.close(terminal)


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (("set_bits",), "no argument has a range"),
        (("set_bits", "9..1"), "with LOW less than HIGH"),
        (("set_bit", "0..1"), "near: set_bits"),
        (("sort", "int8:5:0..300", "5"), "int8 has whole numbers from -128 to 127"),
        (("sort", "int16:0:0..3", "5"), "at least one number"),
        (("sort", "int16:99999999:0..3", "5"), "not more than fit into the RAM"),
        (("sort", "int16:@/etc/hostname", "0..5"), "the content of a file cannot be saved"),
        (("set_bits", "0..9", "--returns", "many"), "write LOW..HIGH"),
        (("set_bits", "0..9", "--calls", "5", "--seconds", "5"), "exclude each other"),
        ((), "name a FUNCTION"),
    ],
)
def test_what_cannot_be_searched_is_refused(
    elf: Path, words: tuple[str, ...], reason: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert worst(elf, *words) == 4
    assert reason in capsys.readouterr().err
    assert not Path("worst.json").exists()


GOOD = {
    "schema": "hiltest.worst-case/1",
    "function": "set_bits",
    "cycles": 5,
    "cycle_model": "m",
    "elf": "a.elf",
    "elf_sha256": "0",
    "hiltest": "0.1.0",
    "seed": 1,
    "calls": 1,
    "points": [],
    "arguments": ["1"],
}


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"schema": "hiltest.run/1"}, 'schema is "hiltest.run/1"'),
        ({"more": 1}, "more"),
        ({"cycles": "5"}, "cycles"),
        ({"cycles": -1}, "at least 1"),
        ({"arguments": []}, "either points or arguments"),
        ({"points": [[1, 2, 3]]}, "either points or arguments"),
        ({"arguments": [], "points": [[1, 2, 99999]]}, "out of the range of int16"),
        ({"arguments": [], "points": [[1, 2]]}, "points"),
        ({"arguments": [], "points": [[1, 2, 3]] * 513}, "513 points"),
        ({"arguments": ["@/etc/passwd"]}, "the content of a file"),
        ({"arguments": ["ptr:@/etc/passwd"]}, "the content of a file"),
        ({"function": "a\x1b[2J"}, "is not a name"),
        ({"function": "nothing"}, "no function 'nothing'"),
    ],
    ids=str,
)
def test_a_hostile_file_is_refused(
    elf: Path, change: dict[str, object], reason: str, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("hostile.json").write_text(json.dumps(GOOD | change))
    assert run("profile", "worst", "--replay", "hostile.json", "--firmware", str(elf)) == 4
    error = capsys.readouterr().err
    assert reason in error
    assert "\x1b" not in error
