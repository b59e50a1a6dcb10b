"""The block hook in C and the one in Python count, stop and find faults alike."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from hiltest.errors import BoardFault, ConfigError
from hiltest.virtual.accounting import AccountingFactory, BlockAccounting
from hiltest.virtual.k64f import VirtualK64F
from hiltest.virtual.native import CHOICE, build, by_block
from hiltest.virtual.native.accounting import NativeBlockAccounting

from .conftest import PROGRAMS, SHIPPED, Build
from .test_faults import HEAD, TAIL, WAITS_FOR_TICKS
from .test_peripherals import Part
from .test_peripherals import _framed as framed

# What every program of these tests begins with: the FPU is off at reset.
FPU_ON = """
    ldr r0, =0xE000ED88
    ldr r1, =0xF << 20
    str r1, [r0]
    dsb
    isb
"""


def state(board: VirtualK64F) -> tuple[object, ...]:
    """Everything that a counting mistake could show in."""
    processor = board.processor
    return (
        board.cycles, board.instructions, processor.idle_cycles, processor.registers.snapshot(),
        list(board.cycle_counter.readings), bytes(processor.memory.sram.view),
    )  # fmt: skip


def test_both_hooks_agree_across_interrupts_that_use_the_fpu(build: Build, native_hook: AccountingFactory) -> None:
    elf = build(PROGRAMS / "exceptions.c")
    states = []
    for hook in (BlockAccounting, native_hook):
        board = VirtualK64F(elf, accounting=hook)
        # In pieces: each end and beginning of a piece settles what is running.
        for until_s in (0.001, 0.0012345, 0.004, 0.05):
            board.run_until(until_s)
            states.append(state(board))
    assert states[:4] == states[4:]
    assert len({counted[0] for counted in states[:4]}) == 4


def test_both_hooks_agree_on_a_session_with_serial_port_and_sensors(native_hook: AccountingFactory) -> None:
    states = []
    for hook in (BlockAccounting, native_hook):
        sensors = Part(0x0E), Part(0x1E)
        board = VirtualK64F(SHIPPED, accounting=hook, i2c1=sensors)
        board.run_until(0.2)
        for message in ("11 07 0000", "01 01 0400 efbeadde"):
            board.uart0.host_write(framed(bytes.fromhex(message)))
            board.run_until(board.time_s + 0.1)
        states.append((*state(board), board.uart0.host_read(1000), [part.seen for part in sensors]))
    assert states[0] == states[1]


def test_both_hooks_pass_the_time_of_a_loop_to_itself_alike(build: Build, native_hook: AccountingFactory) -> None:
    elf = build(HEAD + WAITS_FOR_TICKS + TAIL)
    states = []
    for hook in (BlockAccounting, native_hook):
        board = VirtualK64F(elf, accounting=hook)
        board.run_until(0.0123)
        states.append(state(board))
    assert states[0] == states[1]
    assert states[0][1] > 100_000  # instructions: the rounds that were passed at once are counted


UNALIGNED = f"""
    {FPU_ON}
    ldr r0, =0x20000000
    movs r2, #100
again:
    vldr s0, [r0]
    vldmia r0!, {{s1}}
    subs r2, #1
    bne again
    adds r0, #2
    b last
last:
    vldr s0, [r0]
"""

INSIDE = f"""
    {FPU_ON}
    ldr r3, =0x20000000
    movs r2, #9
again:
    str r3, [sp, #-4]
    ldr r0, [sp, #-4]
    vldr s0, [r0]
    subs r2, #1
    bne again
    adds r3, #1
    movs r2, #1
    b again
"""

DISABLED = f"""
    {FPU_ON}
    movs r2, #9
again:
    vadd.f32 s0, s0, s0
    subs r2, #1
    bne again
    movs r1, #0
    str r1, [r0]
    b last
last:
    vadd.f32 s0, s0, s0
"""


@pytest.mark.parametrize(
    ("code", "cause"),
    [
        (UNALIGNED, "unaligned access: r0 = 0x20000192 in 'vldr s0"),
        (INSIDE, "unaligned access: r0 = 0x20000001 in 'vldr s0"),
        (DISABLED, "FPU used while CPACR disables it"),
    ],
    ids=["unaligned behind aligned ones", "loaded and unaligned within a block", "FPU switched off again"],
)
def test_what_was_right_many_times_is_still_looked_at(
    build: Build, block_hook: AccountingFactory, code: str, cause: str
) -> None:
    board = VirtualK64F(build(HEAD + code + TAIL), accounting=block_hook)
    with pytest.raises(BoardFault, match=cause):
        board.run_until(0.01)


def test_a_base_from_the_stack_pointer_or_the_pc_needs_no_look(build: Build, block_hook: AccountingFactory) -> None:
    code = f"""
    {FPU_ON}
    movs r3, #1
    movs r4, #1
    b 1f
1:  add r3, sp, #-8
    vldr s0, [r3]
    adr r4, 2f
    vldr s1, [r4]
    b end
    .balign 4
2:  .word 0
end:
    b .
"""
    board = VirtualK64F(build(HEAD + code + TAIL), accounting=block_hook)
    board.run_until(0.01)
    assert board.position().startswith("at rest")


def test_the_environment_chooses_the_hook(monkeypatch: pytest.MonkeyPatch, native_hook: AccountingFactory) -> None:
    def chosen(value: str) -> type:
        monkeypatch.setenv(CHOICE, value)
        return type(VirtualK64F(SHIPPED).processor.accounting)

    assert chosen("python") is BlockAccounting
    assert chosen("native") is NativeBlockAccounting
    assert chosen("auto") is NativeBlockAccounting
    with pytest.raises(ConfigError, match="choose auto, native or python"):
        chosen("rust")


def test_the_command_says_which_hook_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(CHOICE, "python")
    command = [sys.executable, "-m", "hiltest.virtual.native"]
    result = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    assert result.stdout.startswith("python: ")


@pytest.mark.parametrize(
    ("compiler", "reason"),
    [("no-such-compiler", "no C compiler"), ("false", "the C compiler failed"), ("", "CC is empty")],
)
def test_a_missing_or_broken_compiler_leaves_no_library_and_is_no_error(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, compiler: str, reason: str
) -> None:
    library = tmp_path / "block_hook.so"
    library.write_bytes(b"of an older build")
    monkeypatch.setattr(build, "LIBRARY", library)
    monkeypatch.setenv("CC", compiler)
    assert reason in build.compile_library()
    assert not list(tmp_path.iterdir())


def test_a_place_that_cannot_be_written_to_is_a_reason_and_no_error(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, require_tool: object
) -> None:
    require_tool("gcc")  # type: ignore[operator]
    library = tmp_path / "block_hook.so"
    library.mkdir()  # stands in for a file system that is read-only, which does not stop root
    monkeypatch.setattr(build, "LIBRARY", library)
    monkeypatch.setenv("CC", "gcc")
    assert "could not be run" in build.compile_library()


@pytest.mark.parametrize("kept", [0.0, 0.05, 0.25, 0.5, 0.75, 0.95])
def test_a_library_that_is_cut_off_is_not_used_and_kills_nothing(
    tmp_path: Path, native_hook: AccountingFactory, kept: float
) -> None:
    content = build.LIBRARY.read_bytes()
    part = tmp_path / "block_hook.so"
    part.write_bytes(content[: int(kept * len(content))])
    code = (
        "import importlib, pathlib, sys; library = importlib.import_module('hiltest.virtual.native.library')\n"
        "library.LIBRARY = pathlib.Path(sys.argv[1]); print(library.missing_because())"
    )
    result = subprocess.run([sys.executable, "-c", code, str(part)], capture_output=True, text=True, timeout=60)
    assert result.returncode == 0
    assert result.stdout.startswith(str(part))


def test_the_source_compiles_without_a_warning(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, require_tool: object
) -> None:
    require_tool("gcc")  # type: ignore[operator]
    monkeypatch.setattr(build, "LIBRARY", tmp_path / "block_hook.so")
    monkeypatch.setenv("CC", "gcc")
    assert build.compile_library("-Wall", "-Wextra", "-Wconversion", "-Werror", "-pedantic") == ""
    assert build.LIBRARY.exists()


def test_by_block_is_what_a_board_uses_by_default() -> None:
    assert type(VirtualK64F(SHIPPED).processor.accounting) is type(by_block(None, None, None, None))  # type: ignore[arg-type]
