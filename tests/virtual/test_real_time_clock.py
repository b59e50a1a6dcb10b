"""RTC: seconds of the crystal, through every reset but power-on."""

from __future__ import annotations

import pytest

from hiltest.virtual.board.k64f import VirtualK64F

from .conftest import Build, follow, word

HEAD = """
#define RTC(offset) WORD(0x4003D000 + (offset))
enum { TSR, TPR = 4, TAR = 8, TCR = 12, CR = 16, SR = 20, LR = 24, IER = 28 };
volatile unsigned seconds, alarms, at, status, first, second;
void Interrupt46_Handler(void) { alarms++; at = RTC(TSR); status = RTC(SR); RTC(TAR) = RTC(TAR) + 3; }
void Interrupt47_Handler(void) { seconds++; }
static void start(unsigned now) {
    WORD(0x4004803C) |= 1u << 29;
    RTC(CR) = 0x100; RTC(SR) = 0; RTC(TSR) = now; RTC(IER) = 0x14; RTC(SR) = 0x10;
    WORD(0xE000E284) = 3u << 14; /* that time was invalid is pending since the gate opened */
    WORD(0xE000E104) = 3u << 14;
}
"""
SLEEP = 'for (;;) { __asm__("wfi"); }'


def board_of(build_c: Build, body: str) -> VirtualK64F:
    return VirtualK64F(build_c(f"{HEAD}int main(void) {{ stop_watchdog(); (void)start; {body} return 0; }}"))


def test_a_second_of_the_crystal_is_a_second(build_c: Build) -> None:
    board = board_of(build_c, f"start(100); {SLEEP}")
    follow(board, {9.999: {"seconds": 9}, 10.001: {"seconds": 10}})
    assert board.unmodelled == ()


def test_the_alarm_comes_as_its_second_ends(build_c: Build) -> None:
    board = board_of(build_c, f"start(100); RTC(TAR) = 101; {SLEEP}")
    follow(board, {1.9: {"alarms": 0}, 2.1: {"alarms": 1, "at": 102, "status": 0x14}, 5.1: {"alarms": 2, "at": 105}})


@pytest.mark.parametrize(("correction", "second_s"), [(0x7F, 32641 / 32768), (0x80, 32896 / 32768), (0x01FF, 0)])
def test_the_length_of_a_second_is_corrected(build_c: Build, correction: int, second_s: float) -> None:
    board = board_of(build_c, f"WORD(0x4004803C) |= 1u << 29; RTC(TCR) = {correction}; start(1); {SLEEP}")
    seconds = 50
    length = seconds * second_s
    if not second_s:  # by -1, every second time
        length = seconds + seconds / 2 / 32768
    follow(board, {length - 0.01: {"seconds": seconds - 1}, length + 0.01: {"seconds": seconds}})


def test_time_reads_as_zero_until_it_is_set_and_again_when_it_overflows(build_c: Build) -> None:
    valid = "RTC(SR) = 0; RTC(TSR) = 0xFFFFFFFF; first = RTC(TSR); RTC(TPR) = 32700; RTC(SR) = 0x10;"
    board = board_of(
        build_c,
        "WORD(0x4004803C) |= 1u << 29; RTC(CR) = 0x100; RTC(SR) = 0x10; at = RTC(SR);"
        f"{valid} while (!(RTC(SR) & 2)) {{}} second = RTC(TSR) + 1; RTC(TSR) = 5;"
        "status = RTC(SR);",
    )
    board.run_until(0.1)
    assert word(board, "at") == 0x11
    assert (word(board, "first"), word(board, "second")) == (0xFFFFFFFF, 1)
    assert word(board, "status") == 0x12  # TSR takes a value only while it stands still


def test_it_goes_on_through_a_reset_and_stops_at_power_on(build_c: Build) -> None:
    again = (
        "if (RTC(SR) & 1) { start(50); WORD(0x4003E01C) = 77; while (RTC(TPR) < 9) {} WORD(0xE000ED0C) = 0x05FA0004; }"
    )
    board = board_of(
        build_c, f"WORD(0x4004803C) |= 1u << 29; first = RTC(SR); {again} second = WORD(0x4003E01C); {SLEEP}"
    )
    follow(board, {3.5: {"first": 0x10, "second": 77}})
    board.boot()
    follow(board, {board.time_s + 1e-4: {"first": 1}})


def test_a_lock_refuses_until_a_software_reset(build_c: Build) -> None:
    board = board_of(
        build_c,
        "WORD(0x4004803C) |= 1u << 29; RTC(LR) = 0xF7; RTC(TCR) = 5; first = RTC(TCR) + 1;"
        "RTC(LR) = 0xFF; at = RTC(LR); RTC(CR) = 1; RTC(CR) = 0; RTC(TCR) = 5;"
        "second = RTC(TCR);",
    )
    follow(board, {0.01: {"first": 1, "at": 0xF7, "second": 5}})
