"""What the core counts of calibrators and of random code is what the model in Python counts, step by step."""

from __future__ import annotations

import random
import struct

import numpy as np
import pytest

from hiltest.errors import BoardFault
from hiltest.virtual.board.k64f import VirtualK64F
from hiltest.virtual.calls.calling import CallResult

from .conftest import SHIPPED, Build
from .oracle import acted, called
from .test_faults import HEAD, TAIL

ONE, TWO = "cortex-m4-trm/1", "cortex-m4-trm/3"
KERNELS = ("magnetometer_direct", "magnetometer_iterative", "magnetometer_empty")
POINTS_ADDRESS = 0x20020000


def call_kernel(board: VirtualK64F, kernel: str, points: np.ndarray) -> tuple[CallResult, bytes]:
    """Run a calibrator over points; the call, and its answer."""
    board.processor.memory.write(POINTS_ADDRESS, points.astype("<i2").tobytes())
    low, high = points.min(axis=0).tolist(), points.max(axis=0).tolist()
    argument = struct.pack("<IH3h3h2x", POINTS_ADDRESS, len(points), *low, *high)
    fit = bytearray(64)
    return board.call(kernel, argument, fit), bytes(fit)


def run_kernel(board: VirtualK64F, kernel: str, points: np.ndarray) -> tuple[int, int, bytes]:
    """Run a calibrator over points; its cycles, instructions and answer."""
    result, fit = call_kernel(board, kernel, points)
    return result.cycles, result.instructions, fit


def cloud(n: int, seed: int) -> np.ndarray:
    generator = np.random.default_rng(seed)
    directions = generator.normal(size=(n, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    noise = generator.normal(size=(n, 3)) * 4
    return np.round(485 * directions * (1.03, 0.99, 0.98) + (120, -80, 40) + noise).astype(np.int16)


@pytest.mark.parametrize(("kernel", "n", "profile"), [*zip(KERNELS, (20, 3, 3), (TWO, TWO, ONE), strict=True)])
def test_a_kernel_takes_the_cycles_of_the_model(kernel: str, n: int, profile: str) -> None:
    _, (cycles, instructions, _) = acted(SHIPPED, lambda board: run_kernel(board, kernel, cloud(n, seed=n)), profile)
    assert cycles > instructions > 0


def test_the_same_call_costs_the_same_cycles_every_time(shipped_board: VirtualK64F) -> None:
    points = cloud(100, seed=1)
    first = run_kernel(shipped_board, "magnetometer_direct", points)
    for _ in range(3):
        run_kernel(shipped_board, "magnetometer_iterative", points)
        assert run_kernel(shipped_board, "magnetometer_direct", points) == first


def random_program(seed: int, length: int) -> str:
    """Write a function of random straight-line code, IT blocks, short branches and loops."""
    choose = random.Random(seed)
    # The function straddles pages of 1 KiB and 4 KiB: instructions lie in two of them.
    lines = ["function main", "bx lr", ".balign 4096", ".space 3800", "function work"]
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
    lines += ["subs r6, #1", "bne.w top", "pop {r4-r7, pc}", "ends work", ".ltorg"]
    lines += [".data", ".balign 8", "scratch: .space 128, 17"]
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize(("seed", "profile"), [(1, ONE), *((seed, TWO) for seed in range(2, 8))])
def test_random_code_takes_the_cycles_of_the_model(build: Build, seed: int, profile: str) -> None:
    result = called(build(random_program(seed, length=220)), "work", profile=profile)
    assert result.instructions > 3 * 220


@pytest.mark.parametrize(("branch", "cycles"), [("beq", 2), ("bne", 1)])
def test_a_branch_to_the_instruction_behind_it_refills_the_pipeline_if_it_is_taken(
    build: Build, branch: str, cycles: int
) -> None:
    code = f"    cmp r0, r0\n    {branch} 1f\n1:" + TAIL
    assert called(build(HEAD + code), "main").cycles == 1 + 1 + cycles + 3


@pytest.mark.parametrize("jump", ["bx r0", "nop\n    nop\n    bx r0"])
def test_a_jump_that_faults_behind_it_is_counted(build: Build, jump: str) -> None:
    elf = build(HEAD + f"    ldr r0, =culprit\n    bic r0, r0, #1\n    {jump}" + TAIL)
    board, fault = acted(elf, lambda board: board.call("main"))
    assert isinstance(fault, BoardFault)
    assert "even address" in str(fault)
    assert board.instructions == 4 + jump.count("nop")  # and `main` begins with a nop
