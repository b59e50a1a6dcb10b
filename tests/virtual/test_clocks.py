"""Clocks as the firmware sets them up, and virtual time that follows them."""

from __future__ import annotations

import itertools
import math
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hiltest.virtual.board.k64f import VirtualK64F
from hiltest.virtual.peripherals.mcg import ClockGenerator, ClockMode
from hiltest.virtual.processor.clock import PICOSECONDS, Clock
from hiltest.virtual.processor.schedule import Schedule

from .conftest import Build, word

C1, C2, C5, C6, S = 0, 1, 4, 5, 6
# C1 (CLKS, IREFS), C2 (LP) and C6 (PLLS) of each mode.
REGISTERS = {
    "FEI": (0x04, 0, 0),
    "FEE": (0x00, 0, 0),
    "FBI": (0x44, 0, 0),
    "FBE": (0x80, 0, 0),
    "PBE": (0x80, 0, 0x40),
    "PEE": (0x00, 0, 0x40),
    "BLPI": (0x44, 2, 0),
    "BLPE": (0x80, 2, 0),
}
# The manual's diagram of modes: both ways each.
DIAGRAM = {
    frozenset(pair.split())
    for pair in (
        "FEI FEE",
        "FEI FBI",
        "FEI FBE",
        "FEE FBI",
        "FEE FBE",
        "FBI FBE",
        "FBI BLPI",
        "FBE BLPE",
        "FBE PBE",
        "PBE BLPE",
        "PBE PEE",
    )
}
THERE = {
    "FEI": [],
    "FEE": ["FEE"],
    "FBI": ["FBI"],
    "FBE": ["FBE"],
    "PBE": ["FBE", "PBE"],
    "PEE": ["FBE", "PBE", "PEE"],
    "BLPI": ["FBI", "BLPI"],
    "BLPE": ["FBE", "BLPE"],
}


def ask_for(generator: ClockGenerator, mode: str) -> None:
    """Write the registers of a mode, the one that says where the clock comes from last."""
    c1, c2, c6 = REGISTERS[mode]
    generator.write(C6, 1, c6 | generator.read(C6, 1) & 0x1F)
    generator.write(C2, 1, c2)
    generator.write(C1, 1, c1)


@pytest.mark.parametrize(("start", "end"), list(itertools.permutations(REGISTERS, 2)))
def test_modes_change_on_the_paths_of_the_manual_and_on_no_other(start: str, end: str) -> None:
    generator = ClockGenerator()
    for mode in THERE[start]:
        ask_for(generator, mode)
    assert generator.mode is ClockMode[start]
    direct = frozenset((start, end)) in DIAGRAM
    # Registers are written one after the other: what lies between may be a mode of its own, on a path that exists.
    c1, c2, c6 = REGISTERS[end]
    if direct:
        ask_for(generator, end)
        assert generator.mode is ClockMode[end]
    else:
        generator._bytes[C6], generator._bytes[C2] = c6, c2  # at once, as no firmware could
        generator.write(C1, 1, c1)
        through = {"BLPI": "FBI", "BLPE": "FBE"}.get(end, end)  # LP is set already: it goes on from there by itself
        assert generator.mode is ClockMode[end if frozenset((start, through)) in DIAGRAM else start]


@pytest.mark.parametrize(
    ("c1", "c5", "status"),
    [(0x80, 0x40, 0x48), (0x80, 0x00, 0x08), (0x04, 0x40, 0x50), (0x44, 0x40, 0x54)],
    ids=["FBE, PLLCLKEN0", "FBE", "FEI, PLLCLKEN0", "FBI, PLLCLKEN0"],
)
def test_the_pll_locks_when_it_is_enabled_for_peripherals_alone(c1: int, c5: int, status: int) -> None:
    generator = ClockGenerator()
    generator.write(C5, 1, c5)
    generator.write(C1, 1, c1)
    assert generator.read(S, 1) == status
    generator.write(C2, 1, 2)
    if c1 & 0xC0:
        assert not generator.read(S, 1) & 0x40  # BLPI and BLPE switch it off


def test_the_output_is_what_the_registers_make() -> None:
    generator = ClockGenerator()
    assert generator.output_hz == 640 * 32_768
    generator.write(3, 1, 0x20)  # C4: DRST_DRS 1
    assert generator.output_hz == 1280 * 32_768
    generator.write(1, 1, 0x10)  # high range: the external reference is divided by 32 and more
    generator.write(C1, 1, 0xA8)  # FBE, FRDIV 5
    assert generator.output_hz == 50_000_000
    generator.write(C1, 1, 0x28)  # FEE
    assert generator.output_hz == Fraction(50_000_000, 1024) * 1280
    generator.write(C1, 1, 0xA8)
    generator.write(C5, 1, 19)
    generator.write(C6, 1, 0x40 | 24)
    generator.write(C1, 1, 0x28)  # PEE
    assert generator.output_hz == 120_000_000
    generator.reset()
    generator.write(C1, 1, 0x46)  # FBI
    assert generator.output_hz == 32_768
    generator.write(1, 1, 0x81)  # IRCS: the fast reference, divided by two out of reset
    assert generator.output_hz == 2_000_000
    assert generator.read(S, 1) & 1


RATES = st.lists(
    st.tuples(st.integers(1, 10**6), st.sampled_from([2_000_000, 20_971_520, 50_000_000, 120_000_000])), min_size=1
)


@given(RATES, st.sampled_from([1000, 32_768, 60_000_000]))
def test_ticks_that_have_passed_stay_passed_and_their_cycles_are_found(rates: list[tuple[int, int]], hz: int) -> None:
    now, true = 0, Fraction(0)
    clock = Clock(Schedule(), lambda: now)
    for cycles, core_hz in rates:
        clock.run_at(Fraction(hz), Fraction(core_hz), now)
        assert clock.now() == math.floor(true)
        tick = clock.now() + 5
        cycle = clock.cycle_of(tick)
        assert clock.ticks_at(int(cycle)) >= tick > clock.ticks_at(int(cycle) - 1)
        now += cycles
        true += Fraction(cycles * hz, core_hz)
        assert clock.now() == math.floor(true)


def test_an_event_of_a_clock_comes_at_its_tick_whatever_the_core_does_meanwhile() -> None:
    now, observations = 0, []
    schedule = Schedule()
    clock = Clock(schedule, lambda: now)
    clock.run_at(Fraction(1000), Fraction(100_000), 0)
    clock.call_at(10, lambda: observations.append(10))
    now = 500
    clock.run_at(Fraction(1000), Fraction(200_000), now)
    schedule.replan()
    schedule.run_due(1499)
    assert not observations
    schedule.run_due(1500)  # five ticks of a hundred cycles, five of two hundred
    assert observations == [10]


PROGRAM = r"""
volatile unsigned ticks;
static void to_pee(unsigned dividers) {
    WORD(0x40048044) = dividers;
    BYTE(0x40064001) = 0x10;
    BYTE(0x40064000) = 0xA8; while ((BYTE(0x40064006) & 0x0C) != 0x08) {}
    BYTE(0x40064004) = 19; BYTE(0x40064005) = 0x58; while (!(BYTE(0x40064006) & 0x40)) {}
    BYTE(0x40064000) = 0x28; while ((BYTE(0x40064006) & 0x0C) != 0x0C) {}
}
void SysTick_Handler(void) { ticks++; }
static void tick_every(unsigned cycles) { WORD(0xE000E014) = cycles - 1; WORD(0xE000E018) = 0; WORD(0xE000E010) = 7; }
int main(void) { (void)to_pee; (void)tick_every; %s for (;;) { __asm__("wfi"); } }
"""


@pytest.mark.parametrize(("dividers", "core_hz", "bus_hz"), [(0x01140000, 120e6, 60e6), (0x11390000, 60e6, 60e6)])
def test_a_tick_takes_the_time_of_the_clock_that_the_firmware_made(
    build_c: Build, dividers: int, core_hz: float, bus_hz: float
) -> None:
    board = VirtualK64F(build_c(PROGRAM % f"to_pee(0x{dividers:08x}u); tick_every({int(core_hz) // 1000});"))
    board.run_until(0.05)
    assert (board.clocks.core_hz, board.clocks.bus_hz) == (core_hz, bus_hz)
    before = word(board, "ticks")
    board.run_until(0.25)  # the watchdog, which this program forgets, comes later
    assert word(board, "ticks") - before == 200  # one a millisecond
    assert board.time_s == pytest.approx(0.25, abs=1e-6)


def test_changing_the_clock_leaves_timers_of_other_clocks_alone(build_c: Build) -> None:
    timer = "WORD(0x4004803C) |= 1u << 23; WORD(0x40037000) = 0; WORD(0x40037100) = 20971; WORD(0x40037108) = 1;"
    board = VirtualK64F(build_c(PROGRAM % f"{timer} to_pee(0x01140000u);"))
    board.run_until(0.01)
    picoseconds = board.clocks.time.now()
    assert picoseconds == pytest.approx(0.01 * PICOSECONDS, rel=1e-6)
    assert board.cycles == pytest.approx(0.01 * 120e6, rel=0.01)  # of which start-up took some at 20.97 MHz
    assert board.cycles < 0.01 * 120e6


def test_a_run_that_is_slowed_down_stops_at_its_time_and_not_at_its_cycle(build_c: Build) -> None:
    slow = "to_pee(0x01140000u); WORD(0x40048044) = 0xF1140000u;"
    board = VirtualK64F(build_c(PROGRAM % slow))
    board.run_until(0.1)
    assert board.clocks.core_hz == 7.5e6
    assert board.time_s == pytest.approx(0.1, abs=1e-6)
