"""How deep stacks get: on programs whose stack is known, and beside what memory holds below it."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from hiltest.virtual.board.k64f import VirtualK64F
from hiltest.virtual.processor.stacks import Stack, known_stacks

from .conftest import Build
from .foreign import machine_for, program_named, watch
from .test_rtos import BuildTasks, build_tasks  # noqa: F401 (a fixture)

FRAME = 32  # an exception's, without floating-point state
# The stack is aligned to eight where it is lowest.
DEEP = """
    function main
    push {r4, lr}
    bl {function}
1:  wfi
    b 1b
    ends main

    function plain
    push {r0-r6, lr}
    sub sp, #200
    add sp, #200
    pop {r0-r6, pc}
    ends plain

    function beyond
    push {r6, lr}
    mov r3, #1000
    sub sp, sp, r3
    bl plain
    add sp, sp, r3
    pop {r6, pc}
    ends beyond

    function calls
    push {r0-r6, lr}
    svc 0
    pop {r0-r6, pc}
    ends calls

    function alone
    ldr r0, =other + 400
    mov r4, sp
    mov sp, r0
    push {r0-r3}
    pop {r0-r3}
    mov sp, r4
    push {r4, lr}
    pop {r4, pc}
    ends alone

    function SVC_Handler
    push {r4-r5}
    pop {r4-r5}
    bx lr
    ends SVC_Handler

    .bss
    .balign 8
    .type other, %object
    .size other, 400
other:
    .space 400
"""


def stacks_of(board: VirtualK64F) -> list[Stack]:
    return known_stacks(board.processor.machine)


@pytest.mark.parametrize(
    ("function", "used"),
    [("plain", 8 + 32 + 200), ("beyond", 8 + 8 + 1000 + 32 + 200), ("calls", 8 + 32 + FRAME + 8)],
    ids=["frames that stand in the code", "an amount that does not", "an exception on top"],
)
def test_a_stack_is_as_deep_as_its_frames(build: Build, tmp_path: Path, function: str, used: int) -> None:
    (tmp_path / "deep.S").write_text(DEEP.replace("{function}", function), encoding="utf-8")
    board = VirtualK64F(build(tmp_path / "deep.S"))
    board.run_until(0.001)
    (stack,) = stacks_of(board)
    assert stack.used == used
    assert board.memory_use()["stack_most"] == used


def test_a_stack_elsewhere_is_one_of_its_own(build: Build, tmp_path: Path) -> None:
    (tmp_path / "deep.S").write_text(DEEP.replace("{function}", "alone"), encoding="utf-8")
    board = VirtualK64F(build(tmp_path / "deep.S"))
    board.run_until(0.001)
    main, other = stacks_of(board)
    assert (main.used, other.used) == (8 + 8, 16)
    assert other.top == board.image.symbols["other"].address + 400
    assert board.memory_use()["alone.stack_most"] == 16


@pytest.mark.parametrize(
    ("function", "used"),
    [
        ("plain", {"plain": 232}),
        ("beyond", {"beyond": 8 + 1000 + 232, "plain": 232}),
        ("calls", {"calls": 32}),
        ("alone", {"alone": None}),
    ],
    ids=[
        "frames that stand in the code",
        "an amount that does not",
        "an exception on top is not its own",
        "on another stack in between",
    ],
)
def test_a_call_takes_what_it_and_what_it_calls_put_on_the_stack(
    build: Build, tmp_path: Path, function: str, used: dict[str, int | None]
) -> None:
    (tmp_path / "deep.S").write_text(DEEP.replace("{function}", function), encoding="utf-8")
    board = VirtualK64F(build(tmp_path / "deep.S"))
    watch = board.watch_calls([*used, "SVC_Handler"])
    board.run_until(0.001)
    assert {name: {call.stack for call in watch.calls(name)} for name in used} == {
        name: {item} for name, item in used.items()
    }
    assert {call.stack for call in watch.calls("SVC_Handler")} == ({8} if function == "calls" else set())


def test_a_reset_begins_at_the_top_again_and_forgets_nothing(build: Build, tmp_path: Path) -> None:
    (tmp_path / "deep.S").write_text(DEEP.replace("{function}", "plain"), encoding="utf-8")
    board = VirtualK64F(build(tmp_path / "deep.S"))
    board.run_until(0.001)
    board.reset()
    board.run_until(0.002)
    (stack,) = stacks_of(board)
    assert stack.used == 8 + 32 + 200


def test_registers_that_a_kernel_puts_below_a_tasks_stack_pointer_are_on_its_stack(
    build_tasks: BuildTasks,  # noqa: F811 (the fixture)
) -> None:
    board = VirtualK64F(build_tasks("-O2"))
    board.run_until(0.03)
    _, *tasks = stacks_of(board)
    assert len(tasks) == 2
    for stack in tasks:
        lowest, below = (board.processor.memory.read(address, 64) for address in (stack.lowest, stack.lowest - 64))
        assert any(lowest), stack
        assert not any(below), stack


# What fills the stacks of the kernels before anything runs there; what is not filled is zero.
FILLS = ({0x00}, {0xA5}, {0xAA}, {0xCC})


@pytest.mark.parametrize("name", ["sdk_freertos_hello", "sdk_freertos_swtimer", "z_synchronization", "nxp_shell"])
def test_below_each_stack_of_others_programs_nothing_was_written(name: str) -> None:
    program = program_named(name)
    machine = machine_for(program)
    watch(program, machine, seconds=0.5)
    stacks = stacks_of(machine)
    assert len(stacks) >= (1 if name == "nxp_shell" else 3)
    for stack in stacks:
        below = machine.processor.memory.read(stack.lowest - 24, 24)
        assert set(below) in FILLS, (stack, below)
        assert any(machine.processor.memory.read(stack.lowest, 64)), stack


def test_flash_and_ram_are_what_the_compilers_own_tool_says(
    shipped_board: VirtualK64F, require_tool: Callable[[str], str]
) -> None:
    output = subprocess.run(
        [require_tool("arm-none-eabi-size"), "-A", "-d", os.fspath(shipped_board.image.name)],
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    rows = [item for line in output.splitlines() if len(item := line.split()) == 3 and item[1].isdigit()]
    sizes = {name: (int(size), int(address)) for name, size, address in rows}
    in_ram = {name: size for name, (size, address) in sizes.items() if 0x1FFF0000 <= address < 0x20030000}
    zeroed = sum(in_ram.get(name, 0) for name in (".bss", ".noinit"))
    loaded = sum(size for name, (size, address) in sizes.items() if 0 <= address < 0x100000 and _is_loaded(name))
    used = shipped_board.memory_use()
    # Segments begin at multiples of eight, and each is counted with what fills it up.
    assert used["ram"] == pytest.approx(sum(in_ram.values()), abs=8 * len(in_ram))
    assert used["flash"] == pytest.approx(loaded + sum(in_ram.values()) - zeroed, abs=8 * len(sizes))


def _is_loaded(section: str) -> bool:
    return section.startswith(".") and not section.startswith((".debug", ".comment", ".ARM.attributes", ".GCC"))
