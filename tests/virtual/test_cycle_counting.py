"""Counting by block gives the totals that counting by instruction gives."""

from __future__ import annotations

import functools
import random
import struct
from pathlib import Path

import numpy as np
import pytest

from hiltest.errors import BoardFault
from hiltest.virtual.accounting import AccountingFactory, InstructionAccounting
from hiltest.virtual.k64f import VirtualK64F
from hiltest.virtual.profile_file import place_of

from .conftest import SHIPPED, Build
from .test_faults import HEAD, TAIL

PROFILES = ("cortex-m4-trm/1", "cortex-m4-trm/2")
KERNELS = ("magnetometer_direct", "magnetometer_iterative", "magnetometer_empty")
POINTS_ADDRESS = 0x20020000


def run_kernel(board: VirtualK64F, kernel: str, points: np.ndarray) -> tuple[int, int, bytes]:
    """Run a calibrator over points; its cycles, instructions and answer."""
    board.processor.memory.write(POINTS_ADDRESS, points.astype("<i2").tobytes())
    low, high = points.min(axis=0).tolist(), points.max(axis=0).tolist()
    argument = struct.pack("<IH3h3h2x", POINTS_ADDRESS, len(points), *low, *high)
    fit = bytearray(64)
    result = board.call(kernel, argument, fit)
    return result.cycles, result.instructions, bytes(fit)


def cloud(n: int, seed: int) -> np.ndarray:
    generator = np.random.default_rng(seed)
    directions = generator.normal(size=(n, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    noise = generator.normal(size=(n, 3)) * 4
    return np.round(485 * directions * (1.03, 0.99, 0.98) + (120, -80, 40) + noise).astype(np.int16)


@functools.cache
def counted_by_instruction(kernel: str, n: int, profile: str) -> tuple[int, int, bytes]:
    """What both hooks are compared with; it takes longer than they do."""
    board = VirtualK64F(SHIPPED, accounting=InstructionAccounting, profile=profile)
    return run_kernel(board, kernel, cloud(n, seed=n))


# By instruction the iterative kernel takes seconds whatever n is: most of it are its sweeps.
SIZES = [(kernel, n) for kernel in KERNELS for n in (3, 20, 100) if (kernel, n) != ("magnetometer_iterative", 20)]


@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize(("kernel", "n"), SIZES)
def test_counting_by_block_agrees_with_counting_by_instruction_on_every_kernel(
    block_hook: AccountingFactory, kernel: str, n: int, profile: str
) -> None:
    by_block = run_kernel(VirtualK64F(SHIPPED, accounting=block_hook, profile=profile), kernel, cloud(n, seed=n))
    assert by_block == counted_by_instruction(kernel, n, profile)


def step(board: VirtualK64F, function: str, state: bytes, argument: bytes) -> tuple[int, int, bytes, bytes]:
    """Make one step of a stream calibrator from a state; its cycles, instructions, next state and answer."""
    after, answer = bytearray(state), bytearray(argument)
    result = board.call(function, after, answer)
    return result.cycles, result.instructions, bytes(after), bytes(answer)


@pytest.mark.slow  # by instruction, in Python
@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize("stream", ["direct_stream", "iterative_stream", "iterative_stream sliced"])
def test_both_ways_of_counting_agree_on_the_steps_of_a_stream(stream: str, profile: str) -> None:
    """Every 20th step and those that run a whole solver, of 4 and of 7 elements: counting by instruction is slow."""
    name, _, sliced = stream.partition(" ")
    by_block = VirtualK64F(SHIPPED, profile=profile)
    by_instruction = VirtualK64F(SHIPPED, accounting=InstructionAccounting, profile=profile)
    fresh = bytearray(0x2000)
    by_block.call(f"{name}_reset", fresh, bool(sliced))
    state, solved = bytes(fresh), 0
    for index, point in enumerate(cloud(180, seed=180)):
        arguments = (f"{name}_add", state, point.astype("<i2").tobytes())
        found = step(by_block, *arguments)
        solved += found[0] > 20_000
        if index % 20 == 0 or found[0] > 20_000:
            assert step(by_instruction, *arguments) == found
        state = found[2]
    assert solved == (2 if stream == "iterative_stream" else 0)
    asked = (f"{name}_report", state, bytes(80))
    assert step(by_instruction, *asked) == step(by_block, *asked)


def test_the_same_call_costs_the_same_cycles_every_time(shipped_board: VirtualK64F) -> None:
    points = cloud(100, seed=1)
    first = run_kernel(shipped_board, "magnetometer_direct", points)
    for _ in range(3):
        run_kernel(shipped_board, "magnetometer_iterative", points)
        assert run_kernel(shipped_board, "magnetometer_direct", points) == first


def random_program(seed: int, length: int) -> str:
    """Write a function of random straight-line code, IT blocks, short branches and loops."""
    choose = random.Random(seed)
    lines = [".syntax unified", ".thumb", ".cpu cortex-m4", ".fpu fpv4-sp-d16", ".text"]
    lines += [".thumb_func", ".global main", ".type main, %function", "main:", "bx lr"]
    # The functions straddle pages of 1 KiB and 4 KiB, where the emulator cuts blocks.
    lines += [".balign 4096", ".space 3800", ".thumb_func", ".global work", ".type work, %function", "work:"]
    lines += ["push {r4-r7, lr}", "ldr r7, =scratch", "movs r6, #3", "top:"]
    forms = [
        lambda: f"adds r{r(5)}, r{r(5)}, r{r(5)}",
        lambda: f"mul r{r(5)}, r{r(5)}, r{r(5)}",
        lambda: f"umull r0, r{1 + r(4)}, r{r(5)}, r{r(5)}",
        lambda: f"ldr r{r(5)}, [r7, #{4 * r(16)}]",
        lambda: f"str r{r(5)}, [r7, #{4 * r(16)}]",
        lambda: f"ldrsh r{r(5)}, [r7, #{2 * r(16)}]",
        lambda: f"strb r{r(5)}, [r7, #{r(16)}]",
        lambda: f"ldmia r7, {{r{r(2)}, r{2 + r(3)}}}",
        lambda: f"vldr s{r(8)}, [r7, #{4 * r(16)}]",
        lambda: f"vstr s{r(8)}, [r7, #{4 * r(16)}]",
        lambda: f"vadd.f32 s{r(8)}, s{r(8)}, s{r(8)}",
        lambda: f"vmul.f32 s{r(8)}, s{r(8)}, s{r(8)}",
        lambda: f"vfma.f32 s{r(8)}, s{r(8)}, s{r(8)}",
        lambda: f"vdiv.f32 s{r(8)}, s{r(8)}, s{r(8)}",
        lambda: f"vmov r{r(5)}, s{r(8)}",
        lambda: f"cmp r{r(5)}, #{r(100)}\nite lt\nldrlt r{r(5)}, [r7]\naddge r{r(5)}, r{r(5)}, #1",
        lambda: f"eor.w r{r(5)}, r{r(5)}, r{r(5)}",
        lambda: f"add r5, r7, #{4 * r(16)}\nldr r{r(5)}, [r5]",
        lambda: f"cmp.w r{r(5)}, #{r(100)}\nit hi\nmovhi r{r(5)}, r{r(5)}",
        lambda: "\n".join(f"vadd.f32 s{r(4)}, s{4 + r(4)}, s{4 + r(4)}" for _ in range(r(9))) or "nop",
    ]

    def r(limit: int) -> int:
        return choose.randrange(limit)

    label = 0
    for _ in range(length):
        lines.append(choose.choice(forms)())
        if r(6) == 0:
            label += 1
            lines += [f"cmp r{r(5)}, r{r(5)}"]
            lines += [f"b{choose.choice(['eq', 'ne', 'lt', 'hi'])}{choose.choice(['', '.w'])} l{label}"]
            lines += [choose.choice(forms)() for _ in range(r(3))]
            lines.append(f"l{label}:")
    lines += ["subs r6, #1", "bne.w top", "pop {r4-r7, pc}", ".size work, . - work", ".ltorg"]
    lines += [".data", ".balign 8", "scratch: .space 128, 17"]
    return "\n".join(lines) + "\n"


def counted(elf: Path, accounting: AccountingFactory, profile: str) -> tuple[object, ...]:
    board = VirtualK64F(elf, accounting=accounting, profile=profile)
    result = board.call("work")
    return result.cycles, result.instructions, result.value


@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize("seed", range(12))
def test_counting_by_block_agrees_with_counting_by_instruction_on_random_code(
    build: Build, block_hook: AccountingFactory, seed: int, profile: str
) -> None:
    elf: Path = build(random_program(seed, length=220))
    assert counted(elf, block_hook, profile) == counted(elf, InstructionAccounting, profile)


def test_ways_of_counting_agree_on_random_code_where_integers_run_under_multiply_accumulates(
    build: Build, block_hook: AccountingFactory, tmp_path: Path
) -> None:
    text = place_of("cortex-m4-trm/1").read_text(encoding="utf-8")
    profile = tmp_path / "hidden.toml"
    profile.write_text(text.replace("value = 0\nband = [0, 2]", "value = 2\nband = [0, 2]"), encoding="utf-8")
    elf: Path = build(random_program(99, length=220))
    counted = [
        VirtualK64F(elf, profile=str(profile), accounting=each).call("work").cycles
        for each in (block_hook, InstructionAccounting)
    ]
    assert counted[0] == counted[1] < VirtualK64F(elf, profile="cortex-m4-trm/1").call("work").cycles


@pytest.mark.parametrize("jump", ["bx r0", "nop\n    nop\n    bx r0"])
def test_a_jump_that_faults_behind_it_is_counted(build: Build, block_hook: AccountingFactory, jump: str) -> None:
    elf = build(HEAD + f"    ldr r0, =culprit\n    bic r0, r0, #1\n    {jump}" + TAIL)
    counted = []
    for accounting in (block_hook, InstructionAccounting):
        board = VirtualK64F(elf, accounting=accounting)
        with pytest.raises(BoardFault, match="even address"):
            board.call("main")
        counted.append((board.cycles, board.instructions))
    assert counted[0] == counted[1]
    assert counted[0][1] == 4 + jump.count("nop")  # and `main` begins with a nop
