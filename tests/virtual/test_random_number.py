"""The random number generator: a word every 256 clocks, from the run's seed."""

from __future__ import annotations

import pytest

from hiltest.boards.bench import VirtualBench
from hiltest.rig.rig_file import load_rig
from hiltest.virtual.board.k64f import VirtualK64F

from .conftest import Build, follow, word
from .foreign import RIG

HEAD = """
#define CR WORD(0x40029000)
#define SR WORD(0x40029004)
#define ER WORD(0x40029008)
#define OR WORD(0x4002900C)
volatile unsigned words[64], status, after, caught;
static void on(void) { WORD(0x4004803C) |= 1u << 9; }
static unsigned take(void) { while (!(SR >> 8 & 0xFF)) {} return OR; }
void Interrupt23_Handler(void) { caught = SR; CR = 1u << 3; }
"""
TAKING = HEAD + "int main(void) { on(); %s CR = 1; for (int i = 0; i < 64; i++) words[i] = take(); return 0; }"


def words_of(board: VirtualK64F) -> list[int]:
    board.run_until(0.02)
    assert board.unmodelled == ()
    return list(board.processor.memory.read_words(board.image.symbols["words"].address, 64))


def test_runs_with_one_seed_draw_the_same_words_and_others_do_not(build_c: Build) -> None:
    elf = build_c(TAKING % "")
    drawn = words_of(VirtualK64F(elf))
    assert drawn == words_of(VirtualK64F(elf))
    assert len(set(drawn)) == 64
    other = VirtualK64F(elf)
    other.seed = 1
    assert not set(drawn) & set(words_of(other))
    # Of 2048 fair bits so many are ones in all but one run of 10^9: six standard deviations of 22.6.
    assert sum(draw.bit_count() for draw in drawn) == pytest.approx(1024, abs=136)


def test_a_bench_gives_its_seed_to_the_board(build_c: Build) -> None:
    elf, rig = build_c(TAKING % ""), load_rig(RIG)
    drawn = [words_of(VirtualBench(rig, firmware=elf, seed=seed).machine) for seed in (7, 7, 8)]
    assert drawn[0] == drawn[1] != drawn[2]


def test_entropy_from_the_firmware_changes_what_comes(build_c: Build) -> None:
    without, with_it = (set(words_of(VirtualK64F(build_c(TAKING % entropy)))) for entropy in ("", "ER = 5;"))
    assert not without & with_it


def test_a_word_takes_256_bus_clocks(build_c: Build) -> None:
    taking = "WORD(0xE000EDFC) |= 1u << 24; WORD(0xE0001000) = 1; CR = 1; take(); unsigned from = WORD(0xE0001004);"
    taking += "for (int i = 0; i < 10; i++) take(); after = WORD(0xE0001004) - from;"
    board = VirtualK64F(build_c(f"{HEAD} int main(void) {{ on(); {taking} return 0; }}"))
    board.run_until(0.01)  # out of reset the bus is as fast as the core
    # From the reading of one word to the next, and up to one turn of the loop until it is seen.
    assert 10 * 256 <= word(board, "after") <= 10 * (256 + 40)


def test_reading_too_early_is_an_underflow_that_interrupts_and_is_cleared(build_c: Build) -> None:
    early = "WORD(0xE000E100) = 1u << 23; CR = 1; words[0] = OR; while (!caught) {}"
    early += "status = SR; words[1] = take(); after = SR;"
    board = VirtualK64F(build_c(f"{HEAD} int main(void) {{ on(); {early} return 0; }}"))
    board.run_until(0.01)
    assert word(board, "caught") == 0x1000E  # ERRI, ORU, LRS
    assert word(board, "words") == 0
    assert word(board, "status") == 0x10002  # ORU went with the reading of SR, ERRI with CLRI
    assert word(board, "after") == 0x10000


def test_no_word_comes_while_it_sleeps(build_c: Build) -> None:
    board = VirtualK64F(build_c(f"{HEAD} int main(void) {{ on(); CR = 0x11; take(); after = 1; return 0; }}"))
    follow(board, {0.01: {"after": 0}})
