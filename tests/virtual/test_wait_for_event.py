"""WFE sleeps until an event, and takes it."""

from __future__ import annotations

import pytest

from hiltest.errors import BoardFault
from hiltest.virtual.board.k64f import VirtualK64F

from .conftest import Build, follow, word

PROGRAM = """
#include <stdint.h>
#define REGISTER(address) (*(volatile uint32_t *)(address))
#define SYST_CSR REGISTER(0xE000E010u)
#define SYST_RVR REGISTER(0xE000E014u)
#define SYST_CVR REGISTER(0xE000E018u)
#define ISPR REGISTER(0xE000E200u)
#define SCR REGISTER(0xE000ED10u)
volatile uint32_t ticks, rounds;
void SysTick_Handler(void)
{
    ticks++;
}
static void tick_every(uint32_t cycles)
{
    SYST_RVR = cycles - 1u;
    SYST_CVR = 0u;
    SYST_CSR = 7u;
}
int main(void)
{
    %s
    for (;;) {
        __asm volatile("nop");
    }
}
"""


@pytest.mark.parametrize("wait", ["wfe", "wfe.w"])
def test_it_sleeps_from_interrupt_to_interrupt(build_c: Build, wait: str) -> None:
    elf = build_c(PROGRAM % f'tick_every(2097); for (;;) {{ __asm volatile("{wait}"); rounds++; }}')
    board = VirtualK64F(elf)
    follow(board, {0.01: {"ticks": 99}})  # every 100 us at 20.97 MHz; the first comes after some start-up code
    assert 99 <= word(board, "rounds") <= 2 * 99  # a handler's entry is an event, and so is its return
    assert board.processor.idle_cycles > 0.97 * board.cycles  # a tick takes 45 of its 2 097 cycles


def test_an_event_that_was_sent_is_taken_once(build_c: Build) -> None:
    elf = build_c(
        PROGRAM % '__asm volatile("sev"); __asm volatile("wfe"); rounds = 1; __asm volatile("wfe"); rounds = 2;'
    )
    board = VirtualK64F(elf)
    with pytest.raises(BoardFault, match="hang: WFE without anything that could wake the processor"):
        board.run_until(float("inf"))
    assert word(board, "rounds") == 1


MASKED = 'SCR = %du << 4; __asm volatile("cpsid i"); tick_every(12000); __asm volatile("wfe"); rounds = 1;'


def test_a_masked_interrupt_is_an_event_where_firmware_says_so(build_c: Build) -> None:
    board = VirtualK64F(build_c(PROGRAM % (MASKED % 1)))
    follow(board, {0.001: {"ticks": 0, "rounds": 1}})
