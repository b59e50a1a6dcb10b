"""Firmware that handles its faults gets them as the part would deliver them; how a run ends names the first one."""

from __future__ import annotations

import pytest

from hiltest.errors import BoardFault
from hiltest.virtual.board.k64f import VirtualK64F

from .conftest import SHIPPED, Build
from .oracle import ran
from .test_faults import HEAD

# A handler that notes what it finds and ends the program in a way that a test can see.
HANDLER = """
    function {name}
    ldr r12, =record
    mrs r0, ipsr
    str r0, [r12], #4
    ldr r0, ={CFSR}
    ldr r1, [r0]
    str r1, [r12], #4
    ldr r1, [r0, #4]
    str r1, [r12], #4
    ldr r1, [r0, #16]
    str r1, [r12], #4
    str lr, [r12], #4
    tst lr, #4
    ite eq
    mrseq r0, msp
    mrsne r0, psp
    .rept 8
    ldr r1, [r0], #4
    str r1, [r12], #4
    .endr
    {last}
    ends {name}
    .ltorg
"""
DATA = """
    .type culprit, %object
    .data
    .balign 8
    .type record, %object
record: .space 64
    .type marks, %object
marks: .space 16
"""
SKIP = "mrs r0, msp\nldr r1, [r0, #24]\nadds r1, #2\nstr r1, [r0, #24]\nbx lr"
LAST = "movs r7, #0x77\n1:  b 1b"
FIELDS = ("ipsr", "cfsr", "hfsr", "bfar", "lr", "r0", "r1", "r2", "r3", "r12", "stacked_lr", "pc", "xpsr")

CFSR, SHCSR, CCR = 0xE000ED28, 0xE000ED24, 0xE000ED14
DATA_BUS, UNDEFINED, INVSTATE, INVPC = 0x8200, 1 << 16, 1 << 17, 1 << 18
NOCP, UNALIGNED, DIVBYZERO = 1 << 19, 1 << 24, 1 << 25
FORCED, DEBUGEVT = 1 << 30, 1 << 31


def program(code: str, *, name: str = "HardFault_Handler", last: str = LAST, before: str = "") -> str:
    """Write a main that faults at `culprit`, with registers and a mark that tell what ran before and behind."""
    main = f"""
    {before}
    ldr r5, =marks
    movs r0, #1
    str r0, [r5]
    b prepare
prepare:
    {code}
    movs r4, #2
    str r4, [r5, #4]
    b finished
finished:
    wfi
    b finished
    ends main
    .ltorg
"""
    return HEAD.replace("culprit:", "") + main + HANDLER.format(name=name, last=last, CFSR=CFSR) + DATA


def record(board: VirtualK64F) -> dict[str, int]:
    words = board.processor.memory.read_words(board.image.symbols["record"].address, len(FIELDS))
    return dict(zip(FIELDS, words, strict=True))


def marks(board: VirtualK64F) -> tuple[int, ...]:
    return board.processor.memory.read_words(board.image.symbols["marks"].address, 4)


def run_to_the_handlers_loop(board: VirtualK64F) -> BoardFault:
    with pytest.raises(BoardFault) as caught:
        board.run_until(0.1)
    return caught.value


ENABLE_FAULTS = f"ldr r0, ={SHCSR}\n    ldr r1, =7 << 16\n    str r1, [r0]"
TRAP_DIVISION = f"ldr r0, ={CCR}\n    ldr r1, [r0]\n    orr r1, r1, #0x10\n    str r1, [r0]"

CASES = {
    "a read where nothing is": (
        "ldr r0, =0x30000000\nculprit: ldr r1, [r0]",
        DATA_BUS,
        "read of unmapped address 0x30000000",
    ),
    "a write where nothing is": (
        "ldr r0, =0x30000000\nculprit: str r1, [r0]",
        DATA_BUS,
        "write to unmapped address 0x30000000",
    ),
    "a write to flash": ("movs r0, #64\nculprit: str r0, [r0]", DATA_BUS, "write to flash at address 0x00000040"),
    "a gated peripheral": ("ldr r0, =0x4006A000\nculprit: ldrb r1, [r0]", DATA_BUS, "UART0 while its clock gate"),
    "no peripheral": ("ldr r0, =0x40010000\nculprit: ldr r1, [r0]", DATA_BUS, "no peripheral"),
    "an undefined instruction": ("movs r0, #64\nculprit: udf #1", UNDEFINED, "undefined"),
    "the FPU switched off": ("movs r0, #64\nculprit: vadd.f32 s0, s0, s0", NOCP, "CPACR"),
    "an unaligned LDRD": (
        "ldr r0, =0x20000002\nculprit: ldrd r2, r3, [r0]",
        UNALIGNED,
        "unaligned access: r0 = 0x20000002",
    ),
    "an unaligned LDM": ("ldr r0, =0x20000006\nculprit: ldm r0, {r2, r3}", UNALIGNED, "r0 = 0x20000006"),
    "a division by zero": (
        f"{TRAP_DIVISION}\nb 1f\n1: movs r0, #0\nculprit: udiv r1, r1, r0",
        DIVBYZERO,
        "division by zero",
    ),
    "a signed division by zero": (
        f"{TRAP_DIVISION}\nb 1f\n1: movs r3, #0\nculprit: sdiv r1, r1, r3",
        DIVBYZERO,
        "division by zero",
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_a_hard_fault_handler_reads_what_happened_and_where(build: Build, case: str) -> None:
    code, status, cause = CASES[case]
    board = VirtualK64F(build(program(code)))
    fault = run_to_the_handlers_loop(board)
    result = record(board)
    culprit = board.image.symbols["culprit"].address & ~1
    assert (result["ipsr"], result["cfsr"], result["hfsr"]) == (3, status, FORCED)
    assert result["pc"] == culprit
    assert result["lr"] == 0xFFFFFFF9
    assert result["xpsr"] >> 24 & 1
    if status == DATA_BUS:
        assert result["bfar"] == result["r0"]
    assert marks(board)[:2] == (1, 0)  # what stands before the instruction has happened, what stands behind it has not
    assert (fault.pc, fault.function) == (culprit, "main")
    assert cause in fault.cause
    assert fault.location.startswith("program.S:")
    assert set(fault.registers) >= {"r0", "sp", "lr", "pc"}
    assert "after: " in str(fault)
    assert fault.ending.startswith("hang at ")
    assert "HardFault_Handler (program.S:" in fault.ending
    assert [(entry.exception, entry.fault.pc) for entry in board.faults] == [("HardFault", culprit)]


def test_a_fault_takes_an_entry_and_the_instruction_that_faults_nothing(build: Build) -> None:
    board = ran(build(program("ldr r0, =0x30000000\nnop\nnop\nculprit: ldr r1, [r0]\nnop", last=SKIP)), 0.001)
    assert len(board.faults) == 1


@pytest.mark.parametrize(
    ("name", "number", "code", "status"),
    [
        ("BusFault_Handler", 5, "ldr r0, =0x30000000\nculprit: ldr r1, [r0]", DATA_BUS),
        ("UsageFault_Handler", 6, "culprit: udf #1", UNDEFINED),
        ("MemManage_Handler", 4, "ldr r0, =0xE0000001\nbx r0\nculprit:", 1),
    ],
)
def test_an_enabled_handler_takes_its_own_faults(build: Build, name: str, number: int, code: str, status: int) -> None:
    board = VirtualK64F(build(program(code, name=name, before=ENABLE_FAULTS)))
    run_to_the_handlers_loop(board)
    result = record(board)
    assert (result["ipsr"], result["cfsr"], result["hfsr"]) == (number, status, 0)
    assert board.faults[0].exception == name.removesuffix("_Handler")


def test_a_supervisor_call_that_may_not_run_is_a_hard_fault(build: Build) -> None:
    board = VirtualK64F(build(program("cpsid i\nsvc 3\nculprit: nop")))
    fault = run_to_the_handlers_loop(board)
    assert (record(board)["ipsr"], record(board)["hfsr"]) == (3, FORCED)
    assert record(board)["pc"] == board.image.symbols["culprit"].address & ~1  # behind the SVC
    assert fault.cause.startswith("SVC while")


def test_a_breakpoint_without_a_debugger_is_a_hard_fault(build: Build) -> None:
    board = VirtualK64F(build(program("culprit: bkpt 1")))
    run_to_the_handlers_loop(board)
    assert (record(board)["cfsr"], record(board)["hfsr"]) == (0, DEBUGEVT)


def test_a_jump_to_an_even_address_is_an_invalid_state(build: Build) -> None:
    board = VirtualK64F(build(program("ldr r0, =target\nbic r0, r0, #1\nbx r0\nculprit: nop\n.balign 4\ntarget: nop")))
    fault = run_to_the_handlers_loop(board)
    result = record(board)
    assert (result["cfsr"], result["pc"]) == (INVSTATE, result["r0"])
    assert not result["xpsr"] >> 24 & 1
    assert "even address" in fault.cause


def test_a_handler_that_skips_the_instruction_lets_the_program_go_on(build: Build) -> None:
    board = VirtualK64F(build(program("ldr r0, =0x30000000\nculprit: ldr r1, [r0]", last=SKIP)))
    board.run_until(0.001)
    assert marks(board)[:2] == (1, 2)
    assert [entry.fault.function for entry in board.faults] == ["main"]
    assert "after" not in board.position()


@pytest.mark.parametrize("condition", ["eq", "ne"])
def test_a_repaired_instruction_inside_an_it_block_goes_on_inside_it(build: Build, condition: str) -> None:
    # The handler repairs r0; the load runs again, and the rest of the IT block by the same condition.
    last = "mrs r0, msp\nldr r1, =marks\nstr r1, [r0]\nbx lr"
    code = f"""movs r3, #0
    ldr r0, =0x30000000
    cmp r3, #{0 if condition == "eq" else 1}
    itte {condition}
    str{condition} r3, [r5, #8]
culprit: ldr{condition} r1, [r0]
    ldr{"ne" if condition == "eq" else "eq"} r1, =0xBAD
    str r1, [r5, #12]"""
    board = VirtualK64F(build(program(code, last=last)))
    board.run_until(0.001)
    assert record(board)["xpsr"] & 0x0600FC00  # the stacked state says where in the IT block
    assert marks(board) == (1, 2, 0, 1)


def test_a_fault_in_the_handler_is_a_lockup_that_names_the_first_cause(build: Build) -> None:
    board = VirtualK64F(build(program("ldr r0, =0x30000000\nculprit: ldr r1, [r0]", last="udf #7")))
    with pytest.raises(BoardFault, match=r"^lockup at 0x\w+ in HardFault_Handler .*undefined instruction") as caught:
        board.run_until(0.1)
    assert caught.value.cause.startswith("read of unmapped address 0x30000000")
    assert caught.value.function == "main"


def test_a_handler_that_sleeps_for_ever_is_a_hang_that_names_the_first_cause(build: Build) -> None:
    board = VirtualK64F(build(program("culprit: udf #1", last="1: wfi\nb 1b")))
    with pytest.raises(BoardFault, match=r"^hang at .*WFI.*after: undefined instruction"):
        board.run_until(0.1)


def test_a_handler_that_loops_in_many_instructions_is_seen_from_outside(build: Build) -> None:
    board = VirtualK64F(build(program("culprit: udf #1", last="1: nop\nb 1b")))
    board.run_until(0.001)
    assert board.position().startswith("executing HardFault_Handler (program.S:")
    assert "after: undefined instruction" in board.position()


def test_firmware_that_resets_itself_after_a_fault_is_named_and_runs_again(build: Build) -> None:
    reset = "ldr r0, =0xE000ED0C\nldr r1, =0x05FA0004\nstr r1, [r0]\n1: b 1b"
    board = VirtualK64F(build(program("culprit: udf #1", last=reset)))
    for _ in range(2):
        with pytest.raises(BoardFault, match=r"^the firmware reset itself, after: undefined instruction") as caught:
            board.run_until(0.1)
        assert caught.value.function == "main"
    assert len(board.faults) == 2


def test_the_shipped_firmwares_record_of_a_fault_is_the_truth() -> None:
    board = VirtualK64F(SHIPPED)
    board.boot()
    board.processor.memory.write(board.image.symbols["main"].address & ~1, b"\x00\xde")
    with pytest.raises(BoardFault, match=r"^the firmware reset itself, after: undefined instruction de00"):
        board.run_until(0.3)
    marker, cause, exception, *frame = board.processor.memory.read_words(
        board.image.symbols["fault_record"].address, 14
    )
    assert (marker, cause, exception) == (0x4C544146, 1, 3)
    assert frame[6] == board.image.symbols["main"].address & ~1
    assert frame[8:10] == [UNDEFINED, FORCED]


def test_a_task_stack_that_leaves_ram_is_a_stacking_fault(build: Build) -> None:
    code = """ldr r0, =0x10000000
    msr psp, r0
    mrs r0, control
    orr r0, r0, #2
    msr control, r0
    isb
culprit: svc 0"""
    board = VirtualK64F(build(program(code)))
    fault = run_to_the_handlers_loop(board)
    assert record(board)["cfsr"] == 1 << 12
    assert fault.cause.startswith("no RAM for a stack frame at 0x0fffff")


def test_a_return_that_fits_no_exception_is_an_invalid_return(build: Build) -> None:
    handler = """
    function SVC_Handler
    ldr r0, =0xFFFFFFF1
    bx r0
    ends SVC_Handler
"""
    board = VirtualK64F(build(program("culprit: svc 0").replace("    .data", handler + "    .ltorg\n    .data")))
    fault = run_to_the_handlers_loop(board)
    assert record(board)["cfsr"] == INVPC
    assert fault.function == "SVC_Handler"


def test_status_bits_are_cleared_by_writing_ones(build: Build) -> None:
    last = f"""ldr r0, ={CFSR}
    movs r1, #0x80
    strb r1, [r0, #1]
    ldr r2, [r0]
    ldr r1, =0xFFFFFFFF
    str r1, [r0]
    ldr r3, [r0]
    ldr r7, =marks
    str r2, [r7, #8]
    str r3, [r7, #12]
    1: b 1b"""
    board = VirtualK64F(build(program("ldr r0, =0x30000000\nculprit: ldr r1, [r0]", last=last)))
    run_to_the_handlers_loop(board)
    assert marks(board)[2:] == (0x0200, 0)
