"""LPTMR: counts of each of its clocks, and of a pin, at their times."""

from __future__ import annotations

from pathlib import Path

import pytest

from hiltest.virtual.board.k64f import VirtualK64F

from .both_ways import outcome
from .conftest import Build, follow, word

HEAD = """
#define CSR WORD(0x40040000)
#define PSR WORD(0x40040004)
#define CMR WORD(0x40040008)
#define CNR WORD(0x4004000C)
volatile unsigned fired, count, flag;
void Interrupt58_Handler(void) { fired++; CSR |= 0x80; }
static void begin(void) {
    WORD(0x40048038) |= 1u | 7u << 9; /* LPTMR, PORTA to PORTC */
    WORD(0xE000E104) = 1u << 26;
    WORD(0x4004803C) |= 1u << 29; /* RTC */
}
"""


def program_of(build_c: Build, body: str) -> Path:
    return build_c(f"{HEAD}int main(void) {{ stop_watchdog(); begin(); {body} return 0; }}")


def board_of(build_c: Build, body: str) -> VirtualK64F:
    return VirtualK64F(program_of(build_c, body))


@pytest.mark.parametrize(
    ("set_up", "hz"),
    [
        ("PSR = 5;", 1000),
        ("PSR = 1;", 500),
        ("WORD(0x40047000) |= 2u << 18; WORD(0x4003D010) = 0x100; PSR = 6;", 32_768),
        ("WORD(0x40047000) |= 3u << 18; PSR = 6;", 1000),
        ("BYTE(0x40064000) |= 2; PSR = 4;", 32_768),
        ("PSR = 3 | 9u << 3;", 50_000_000 / 1024),
    ],
    ids=["LPO", "LPO / 2", "crystal", "LPO as ERCLK32K", "internal reference", "oscillator / 1024"],
)
def test_it_interrupts_once_a_round_of_the_clock_that_is_selected(build_c: Build, set_up: str, hz: float) -> None:
    board = board_of(build_c, f"{set_up} CMR = 99; CSR = 0x40; CSR = 0x41;")
    rounds = 20
    board.run_until(rounds * 100 / hz)  # those of the timer begin a few instructions after power-on
    assert word(board, "fired") == rounds - 1
    follow(board, {(rounds + 0.5) * 100 / hz + 2e-5: {"fired": rounds}})
    assert board.unmodelled == ()


def test_a_crystal_that_was_not_switched_on_does_not_count(build_c: Build) -> None:
    board = board_of(build_c, "WORD(0x40047000) |= 2u << 18; PSR = 6; CMR = 9; CSR = 0x41;")
    follow(board, {0.1: {"fired": 0}})


def test_the_count_is_what_it_was_when_it_was_asked_for(build_c: Build) -> None:
    wait = "for (volatile int i = 0; i < 60000; i++) {}"  # some 40 ms
    board = board_of(build_c, f"PSR = 5; CMR = 1000; CSR = 1; {wait} CNR = 7; count = CNR; {wait} flag = CNR;")
    board.run_until(0.2)
    assert 20 < word(board, "count") < 100
    assert word(board, "flag") == word(board, "count")


def test_a_free_running_timer_goes_on_past_its_compare_value(build_c: Build) -> None:
    wait = "while (!(CSR & 0x80)) {} CSR = 0x85; CNR = 0; count = CNR; while (!(CSR & 0x80)) {} flag = 1;"
    board = board_of(build_c, f"PSR = 3 | 5u << 3; CMR = 20; CSR = 5; {wait}")
    count_s = 64 / 50e6
    follow(
        board,
        {
            30 * count_s: {"count": 21, "flag": 0},
            (65536 + 20) * count_s: {"flag": 0},
            (65536 + 21) * count_s + 2e-5: {"flag": 1},
        },
    )


def test_a_timer_that_is_switched_off_forgets(build_c: Build) -> None:
    board = board_of(
        build_c, "PSR = 5; CMR = 0; CSR = 1; while (!(CSR & 0x80)) {} CSR = 0; flag = CSR; CNR = 0;count = CNR + 1;"
    )
    follow(board, {0.01: {"flag": 0, "count": 1}})


@pytest.mark.parametrize(("control", "fires_at"), [(0x63, [2, 5]), (0x6B, [3, 6])], ids=["rising", "falling"])
def test_it_counts_the_edges_of_a_pin(build_c: Build, control: int, fires_at: list[int]) -> None:
    # PTC5 as LPTMR0_ALT2
    board = board_of(build_c, f"WORD(0x4004B014) = 3u << 8; PSR = 5; CMR = 2; CSR = {control & 0x7E}; CSR = {control};")
    board.run_until(0.001)
    observations = []
    for pulse in range(8):
        before = word(board, "fired")
        board.drive("PTC5", True)
        board.run_until(board.time_s + 0.001)
        if word(board, "fired") > before:
            observations.append(pulse)
        board.drive("PTC5", False)
        board.run_until(board.time_s + 0.001)
        if word(board, "fired") > before and pulse not in observations:
            observations.append(pulse + 1)
    assert observations == fires_at


@pytest.mark.parametrize(
    ("control", "counts"), [(1, range(996, 1001)), (5, range(2, 3))], ids=["in rounds", "free running"]
)
def test_a_loop_that_polls_goes_on_at_the_end_of_a_round(build_c: Build, control: int, counts: range) -> None:
    loop = f"for (;;) {{ while (!(CSR & 0x80)) {{}} CSR = {control | 0x80}; count++; }}"
    elf = program_of(build_c, f"PSR = 3 | 1u << 3; CMR = 124; CSR = {control}; {loop}")
    board = VirtualK64F(elf)
    board.run_until(0.01)  # 125 000 counts of a quarter of 50 MHz; 65 536 are a round of the counter
    assert word(board, "count") in counts
    assert outcome(elf, 0.005, executes_all=False) == outcome(elf, 0.005, executes_all=True)


def test_a_compare_value_that_is_behind_the_count_is_met_in_the_next_round_of_all_counts(build_c: Build) -> None:
    wait = "do { CNR = 0; } while (CNR < 1000);"
    board = board_of(build_c, f"PSR = 3 | 5u << 3; CMR = 60000; CSR = 0x41; {wait} CMR = 99;")
    count_s = 64 / 50e6
    follow(
        board,
        {
            65_500 * count_s: {"fired": 0},
            (65_536 + 100 + 50) * count_s: {"fired": 1},
            (65_536 + 980) * count_s: {"fired": 9},
        },
    )
