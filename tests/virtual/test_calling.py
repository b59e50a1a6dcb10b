"""Functions are called as the C compiler would call them, whatever they take and however floats are passed."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hiltest.errors import BoardFault, ConfigError
from hiltest.virtual.board.k64f import VirtualK64F

from .conftest import FLAGS, PROGRAMS, Build

# Every argument has a weight of its own: one in a wrong place shows.
SOURCE = """
#include <stdbool.h>
#include <stdint.h>
struct three { float x, y, z; };
int main(void) { return 0; }
float two(float a, float b) { return a - 10.0f * b; }
float mixed(float a, int b, float c, double d, float e, int f) {
    return a + 10.0f * (float)b + 100.0f * c + 1000.0f * (float)(int)d + 10000.0f * e + 100000.0f * (float)f;
}
double wide_floats(float a, double b, float c, double d) { return a + 10.0 * b + 100.0 * (double)c + 1000.0 * d; }
int64_t wide(int a, int64_t b, int c, int64_t d) { return a + 10 * b + 100 * c + 1000 * d; }
uint64_t product(uint32_t a, uint32_t b) { return (uint64_t)a * b; }
bool negative(int a) { return a < 0; }
float sum(const float *restrict values, int count) {
    float total = 0.0f;
    for (int k = 0; k < count; k++) total += values[k];
    return total;
}
struct three make(float x) { return (struct three){x, x, x}; }
float taken(struct three v) { return v.x; }
int poll(void) { int n = 0; while (!(*(volatile uint32_t *)0x20000100)) n++; return n; }
"""


@pytest.fixture(scope="module", params=["hard", "softfp", "soft"])
def elf(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory, require_tool: Callable[[str], str]
) -> Path:
    """An image whose floats are passed as the parameter says, with the compiler's library for what the FPU lacks."""
    folder = tmp_path_factory.mktemp(request.param)
    compiler, source, elf = require_tool("arm-none-eabi-gcc"), folder / "program.c", folder / "program.elf"
    source.write_text(SOURCE)
    # One float ABI only: by two the compiler driver chooses a library of Arm code.
    flags = [flag for flag in FLAGS if not flag.startswith("-mfloat-abi")] + [f"-mfloat-abi={request.param}"]
    command = [compiler, *flags, str(PROGRAMS / "start.S"), str(source), "-lgcc", "-o", str(elf)]
    subprocess.run(command, check=True, timeout=60)
    return elf


@pytest.fixture
def board(elf: Path) -> VirtualK64F:
    return VirtualK64F(elf)


@pytest.mark.parametrize(
    ("function", "arguments", "answer"),
    [
        ("two", (1.5, 2.0), -18.5),
        ("mixed", (1.0, 2, 3.0, 4.0, 5.0, 6), 654321.0),
        ("wide_floats", (1.0, 2.0, 3.0, 4.0), 4321.0),
        ("wide", (1, 2, 3, 4), 4321),
        ("wide", (-1, -2, -3, -4_000_000_000), -4_000_000_000_321),
        ("product", (4_000_000_000, 4_000_000_000), 16 * 10**18),
        ("negative", (-5,), 1),
    ],
)
def test_numbers_go_where_the_calling_convention_of_the_image_has_them(
    board: VirtualK64F, function: str, arguments: tuple[float, ...], answer: float
) -> None:
    assert board.call(function, *arguments).value == answer


def test_a_pointer_that_nothing_else_points_to_is_a_pointer(board: VirtualK64F) -> None:
    assert board.call("sum", np.array([1, 2, 4], np.float32), 3).value == 7.0


def test_numbers_of_numpy_are_passed_by_value(board: VirtualK64F) -> None:
    assert board.call("wide", np.int8(-1), np.int64(2), np.uint16(3), 4).value == 4319
    assert board.call("negative", np.bool_(True)).value == 0
    assert board.call("two", np.float32(1.5), np.int16(2)).value == -18.5


@pytest.mark.parametrize(
    ("function", "arguments", "reason"),
    [
        ("make", (1.0,), "make returns a struct"),
        ("taken", (1.0,), "argument 1 of taken is a struct"),
        ("two", (1e39, 0.0), r"argument 1 of two: 1e\+39 is beyond the largest float"),
        ("two", (0.0, b"12"), "argument 2 of two is float, not bytes"),
        ("negative", (1 << 32,), "4294967296 does not fit its 32 bits"),
        ("negative", (1.5,), "argument 1 of negative is signed, not float"),
        ("wide", (1, b"12345678", 3, 4), "argument 2 of wide is signed64, not a buffer"),
        ("sum", ([1.0, 2.0], 2), "argument 1 of sum cannot be list: pass a number, bytes"),
        ("sum", (np.zeros(6, np.float32)[::2], 3), "argument 1 of sum cannot be ndarray: .*contiguous"),
    ],
)
def test_what_cannot_be_passed_is_refused_and_says_which(
    board: VirtualK64F, function: str, arguments: tuple[object, ...], reason: str
) -> None:
    with pytest.raises(ConfigError, match=reason):
        board.call(function, *arguments)
    assert board.call("two", 1.0, 0.0).value == 1.0, "the board is as before"


CPP = """
namespace mag {
class Filter { float state; public: float update(float x, const float &gain); };
float Filter::update(float x, const float &gain) { state += gain * (x - state); return state; }
float blend(float a, float b) { return a - 2.0f * b; }
}
float twice(float a) { return 2.0f * a; }
int main() { return 0; }
"""


def test_functions_of_cpp_are_called_by_their_mangled_names(
    tmp_path: Path, build: Build, require_tool: Callable[[str], str]
) -> None:
    require_tool("arm-none-eabi-g++")  # whose compiler proper the driver of C calls for this file
    (tmp_path / "program.cpp").write_text(CPP)
    board = VirtualK64F(build(tmp_path / "program.cpp", with_start=False))
    assert board.call("_Z5twicef", 1.5).value == 3.0
    assert board.call("_ZN3mag5blendEff", 1, 2).value == -3.0
    state = np.array([1], np.float32)
    assert board.call("_ZN3mag6Filter6updateEfRKf", state, 3.0, np.array([0.5], np.float32)).value == 2.0 == state[0]
    with pytest.raises(ConfigError, match="no function 'mag::blend'; near: _ZN3mag5blendEff"):
        board.call("mag::blend", 1.0, 2.0)


def test_buffers_find_room_where_the_heap_gets_all_that_is_left(tmp_path: Path, build: Build) -> None:
    script = (PROGRAMS / "flash.ld").read_text()
    script = script.replace("stack_top =", ".heap (NOLOAD) : { . += 0x200; . = 0x2f000; } > sram\n    stack_top =")
    (tmp_path / "heap.ld").write_text(script)
    (tmp_path / "program.c").write_text("int main(void) { return 0; }\nint second(const int *v) { return v[1]; }\n")
    elf = build(tmp_path / "program.c", f"-Wl,-T,{tmp_path / 'heap.ld'}")
    board = VirtualK64F(elf)
    assert max(segment.run_address + segment.run_size for segment in board.image.segments) == 0x2002F000
    assert board.call("second", np.array([3, 7], np.int32)).value == 7
    with pytest.raises(ConfigError, match=r"the arguments need \d+ bytes more RAM than the image leaves free"):
        board.call("second", bytes(0x10008))


def test_a_function_that_waits_for_ever_ends_after_the_virtual_time_that_it_was_given(board: VirtualK64F) -> None:
    with pytest.raises(BoardFault, match="hang: poll did not return within 120000 cycles"):
        board.call("poll", timeout_s=0.001)


CLOCKED = """
int main(void) { for (;;) { } }
int negative(int a) { return a < 0; }
int poll(void) { while (!*(volatile unsigned *)0x20000100) { } return 1; }
"""


def test_a_call_takes_its_time_at_the_clock_that_was_named_and_at_the_firmwares_once_it_runs(build_c: Build) -> None:
    board = VirtualK64F(build_c(CLOCKED))
    assert (board.call("negative", 1).clock_hz, board.call("negative", 1, clock_hz=48e6).clock_hz) == (120e6, 48e6)
    with pytest.raises(BoardFault, match="poll did not return within 480000 cycles"):
        board.call("poll", timeout_s=0.01, clock_hz=48e6)
    board.run_until(0.001)
    assert board.call("negative", 1).clock_hz == board.clocks.core_hz == pytest.approx(20.97152e6)
    with pytest.raises(ConfigError, match=r"the running firmware has set up 20\.9715 MHz"):
        board.call("negative", 1, clock_hz=48e6)
