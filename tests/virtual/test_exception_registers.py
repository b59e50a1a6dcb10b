"""What a handler reads about the exception that it is, and about those that wait."""

from __future__ import annotations

import pytest

from hiltest.virtual.board.k64f import VirtualK64F

from .conftest import Build
from .test_exceptions import word

REGISTERS = """
#include <stdint.h>
#define REGISTER(address) (*(volatile uint32_t *)(address))
#define PRIORITY(number) (*(volatile uint8_t *)(0xE000E400u + (number)))
#define ISER REGISTER(0xE000E100u)
#define ISPR REGISTER(0xE000E200u)
#define ICSR REGISTER(0xE000ED04u)
volatile uint32_t found, found_after, stacks_differ;
static uint64_t task_stack[64];
"""


@pytest.mark.parametrize("unprivileged", [0, 1])
def test_a_handler_reads_that_it_runs_on_the_main_stack(build_c: Build, unprivileged: int) -> None:
    source = f"""{REGISTERS}
void SVC_Handler(void)
{{
    uint32_t control, sp, msp;
    __asm volatile("mrs %0, control\\n\\tmov %1, sp\\n\\tmrs %2, msp" : "=r"(control), "=r"(sp), "=r"(msp));
    found = control;
    stacks_differ = sp != msp;
}}
int main(void)
{{
    __asm volatile("msr psp, %0\\n\\tmsr control, %1\\n\\tisb" ::"r"(task_stack + 64), "r"(2 | {unprivileged}));
    __asm volatile("svc 0");
    uint32_t control;
    __asm volatile("mrs %0, control" : "=r"(control));
    found_after = control;
    for (;;) {{
        __asm volatile("nop");
    }}
}}
"""
    board = VirtualK64F(build_c(source))
    board.run_until(0.001)
    assert word(board, "found") == unprivileged  # nPRIV stays, SPSEL does not
    assert word(board, "stacks_differ") == 0
    assert word(board, "found_after") == 2 | unprivileged


def test_what_waits_behind_the_handler_that_runs_is_shown_as_pending(build_c: Build) -> None:
    source = f"""{REGISTERS}
void Interrupt1_Handler(void)
{{
    ISPR = 1u << 3; /* less urgent than this one */
    found = ICSR >> 12 & 0x1FFu;
}}
void Interrupt3_Handler(void)
{{
    found_after = ICSR >> 12 & 0x1FFu;
}}
int main(void)
{{
    PRIORITY(1) = 0x40;
    PRIORITY(3) = 0x80;
    ISER = 0xA;
    ISPR = 1u << 1;
    return 0;
}}
"""
    board = VirtualK64F(build_c(source))
    board.run_until(0.001)
    assert (word(board, "found"), word(board, "found_after")) == (16 + 3, 0)
