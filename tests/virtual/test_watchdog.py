"""A watchdog that firmware leaves on and does not serve resets the part, and the firmware is told by whom."""

from __future__ import annotations

import pytest

from hiltest.virtual.board.k64f import VirtualK64F

from .conftest import Build, follow, word

# What a program of these tests does first: it counts its starts and keeps their sources, in memory that none clears.
HEAD = """
#define STCTRLH HALF(0x40052000)
#define TOVALH HALF(0x40052004)
#define TOVALL HALF(0x40052006)
#define REFRESH HALF(0x4005200C)
#define UNLOCK HALF(0x4005200E)
#define PRESC HALF(0x40052016)
__attribute__((section(".noinit"))) volatile unsigned starts, sources;
static void unlock(void) { UNLOCK = 0xC520u; UNLOCK = 0xD928u; }
static void refresh(void) { REFRESH = 0xA602u; REFRESH = 0xB480u; }
"""
# 5 000 012 ticks of the bus clock, through a prescaler of five; out of reset a core cycle is a tick.
OUT_OF_RESET_HZ = 640 * 32_768  # the FLL on the internal reference
FORGOTTEN_CYCLES = 5 * 0x4C4B4C


def program(body: str) -> str:
    main = "starts++; sources = sources << 16 | BYTE(0x4007F000) | BYTE(0x4007F001) << 8;"
    return f'{HEAD}int main(void) {{ {main} {body} for (;;) {{ __asm__("nop"); }} }}\n'


def board_of(build_c: Build, body: str) -> VirtualK64F:
    return VirtualK64F(build_c(program(f"(void)unlock; (void)refresh; {body}")))


def test_a_forgotten_watchdog_resets_the_part_after_its_time(build_c: Build) -> None:
    board = board_of(build_c, "")
    follow(board, {(FORGOTTEN_CYCLES - 1000) / OUT_OF_RESET_HZ: {"starts": 1}})
    assert "watchdog" not in board.position()
    board.run_until((FORGOTTEN_CYCLES + 1000) / OUT_OF_RESET_HZ)
    assert word(board, "starts") == 2
    assert word(board, "sources") == 0x0082_0020  # power-on, then WDOG
    assert board.position().endswith(", reset 1 times by its watchdog")


# On, with 65 536 ticks of the bus clock instead of those out of reset.
SHORT, SHORT_CYCLES = "unlock(); TOVALH = 1; TOVALL = 0; PRESC = 0; STCTRLH = 0x01D3u;", 65_536 + 5000


@pytest.mark.parametrize(
    ("body", "cycles", "starts"),
    [
        (f"{SHORT} unlock(); STCTRLH = 0x01D2u;", SHORT_CYCLES, 1),
        (f"{SHORT} for (;;) {{ for (volatile int i = 0; i < 1000; i++) {{}} refresh(); }}", SHORT_CYCLES, 1),
        (f"{SHORT} for (;;) {{ REFRESH = 0xB480u; REFRESH = 0xA602u; REFRESH = 0u; }}", SHORT_CYCLES, 2),
        ("STCTRLH = 0x01D2u;", FORGOTTEN_CYCLES + 1000, 2),
        ("UNLOCK = 0xD928u; UNLOCK = 0xC520u; STCTRLH = 0x01D2u;", FORGOTTEN_CYCLES + 1000, 2),
    ],
    ids=["switched off", "served", "served the wrong way round", "never unlocked", "unlocked the wrong way round"],
)
def test_it_resets_the_part_unless_it_is_unlocked_and_switched_off_or_served(
    build_c: Build, body: str, cycles: int, starts: int
) -> None:
    board = board_of(build_c, body)
    follow(board, {cycles / OUT_OF_RESET_HZ: {"starts": starts}})


def test_a_test_counts_the_bus_clock(build_c: Build) -> None:
    board = board_of(build_c, "unlock(); TOVALH = 1; TOVALL = 0; PRESC = 0; STCTRLH = 0x0411u;")
    follow(board, {65_000 / OUT_OF_RESET_HZ: {"starts": 1}, 67_000 / OUT_OF_RESET_HZ: {"starts": 2}})


@pytest.mark.parametrize(("after", "resets"), [(8, True), (12, False)])
def test_serving_it_before_its_window_opens_is_a_reset(build_c: Build, after: int, resets: bool) -> None:
    window = "HALF(0x40052008) = 0; HALF(0x4005200A) = 10; STCTRLH = 0x01D9u;"  # of 20 ms, by the oscillator of 1 kHz
    wait = f"while (HALF(0x40052012) < {after}) {{}} refresh(); while (HALF(0x40052012) > 2) {{}}"
    board = board_of(build_c, f"unlock(); TOVALH = 0; TOVALL = 20; PRESC = 0; {window} {wait}")
    board.run_until(0.013)
    assert word(board, "starts") == (2 if resets else 1)


def test_it_counts_how_often_it_has_reset_the_part(build_c: Build) -> None:
    counting = "TOVALH = 0; TOVALL = 5; PRESC = 0; STCTRLH = 0x01D1u; if (HALF(0x40052014) == 3) HALF(0x40052014) = 3;"
    board = board_of(build_c, f"unlock(); sources = HALF(0x40052014); {counting}")
    observations = []
    for turn in range(5):
        board.run_until((turn + 0.5) * 0.005)
        observations.append(word(board, "sources"))
    assert observations == [0, 1, 2, 3, 1]


def test_its_time_and_clock_are_what_firmware_sets(build_c: Build) -> None:
    # 25 ticks of the oscillator of 1 kHz, not divided: 25 ms after it was set up.
    board = board_of(build_c, "unlock(); TOVALH = 0; TOVALL = 25; PRESC = 0; STCTRLH = 0x01D1u;")
    follow(board, {0.0249: {"starts": 1}, 0.0251: {"starts": 2}})


def test_a_sleeping_part_is_reset_too(build_c: Build) -> None:
    tick = "HALF(0xE000E014) = 0xFFFF; HALF(0xE000E016) = 0xFF; BYTE(0xE000E010) = 7;"
    source = program(f'(void)unlock; (void)refresh; {tick} for (;;) {{ __asm__("wfi"); }}')
    board = VirtualK64F(build_c(source + "void SysTick_Handler(void) {}\n"))
    follow(board, {(FORGOTTEN_CYCLES + 1000) / OUT_OF_RESET_HZ: {"starts": 2}})


def test_a_reset_by_firmware_is_told_apart(build_c: Build) -> None:
    board = board_of(build_c, "if (starts == 1) { *(volatile unsigned *)0xE000ED0C = 0x05FA0004u; }")
    follow(board, {0.001: {"sources": 0x0082_0400}})  # SRS1: SW


@pytest.mark.parametrize("count", [20, 70_000], ids=["the lower half alone", "both halves"])
def test_waiting_for_its_count_ends_at_the_same_cycle_if_it_is_asked_each_time(build_c: Build, count: int) -> None:
    body = (
        "unlock(); TOVALH = 0x10; TOVALL = 0; PRESC = 0; STCTRLH = 0x01D3u;"
        f"while (((unsigned)HALF(0x40052010) << 16 | HALF(0x40052012)) < {count}u) {{}} sources = 1;"
    )
    ends = []
    for executes_all in (False, True):
        board = VirtualK64F(build_c(program(f"(void)refresh; {body}")))
        board.processor.core.executes_all = executes_all
        board.run_until(0.006)
        ends.append((board.cycles, board.instructions, board.processor.registers.general.read()))
        assert word(board, "sources") == 1
    assert ends[0] == ends[1]
