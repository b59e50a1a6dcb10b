"""The STM32F411 Discovery: programs that set up clocks, send bytes, wait by timers and switch LEDs."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from hiltest.errors import ConfigError
from hiltest.virtual.board.described_machine import DescribedMachine
from hiltest.virtual.part.machine_file import load_machine

LINK = """
MEMORY { flash (rx) : ORIGIN = 0x08000000, LENGTH = 512K  ram (rwx) : ORIGIN = 0x20000000, LENGTH = 128K }
SECTIONS {
  .text : { KEEP(*(.vectors)) *(.text*) *(.rodata*) } > flash
  .bss (NOLOAD) : { *(.data*) *(.bss*) } > ram
}
"""
START = """
#include <stdint.h>
#define R(address) (*(volatile uint32_t *)(address))
#define RCC(offset) R(0x40023800 + (offset))
#define USART2(offset) R(0x40004400 + (offset))
#define TIM2(offset) R(0x40000000 + (offset))
#define GPIO(port, offset) R(0x40020000 + 0x400 * (port) + (offset))
void main(void);
__attribute__((weak)) void handle(void); /* 0 in a program without it */
__attribute__((section(".vectors"), used)) void *const vectors[102] = {
    (void *)0x20020000, main, handle, handle, handle, handle, handle, [11] = handle, [14] = handle, [15] = handle,
    [16 + 17] = handle, [16 + 28] = handle, [16 + 38] = handle,
};
/* 96 MHz of the crystal: 8 MHz / 8 * 192 / 2, APB1 by 2. */
static inline void begin_clocks(void)
{
    RCC(0x40) |= 1u << 28;
    RCC(0x00) |= 1u << 16;
    while (!(RCC(0x00) & 1u << 17)) {}
    RCC(0x04) = 8 | 192 << 6 | 1u << 22 | 8u << 24;
    RCC(0x00) |= 1u << 24;
    while (!(RCC(0x00) & 1u << 25)) {}
    R(0x40023C00) = 3 | 7u << 8;
    RCC(0x08) = 2 | 4u << 10;
    while ((RCC(0x08) & 0xC) != 8) {}
}
static inline void begin_serial(void)
{
    RCC(0x30) |= 1;
    RCC(0x40) |= 1u << 17;
    GPIO(0, 0x00) |= 2u << 4 | 2u << 6;
    GPIO(0, 0x20) |= 7u << 8 | 7u << 12;
    USART2(0x08) = 417;  /* 48 MHz / 115200 */
    USART2(0x0C) = 1u << 13 | 1u << 3 | 1u << 2;
}
static inline void send(char byte)
{
    while (!(USART2(0x00) & 0x80)) {}
    USART2(0x04) = (uint8_t)byte;
}
static inline void begin_microseconds(void)
{
    RCC(0x40) |= 1;
    TIM2(0x28) = 95;
    TIM2(0x14) = 1;
    TIM2(0x00) = 1;
}
volatile uint32_t seen[8];
"""

Run = Callable[..., DescribedMachine]


@pytest.fixture
def board(tmp_path: Path, require_tool: Callable[[str], str]) -> Run:
    """Return a function that compiles a program behind START and puts it onto the board."""
    compiler = require_tool("arm-none-eabi-gcc")

    def make(source: str) -> DescribedMachine:
        (tmp_path / "link.ld").write_text(LINK)
        (tmp_path / "program.c").write_text(START + source)
        elf = tmp_path / "program.elf"
        flags = ["-mcpu=cortex-m4", "-mthumb", "-Og", "-g", "-nostdlib", "-ffreestanding", "-Wl,-T,link.ld"]
        subprocess.run([compiler, *flags, "program.c", "-o", str(elf)], cwd=tmp_path, check=True, timeout=60)
        return DescribedMachine("stm32f411-disco", elf)

    return make


def seen(board: DescribedMachine) -> tuple[int, ...]:
    return board.processor.memory.read_words(board.image.symbols["seen"].address, 8)


def test_a_program_sets_up_the_pll_and_sends_a_line(board: Run) -> None:
    machine = board("void main(void) { begin_clocks(); begin_serial(); send('o'); send('k'); for (;;) {} }")
    machine.run_until(0.01)
    clocks = machine.clocks
    assert (clocks.core_hz, machine.uart0.host_read(10)) == (96e6, b"ok")
    assert [float(clock.hz) for clock in (clocks.pclk1, clocks.pclk2, clocks.timers1)] == [48e6, 96e6, 96e6]
    assert machine.uart0.baud == pytest.approx(115_200, rel=1e-3)


def test_bytes_of_the_host_interrupt_and_are_echoed(board: Run) -> None:
    machine = board(
        "void handle(void) { send(USART2(4) + 1); }"
        "void main(void) { begin_clocks(); begin_serial(); USART2(0xC) |= 1 << 5; R(0xE000E104) = 1 << 6; for (;;) {} }"
    )
    machine.run_until(0.01)
    machine.uart0.host_write(b"abc")
    machine.run_until(0.02)
    assert machine.uart0.host_read(10) == b"bcd"


def test_a_byte_that_nobody_reads_is_kept_and_the_next_one_is_an_overrun(board: Run) -> None:
    machine = board("void main(void) { begin_clocks(); begin_serial(); while (!(seen[0] = USART2(0) & 8)) {}"
                    " seen[1] = USART2(4); seen[2] = USART2(0) & 0x28; for (;;) {} }")  # fmt: skip
    machine.run_until(0.01)
    machine.uart0.host_write(b"xy")
    machine.run_until(0.02)
    assert seen(machine)[:3] == (8, ord("x"), 0)


def test_another_speed_than_that_of_the_line_is_named(board: Run) -> None:
    machine = board("void main(void) { begin_clocks(); begin_serial(); USART2(8) = 5000; for (;;) {} }")
    machine.run_until(0.01)
    assert machine.uart0.wrong_speed.startswith("the firmware runs USART2 at 9600 baud, and the line is read at 115200")


def test_a_timer_counts_microseconds_and_interrupts_at_its_period(board: Run) -> None:
    machine = board(
        "void handle(void) { TIM2(0x10) = ~1u; seen[0]++; }"
        "void main(void) { begin_clocks(); begin_microseconds(); seen[1] = TIM2(0x24);"
        " while (TIM2(0x24) < 500) {} seen[2] = TIM2(0x24); TIM2(0x24) = 0; TIM2(0x2C) = 999; TIM2(0x10) = 0;"
        " TIM2(0x0C) = 1; R(0xE000E100) = 1 << 28; for (;;) {} }"
    )
    machine.run_until(0.002 + 0.0002 + 0.0005 + 0.01)
    assert seen(machine)[1:3] == (0, 500)
    assert seen(machine)[0] in (9, 10)  # the start of the oscillators takes 2.2 ms, the set-up some microseconds


def test_a_compare_event_sets_its_flag_at_its_count(board: Run) -> None:
    machine = board(
        "void main(void) { begin_clocks(); TIM2(0x34) = 0; begin_microseconds(); TIM2(0x34) = 300; TIM2(0x10) = 0;"
        " while (!(TIM2(0x10) & 2)) {} seen[0] = TIM2(0x24); for (;;) {} }"
    )
    machine.run_until(0.01)
    assert seen(machine)[0] in (300, 301)


def test_pins_light_leds_and_read_the_button(board: Run) -> None:
    machine = board(
        "void main(void) { RCC(0x30) = 9; GPIO(3, 0) = 1 << 24; GPIO(3, 0x18) = 1 << 12;"
        " for (;;) seen[0] = GPIO(0, 0x10) & 1; }"
    )
    machine.run_until(0.001)
    assert (machine.is_on("LED green"), machine.is_on("LED red"), seen(machine)[0]) == (True, False, 0)
    machine.press("button USER")
    machine.run_until(0.002)
    assert seen(machine)[0] == 1


def test_a_block_without_its_clock_reads_as_zero_and_is_named(board: Run) -> None:
    machine = board("void main(void) { TIM2(0x2C) = 7; seen[0] = 1 + TIM2(0x2C); for (;;) {} }")
    machine.run_until(0.001)
    assert seen(machine)[0] == 1
    assert "TIM2_ARR at 0x4000002c has no clock, because RCC does not enable TIM2; write of" in str(
        machine.unmodelled[0]
    )


def test_a_block_without_a_model_is_named(board: Run) -> None:
    machine = board("void main(void) { RCC(0x44) = 1 << 8; R(0x40012000) = 4; for (;;) {} }")
    machine.run_until(0.001)
    assert "ADC1+0x000 at 0x40012000 is not modelled; write of 0x00000004" in str(machine.unmodelled[0])


def test_flash_is_seen_at_address_0_and_the_identity_in_system_memory(board: Run) -> None:
    machine = board(
        "void main(void) { seen[0] = R(4 + 0 * seen[7]) == R(0x08000004); seen[1] = R(0x1FFF7A20) >> 16; for (;;) {} }"
    )
    machine.run_until(0.001)
    assert seen(machine)[:2] == (1, 512)


def test_a_snapshot_restores_clocks_timer_and_bytes(board: Run) -> None:
    machine = board(
        "void main(void) { begin_clocks(); begin_serial(); begin_microseconds();"
        " for (;;) { while (TIM2(0x24) < 1000) {} TIM2(0x24) = 0; send('0' + (seen[0]++ & 7)); } }"
    )
    machine.run_until(0.01)
    before = machine.snapshot()
    machine.uart0.host_read(100)
    machine.run_until(0.03)
    first = machine.uart0.host_read(100)
    machine.restore(before)
    machine.uart0.host_read(100)
    machine.run_until(0.03)
    assert first == machine.uart0.host_read(100)


def test_a_machine_that_does_not_exist_is_refused_with_the_names_of_those_that_do() -> None:
    with pytest.raises(ConfigError, match="known: frdm-k64f, microbit-v1, stm32f407-disco, stm32f411-disco"):
        load_machine("stm32f999-disco")


@pytest.mark.parametrize(("prescaler", "timpre", "timers_mhz"), [(4, 0, 96), (5, 0, 48), (5, 1, 96), (6, 1, 48)])
def test_timers_count_twice_the_clock_of_a_divided_bus_and_four_times_with_timpre(
    board: Run, prescaler: int, timpre: int, timers_mhz: float
) -> None:
    machine = board(
        "void main(void) { begin_clocks(); "
        f"RCC(0x08) = 2 | {prescaler}u << 10; RCC(0x8C) = {timpre}u << 24; for (;;) {{}} }}"
    )
    machine.run_until(0.01)
    assert float(machine.clocks.timers1.hz) == timers_mhz * 1e6


def test_an_erased_and_programmed_word_is_read_back_and_the_core_stops_meanwhile(board: Run) -> None:
    machine = board(
        "#define FLASH(offset) R(0x40023C00 + (offset))\n"
        "void main(void) { begin_clocks(); begin_microseconds(); FLASH(4) = 0x45670123; FLASH(4) = 0xCDEF89AB;"
        " R(0x08060000) = 0; seen[4] = FLASH(0xC); FLASH(0xC) = 0xF0;"  # PG is not set: a sequence error
        " FLASH(0x10) = 2 << 8 | 2 | 7 << 3; uint32_t begin = TIM2(0x24); FLASH(0x10) |= 1 << 16;"
        " while (FLASH(0xC) & 1 << 16) seen[3]++; seen[0] = (TIM2(0x24) - begin) / 1000; FLASH(0x10) = 2 << 8 | 1;"
        " R(0x08060000) = 0x12345678; seen[1] = R(0x08060000); R(0x08060000) = 0xFFFF0000; seen[2] = R(0x60000);"
        " for (;;) {} }"
    )
    machine.run_until(1.1)
    assert seen(machine)[:5] == (1000, 0x12345678, 0x12340000, 0, 0x80)


def test_the_stores_of_a_locked_flash_change_nothing(board: Run) -> None:
    machine = board(
        "#define FLASH(offset) R(0x40023C00 + (offset))\n"
        "void main(void) { FLASH(4) = 1; FLASH(4) = 0x45670123; FLASH(4) = 0xCDEF89AB; FLASH(0x10) = 1 | 2 << 8;"
        " seen[0] = FLASH(0x10); R(0x08060000) = 7; seen[1] = R(0x08060000); seen[2] = FLASH(0xC); for (;;) {} }"
    )
    machine.run_until(0.001)
    assert seen(machine)[:3] == (0x80000000, 0xFFFFFFFF, 0x80)  # a wrong key locks until the next reset


def test_dma_sends_a_line_and_interrupts_at_its_half_and_at_its_end(board: Run) -> None:
    machine = board(
        "#define DMA1(offset) R(0x40026000 + (offset))\n"
        'static const char LINE[] = "compass\\n";'
        "void handle(void) { seen[seen[0] + 1] = DMA1(0x04); DMA1(0x0C) = 0x3D << 16; seen[0]++; }"
        "void main(void) { begin_clocks(); begin_serial(); RCC(0x30) |= 1 << 21; USART2(0x14) = 0x80;"
        " DMA1(0xA8) = 0x40004404; DMA1(0xAC) = (uint32_t)LINE; DMA1(0xA4) = 8; R(0xE000E100) = 1 << 17;"
        " DMA1(0xA0) = 4 << 25 | 1 << 10 | 1 << 6 | 0x1F; for (;;) {} }"
    )
    machine.run_until(0.01)
    assert machine.uart0.host_read(20) == b"compass\n"
    assert seen(machine)[:3] == (2, 1 << 20, 1 << 21)
    assert machine.bus.read(0x400260A0, 4) & 1 == 0  # the stream has ended
