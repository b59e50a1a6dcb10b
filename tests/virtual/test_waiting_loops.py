"""While firmware waits, devices are not asked again and turns of loops are only counted: nothing but time shows it."""

from __future__ import annotations

import os
import re

import pytest

from hiltest.virtual.board.k64f import VirtualK64F
from hiltest.virtual.peripherals.unmodelled import UnmodelledLog

from .both_ways import assert_same_both_ways
from .conftest import PROGRAMS, SHIPPED, Build, word
from .foreign import PROGRAMS as FOREIGN
from .foreign import Program
from .random_loops import HEAD, TAIL, random_program

WAITS = PROGRAMS / "waits.c"
LOOPS = re.findall(r"^static void (\w+)\(void\)", WAITS.read_text(), re.MULTILINE)
LOOPS.remove("prepare")
FOREIGN_S = float(os.environ.get("HILTEST_FOREIGN_S", "0.3"))  # how much of each foreign program is compared [s]


@pytest.mark.parametrize("loop", LOOPS)
@pytest.mark.parametrize("level", ["-O0", "-O2"])
def test_a_loop_ends_at_the_same_cycle_with_the_same_state(build: Build, loop: str, level: str) -> None:
    elf = build(WAITS, level, f"-DLOOP={loop}")
    sendings = [(0.0005, b"x"), (0.0009, b"aaaaabb"), (0.0017, b"bbbbbbbbb"), (0.0029, bytes(range(9)))]
    assert_same_both_ways(elf, 0.004, sendings)


@pytest.mark.parametrize("profile", ["cortex-m4-trm/3", "cortex-m4-k64f/3"])
@pytest.mark.parametrize("seeds", [range(12), pytest.param(range(12, 40), marks=pytest.mark.ci)], ids=["few", "many"])
def test_random_loops_run_the_same(build: Build, seeds: range, profile: str) -> None:
    for seed in seeds:
        assert_same_both_ways(build(random_program(seed)), 0.01, profile=profile)


def test_turns_that_are_passed_over_executed_what_the_one_before_did(build: Build) -> None:
    loop = """
loop:
    ldr r0, [r11, #0x10C]
    cmp r0, #0
    it eq
    ldrdeq r2, r3, [r10]
    tst r0, #1
    beq loop
    str r0, [r11, #0x10C]
"""
    elf = build(HEAD.format(timer=50_000, reload=0xFFFFFF, control=5) + "again:\n" + loop + TAIL)
    assert_same_both_ways(elf, 0.02, profile="cortex-m4-trm/3")


def test_turns_that_skip_something_else_are_told_apart(build: Build) -> None:
    # It waits for 50 000 cycles, and from 20 000 on its turns take a load more.
    loop = """
    ldr r6, [r9, #4]
loop:
    ldr r0, [r9, #4]
    subs r5, r0, r6
    ldr r1, =20000
    ldr r7, =50000
    cmp r5, r1
    it hi
    ldrdhi r2, r3, [r10]
    cmp r5, r7
    blo loop
    str r0, [r10, #4]
"""
    elf = build(HEAD.format(timer=1234, reload=0xFFFFFF, control=5) + "again:\n" + loop + TAIL)
    assert_same_both_ways(elf, 0.02, profile="cortex-m4-trm/3")


def test_a_sensor_is_polled_and_printed_the_same(build: Build) -> None:
    result = assert_same_both_ways(build(PROGRAMS / "polls_fxos8700.c"), 0.03)
    assert len(result.sent) > 50
    assert len(result.on_i2c) > 50


def test_the_shipped_firmware_runs_the_same() -> None:
    assert assert_same_both_ways(SHIPPED, 0.3, [(0.2, b"\x7e\x11\x07\x00\x00\x7e")]).cycles[0] > 35e6


@pytest.mark.parametrize(
    "loop",
    [
        "poll_status",
        "two_registers",
        "wait_count_flag",
        "wait_unmodelled",
        "wait_in_calls",
        "wait_dma_sending",
        "poll_crc",
        "wait_for_interrupt",
    ],
)
@pytest.mark.parametrize("profile", ["cortex-m4-trm/3", "cortex-m4-k64f/3"])
def test_most_of_a_wait_is_not_executed(build: Build, loop: str, profile: str) -> None:
    board = VirtualK64F(build(WAITS, "-O2", f"-DLOOP={loop}"), profile=profile)
    board.report_waits(lambda _unmodelled: None)
    board.run_until(0.02)
    assert board.processor.core.passed > 0.8 * board.instructions


def test_a_device_is_asked_once_while_it_answers_the_same(build: Build, monkeypatch: pytest.MonkeyPatch) -> None:
    def note(log: UnmodelledLog, address: int, size: int, written: int | None) -> None:
        notes.append(address)
        noted(log, address, size, written)

    notes: list[int] = []
    noted = UnmodelledLog.note
    monkeypatch.setattr(UnmodelledLog, "note", note)
    board = VirtualK64F(build(WAITS, "-O2", "-DLOOP=wait_unmodelled"))
    board.report_waits(lambda _unmodelled: None)
    board.run_until(0.02)
    (access,) = board.unmodelled
    assert len(notes) < access.accesses / 50


TIMED = """
#define CYCCNT WORD(0xE0001004)
volatile unsigned sum, overhead, cost, done;
static void poll(unsigned cycles) { unsigned began = CYCCNT; while (CYCCNT - began < cycles) {} }
__attribute__((noinline)) void work(unsigned n) { %s while (n--) sum += n; }
int main(void) {
    WORD(0xE000EDFC) |= 1u << 24;
    WORD(0xE0001000) = 1;
    poll(20000);
    unsigned first = CYCCNT, second = CYCCNT, third = CYCCNT;
    work(20);
    unsigned fourth = CYCCNT;
    overhead = second - first;
    cost = fourth - third - overhead;
    poll(%s);
    done = 1;
    for (;;) {}
}
"""


@pytest.mark.parametrize(
    ("inside", "behind", "is_found"),
    [("", "10", True), ("", "900", True), ("", "30000", True), ("poll(30000);", "10", False)],
    ids=["few readings behind", "more behind", "thousands behind, which are polled and not kept", "between them"],
)
def test_a_timed_function_is_found_among_the_readings_of_the_counter_as_if_every_turn_had_run(
    build_c: Build, inside: str, behind: str, is_found: bool
) -> None:
    elf = build_c(TIMED % (inside, behind), "-O2")
    results = []
    for executes_all in (False, True):
        board = VirtualK64F(elf)
        board.processor.core.executes_all = executes_all
        watch = board.watch_calls(["work"])
        board.run_until(0.006)
        words = [word(board, name) for name in ("cost", "overhead", "done")]
        counter, (call,) = board.cycle_counter, watch.calls("work")
        executed = counter.executed_in(words[0], words[1], (call.entered, call.returned))
        ran = executed and [
            [(part.cycles, part.instructions, list(part.answers)) for part in slices] for slices in executed
        ]
        steps = counter.executed_in_steps([words[0]], words[1]) is not None
        between = counter.instructions_between(sum(words[:2]))
        results.append((words, call.cycles, ran, steps, between, len(counter.readings)))
    assert results[0] == results[1]
    assert results[0][0][2] == 1
    assert (results[0][2] is not None, results[0][4] is not None) == (is_found, is_found)


@pytest.mark.slow
@pytest.mark.ci
@pytest.mark.parametrize("program", FOREIGN, ids=lambda program: program.name)
def test_foreign_firmware_runs_the_same(program: Program) -> None:
    assert_same_both_ways(program.path, FOREIGN_S, [(FOREIGN_S / 3, b"s\r\n"), (FOREIGN_S / 2, b"help\r\n")])
