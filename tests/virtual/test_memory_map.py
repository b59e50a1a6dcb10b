"""Functions of images for other parts run unmodified on those parts' memories, and their peripherals are nobody's."""

from __future__ import annotations

import subprocess
from dataclasses import replace

import numpy as np
import pytest

import hiltest
from hiltest.errors import BoardFault, ConfigError
from hiltest.virtual.board.k64f import VirtualK64F, board_for
from hiltest.virtual.board.memory_map import memory_map
from hiltest.virtual.processor.memory import MK64FN1M0
from hiltest.virtual.program.elf import load_image

from .conftest import FLAGS, PROGRAMS

SOURCE = """
#include <stdint.h>
static const uint16_t weights[4] = {1, 10, 100, 1000};
int16_t scale[2] = {2, 3};
static int32_t history[8];
int dot(const int16_t *a, int n) {
    int s = 0;
    for (int k = 0; k < n; k++) { history[k] = a[k] * weights[k] * scale[k & 1]; s += history[k]; }
    return s;
}
uint32_t port(uint32_t address) { return *(volatile uint32_t *)address; }
void drive(uint32_t address) { *(volatile uint32_t *)address = 1; }
uint32_t ticks(uint32_t count) {
    volatile uint32_t *systick = (volatile uint32_t *)0xE000E010;
    systick[1] = count - 1; systick[2] = 0; systick[0] = 5;
    while (!(systick[0] >> 16 & 1)) { }
    return systick[1];
}
int main(void) { return 0; }
"""
SCRIPT = """
MEMORY {{ code (rx) : ORIGIN = {code}, LENGTH = 64K  data (rwx) : ORIGIN = {data}, LENGTH = 16K }}
SECTIONS {{
    .vectors : {{ KEEP(*(.vectors)) }} > code
    .text : {{ *(.text*) *(.rodata*) }} > code
    .data : {{ data_start = .; *(.data*) . = ALIGN(4); data_end = .; }} > data AT > code
    data_load = LOADADDR(.data);
    .bss (NOLOAD) : {{ bss_start = .; *(.bss*) . = ALIGN(4); bss_end = .; }} > data
    stack_top = ORIGIN(data) + LENGTH(data);
}}
"""
#: First addresses of flash and RAM.
PARTS = {
    "K64F": (0x0, 0x20000000),
    "STM32F4": (0x08000000, 0x20000000),
    "CCM": (0x08000000, 0x10000000),
    "SAM4": (0x400000, 0x20000000),
    "LPC4088": (0x0, 0x10000000),
    "QSPI": (0x90000000, 0x20000000),
}


@pytest.fixture
def linked(tmp_path, require_tool):
    """Return a function that links the program to two addresses."""
    compiler, source = require_tool("arm-none-eabi-gcc"), tmp_path / "program.c"
    source.write_text(SOURCE)
    flags = [flag for flag in FLAGS if "-T," not in flag]

    def link(code: int, data: int):
        script, elf = (tmp_path / f"{code:x}-{data:x}.{kind}" for kind in ("ld", "elf"))
        script.write_text(SCRIPT.format(code=hex(code), data=hex(data)))
        command = [compiler, *flags, f"-Wl,-T,{script}", str(PROGRAMS / "start.S"), str(source), "-o", str(elf)]
        subprocess.run(command, check=True, timeout=60)
        return elf

    return link


@pytest.mark.parametrize("part", PARTS)
def test_a_function_answers_and_counts_as_on_the_k64f_wherever_it_is_linked(linked, part):
    home = board_for(linked(*PARTS["K64F"])).call("dot", np.array([1, 2, 3, 4], np.int16), 4)
    away = board_for(linked(*PARTS[part]))
    result = away.call("dot", np.array([1, 2, 3, 4], np.int16), 4)
    # A load of data behind one of a constant takes a cycle more, unless both are on the same side of the buses.
    code, data = PARTS[part]
    is_one_bus = (code < 0x20000000) == (data < 0x20000000)
    assert replace(result, cycles=result.cycles + 4 * is_one_bus) == home
    assert home.value == 2 + 60 + 600 + 12000
    assert isinstance(away, VirtualK64F) == (part == "K64F")
    assert (away.memory == MK64FN1M0) == (part == "K64F")


@pytest.mark.parametrize("part", ["STM32F4", "LPC4088"])
def test_a_peripheral_of_another_part_is_an_error_that_names_the_access(linked, part):
    board = board_for(linked(*PARTS[part]))
    sim_of_the_k64f = 0x40047000
    for address in (0x40020014, sim_of_the_k64f, 0x50000504, 0x42000000):
        with pytest.raises(BoardFault, match=f"read of .*0x{address:08x}.* in port"):
            board.call("port", address)
        with pytest.raises(BoardFault, match=f"write to .*0x{address:08x}.* in drive"):
            board.call("drive", address)
    assert board.call("port", 0xE000ED00).value == 0x410FC241  # the core's own: CPUID
    assert board.unmodelled == ()


def test_the_chip_tells_which_part_and_how_much_memory_it_is(linked):
    board = board_for(linked(*PARTS["K64F"]))
    identification = board.call("port", 0x40048024).value
    assert (identification >> 28, identification >> 24 & 0xF, identification & 0xF) == (6, 4, 8)  # K6x, K64, 100 pins
    assert str(board.memory) == "flash=0x00000000:1024K,ram=0x1fff0000:256K"
    assert board.call("port", 0x2002FFFC).value == 0
    with pytest.raises(BoardFault, match="read of unmapped address 0x20030000"):
        board.call("port", 0x20030000)


def test_the_core_of_another_part_waits_for_its_systick_as_the_k64fs_does(linked):
    home, away = (board_for(linked(*PARTS[part])).call("ticks", 100_000) for part in ("K64F", "STM32F4"))
    assert away == home
    assert 100_000 < home.cycles < 100_100


def test_a_board_that_is_to_boot_takes_no_image_of_another_part(linked):
    with pytest.raises(ConfigError, match=r"for another chip .*, as on STM32.* link for 1 MiB of flash at 0"):
        VirtualK64F(linked(*PARTS["STM32F4"]))


def test_named_memories_make_it_another_part_also_where_the_k64f_has_some(linked):
    elf = linked(*PARTS["K64F"])
    assert board_for(elf).call("port", 0x40047000).value is not None
    board = board_for(elf, memory="flash=0:512K, ram=0x20000000:64K")  # an nRF52832
    with pytest.raises(
        BoardFault, match="0x40047000, where no peripheral is modelled: the memories are another part's"
    ):
        board.call("port", 0x40047000)
    with pytest.raises(BoardFault, match="read of unmapped address 0x20010000"):
        board.call("port", 0x20010000)
    with pytest.raises(BoardFault, match="write to flash at address 0x00000100"):
        board.call("drive", 0x100)


def test_the_same_cycles_are_counted_by_the_profiler_which_names_the_memory(linked):
    elf = linked(*PARTS["STM32F4"])
    image = hiltest.cycles(elf)
    counted = image.call("dot", np.array([1, 2], np.int16), 2)
    assert counted.cycle_model == "cortex-m4-trm/3@flash"
    assert counted.cycles == board_for(elf).call("dot", np.array([1, 2], np.int16), 2).cycles
    with pytest.raises(ConfigError, match="cortex-m4-k64f/3 prices the K64F's memories"):
        hiltest.cycles(elf, profile="cortex-m4-k64f/3")


def test_the_guess_covers_what_is_loaded_and_leaves_room_for_arguments(linked):
    assert str(memory_map(load_image(linked(*PARTS["CCM"])))) == (
        "flash=0x08000000:64K,ram=0x10000000:192K,ram=0x20000000:128K"
    )
    large = bytearray(100_000)
    board = board_for(linked(*PARTS["SAM4"]))
    assert board.call("port", 0x20000000).value == 0x00030002  # initialised data, as start-up code would leave it
    assert board.call("dot", large, 0).value == 0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "'' is not a memory; write it as flash="),
        ("rom=0:1K,ram=0x20000000:4K", "'rom=0:1K' is not a memory"),
        ("flash=0:512K", "has no RAM"),
        ("ram=0x20000000:1K", "0x20000000:0x400 is not a multiple of 4 KiB"),
        ("ram=0x20000000:0", "is not a multiple of 4 KiB"),
        ("ram=0x40000000:4K", "outside the processor's memory regions"),
        ("ram=0x3ffff000:8K", "outside the processor's memory regions"),
        ("ram=0xffffffff:4096", "is not a multiple of 4 KiB"),
        ("ram=0x20000000:99999M", "is not a memory|is outside the processor"),
        ("ram=0x20000000:128M", "outside the processor's memory regions"),
        ("ram=0x60000000:128M", "exceed 64 MiB"),
        ("flash=0x20000000:64K,ram=0x20008000:64K", "overlap"),
        ("ram=0x1ffe0000:128K", "0x1ffef000, the return address of called functions"),
        ("flash=0x08000000:64K,ram=0x20000000:64K", "does not fit the memories flash=0x08000000"),
    ],
)
def test_memories_that_cannot_be_are_refused(linked, text, message):
    elf = linked(*PARTS["K64F"])
    with pytest.raises(ConfigError, match=message):
        board_for(elf, memory=text).call("dot", b"", 0)
