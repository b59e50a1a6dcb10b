"""Every cycle of a call is given to one function, one line, one instruction and one kind of work or stall."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hiltest.virtual.board.k64f import VirtualK64F
from hiltest.virtual.calls.buffers import Address, Structure
from hiltest.virtual.counts.cost_classes import WORK_OF_ROW, Stall, Work
from hiltest.virtual.counts.profiling import CallProfile, profile_call
from hiltest.virtual.model.profile_file import load_profile
from hiltest.virtual.program.elf import FirmwareImage

from .conftest import SHIPPED, Build
from .test_cycle_counting import cloud, random_program


def function(name: str, body: str) -> str:
    return f"function {name}\n{body}\nends {name}\n"


def profiled(elf: Path, name: str, *arguments: object) -> CallProfile:
    return profile_call(VirtualK64F(elf), name, *arguments)


def assert_adds_up(profile: CallProfile, elf: Path, name: str, *arguments: object) -> None:
    """Every table adds up to what counting by block gives for the same call, on a board of its own."""
    counted = VirtualK64F(elf).call(name, *arguments)
    assert (profile.cycles, profile.instructions) == (counted.cycles, counted.instructions)
    sums = {
        "kinds": sum(profile.work.values()) + sum(profile.stalls.values()) + profile.asleep_cycles,
        "functions": sum(row.self_cycles for row in profile.functions),
        "lines": sum(line.cycles for line in profile.lines) + profile.asleep_cycles,
        "instructions": sum(address.cycles for address in profile.addresses) + profile.asleep_cycles,
        "stacks": sum(stack.cycles for stack in profile.stacks),
    }
    if not profile.lines:
        del sums["lines"]
    assert set(sums.values()) == {counted.cycles}, sums
    assert sum(address.executions for address in profile.addresses) == counted.instructions
    assert sum(row.stall_cycles for row in profile.functions) == sum(profile.stalls.values())
    assert min(profile.stalls.values()) >= 0
    (root,) = [row for row in profile.functions if row.name == name]
    assert root.cycles == counted.cycles


def kernels() -> list[str]:
    image = FirmwareImage(SHIPPED)
    return sorted(
        name
        for name, symbol in image.symbols.items()
        if symbol.is_function
        and name.startswith("magnetometer_")
        and (signature := image.signature(name))
        and signature.parameters == ("pointer", "pointer")
    )


@pytest.mark.parametrize("n", [3, 100])
@pytest.mark.parametrize("kernel", kernels())
def test_the_tables_of_every_kernel_add_up_to_what_the_board_counts(kernel: str, n: int) -> None:
    points = cloud(n, seed=n)
    limits = np.array([points.min(axis=0), points.max(axis=0)])
    argument = Structure(Address(points), np.array([n], np.uint16), limits)
    profile = profiled(SHIPPED, kernel, argument, bytearray(64))
    assert_adds_up(profile, SHIPPED, kernel, argument, bytearray(64))
    assert profile.cycle_model == "cortex-m4-trm/3@sram"
    assert profile.asleep_cycles == 0


@pytest.mark.parametrize("seed", range(6))
def test_the_tables_of_random_code_add_up(build: Build, seed: int) -> None:
    elf = build(random_program(seed, length=220))
    assert_adds_up(profiled(elf, "work"), elf, "work")


def test_each_kind_of_work_and_each_stall_is_what_the_table_of_prices_says(build: Build) -> None:
    elf = build(
        function("main", "bx lr")
        + function(
            "work",
            """
        ldr r1, =scratch    @ work 2
        ldr r2, [r1]        @ work 1, and 1 because r1 is just being loaded
        ldr r3, [r1, #4]    @ work 1: behind a load that it does not depend on
        str r3, [r1, #8]    @ work 0: behind a load
        ldr r2, [r1]        @ work 2, and 1 behind the store
        adds r2, #1         @ work 1
        vmov s0, r2         @ work 1
        vadd.f32 s1, s0, s0 @ work 1, and 1 for s0
        vdiv.f32 s2, s1, s1 @ work 1, and 1 for s1; the FPU is busy for 13 more
        nop                 @ work 1, under the division
        vadd.f32 s3, s2, s2 @ work 1, and 12 until the FPU is free, and 1 for the result
        cmp r2, #0          @ work 1
        beq 1f              @ work 1, not taken
        b 1f                @ work 1, and 1 refill
    1:  bx lr               @ work 1, and 2 refill
    """,
        )
        + ".ltorg\n.data\n.balign 4\nscratch: .word 1, 2, 3\n"
    )
    profile = profiled(elf, "work")
    assert profile.work == {
        Work.LOAD_STORE: 6,
        Work.INTEGER: 2,
        Work.FLOATING_POINT: 4,
        Work.BRANCH: 3,
        Work.SYSTEM: 1,
    }
    assert profile.stalls == {
        Stall.LOAD_USE: 1,
        Stall.STORE_BUFFER: 1,
        Stall.FP_RESULT: 2,
        Stall.DIVISION: 13,
        Stall.TAKEN_BRANCH: 3,
        Stall.ADDRESS: 0,
        Stall.FETCH: 0,
    }
    assert profile.cycles == 36
    assert profile.cycle_model == "cortex-m4-trm/3@flash"
    assert_adds_up(profile, elf, "work")


def test_calls_and_tail_calls_are_told_apart_and_counted(build: Build) -> None:
    elf = build(
        function("main", "bx lr")
        + function("outer", "push {r4, lr}\n bl f\n bl f\n pop {r4, pc}")  # 3 + 2 + 2 + 3 + 2 refill
        + function("f", "push {r3, lr}\n bl g\n pop.w {r3, lr}\n b h")  # 3 + 2 + 3 + 2, twice
        + function("g", "bx lr")
        + function("h", "bx lr")  # 3 each, twice
    )
    profile = profiled(elf, "outer")
    assert {stack.functions: stack.cycles for stack in profile.stacks} == {
        ("outer",): 12,
        ("outer", "f"): 20,
        ("outer", "f", "g"): 6,
        ("outer", "f", "h"): 6,
    }
    assert {row.name: (row.calls, row.self_cycles, row.cycles) for row in profile.functions} == {
        "outer": (1, 12, 44),
        "f": (2, 20, 32),
        "g": (2, 6, 6),
        "h": (2, 6, 6),
    }
    assert_adds_up(profile, elf, "outer")


@pytest.fixture
def in_c(build: Build, tmp_path: Path) -> Callable[..., Path]:
    """Return a function that builds C files, the first named `program.c`."""

    def compile_files(main: str, *flags: str, **more: str) -> Path:
        for name, text in {"program_c": main, **more}.items():
            (tmp_path / name.replace("_", ".")).write_text(text)
        sources = [str(tmp_path / name.replace("_", ".")) for name in more if name.endswith("_c")]
        return build(tmp_path / "program.c", *flags, *sources, f"-I{tmp_path}")

    return compile_files


RECURSION = """
int fib(int n) { return n < 2 ? n : fib(n - 1) + fib(n - 2); }
int odd(int n);
int even(int n) { return n == 0 ? 1 : !odd(n - 1) + 0 * n; }
int odd(int n) { return n == 0 ? 0 : !even(n - 1) + 0 * n; }
int main(void) { return fib(1) + even(1); }
"""


def test_a_recursive_function_is_counted_once_in_what_it_costs(in_c: Callable[..., Path]) -> None:
    elf = in_c(RECURSION)
    profile = profiled(elf, "fib", 10)
    assert profile.value == 55
    (fib,) = profile.functions
    assert (fib.calls, fib.cycles, fib.self_cycles) == (177, profile.cycles, profile.cycles)
    assert_adds_up(profile, elf, "fib", 10)


def test_a_deep_mutual_recursion_stays_small_and_exact(in_c: Callable[..., Path]) -> None:
    elf = in_c(RECURSION)
    profile = profiled(elf, "even", 2000)
    assert {row.name: row.calls for row in profile.functions} == {"even": 1001, "odd": 1000}
    assert max(len(stack.functions) for stack in profile.stacks) <= 102
    assert_adds_up(profile, elf, "even", 2000)


def test_inlined_code_is_shown_where_it_was_written(in_c: Callable[..., Path]) -> None:
    elf = in_c(
        '#include "square.h"\nint sum(int n) {\n int s = 0;\n for (int i = 0; i < n; i++)\n  s += square(i);\n'
        " return s;\n}\nint main(void) { return sum(2); }\n",
        square_h="static inline __attribute__((always_inline)) int square(int x) {\n return x * x + 1;\n}\n",
    )
    profile = profiled(elf, "sum", 10)
    assert [row.name for row in profile.functions] == ["sum"]
    (inlined,) = [line for line in profile.lines if line.location == "square.h:2"]
    assert inlined.instructions >= 10, "the multiplication of each round"
    assert_adds_up(profile, elf, "sum", 10)


def test_static_functions_of_one_name_are_told_apart(in_c: Callable[..., Path]) -> None:
    one = (
        "static __attribute__((noinline)) int step(int x) {{ return x {op}; }}\n"
        "int {name}(int x) {{ return step(x) + 1; }}\n"
    )
    elf = in_c(
        "int one(int x);\nint two(int x);\nint main(void) { return one(1) + two(1); }\n",
        "-fno-ipa-ra",
        one_c=one.format(op="* 3", name="one"),
        two_c=one.format(op="* x + 5", name="two"),
    )
    profile = profiled(elf, "main")
    steps = [row for row in profile.functions if row.name.startswith("step@0x")]
    assert [step.calls for step in steps] == [1, 1]
    assert len({row.name for row in profile.functions}) == len(profile.functions) == 5


def test_without_debug_information_functions_are_still_told_apart(in_c: Callable[..., Path]) -> None:
    elf = in_c(RECURSION, "-g0")
    profile = profiled(elf, "main")
    assert profile.lines == ()
    assert {row.name for row in profile.functions} == {"main", "fib", "even", "odd"}
    assert_adds_up(profile, elf, "main")


def test_sleep_is_shown_beside_the_work(build: Build) -> None:
    # SysTick is pending, so that WFI ends, and masked, so that it is not taken.
    elf = build(
        function("main", "bx lr")
        + function(
            "nap",
            """
        ldr r0, =0xE000E010
        movw r1, #9999
        str r1, [r0, #4]
        str r1, [r0, #8]
        movs r1, #7
        str r1, [r0]
        wfi
        movs r1, #0
        str r1, [r0]
        bx lr
    """,
        )
        + ".ltorg\n"
    )
    profile = profiled(elf, "nap")
    assert 9900 < profile.asleep_cycles <= 10_000
    assert_adds_up(profile, elf, "nap")


def test_pointers_in_a_structure_lead_to_what_they_point_to(in_c: Callable[..., Path]) -> None:
    elf = in_c("""
        struct list { unsigned char tag; const short *values; unsigned short count; long long sum; };
        int add(struct list *list) {
            list->sum = 0;
            for (int i = 0; i < list->count; i++) list->sum += list->values[i];
            return (int)sizeof *list + list->tag;
        }
        int main(void) { return 0; }
    """)
    total = np.zeros(1, np.int64)
    argument = Structure(b"\7", Address(np.array([1, -2, 300], np.int16)), np.array([3], np.uint16), total)
    assert argument.size == 24
    assert profiled(elf, "add", argument).value == 24 + 7
    assert total.tolist() == [299]


def test_every_row_that_prices_instructions_has_a_class() -> None:
    added = {
        "load_behind_load",
        "store_behind_load",
        "load_behind_store",
        "refill_direct",
        "refill_indirect",
        "fp_use",
        "fp_accumulate_hidden",
        "fp_divide_use",
        "exception_entry",
        "exception_return",
    }
    optional = {"it_skipped", "multiply", "multiply_accumulate", "multiply_long", "accumulate_long"}
    assert set(WORK_OF_ROW) == set(load_profile("cortex-m4-trm/1").rows) - added | optional


def test_profiles_can_be_taken_one_after_the_other_on_one_board() -> None:
    board = VirtualK64F(SHIPPED)
    first = profile_call(board, "crc32", b"123456789", 9)
    board.call("crc32", bytes(500), 500)
    assert profile_call(board, "crc32", b"123456789", 9) == first
    assert first.value == 0xCBF43926
    assert Counter(address.function for address in first.addresses) == {"crc32": len(first.addresses)}
    assert struct.pack("<I", first.value)[0] == 0x26
