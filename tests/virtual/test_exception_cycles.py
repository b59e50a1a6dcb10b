"""What exceptions take by version 2 of the cycle model: handlers in a chain, floating-point state in frames."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from hiltest.virtual.model.profile_file import load_profile
from hiltest.virtual.model.timing import TimingProfile, moved

from .conftest import Build
from .oracle import ran
from .test_exceptions import word

Count = Callable[..., int]
ENTRY, RETURN, CHAIN, FRAME = 12, 10, 6, 17  # as the profile has them
BX = 1 + 2  # BX LR, which ends a handler: the branch, and the refill that every such branch pays
LAZY, AT_ONCE = "0xC0000000u", "0x80000000u"  # FPCCR with ASPEN, and LSPEN or not

# Interrupts that wait when PRIMASK is taken back run between two readings of the cycle counter.
PROGRAM = """
#include <stdint.h>
#define REGISTER(address) (*(volatile uint32_t *)(address))
volatile uint32_t cycles;
__attribute__((naked)) void Interrupt1_Handler(void) { __asm volatile(FIRST "\\n\\tbx lr"); }
__attribute__((naked)) void Interrupt2_Handler(void) { __asm volatile(SECOND "\\n\\tbx lr"); }
int main(void)
{
    uint32_t before, after;
    REGISTER(0xE000ED88u) |= 0xFu << 20; /* CPACR */
    REGISTER(0xE000EF34u) = STACKING;    /* FPCCR */
    REGISTER(0xE000EDFCu) |= 1u << 24;   /* DEMCR.TRCENA */
    REGISTER(0xE0001000u) |= 1u;         /* DWT.CYCCNTENA */
    __asm volatile("dsb\\n\\tisb\\n\\t" STATE ::: "s0");
    REGISTER(0xE000E100u) = 6u;
    __asm volatile("cpsid i");
    REGISTER(0xE000E200u) = PENDING;
    __asm volatile(
        ".balign 4\\n\\tdsb\\n\\tldr %0, [%2]\\n\\tcpsie i\\n\\tisb\\n\\tcpsid i\\n\\tisb\\n\\tldr %1, [%2]"
        : "=&r"(before), "=&r"(after) : "r"(0xE0001004u));
    cycles = after - before;
    for (;;) { __asm volatile("wfi"); }
}
"""
INTEGER, FLOATING = "nop", "vadd.f32 s1, s1, s1"


@pytest.fixture
def taken(build_c: Build) -> Count:
    """Return a function that counts the cycles from one reading to the other."""

    def count(
        pending: int, first: str = INTEGER, second: str = INTEGER, *, state: str = "nop", stacking: str = LAZY,
        profile: TimingProfile | None = None,
    ) -> int:  # fmt: skip
        texts = {"FIRST": first, "SECOND": second, "STATE": state}
        defines = [f'-D{name}="{text}"' for name, text in texts.items()]
        elf = build_c(PROGRAM, f"-DPENDING={pending}u", f"-DSTACKING={stacking}", *defines)
        board = ran(elf, 0.001, profile or load_profile("cortex-m4-trm/2"))
        return word(board, "cycles")

    return count


def test_a_handler_takes_an_entry_and_a_return(taken: Count) -> None:
    assert taken(0b010) - taken(0) == ENTRY + 1 + BX + RETURN


def test_an_exception_that_waits_follows_without_a_return_and_an_entry(taken: Count) -> None:
    none = taken(0)
    assert taken(0b110) - none == ENTRY + 1 + BX + CHAIN + 1 + BX + RETURN
    one = load_profile("cortex-m4-trm/1")  # has no row for it
    assert taken(0b110, profile=one) - taken(0, profile=one) == 2 * (ENTRY + 1 + BX + RETURN)


def test_a_handler_that_uses_the_fpu_saves_floating_point_state_and_has_it_restored(taken: Count) -> None:
    plain = ENTRY + 1 + BX + RETURN
    none = taken(0, state=FLOATING)
    assert taken(0b010, state=FLOATING) - none == plain  # room is reserved, and nothing moved
    assert taken(0b010, FLOATING, state=FLOATING) - none == plain + 2 * FRAME
    assert taken(0b010, FLOATING) - taken(0) == plain  # where there is none to save


def test_handlers_in_a_chain_save_floating_point_state_once(taken: Count) -> None:
    chained = ENTRY + 1 + BX + CHAIN + 1 + BX + RETURN
    none = taken(0, state=FLOATING)
    assert taken(0b110, FLOATING, FLOATING, state=FLOATING) - none == chained + 2 * FRAME
    assert taken(0b110, INTEGER, FLOATING, state=FLOATING) - none == chained + 2 * FRAME
    assert taken(0b110, FLOATING, INTEGER, state=FLOATING) - none == chained + 2 * FRAME


def test_stacking_at_once_takes_as_long_whatever_the_handler_does(taken: Count) -> None:
    none = taken(0, state=FLOATING, stacking=AT_ONCE)
    for handler in (INTEGER, FLOATING):
        took = taken(0b010, handler, state=FLOATING, stacking=AT_ONCE) - none
        assert took == ENTRY + FRAME + 1 + BX + FRAME + RETURN


def test_the_rows_are_what_is_counted(taken: Count) -> None:
    other = moved(load_profile("cortex-m4-trm/2"), {"tail_chain": CHAIN + 3, "fp_frame": FRAME + 5})
    with_state = {"state": FLOATING, "profile": other}
    none = taken(0, **with_state)
    chained = ENTRY + 1 + BX + CHAIN + 3 + 1 + BX + RETURN
    assert taken(0b110, FLOATING, FLOATING, **with_state) - none == chained + 2 * (FRAME + 5)
