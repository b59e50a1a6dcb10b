"""Each encoding does what Unicorn does with it, from random states: registers, flags, memory and faults."""

from __future__ import annotations

import os
import random
import struct
from collections import Counter
from functools import cache
from typing import Any

import pytest
import unicorn
from unicorn import arm_const as arm
from unicorn import unicorn_py3

from .decoder import Encoding, encodings
from .inner_library import inner_library

STATES = int(os.environ.get("HILTEST_STATES_PER_ENCODING", "40"))
CODE, DATA, SIZE = 0x10000000, 0x20200000, 0x2000  # no bit of DATA has an alias: Unicorn does not know those
_CONTROL, _NON_SECURE = 20, 0x80  # numbers of special registers
_VMOV = CODE + 0x800  # address of vmov.f32 s0, s0
_CORE = [f"R{n}" for n in range(16)]
_SPECIAL = ["XPSR", "MSP", "PSP", "CONTROL", "PRIMASK", "BASEPRI", "FAULTMASK", "FPSCR"]
_NAMES = [*_CORE, *_SPECIAL, *(f"S{n}" for n in range(32))]
_NUMBERS = [getattr(arm, f"UC_ARM_REG_{name}") for name in _NAMES]
_FLAGS, _T, _FPCA = 0xF80F0000, 1 << 24, 4  # with CONTROL.FPCA no context is made, so that FPSCR stays as it is set
# The lowest bits of a stack pointer are always zero (DDI 0403E, B1.4.7); Unicorn keeps them in some instructions.
# Of a priority four bits are implemented; Unicorn has eight.
_COMPARED = {"XPSR": _FLAGS | _T, "CONTROL": 7, "BASEPRI": 0xF0, "R13": ~3, "MSP": ~3, "PSP": ~3}
# Unicorn stops or goes elsewhere at these; tests of their own show what the core does.
_APART = {"SVC", "BKPT", "UNDEFINED", "NO_COPROCESSOR", "WFE", "WFI", "SEV", "YIELD", "IT", "CPS"}


@cache
def emulator() -> Any:
    engine: Any = unicorn_py3.Uc(unicorn.UC_ARCH_ARM, unicorn.UC_MODE_THUMB | unicorn.UC_MODE_MCLASS)
    engine.ctl_set_cpu_model(arm.UC_CPU_ARM_CORTEX_M4)
    engine.mem_map(CODE, 0x1000)
    engine.mem_map(DATA, SIZE)
    engine.interrupts = []

    def note_interrupt(_engine: Any, number: int, _data: Any) -> None:
        engine.interrupts.append(number)
        engine.emu_stop()

    engine.hook_add(unicorn.UC_HOOK_INTR, note_interrupt)
    return engine


@cache
def machine() -> tuple[Any, Any, Any]:
    ffi, library = inner_library()
    made = library.machine_create(False)
    assert library.machine_add_memory(made, CODE, 0x1000, True) != ffi.NULL
    assert library.machine_add_memory(made, DATA, SIZE, True) != ffi.NULL
    library.machine_set_fpu(made, True)
    core = library.machine_core(made)
    core.deadline = 2**62
    return ffi, library, made


class State:
    """A random state, in which addresses are near data."""

    def __init__(self, chance: random.Random, bits: int, size: int) -> None:
        self.code = code_of(bits, size)
        self.core = [self._word(chance) for _ in range(13)]
        self.stack = DATA + 4 * chance.randrange(64, SIZE // 4 - 64)
        self.link = chance.randrange(2**32)
        self.floats = [self._float(chance) for _ in range(32)]
        self.fpscr = chance.choice((0, 0, chance.randrange(2**32))) & 0xF7C0009F
        self.flags = chance.randrange(2**32) & _FLAGS
        self.it_state = chance.choice((0, 0, 0, chance.randrange(14) << 4 | 8, chance.randrange(14) << 4 | 4))
        self.data = chance.randbytes(SIZE)

    @staticmethod
    def _word(chance: random.Random) -> int:
        kind = chance.randrange(6)
        if kind < 3:
            return DATA + chance.randrange(0x200, SIZE - 0x200) // 4 * 4
        if kind == 3:
            return chance.randrange(64)
        return chance.choice((0, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 0x7FFF8000, chance.randrange(2**32)))

    @staticmethod
    def _float(chance: random.Random) -> int:
        if chance.randrange(4):
            return struct.unpack("<I", struct.pack("<f", chance.uniform(-100, 100)))[0]
        return chance.choice((0, 1 << 31, 0x7F800000, 0xFF800000, 0x7FC00001, 0x7F800001, 1, chance.randrange(2**32)))

    @property
    def xpsr(self) -> int:
        return 1 << 24 | self.flags | (self.it_state & 3) << 25 | self.it_state >> 2 << 10

    def page(self) -> bytes:
        """Return the page of code: the instructions, and behind them one that does nothing."""
        return (self.code + b"\x00\xbf" * 8).ljust(_VMOV - CODE, b"\0") + b"\xb0\xee\x40\x0a" + b"\x00\xbf" * 8

    def registers(self) -> dict[str, int]:
        return {
            **{f"R{n}": value for n, value in enumerate(self.core)}, "R13": self.stack, "R14": self.link,
            "FPSCR": self.fpscr, **{f"S{n}": value for n, value in enumerate(self.floats)},
        }  # fmt: skip


def run_unicorn(state: State, *, until: int | None = None) -> tuple[str, dict[str, int], bytes]:
    engine = emulator()
    engine.interrupts.clear()
    engine.mem_write(CODE, state.page())
    engine.mem_write(DATA, state.data)
    engine.ctl_remove_cache(CODE, CODE + 256)
    begin = {"XPSR": 1 << 24, "CONTROL": _FPCA, "PRIMASK": 0, "BASEPRI": 0, "FAULTMASK": 0, "PSP": 0}
    for name, value in begin.items():
        engine.reg_write(getattr(arm, f"UC_ARM_REG_{name}"), value)
    engine.emu_start(_VMOV | 1, 0xFFFFFFFE, count=1)  # the first instruction of the FPU sets FPSCR
    before = state.registers()
    engine.reg_write_batch([(getattr(arm, f"UC_ARM_REG_{name}"), value) for name, value in before.items()])
    engine.reg_write(arm.UC_ARM_REG_XPSR_NZCVQG, state.flags)  # GE too, which XPSR leaves alone
    engine.reg_write(arm.UC_ARM_REG_XPSR, state.xpsr)
    try:
        if until is None:
            engine.emu_start(CODE | 1, 0xFFFFFFFE, count=1)
        else:
            engine.emu_start(CODE | 1, until)
        outcome = "fault" if engine.interrupts else "ran"
    except unicorn.UcError:
        outcome = "fault"
    values = dict(zip(_NAMES, engine.reg_read_batch(_NUMBERS), strict=True))
    values["XPSR"] |= engine.reg_read(arm.UC_ARM_REG_XPSR_NZCVQG)
    return outcome, values, bytes(engine.mem_read(DATA, SIZE))


def run_core(state: State, *, limit: int = 1) -> tuple[str, dict[str, int], bytes]:
    ffi, library, made = machine()
    core = library.machine_core(made)
    library.machine_reset(made)
    library.machine_set_fpu(made, True)
    core.control = _FPCA
    for address, data in ((CODE, state.page()), (DATA, state.data)):
        library.machine_write(made, address, len(data), data)
    for name, value in state.registers().items():
        if name[0] == "R":
            core.r[int(name[1:])] = value
        elif name[0] == "S":
            core.s[int(name[1:])] = value
    core.fpscr, core.r[15] = state.fpscr, CODE
    library.machine_set_xpsr(made, state.xpsr)
    core.may_loop = True
    core.instruction_limit = core.instructions + limit
    reason = library.machine_run(made)
    outcomes = {library.STOP_STEP: "ran", library.STOP_RETURNED: "ran", library.STOP_FAULT: "fault"}
    outcome = outcomes.get(reason, f"stopped: {reason}")
    values = {f"R{n}": core.r[n] for n in range(16)} | {f"S{n}": core.s[n] for n in range(32)}
    values |= {
        "XPSR": library.machine_xpsr(made), "MSP": library.machine_stack_pointer(made, False),
        "PSP": library.machine_stack_pointer(made, True), "CONTROL": core.control, "PRIMASK": core.primask,
        "BASEPRI": core.basepri, "FAULTMASK": core.faultmask, "FPSCR": core.fpscr,
    }  # fmt: skip
    data = ffi.new("uint8_t[]", SIZE)
    library.machine_read(made, DATA, SIZE, data)
    return outcome, values, bytes(ffi.buffer(data))


def operation(code: bytes) -> tuple[str, Any]:
    """Name what the decoder takes an instruction for, and return its fields."""
    ffi, library, _ = machine()
    decoded = ffi.new("struct instruction *")
    first, second = struct.unpack("<HH", (code + b"\0\0")[:4])
    library.decode_instruction(CODE, first, second, 0, False, decoded)
    return ffi.string(library.operation_name(decoded.operation)).decode(), decoded


def is_explained(name: str, decoded: Any, state: State, outcomes: tuple[str, str], fault: int) -> bool:
    """Whether the architecture manual (DDI 0403E) explains that the core does something else than Unicorn."""
    _, library, _ = machine()
    ours, theirs = outcomes
    if name.startswith("STREX") and (ours, theirs, fault) == ("fault", "ran", library.FAULT_UNALIGNED):
        return True  # B2.3.7: the alignment is checked before the monitor
    if (ours, theirs, fault) == ("fault", "ran", library.FAULT_UNALIGNED):
        return True  # A3.2.1: LDM, STM, LDRD, STRD and the FPU's transfers need addresses that are multiples of four
    if name == "LDRD_W" or (name == "LDRD" and decoded.mode):
        return decoded.n in (decoded.d, decoded.a)  # UNPREDICTABLE
    if name == "MRS" and (decoded.immediate == _CONTROL or decoded.immediate >= _NON_SECURE):
        return True  # Unicorn has the special registers of ARMv8-M
    if decoded.transfer and state.it_state & 7:
        return True  # UNPREDICTABLE: a branch that is not the last instruction of an IT block
    # VCVT (between floating-point and fixed-point): always rounded to nearest; Unicorn rounds as FPSCR says.
    return name == "VCVT_FROM_FIXED" and state.fpscr >> 22 & 3 != 0


def differences(state: State) -> list[str]:
    """Run an instruction in both; return what differs."""
    outcome, theirs, their_data = run_unicorn(state)
    ours_outcome, ours, our_data = run_core(state)
    can_go_on = CODE <= ours["R15"] < CODE + 0x1000 and ours["XPSR"] & _T
    if (outcome, ours_outcome) == ("fault", "ran") and not can_go_on:
        return []  # it has fetched the next instruction too, which cannot run
    behind = CODE + len(state.code)
    if state.it_state and ours["R15"] == behind < theirs["R15"] <= behind + 4:
        theirs["R15"] = behind  # it does not count what an IT block skips, and has executed a NOP behind that
    _, library, made = machine()
    name, decoded = operation(state.code)
    fault = library.machine_core(made).fault.kind
    if is_explained(name, decoded, state, (ours_outcome, outcome), fault):
        return []
    if outcome != ours_outcome:
        return [f"outcome: {ours_outcome}, Unicorn {outcome}"]
    if outcome == "fault":
        return []
    differing = [
        f"{name}: {ours[name]:08x}, Unicorn {theirs[name]:08x}"
        for name in _NAMES if (ours[name] ^ theirs[name]) & _COMPARED.get(name, 0xFFFFFFFF)
    ]  # fmt: skip
    return differing + (["memory"] if our_data != their_data else [])


def random_instance(chance: random.Random, encoding: Encoding) -> int:
    return chance.randrange(1 << 8 * encoding.size) & ~encoding.mask | encoding.value


def code_of(bits: int, size: int) -> bytes:
    return struct.pack("<H", bits) if size == 2 else struct.pack("<HH", bits >> 16, bits & 0xFFFF)


@pytest.mark.parametrize("encoding", encodings(), ids=lambda encoding: encoding.name)
def test_an_encoding_does_what_unicorn_does(encoding: Encoding) -> None:
    emulator.cache_clear()  # one that has run many programs gives wrong answers
    chance, size = random.Random(encoding.name), encoding.size
    problems: Counter[str] = Counter()
    for _ in range(STATES):
        bits = random_instance(chance, encoding)
        state = State(chance, bits, size)
        if operation(state.code)[0] in _APART:  # a special case of the encoding may be another instruction
            continue
        if found := differences(state):
            problems[f"{bits:0{2 * size}x}, it {state.it_state:02x}: {'; '.join(found[:4])}"] += 1
    assert not problems, f"{len(problems)} of {STATES}:\n" + "\n".join(list(problems)[:6])


SEQUENCES = int(os.environ.get("HILTEST_SEQUENCES", "1000"))
LENGTH = 20


@cache
def straight_encodings() -> list[Encoding]:
    """Return the encodings of which random instances neither branch nor reach the processor's masks."""
    chance = random.Random(1)

    def is_straight(encoding: Encoding) -> bool:
        codes = [code_of(random_instance(chance, encoding), encoding.size) for _ in range(64)]
        operations = [operation(code) for code in codes]
        return not any(decoded.transfer or name in {*_APART, "MSR", "MRS"} for name, decoded in operations)

    return [encoding for encoding in encodings() if is_straight(encoding)]


def random_sequence(chance: random.Random) -> bytes:
    """Return random instructions that may follow on one another, with IT blocks."""
    code = b""
    while len(code) < 4 * LENGTH:
        encoding = chance.choice(straight_encodings())
        instruction = code_of(random_instance(chance, encoding), encoding.size)
        name, decoded = operation(instruction)
        if name in _APART or decoded.transfer or name.startswith(("LDREX", "STREX", "VCVT_FROM_FIXED", "LDRD")):
            continue  # see `is_explained`
        if decoded.core_writes >> 13 & 1:
            continue  # see `_COMPARED`
        if chance.randrange(8) == 0:
            code += struct.pack("<H", 0xBF08 | chance.randrange(14) << 4)
        code += instruction
    return code


def test_sequences_do_what_unicorn_does_up_to_the_same_fault() -> None:
    chance = random.Random(7)
    ffi, library, made = machine()
    core = library.machine_core(made)
    executed, problems = 0, []
    for _ in range(SEQUENCES):
        state = State(chance, 0xBF00, 2)
        state.it_state, state.code = 0, random_sequence(chance)
        end = CODE + len(state.code)
        before = core.instructions
        core.return_address = end
        ours_outcome, ours, our_data = run_core(state, limit=1000)
        executed += core.instructions - before
        outcome, theirs, their_data = run_unicorn(state, until=end)
        fault, place = core.fault.kind, core.fault.place
        if fault in (library.FAULT_UNALIGNED, library.FAULT_UNDEFINED_INSTRUCTION):
            continue  # Unicorn lets it pass, see `is_explained`
        code = ffi.new("uint8_t[]", len(state.code))
        library.machine_read(made, CODE, len(code), code)
        if bytes(ffi.buffer(code)) != state.code:
            continue  # it has rewritten itself without a barrier (A3.8.3): Unicorn may go on with what was there
        if fault and core.it_state:
            continue  # Unicorn goes on behind a store of an IT block that faults
        compared = [name for name in _NAMES if not (ours_outcome == "fault" and name in ("R15", "XPSR"))]
        differing = [name for name in compared if (ours[name] ^ theirs[name]) & _COMPARED.get(name, 0xFFFFFFFF)]
        if outcome != ours_outcome or differing or (our_data != their_data and ours_outcome != "fault"):
            problems.append(f"{state.code.hex()}: {ours_outcome} at {place:x}, Unicorn {outcome}: {differing}")
    core.return_address = 2**32 - 1
    assert executed > LENGTH / 4 * SEQUENCES  # most do not fault at once
    assert not problems, f"{len(problems)}\n" + "\n".join(problems[:5])
