"""FTM: rounds of the counter, pulse widths and compares on pins, captures of pins, and when values are taken over."""

from __future__ import annotations

from random import Random

import pytest

from hiltest.virtual.board.k64f import VirtualK64F
from hiltest.virtual.core.library import lib
from hiltest.virtual.core.machine import NEVER

from .both_ways import outcome
from .conftest import Build, follow, word
from .stepped_timer import SteppedTimer, TimerAlone

BUS_HZ = 640 * 32_768  # out of reset
HEAD = """
#define FTM(offset) WORD(0x40038000 + (offset))
enum {
    SC, CNT = 4, MOD = 8, C0SC = 12, C0V = 16, C1SC = 20, C1V = 24, CNTIN = 0x4C, STATUS = 0x50, MODE = 0x54,
    SYNC = 0x58, OUTINIT = 0x5C, OUTMASK = 0x60, COMBINE = 0x64, POL = 0x70, QDCTRL = 0x80, CONF = 0x84,
    SYNCONF = 0x8C, PWMLOAD = 0x98
};
volatile unsigned fired, seen, first, second, third, changes;
void Interrupt42_Handler(void) {
    fired++; seen = FTM(STATUS);
    FTM(SC) &= ~0x80u; FTM(STATUS) = 0;
}
void Interrupt61_Handler(void) { changes++; WORD(0x4004B0A0) = ~0u; } /* PORTC */
static void begin(void) {
    stop_watchdog();
    WORD(0x4004803C) |= 1u << 24; WORD(0x40048038) |= 0x1Fu << 9;
    WORD(0x4004B004) = 4u << 8; WORD(0x4004B008) = 4u << 8; /* PTC1 and PTC2: FTM0_CH0 and FTM0_CH1 */
    WORD(0xE000E104) = 1u << 10 | 1u << 29;
}
"""
SLEEP = ' for (;;) { __asm__("wfi"); }'


def board_of(build_c: Build, body: str) -> VirtualK64F:
    return VirtualK64F(build_c(f"{HEAD}int main(void) {{ begin(); {body} {SLEEP} }}"))


@pytest.mark.parametrize(
    ("set_up", "control", "period_s"),
    [
        ("FTM(MOD) = 9999;", 0x48, 10_000 / BUS_HZ),
        ("FTM(MOD) = 9999;", 0x4B, 80_000 / BUS_HZ),
        ("FTM(MOD) = 99;", 0x50, 100 / 32_768),
        ("FTM(MOD) = 5000;", 0x68, 10_000 / BUS_HZ),
        ("FTM(MOD) = 5000; FTM(CNTIN) = 1000;", 0x68, 8000 / BUS_HZ),
        ("FTM(CNTIN) = 0xFF00; FTM(MOD) = 0x00FF;", 0x4B, 512 * 8 / BUS_HZ),
        ("", 0x48, 65_536 / BUS_HZ),
        ("FTM(MOD) = 999; FTM(CONF) = 4;", 0x48, 5000 / BUS_HZ),
    ],
    ids=["up", "up, by 8", "fixed clock", "up and down", "from CNTIN and back", "from below zero", "free", "NUMTOF"],
)
def test_it_interrupts_once_a_round(build_c: Build, set_up: str, control: int, period_s: float) -> None:
    board = board_of(build_c, f"{set_up} FTM(SC) = {control};")
    board.run_until(0.005)
    before, began_s, rounds = word(board, "fired"), board.time_s, 40
    board.run_until(began_s + (rounds - 0.02) * period_s)
    assert rounds - 1 <= word(board, "fired") - before <= rounds
    board.run_until(began_s + (rounds + 0.02) * period_s)
    assert rounds <= word(board, "fired") - before <= rounds + 1
    board.run_until(board.time_s + 100 * period_s)
    assert 139 <= word(board, "fired") - before <= 141
    assert board.unmodelled == ()


def test_it_counts_a_clock_that_comes_from_a_pin(build_c: Build) -> None:
    # PTB16 as FTM_CLKIN0
    board = board_of(build_c, "WORD(0x4004A040) = 4u << 8; FTM(MOD) = 2; FTM(SC) = 0x58;")
    board.run_until(0.001)
    fired = []
    for _ in range(9):
        board.drive("PTB16", True)
        board.drive("PTB16", False)
        board.run_until(board.time_s + 1e-4)
        fired.append(word(board, "fired"))
    assert fired == [0, 0, 1, 1, 1, 2, 2, 2, 3]


def edges(board: VirtualK64F, pin: str, duration_s: float) -> list[tuple[float, bool]]:
    """Step by microseconds; return when a pin had changed, and to what."""
    results, before, end_s = [], board.level(pin), board.time_s + duration_s
    while board.time_s < end_s:
        board.run_until(board.time_s + 1e-6)
        if board.level(pin) != before:
            before = not before
            results.append((board.time_s, before))
    return results


def shares(board: VirtualK64F, pin: str) -> tuple[float, float]:
    """Period and share of the time high of a pin, of five rounds of at most a millisecond."""
    result = edges(board, pin, 0.006)
    if len(result) < 4:
        return 0.0, float(board.level(pin))
    rises = [at for at, high in result if high]
    falls = [at for at, high in result if not high and at > rises[0]]
    period_s = (rises[-1] - rises[0]) / (len(rises) - 1)
    return period_s, sum(fall - rise for rise, fall in zip(rises, falls, strict=False)) / len(falls) / period_s


@pytest.mark.parametrize(
    ("set_up", "share"),
    [
        ("FTM(C0SC) = 0x28; FTM(C0V) = 2500;", 0.25),
        ("FTM(C0SC) = 0x28; FTM(C0V) = 2500; FTM(POL) = 1;", 0.75),
        ("FTM(C0SC) = 0x28; FTM(C0V) = 2500; FTM(OUTMASK) = 1;", 0.0),
        ("FTM(C0SC) = FTM(C1SC) = 0x28; FTM(C0V) = 1000; FTM(C1V) = 4000; FTM(COMBINE) = 1;", 0.3),
    ],
    ids=["high", "polarity", "masked", "combined"],
)
def test_a_pulse_width_is_on_its_pin(build_c: Build, set_up: str, share: float) -> None:
    board = board_of(build_c, f"FTM(MOD) = 9999; {set_up} FTM(SC) = 8;")
    board.run_until(0.002)
    period_s, result = shares(board, "PTC1")
    assert result == pytest.approx(share, abs=0.003)
    if 0 < share < 1:
        assert period_s == pytest.approx(10_000 / BUS_HZ, abs=1e-6)


def test_the_other_of_a_complementary_pair_is_its_opposite(build_c: Build) -> None:
    board = board_of(
        build_c, "FTM(MOD) = 9999; FTM(C0SC) = FTM(C1SC) = 0x28; FTM(C0V) = 2500; FTM(COMBINE) = 2;FTM(SC) = 8;"
    )
    board.run_until(0.002)
    for _ in range(50):
        board.run_until(board.time_s + 1.7e-5)
        assert board.level("PTC1") != board.level("PTC2")


@pytest.mark.parametrize(("edge", "captured"), [(4, [0, 2]), (8, [1, 3]), (12, [0, 1, 2, 3])])
def test_edges_of_a_pin_are_captured(build_c: Build, edge: int, captured: list[int]) -> None:
    board = board_of(build_c, f"FTM(C0SC) = {0x40 | edge}; FTM(SC) = 8;")
    board.run_until(0.001)
    results = []
    for turn in range(4):
        before = word(board, "fired")
        board.drive("PTC1", turn % 2 == 0)
        board.run_until(board.time_s + 1e-4)
        if word(board, "fired") > before:
            results.append(turn)
    assert results == captured


def test_a_captured_count_is_the_time_of_its_edge(build_c: Build) -> None:
    read = "while (!(FTM(C0SC) & 0x80)) {} first = FTM(C0V); FTM(C0SC) &= ~0x80u; while (!(FTM(C0SC) & 0x80)) {}"
    board = board_of(build_c, f"FTM(C0SC) = 12; FTM(SC) = 8; {read} second = FTM(C0V); third = FTM(CNT);")
    board.run_until(0.001)
    board.drive("PTC1", True)
    board.run_until(board.time_s + 12_345 / BUS_HZ)
    board.drive("PTC1", False)
    board.run_until(board.time_s + 0.001)
    assert (word(board, "second") - word(board, "first")) % 65536 == pytest.approx(12_345, abs=12)  # a block of code
    assert (word(board, "third") - word(board, "second")) % 65536 < 60


@pytest.mark.parametrize(
    ("mode", "release", "changes"),
    [
        (4, "", True),
        (5, "", False),
        (5, "FTM(SYNCONF) = 0x280; FTM(SYNC) = 0x81;", True),
        (5, "FTM(SYNCONF) = 0x80; FTM(SYNC) = 0x81;", False),
        (5, "FTM(SYNCONF) = 0x280; FTM(SYNC) = 0x80;", False),
        (5, "FTM(PWMLOAD) = 0x200;", True),
    ],
    ids=["FTMEN = 0", "FTMEN", "software trigger", "not for buffers", "no loading point", "LDOK"],
)
def test_values_are_taken_over_at_the_end_of_a_round(build_c: Build, mode: int, release: str, changes: bool) -> None:
    wait = "while (FTM(CNT) < 2000) {}"
    write = "FTM(MOD) = 4999; FTM(C0V) = 2500;"
    board = board_of(
        build_c,
        f"FTM(MODE) = {mode}; FTM(MOD) = 9999; FTM(C0SC) = 0x28; FTM(C0V) = 8000;"
        f"FTM(COMBINE) = 0x20; FTM(SC) = 8; {wait} {write} first = FTM(MOD); second = FTM(C0V);"
        f"{release} third = FTM(MOD);",
    )
    follow(board, {3000 / BUS_HZ: {"first": 9999, "second": 8000, "third": 9999}})
    period_s, share = shares(board, "PTC1")
    expected = (5000 / BUS_HZ, 0.5) if changes else (10_000 / BUS_HZ, 0.8)
    assert (period_s * BUS_HZ, share) == pytest.approx((expected[0] * BUS_HZ, expected[1]), rel=0.01)


def test_a_trigger_leaves_the_channels_of_a_pair_that_is_not_synchronised(build_c: Build) -> None:
    board = board_of(
        build_c,
        "FTM(MODE) = 5; FTM(MOD) = 9999; FTM(C0SC) = 0x28; FTM(C0V) = 2000; FTM(SC) = 8;"
        "FTM(MOD) = 4999; FTM(C0V) = 3000; FTM(SYNCONF) = 0x280; FTM(SYNC) = 0x81;",
    )
    board.run_until(0.002)
    period_s, share = shares(board, "PTC1")
    assert (period_s * BUS_HZ, share) == pytest.approx((5000, 0.4), rel=0.01)


def test_a_trigger_that_restarts_the_counter_takes_over_at_once(build_c: Build) -> None:
    board = board_of(
        build_c,
        "FTM(MODE) = 5; FTM(MOD) = 9999; FTM(SC) = 8; while (FTM(CNT) < 2000) {}"
        "FTM(MOD) = 77; FTM(SYNCONF) = 0x380; FTM(SYNC) = 0x80; first = FTM(CNT);"
        "second = FTM(MOD); third = FTM(SYNC);",
    )
    board.run_until(0.001)
    assert word(board, "first") < 78
    assert (word(board, "second"), word(board, "third")) == (77, 0)


def test_a_flag_is_cleared_by_a_zero_after_it_was_read(build_c: Build) -> None:
    board = board_of(
        build_c,
        "FTM(MOD) = 999; FTM(SC) = 8; for (volatile int i = 0; i < 1000; i++) {}"
        "FTM(SC) = 0; first = FTM(SC); FTM(SC) = 0x80; second = FTM(SC); FTM(SC) = 0;"
        "third = FTM(SC);",
    )
    follow(board, {0.005: {"first": 0x80, "second": 0x80, "third": 0}})


def test_a_counter_that_is_stopped_keeps_its_count_and_a_write_restarts_it(build_c: Build) -> None:
    board = board_of(
        build_c,
        "FTM(SC) = 8; for (volatile int i = 0; i < 100; i++) {} FTM(SC) = 0;"
        "first = FTM(CNT); for (volatile int i = 0; i < 100; i++) {} second = FTM(CNT);"
        "FTM(CNTIN) = 7; FTM(CNT) = 55; third = FTM(CNT);",
    )
    board.run_until(0.005)
    assert word(board, "first") == word(board, "second") > 100
    assert word(board, "third") == 7


@pytest.mark.parametrize(
    ("body", "register"),
    [
        ("FTM(QDCTRL) = 1;", "FTM0_QDCTRL"),
        ("FTM(C0SC) = 0x51;", "FTM0_C0SC"),
        ("FTM(MODE) = 0x64;", "FTM0_MODE"),
        ("FTM(SYNC) = 0x10;", "FTM0_SYNC"),
    ],
)
def test_what_is_not_modelled_is_named_when_it_is_asked_for(build_c: Build, body: str, register: str) -> None:
    board = board_of(build_c, f"FTM(QDCTRL) = 0; FTM(MODE) = 4; {body}")
    board.run_until(0.001)
    assert [access.register for access in board.unmodelled] == [register]


def test_pulse_widths_that_nobody_looks_at_plan_no_event(build_c: Build) -> None:
    board = board_of(build_c, "FTM(MOD) = 99; FTM(C0SC) = FTM(C1SC) = 0x28; FTM(C0V) = 20; FTM(SC) = 8;")
    board.run_until(0.001)
    assert lib.machine_next_event(board.processor.machine.handle) == NEVER


@pytest.mark.parametrize(
    ("set_up", "edges"),
    [
        ("FTM(C0SC) = 0x28; FTM(C0V) = 2500;", 41),
        ("FTM(C0SC) = FTM(C1SC) = 0x28; FTM(C0V) = 1000; FTM(C1V) = 4000; FTM(COMBINE) = 1; WORD(0x4004B008) = 0;", 42),
        ("FTM(C0SC) = FTM(C1SC) = 0x14; FTM(C0V) = 2500; FTM(C1V) = 7500; WORD(0x4004B008) = 11u << 16 | 4u << 8;", 41),
    ],
    ids=["edge-aligned", "combined, one on a pin", "two that toggle"],
)
def test_each_edge_of_a_pin_whose_port_interrupts_is_seen(build_c: Build, set_up: str, edges: int) -> None:
    board = board_of(build_c, f"FTM(MOD) = 9999; {set_up} WORD(0x4004B004) = 11u << 16 | 4u << 8; FTM(SC) = 8;")
    board.run_until(500 / BUS_HZ)
    before = word(board, "changes")
    board.run_until(204_500 / BUS_HZ)
    assert word(board, "changes") - before == edges


@pytest.mark.parametrize(
    ("body", "counts"),
    [
        ("while (PINS & 2) {} first = FTM(CNT); while (!(PINS & 2)) {} second++;", range(2500, 2520)),
        ("while (!(FTM(SC) & 0x80)) {} FTM(SC) = 8; first = FTM(CNT); second++;", range(20)),
        ("while (!(FTM(STATUS) & 1)) {} FTM(STATUS) = 0; first = FTM(CNT); second++;", range(2500, 2520)),
        ("while (FTM(CNT) < 4000) {} first = FTM(CNT); while (FTM(CNT) >= 4000) {} second++;", range(4000, 4020)),
    ],
    ids=["pin", "overflow", "match", "count"],
)
def test_a_loop_that_polls_goes_on_at_the_edge(build_c: Build, body: str, counts: range) -> None:
    set_up = "begin(); FTM(MOD) = 9999; FTM(C0SC) = 0x28; FTM(C0V) = 2500; FTM(SC) = 8;"
    elf = build_c(f"{HEAD}\n#define PINS WORD(0x400FF090)\nint main(void) {{ {set_up} for (;;) {{ {body} }} }}")
    board = VirtualK64F(elf)
    board.run_until(202_000 / BUS_HZ)
    assert word(board, "first") in counts
    assert word(board, "second") == 20
    assert outcome(elf, 0.005, executes_all=False) == outcome(elf, 0.005, executes_all=True)


@pytest.mark.parametrize("seed", range(80))
def test_it_does_what_a_timer_does_that_steps_through_every_tick(seed: int) -> None:
    chance, stepped, is_heard = Random(seed), SteppedTimer(), seed % 2
    timer = TimerAlone(heard=is_heard)
    limit = chance.choice([3, 12, 60])
    up_down = chance.random() < 0.4
    stepped.up_down = up_down

    def write(offset: int, value: int) -> None:
        stepped.write(offset, value)
        timer.write(offset, value)

    write(0x08, chance.randrange(1, limit))  # MOD
    write(0x84, chance.choice([0, 0, 2]))  # NUMTOF
    for channel in range(2):
        write(0x0C + 8 * channel, chance.choice([0x14, 0x1C, 0x18, 0x28, 0x24, 0x68, 0x54]))
        write(0x10 + 8 * channel, chance.randrange(limit + 1))
    write(0x00, chance.choice([0x08, 0x48]) | chance.choice([0, 0, 2, 5]) | up_down << 5)
    for _ in range(40):
        action = chance.randrange(6)
        if action == 0:
            write(0x10 + 8 * chance.randrange(2), chance.randrange(limit + 1))
        elif action == 1 and not up_down:
            write(0x08, chance.randrange(1, limit))
        elif action == 2:
            assert timer.read(0x50) == stepped.read_status()
            assert timer.read(0x00) & 0x80 == stepped.read_overflow()
        elif action == 3:
            write(0x50, chance.choice([0, 1]))
            write(0x00, stepped.control)
        else:
            cycles = chance.choice([1, 2, 7, chance.randrange(300)])
            stepped.run(cycles)
            timer.run(cycles)
        assert timer.read(0x04) == stepped.count
        assert [timer.level(channel) for channel in range(2)] == [stepped.level(channel) for channel in range(2)]
        assert timer.interrupts == stepped.interrupts
        assert not is_heard or timer.edges == stepped.edges
