"""Samples that a firmware keeps: laid out by sample or by axis, and cells that are empty."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from hiltest.errors import ConfigError
from hiltest.interfaces.sample_buffer import SampleBuffer
from hiltest.interfaces.variables import Variables
from hiltest.virtual.program.elf import load_image

from .compiled import InitialMemory, compile_c

SOURCE = """
#include <stdint.h>
int16_t samples[3][3] = { { 1, -2, 3 }, { 4, 5, -6 }, { 7, 8, 9 } };
struct { int32_t index[2][2]; int16_t axes[3][2][2]; int16_t two[2]; } buffer = {
    { { 0, -1 }, { 70000, 5 } },
    { { { 1, 2 }, { 3, 4 } }, { { 10, 20 }, { 30, -40 } }, { { 100, 200 }, { 300, 400 } } },
};
int main(void)
{
    __asm volatile("" :: "r"(&samples), "r"(&buffer) : "memory");
    for (;;) { }
}
"""
BY_AXIS = tuple(f"buffer.axes[{axis}]" for axis in range(3))


@pytest.fixture
def buffer(tmp_path: Path, require_tool: Callable[[str], str]) -> Callable[..., list[list[float]]]:
    """Return a function that reads a buffer out of a program's memory."""
    image = load_image(compile_c(require_tool("arm-none-eabi-gcc"), tmp_path, SOURCE))
    memory, variables = InitialMemory(image), Variables(image)
    return lambda *paths, used=None: SampleBuffer(paths, used, variables).counts(memory).tolist()


def test_samples_lie_one_behind_the_other(buffer: Callable[..., list[list[float]]]) -> None:
    assert buffer("samples") == [[1, -2, 3], [4, 5, -6], [7, 8, 9]]


def test_axes_lie_apart_and_what_has_no_index_is_empty(buffer: Callable[..., list[list[float]]]) -> None:
    assert buffer(*BY_AXIS) == [[1, 10, 100], [2, 20, 200], [3, 30, 300], [4, -40, 400]]
    assert buffer(*BY_AXIS, used="buffer.index") == [[1, 10, 100], [3, 30, 300], [4, -40, 400]]


@pytest.mark.parametrize(
    ("paths", "used", "says"),
    [
        (("buffer.two",), None, "three numbers each, or one to each axis (buffer.two is int16_t[2])"),
        (BY_AXIS[:2], None, "three numbers each, or one to each axis"),
        ((*BY_AXIS[:2], "buffer.two"), None, "buffer.two is int16_t[2]"),
        (BY_AXIS, "buffer.two", "buffer.two is int16_t[2], and the buffer has 4 cells"),
        (("smaples",), None, "nearest: samples"),
    ],
)
def test_what_is_no_buffer_is_refused(
    buffer: Callable[..., list[list[float]]], paths: tuple[str, ...], used: str | None, says: str
) -> None:
    with pytest.raises(ConfigError) as refused:
        buffer(*paths, used=used)
    assert says in str(refused.value)
