"""Sleep: what stands still in each mode, what ends it, and what firmware finds afterwards."""

from __future__ import annotations

import math

import pytest

from hiltest.errors import BoardFault
from hiltest.virtual.board.k64f import VirtualK64F
from hiltest.virtual.peripherals.mcg import ClockMode

from .conftest import Build, follow, word

HEAD = """
enum { STOP = 0, VLPS = 2, LLS = 3, VLLS = 4 };
volatile unsigned woken, timer, unit, port, ticks, before, after, kept, status, source, isolated;
void Interrupt58_Handler(void) { timer++; WORD(0x40040000) |= 0x80; }
void Interrupt21_Handler(void) {
    unit++; source = BYTE(0x4007C005) | BYTE(0x4007C006) << 8 | BYTE(0x4007C007) << 16;
    WORD(0x40040000) |= 0x80; BYTE(0x4007C005) = 0xFF; BYTE(0x4007C006) = 0xFF;
}
void Interrupt61_Handler(void) { port++; WORD(0x4004B0A0) = ~0u; }
void SysTick_Handler(void) { ticks++; }
static void begin(void) {
    stop_watchdog();
    WORD(0x40048038) |= 1u | 0x1Fu << 9;
    BYTE(0x4007E000) = 0x2A;
    WORD(0x4004B018) = 0x100 | 10u << 16; /* PTC6: SW2 interrupts as it falls */
    WORD(0xE000E100) = 1u << 21; WORD(0xE000E104) = 1u << 26 | 1u << 29;
}
static void alarm(unsigned ms) { WORD(0x40040004) = 5; WORD(0x40040008) = ms - 1; WORD(0x40040000) = 0x41; }
__attribute__((noinline)) static void sleep(unsigned mode) {
    BYTE(0x4007E001) = mode; (void)BYTE(0x4007E001);
    WORD(0xE000ED10) = 4;
    __asm__("wfi");
    WORD(0xE000ED10) = 0;
    woken++;
}
static void to_pee(void) {
    WORD(0x40048044) = 0x01140000u;
    BYTE(0x40064001) = 0x10; BYTE(0x40064000) = 0xA8; while ((BYTE(0x40064006) & 0x0C) != 0x08) {}
    BYTE(0x40064004) = 19 | PLLSTEN; BYTE(0x40064005) = 0x58; while (!(BYTE(0x40064006) & 0x40)) {}
    BYTE(0x40064000) = 0x28; while ((BYTE(0x40064006) & 0x0C) != 0x0C) {}
}
"""


def board_of(build_c: Build, body: str, *, pllsten: int = 0) -> VirtualK64F:
    unused = "(void)alarm; (void)sleep; (void)to_pee;"
    program = f"#define PLLSTEN {pllsten}\n{HEAD}int main(void) {{ {unused} begin(); {body} return 0; }}"
    return VirtualK64F(build_c(program))


@pytest.mark.parametrize("mode", ["STOP", "VLPS"])
def test_the_low_power_timer_ends_a_stop_in_which_core_and_bus_stand_still(build_c: Build, mode: str) -> None:
    systick = "WORD(0xE000E014) = 20971; WORD(0xE000E018) = 0; WORD(0xE000E010) = 7;"
    pit = "WORD(0x4004803C) |= 1u << 23; WORD(0x40037000) = 0; WORD(0x40037100) = ~0u; WORD(0x40037108) = 1;"
    board = board_of(
        build_c,
        f"{systick} {pit} before = WORD(0x40037104); alarm(50); sleep({mode});"
        f"after = WORD(0x40037104); WORD(0xE000E010) = 0; sleep({mode});",
    )
    follow(board, {0.0495: {"woken": 0}})
    assert board.position().startswith(f"asleep ({mode}) in sleep (program.c:")
    follow(board, {0.06: {"woken": 1, "timer": 1, "ticks": 0}})
    assert 0 < word(board, "before") - word(board, "after") < 1000  # of the bus clock, which has 2 million in 0.1 s
    follow(board, {0.11: {"woken": 2}})
    assert board.unmodelled == ()


def test_in_wait_the_timers_go_on(build_c: Build) -> None:
    board = board_of(
        build_c, 'WORD(0xE000E014) = 20971; WORD(0xE000E018) = 0; WORD(0xE000E010) = 7;for (;;) { __asm__("wfi"); }'
    )
    follow(board, {0.0505: {"ticks": 50}})
    assert board.position().startswith("asleep in main")


@pytest.mark.parametrize(
    ("mode", "pllsten", "goes_on_in"),
    [("STOP", 0, ClockMode.PBE), ("STOP", 0x20, ClockMode.PEE), ("VLPS", 0x20, ClockMode.PBE)],
)
def test_a_stop_costs_the_pll_its_lock_unless_it_is_kept(
    build_c: Build, mode: str, pllsten: int, goes_on_in: ClockMode
) -> None:
    board = board_of(build_c, f"to_pee(); alarm(5); sleep({mode}); for (;;) {{}}", pllsten=pllsten)
    follow(board, {0.004: {"woken": 0}, 0.008: {"woken": 1}})
    assert board.clocks.core_hz == (120e6 if goes_on_in is ClockMode.PEE else 50e6)
    assert board.time_s == pytest.approx(0.008, abs=1e-6)


@pytest.mark.parametrize("mode", ["STOP", "VLPS"])
def test_a_pin_ends_a_stop(build_c: Build, mode: str) -> None:
    board = board_of(build_c, f"sleep({mode});")
    follow(board, {0.5: {"woken": 0}})
    board.press("SW2")
    follow(board, {0.5001: {"woken": 1, "port": 1}})


def test_lls_ends_by_what_its_unit_watches_and_by_nothing_else(build_c: Build) -> None:
    board = board_of(build_c, "BYTE(0x4007C002) = 2 << 4; alarm(20); sleep(LLS);")  # LLWU_P10 is PTC6, falling
    follow(board, {0.1: {"woken": 0, "timer": 0}})  # the timer is not enabled there
    assert board.position().startswith("asleep (LLS) in sleep (program.c:")
    board.press("SW2")
    follow(board, {0.101: {"woken": 1, "unit": 1, "source": 0x400}})


def test_while_it_runs_the_unit_notes_nothing(build_c: Build) -> None:
    board = board_of(build_c, "BYTE(0x4007C002) = 2 << 4; for (;;) { source = BYTE(0x4007C006); }")
    board.run_until(0.001)
    board.press("SW2")
    follow(board, {0.002: {"port": 1, "unit": 0, "source": 0}})


@pytest.mark.parametrize(("keeps", "woken"), [(0x20, 1), (0x00, 0)])
def test_the_oscillator_goes_on_in_a_stop_where_it_is_told_to(build_c: Build, keeps: int, woken: int) -> None:
    timer = "WORD(0x40040004) = 3 | 15u << 3; WORD(0x40040008) = 7; WORD(0x40040000) = 0x41;"  # 8 times 1.3 ms
    board = board_of(build_c, f"BYTE(0x40065000) = {0x80 | keeps}; {timer} sleep(STOP);")
    follow(board, {0.1: {"woken": woken}})


def test_vlls_ends_in_a_handler_too(build_c: Build) -> None:
    handler = "void SVC_Handler(void) { BYTE(0x4007C004) = 1; alarm(20); sleep(VLLS); }"
    start = 'begin(); status = BYTE(0x4007F000); if (status & 0x80) { __asm__("svc 0"); }'
    program = f"#define PLLSTEN 0\n{HEAD}{handler} int main(void) {{ (void)to_pee; {start} return 0; }}"
    board = VirtualK64F(build_c(program))
    follow(board, {0.021: {"status": 1, "woken": 0}})


def test_the_low_power_timer_ends_lls_where_its_unit_watches_it(build_c: Build) -> None:
    board = board_of(build_c, "BYTE(0x4007C004) = 1; alarm(20); sleep(LLS);")
    follow(board, {0.019: {"woken": 0}, 0.021: {"woken": 1, "unit": 1, "source": 0x10000}})


@pytest.mark.parametrize(("vlls", "survives"), [(3, True), (1, False)])
def test_vlls_ends_in_a_reset_that_names_itself(build_c: Build, vlls: int, survives: bool) -> None:
    first = f"*(volatile unsigned *)0x20001000 = 77; BYTE(0x4007E002) = {vlls}; BYTE(0x4007C004) = 1; alarm(20);"
    later = "kept = *(volatile unsigned *)0x20001000; isolated = BYTE(0x4007D002);"
    board = board_of(
        build_c,
        f"status = BYTE(0x4007F000); if (status & 0x80) {{ {first} sleep(VLLS); }} {later}"
        "BYTE(0x4007D002) = 8; after = BYTE(0x4007D002);",
    )
    follow(board, {0.019: {"status": 0x82}, 0.021: {"status": 1, "woken": 0, "source": 0x10000}})
    assert word(board, "kept") == (77 if survives else 0)
    assert (word(board, "isolated") & 8, word(board, "after") & 8) == (8, 0)


@pytest.mark.parametrize(
    ("set_up", "mode"),
    [("WORD(0xE000E180) = ~0u; WORD(0xE000E184) = ~0u;", "STOP"), ("", "LLS"), ("", "VLLS")],
)
def test_a_board_that_nothing_can_wake_says_so(build_c: Build, set_up: str, mode: str) -> None:
    board = board_of(build_c, f"{set_up} sleep({mode});")
    board.run_until(0.2)
    start = f"asleep ({mode}, with no source of wake-up enabled) in sleep"
    assert board.position().startswith(start)
    with pytest.raises(BoardFault, match="hang: WFI without anything that could wake the processor"):
        board.run_until(math.inf)


def test_a_mode_is_entered_only_where_it_was_permitted(build_c: Build) -> None:
    board = board_of(
        build_c,
        "BYTE(0x4007E001) = 2 << 5; status = BYTE(0x4007E003); BYTE(0x4007E001) = 0;"
        "after = BYTE(0x4007E003); BYTE(0x4007E000) = 0; before = BYTE(0x4007E000);",
    )
    follow(board, {0.001: {"status": 4, "after": 1, "before": 0x2A}})
    refused = VirtualK64F(
        build_c(
            f"#define PLLSTEN 0\n{HEAD}int main(void) {{ (void)alarm; (void)sleep; (void)to_pee;"
            "BYTE(0x4007E001) = 2 << 5 | VLLS; status = BYTE(0x4007E003);"
            "after = BYTE(0x4007E001); return 0; }"
        )
    )
    refused.run_until(0.001)
    assert (word(refused, "status"), word(refused, "after"), word(refused, "woken")) == (1, 0, 0)


def test_in_a_stop_a_byte_is_not_heard(build_c: Build) -> None:
    uart = "WORD(0x40048034) |= 1u << 10; BYTE(0x4006A001) = 11; BYTE(0x4006A003) = 0x2C; WORD(0xE000E100) = 1u << 31;"
    board = board_of(build_c, f"{uart} alarm(20); sleep(STOP); before = BYTE(0x4006A004); for (;;) {{}}")
    board.run_until(0.005)
    board.uart0.host_write(b"a")
    follow(board, {0.021: {"woken": 1}})
    assert not word(board, "before") & 0x20  # RDRF


def test_the_low_power_timer_goes_on_through_a_reset(build_c: Build) -> None:
    board = board_of(build_c, "if (BYTE(0x4007F000) & 0x80) { alarm(20); WORD(0xE000ED0C) = 0x05FA0004; }")
    follow(board, {0.019: {"timer": 0}, 0.021: {"timer": 1}})
