"""What a real part would trap, and what would hang it, ends in a BoardFault that names the place."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Callable, Iterator

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hiltest.errors import BoardFault, ConfigError
from hiltest.virtual.board.k64f import VirtualK64F
from hiltest.virtual.board.microcontroller import Microcontroller
from hiltest.virtual.peripherals.rcm import ResetSource
from hiltest.virtual.program.elf import FirmwareImage

from .conftest import SHIPPED, Build

HEAD = """
    function main
    nop
culprit:
"""
TAIL = "\n    bx lr\n    ends main\n    .ltorg\n    .data\nwords: .word 0x20000006\n"

# A loop to itself that a tick every 1000 cycles interrupts; r7 counts them.
WAITS_FOR_TICKS = """
    ldr r0, =0xE000E014
    ldr r1, =999
    str r1, [r0]
    str r1, [r0, #4]
    movs r1, #7
    ldr r0, =0xE000E010
    str r1, [r0]
wait:
    b wait
    function SysTick_Handler
    adds r7, #1
    bx lr
    ends SysTick_Handler
"""

CASES = [
    ("a jump into nothing", "ldr r0, =0x30000001\n    bx r0", "unmapped address"),
    ("a branch to itself", "b culprit", "hang: a branch to itself"),
    ("sleep that nothing ends", "cpsid i\n    wfi\n    wfi", "hang: WFI"),
    ("a breakpoint", "bkpt 1", "breakpoint"),
]


@pytest.mark.parametrize(("what", "code", "cause"), CASES, ids=[case[0] for case in CASES])
def test_a_fault_names_its_cause_and_place(build: Build, what: str, code: str, cause: str) -> None:
    board = VirtualK64F(build(HEAD + "    " + code + TAIL))
    board.may_rest = False
    with pytest.raises(BoardFault, match=cause) as caught:
        # A hang must be found at once, not when the time is up: an hour would take minutes to execute.
        board.run_until(3600.0 if "sleep" not in what else float("inf"))
    fault = caught.value
    assert fault.function == "main"
    assert fault.location.startswith("program.S:")
    assert set(fault.registers) >= {"r0", "sp", "lr", "pc"}


GATES_OPEN = """
    ldr r0, =0x40048028
    ldr r1, =0xFFFFFFFF
    movs r2, #7
1:  str r1, [r0], #4
    subs r2, #1
    bne 1b
"""

HOSTILE = {
    "a stack nowhere": ("ldr r0, =0x10000000\n mov sp, r0\n udf #1", "lockup.*after: undefined instruction"),
    "a stack that leaves SRAM": (
        "1: push {r0-r7}\n b 1b",
        "lockup.*after: stack overflow: write to unmapped address 0x1ffeff",
    ),
    "a jump to the last halfword of SRAM": (
        "ldr r1, =0x2002FFFE\n ldr r2, =0xBF00\n strh r2, [r1]\n adds r1, #1\n bx r1",
        "jump to unmapped address 0x20030000",
    ),
    "half an instruction at the end of SRAM": (
        "ldr r1, =0x2002FFFE\n ldr r2, =0xF3AF\n strh r2, [r1]\n adds r1, #1\n bx r1",
        "jump to unmapped address 0x20030000",
    ),
    "a loop in the last halfword of SRAM": (
        "ldr r1, =0x2002FFFE\n ldr r2, =0xE7FE\n strh r2, [r1]\n adds r1, #1\n bx r1",
        "hang: a branch to itself that no interrupt can end at 0x2002fffe",
    ),
    "a jump to where called functions return to": ("ldr r0, =0x1FFEF001\n bx r0", "address 0x1ffef000 at .*main"),
    "no memory at VTOR": ("ldr r0, =0xE000ED08\n ldr r1, =0x10000000\n str r1, [r0]\n svc 0", "no memory at VTOR"),
    "vectors of zero": ("ldr r0, =0xE000ED08\n ldr r1, =0x20010000\n str r1, [r0]\n svc 0", "vector 0x00000000"),
    "EXC_RETURN without an exception": ("ldr r0, =0xFFFFFFF9\n bx r0", "0xfffffff9 while no exception is active"),
    "an unaligned LDREX": ("ldr r0, =0x20000002\n ldrex r1, [r0]", "unaligned exclusive access at .* in main"),
    "a coprocessor": ("mrc p15, 0, r0, c0, c0, 0", r"absent coprocessor \(NOCP\) at .* in main"),
    "a word across the end of the peripherals": (
        f"{GATES_OPEN}\n ldr r0, =0x40052FFE\n ldr r1, [r0]",
        "read of 0x40052ffe, where the chip has no peripheral at .* in main",
    ),
}


@pytest.mark.parametrize("case", HOSTILE)
def test_whatever_firmware_does_ends_in_a_fault_that_says_what_happened(build: Build, case: str) -> None:
    code, ending = HOSTILE[case]
    board = VirtualK64F(build(HEAD + code + TAIL))
    board.may_rest = False
    with pytest.raises(BoardFault, match=ending):
        board.run_until(0.01)
    board.position()  # whoever waits for the board says where it is


def test_waiting_in_a_loop_for_interrupts_passes_time_and_is_no_hang(build: Build) -> None:
    board = VirtualK64F(build(HEAD + WAITS_FOR_TICKS + TAIL))
    board.run_until(0.1)
    # A tick every thousand cycles, which are 2.1 million out of reset.
    assert board.processor.registers.snapshot()["r7"] == pytest.approx(2_097, abs=2)
    assert board.position().startswith("at rest, in a branch to itself in main (program.S:")


TICKS_AT_THE_END = WAITS_FOR_TICKS.replace("wait:\n", "    cpsid i\nwait:\n")


def test_a_program_that_ends_in_a_loop_rests_and_the_board_goes_on(build: Build) -> None:
    board = VirtualK64F(build(HEAD + "wait: b wait" + TAIL))
    board.run_until(0.004)
    assert board.time_s == pytest.approx(0.004, abs=1e-6)
    assert board.instructions == pytest.approx(0.004 * 20_971_520 / 2, rel=0.01)  # two cycles a turn
    with pytest.raises(BoardFault, match="hang: a branch to itself"):
        board.run_until(float("inf"))  # nothing will ever happen
    masked = VirtualK64F(build(HEAD + TICKS_AT_THE_END + TAIL))
    masked.run_until(0.1)
    assert masked.position().startswith("at rest, in a branch to itself in main")


def test_in_a_handler_a_loop_is_no_rest(build: Build) -> None:
    loops = "function HardFault_Handler\n b ."
    board = VirtualK64F(build(HEAD + "udf #1" + TAIL.replace(".ltorg", f".ltorg\n{loops}")))
    with pytest.raises(BoardFault, match=r"hang at 0x.*: a branch to itself .*after: undefined instruction"):
        board.run_until(0.01)
    svc = loops.replace("HardFault", "SVC")
    board = VirtualK64F(build(HEAD + "svc 0" + TAIL.replace(".ltorg", f".ltorg\n{svc}")))
    with pytest.raises(BoardFault, match="hang: a branch to itself"):
        board.run_until(0.01)


def test_a_called_function_that_never_returns_is_a_hang(build: Build) -> None:
    board = VirtualK64F(build(HEAD + "    b culprit" + TAIL))
    with pytest.raises(BoardFault, match="hang"):
        board.call("main")


def test_calling_a_function_that_is_not_there_names_the_nearest(build: Build) -> None:
    board = VirtualK64F(build(HEAD + TAIL))
    with pytest.raises(ConfigError, match="near: main"):
        board.call("mian")


def test_a_file_that_is_no_firmware_is_refused() -> None:
    with pytest.raises(ConfigError, match="not a complete ELF"):
        VirtualK64F(b"\x7fELx" + bytes(60))


@pytest.mark.parametrize("size", [0, 16, 52, 100, 5000, 100_000])
def test_a_truncated_file_is_refused(size: int) -> None:
    with pytest.raises(ConfigError, match=r"complete ELF|ends within"):
        VirtualK64F(SHIPPED.read_bytes()[:size])


def test_a_damaged_header_is_refused_or_harmless(build: Build) -> None:
    whole = build(HEAD + TAIL).read_bytes()  # with a symbol table that is read in no time

    @settings(deadline=None)  # how long a board takes to be made is the machine's affair
    @given(st.integers(0, 0x53), st.integers(0, 255))  # ELF header and first program header
    def is_refused_or_harmless(position: int, value: int) -> None:
        content = bytearray(whole)
        content[position] = value
        with contextlib.suppress(ConfigError):
            VirtualK64F(bytes(content))

    is_refused_or_harmless()


@pytest.mark.parametrize(
    ("flags", "case"),
    [(["-mcpu=cortex-m7", "-mfpu=fpv5-d16"], "floating-point unit"), (["-mcpu=cortex-m33"], "Armv8-M Mainline")],
)
def test_an_image_for_a_neighbouring_core_is_refused(build: Build, flags: list[str], case: str) -> None:
    elf = build(HEAD + TAIL, *flags, with_start=False)
    with pytest.raises(ConfigError, match=case):
        VirtualK64F(elf)


@pytest.mark.parametrize(
    ("position", "word"),
    [(0, 0), (0, 0x20030004), (4, 0), (4, 0x00000410), (4, 0x20000001)],
    ids=["no stack", "stack past SRAM", "no reset", "no Thumb bit", "reset in RAM"],
)
def test_a_vector_table_that_is_none_is_refused(build: Build, position: int, word: int) -> None:
    elf = bytearray(build(HEAD + TAIL).read_bytes())
    image = FirmwareImage(bytes(elf))
    at = bytes(elf).index(image.segments[0].data)
    elf[at + position : at + position + 4] = word.to_bytes(4, "little")
    board = VirtualK64F(bytes(elf))
    with pytest.raises(ConfigError, match="no valid vector table"):
        board.run_until(0.1)


def test_a_handler_without_the_thumb_bit_is_a_fault(build: Build) -> None:
    board = VirtualK64F(build(HEAD + "    svc 0" + TAIL))
    board.boot()
    board.processor.memory.write_words(4 * 11, [0x410])
    with pytest.raises(BoardFault, match="exception 11 has no Thumb bit"):
        board.run_until(0.1)


def test_ctrl_c_stops_a_running_board_and_it_can_go_on(build: Build) -> None:
    board = VirtualK64F(build(HEAD + "1:  adds r7, #1\n    nop\n    b 1b" + TAIL))

    def run_with_ctrl_c() -> None:
        threading.Timer(0.03, signal.raise_signal, [signal.SIGINT]).start()
        board.run_until(3600.0)

    for _ in range(20):
        # Anywhere in callbacks and between them: none may be dropped.
        with pytest.raises(KeyboardInterrupt):
            run_with_ctrl_c()
    # Not after each: on a busy machine the signal may come before the first instruction does.
    stopped = board.cycles
    assert stopped > 0
    board.run_until(board.time_s + 0.001)
    assert board.cycles - stopped == pytest.approx(0.001 * board.clocks.core_hz, abs=3)  # of the last instruction


def test_ctrl_c_within_a_reset_leaves_no_half_reset_board(build: Build, monkeypatch: pytest.MonkeyPatch) -> None:
    board = VirtualK64F(build(HEAD + "1:  adds r7, #1\n    nop\n    b 1b" + TAIL))
    reset_chip = Microcontroller.reset

    def reset_with_ctrl_c(chip: Microcontroller, source: ResetSource) -> None:
        signal.raise_signal(signal.SIGINT)
        reset_chip(chip, source)

    board.run_until(0.1)
    monkeypatch.setattr(Microcontroller, "reset", reset_with_ctrl_c)
    with pytest.raises(KeyboardInterrupt):
        board.reset()
    assert board.processor.core.r[15] != 0  # the vector table, which must not be executed
    board.run_until(0.2)
    assert board.processor.core.r[7] > 0


def test_a_handler_of_ctrl_c_that_raises_nothing_does_not_end_a_run_early(build: Build) -> None:
    board = VirtualK64F(build(HEAD + "1:  adds r7, #1\n    nop\n    b 1b" + TAIL))
    presses: list[int] = []

    def note(number: int, _frame: object) -> None:
        presses.append(number)
        signal.signal(signal.SIGINT, signal.default_int_handler)  # the next one breaks in

    with restored_handler(note):
        threading.Timer(0.03, signal.raise_signal, [signal.SIGINT]).start()
        board.run_until(5.0)
        assert board.time_s == pytest.approx(5.0)
        threading.Timer(0.03, signal.raise_signal, [signal.SIGINT]).start()
        with pytest.raises(KeyboardInterrupt):
            board.run_until(3600.0)
    assert presses == [signal.SIGINT]


@contextlib.contextmanager
def restored_handler(handler: Callable[[int, object], None]) -> Iterator[None]:
    before = signal.signal(signal.SIGINT, handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
