"""Each encoding does what Unicorn does with it, from random states: registers, flags, FPSCR, memory and faults."""

from __future__ import annotations

import os
import zlib
from collections import Counter
from functools import cache
from typing import Any

import numpy as np
import pytest
import unicorn
from numpy.typing import NDArray
from unicorn import arm_const as arm
from unicorn import unicorn_py3

from .decoder import Encoding, encodings, operation_name
from .inner_library import inner_library

Words = NDArray[np.uint32]

STATES = int(os.environ.get("HILTEST_STATES_PER_ENCODING", "100"))
STATES_IN_CI = 20 * STATES
INSTRUCTIONS = int(os.environ.get("HILTEST_INSTRUCTIONS_IN_SEQUENCE", "20000"))
INSTRUCTIONS_IN_CI = 50 * INSTRUCTIONS

CODE, CODE_SIZE = 0x10000000, 0x40000
DATA, DATA_SIZE = 0x20200000, 0x2000  # no bit of DATA has an alias: Unicorn does not know those
PAGE = 0x1000
# Unicorn translates up to a branch, which takes its time: behind an instruction there is one to itself.
NOP, IT, ENDLESS_LOOP, VMOV = 0xBF00, 0xBF00, 0xE7FE, 0xEEB00A40
SLOT = 16  # bytes of code for one state; no address is used twice, since Unicorn keeps what it has translated
NO_END = 0xFFFFFFFE
TRIALS = 200
_CONTROL, _NON_SECURE = 20, 0x80  # numbers of special registers
_FLAGS, _T, _FPCA = 0xF80F0000, 1 << 24, 4  # with CONTROL.FPCA no context is made, so that FPSCR stays as it is set

CORE = [f"R{n}" for n in range(16)]
FLOATS = [f"S{n}" for n in range(32)]
# XPSR_NZCVQG has GE too, which a write of XPSR leaves alone.
SET = [*CORE[:15], *FLOATS, "FPSCR", "XPSR_NZCVQG", "XPSR"]
COMPARED = [*CORE, *FLOATS, "FPSCR", "XPSR", "MSP", "PSP", "CONTROL", "PRIMASK", "BASEPRI", "FAULTMASK"]
# The lowest bits of a stack pointer are always zero (DDI 0403E, B1.4.7); Unicorn keeps them in some instructions.
# Of a priority four bits are implemented; Unicorn has eight.
_BITS = {"XPSR": _FLAGS | _T, "CONTROL": 7, "BASEPRI": 0xF0, "R13": ~3, "MSP": ~3, "PSP": ~3}
MASKS = np.array([_BITS.get(name, 0xFFFFFFFF) & 0xFFFFFFFF for name in COMPARED], np.uint32)
PC, XPSR = COMPARED.index("R15"), COMPARED.index("XPSR")
_UNICORN = """
int uc_reg_write_batch(void *engine, const int *numbers, void *const *values, int count);
int uc_reg_read_batch(void *engine, const int *numbers, void **values, int count);
int uc_emu_start(void *engine, uint64_t begin, uint64_t until, uint64_t timeout, size_t count);
int uc_mem_map_ptr(void *engine, uint64_t address, size_t size, uint32_t permissions, void *bytes);
int uc_context_alloc(void *engine, void **context);
int uc_context_save(void *engine, void *context);
int uc_context_restore(void *engine, void *context);
int uc_free(void *context);
"""
# What Unicorn calls a fault: numbers of QEMU's exceptions and of Unicorn's errors. 8 is a branch to EXC_RETURN, which
# in Thread mode is an address like any other (B1.5.8), and nothing executes there.
_EXCEPTIONS = {
    1: "UNDEFINED_INSTRUCTION",
    3: "EXECUTE_NEVER",
    4: "UNALIGNED",
    7: "BREAKPOINT",
    8: "EXECUTE_NEVER",
    17: "NO_COPROCESSOR",
    18: "INVALID_STATE",
}
_ERRORS = {
    unicorn.UC_ERR_READ_UNMAPPED: "DATA_BUS",
    unicorn.UC_ERR_WRITE_UNMAPPED: "DATA_BUS",
    unicorn.UC_ERR_FETCH_UNMAPPED: "INSTRUCTION_BUS",
    unicorn.UC_ERR_INSN_INVALID: "UNDEFINED_INSTRUCTION",
}
RAN = "ran"
# Unicorn stops or goes elsewhere at these; tests of their own show what the core does. What is undefined is compared in
# test_decode.py.
_APART = {"SVC", "UNDEFINED", "WFE", "WFI", "SEV", "YIELD", "IT"}


@cache
def library() -> tuple[Any, Any]:
    """Return cffi's `ffi` and the core's library."""
    ffi, core = inner_library()
    ffi.cdef(_UNICORN, override=True)
    return ffi, core


@cache
def unicorn_library() -> Any:
    """Return Unicorn's library."""
    return library()[0].dlopen(unicorn_py3.unicorn.uclib._name)


def pointers(values: Words) -> Any:
    """Return the address of each word."""
    ffi, _ = library()
    first = ffi.from_buffer("uint32_t[]", values)
    return ffi.new("void *[]", [first + index for index in range(len(values))])


def numbers(names: list[str]) -> Any:
    """Return Unicorn's numbers of registers."""
    ffi, _ = library()
    return ffi.new("int[]", [getattr(arm, f"UC_ARM_REG_{name}") for name in names])


class Unicorn:
    """Unicorn's Cortex-M4 with a memory of code and one of data, called without its binding, which is slow."""

    def __init__(self) -> None:
        self._ffi, _ = library()
        self._calls = unicorn_library()
        self._owner: Any = unicorn_py3.Uc(unicorn.UC_ARCH_ARM, unicorn.UC_MODE_THUMB | unicorn.UC_MODE_MCLASS)
        self._owner.ctl_set_cpu_model(arm.UC_CPU_ARM_CORTEX_M4)
        self._owner.hook_add(unicorn.UC_HOOK_INTR, self._note_exception)
        self._engine = self._ffi.cast("void *", self._owner._uch.value)
        self._exception = 0
        self.code, self.data = (self._map(*memory) for memory in ((CODE, CODE_SIZE), (DATA, DATA_SIZE)))
        self._before, self._after = np.zeros(len(SET), np.uint32), np.zeros(len(COMPARED), np.uint32)
        self._set = numbers(SET), pointers(self._before), len(SET)
        self._get = numbers(COMPARED), pointers(self._after), len(COMPARED)
        context = self._ffi.new("void **")
        self._calls.uc_context_alloc(self._engine, context)
        self._context = self._ffi.gc(context[0], self._calls.uc_free)
        self._prepare()

    def _map(self, base: int, size: int) -> Any:
        data = self._ffi.new("uint8_t[]", size + PAGE)
        first = data + -int(self._ffi.cast("uintptr_t", data)) % PAGE
        assert not self._calls.uc_mem_map_ptr(self._engine, base, size, unicorn.UC_PROT_ALL, first)
        return self._ffi.gc(first, lambda _, owner=data: None, size)

    def _prepare(self) -> None:
        """Execute an instruction of the FPU, so that those that follow begin no context."""
        for name, value in {"XPSR": _T, "CONTROL": _FPCA}.items():
            self._owner.reg_write(getattr(arm, f"UC_ARM_REG_{name}"), value)
        self._ffi.memmove(self.code, code_of(VMOV, 4) + code_of(ENDLESS_LOOP, 2), 6)
        assert not self._calls.uc_emu_start(self._engine, CODE | 1, NO_END, 0, 1)
        self._calls.uc_context_save(self._engine, self._context)

    def _note_exception(self, engine: Any, number: int, _: object) -> None:
        self._exception = number
        engine.emu_stop()

    def run(self, state: Words, place: int, *, until: int = NO_END, count: int = 1) -> tuple[str, Words]:
        """Execute from a state; return RAN or the kind of fault, and the registers."""
        self._calls.uc_context_restore(self._engine, self._context)
        self._before[:] = state
        self._calls.uc_reg_write_batch(self._engine, *self._set)
        self._exception = 0
        error = self._calls.uc_emu_start(self._engine, place | 1, until, 0, count)
        self._calls.uc_reg_read_batch(self._engine, *self._get)
        if self._exception:
            return _EXCEPTIONS.get(self._exception, f"exception {self._exception}"), self._after
        return (_ERRORS.get(error, f"error {error}") if error else RAN), self._after


class Core:
    """A machine of the core with the same memories."""

    def __init__(self) -> None:
        self._ffi, self._library = library()
        self._machine = self._ffi.gc(self._library.machine_create(False), self._library.machine_destroy)
        self.code, self.data = (
            self._library.machine_add_memory(self._machine, base, size, True)
            for base, size in ((CODE, CODE_SIZE), (DATA, DATA_SIZE))
        )
        self._core = self._library.machine_core(self._machine)
        self._core.deadline = 2**62
        self._after = np.zeros(len(COMPARED), np.uint32)
        self._words = self._ffi.from_buffer("uint32_t[]", self._after)
        names = self._ffi.typeof("enum fault_kind").elements
        self._kinds = {number: name.removeprefix("FAULT_") for number, name in names.items()}

    def write(self, address: int, data: bytes) -> None:
        """Write into a memory."""
        assert self._library.machine_write(self._machine, address, len(data), data)

    def code_at(self, address: int, size: int) -> bytes:
        """Return what is in the memory of code."""
        return bytes(self._ffi.buffer(self.code + (address - CODE), size))

    @property
    def fault(self) -> Any:
        """The latest fault."""
        return self._core.fault

    @property
    def instructions(self) -> int:
        """Instructions executed, skipped ones of IT blocks included."""
        executed: int = self._core.instructions
        return executed

    def run(self, state: Words, place: int, *, until: int = 2**32 - 1, count: int = 1) -> tuple[str, Words]:
        """Execute from a state; return RAN or the kind of fault, and the registers."""
        core, calls, machine, words = self._core, self._library, self._machine, self._words
        calls.machine_reset(machine)
        calls.machine_set_fpu(machine, True)
        before = self._ffi.from_buffer("uint32_t[]", state)
        self._ffi.memmove(core.r, before, 60)
        self._ffi.memmove(core.s, before + 15, 128)
        core.r[15], core.control, core.fpscr, core.may_loop = place, _FPCA, before[47], True
        calls.machine_set_xpsr(machine, before[49] | before[48])
        core.return_address, core.instruction_limit = until, core.instructions + count
        reason = calls.machine_run(machine)
        self._ffi.memmove(words, core.r, 64)
        self._ffi.memmove(words + 16, core.s, 128)
        words[48], words[49] = core.fpscr, calls.machine_xpsr(machine)
        words[50], words[51] = (calls.machine_stack_pointer(machine, process) for process in (False, True))
        words[52], words[53], words[54], words[55] = core.control, core.primask, core.basepri, core.faultmask
        if reason == calls.STOP_FAULT:
            return self._kinds[core.fault.kind], self._after
        return (RAN if reason in (calls.STOP_STEP, calls.STOP_RETURNED) else f"stop {reason}"), self._after


@cache
def core() -> Core:
    return Core()


class Pair:
    """The core and a new Unicorn, of which one that has run many programs gives wrong answers."""

    def __init__(self, chance: np.random.Generator) -> None:
        self._ffi, _ = library()
        self.core, self.unicorn = core(), Unicorn()
        self.core.write(CODE, bytes(CODE_SIZE))
        self.write(CODE, b"\0" * CODE_SIZE)
        self.write(DATA, chance.bytes(DATA_SIZE))

    def write(self, address: int, data: bytes) -> None:
        """Write into both memories."""
        memory, base = (self.unicorn.data, DATA) if address >= DATA else (self.unicorn.code, CODE)
        self._ffi.memmove(memory + (address - base), data, len(data))
        self.core.write(address, data)

    def has_same_data(self) -> bool:
        """Whether the memories of data are equal; makes them so."""
        ours, theirs = (self._ffi.buffer(data, DATA_SIZE) for data in (self.core.data, self.unicorn.data))
        if ours == theirs:
            return True
        self._ffi.memmove(self.unicorn.data, self.core.data, DATA_SIZE)
        return False


def random_states(chance: np.random.Generator, count: int) -> Words:
    """Return rows of the registers in SET, in which addresses are near data."""
    states = np.zeros((count, len(SET)), np.uint32)
    near = DATA + 4 * chance.integers(0x80, DATA_SIZE // 4 - 0x80, (count, 15))
    other = chance.choice([0, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 0x7FFF8000, 0], (count, 15))
    other[:, ::2] = chance.integers(0, 2**32, (count, 15))[:, ::2]
    kinds = chance.integers(0, 6, (count, 15))
    other = chance.permuted(other, axis=1)
    states[:, :15] = np.where(kinds < 3, near, np.where(kinds == 3, chance.integers(0, 64, (count, 15)), other))
    states[:, 13] = DATA + 4 * chance.integers(64, DATA_SIZE // 4 - 64, count)
    states[:, 14] = chance.integers(0, 2**32, count)
    special = chance.choice([0, 1 << 31, 0x7F800000, 0xFF800000, 0x7FC00001, 0x7F800001, 1, 0x80000001], (count, 32))
    special = np.where(chance.random((count, 32)) < 0.2, chance.integers(0, 2**32, (count, 32)), special)
    moderate = chance.uniform(-100, 100, (count, 32)).astype(np.float32).view(np.uint32)
    states[:, 15:47] = np.where(chance.random((count, 32)) < 0.75, moderate, special)
    states[:, 47] = np.where(chance.random(count) < 1 / 3, chance.integers(0, 2**32, count) & 0xF7C0009F, 0)
    states[:, 48] = chance.integers(0, 2**32, count) & _FLAGS
    states[:, 49] = _T | states[:, 48]
    return states


def random_it_states(chance: np.random.Generator, count: int) -> Words:
    """Return values of ITSTATE: outside a block, or before the last instruction of one or the last but one."""
    choice = chance.choice([0, 0, 0, 4, 8], count)
    return np.where(choice, chance.integers(0, 14, count) << 4 | choice, 0).astype(np.uint32)


def code_of(bits: int, size: int) -> bytes:
    return bits.to_bytes(2, "little") if size == 2 else (bits >> 16 | (bits & 0xFFFF) << 16).to_bytes(4, "little")


def random_instances(chance: np.random.Generator, encoding: Encoding, count: int) -> list[int]:
    """Return random instructions of an encoding; if it is one of those that are left apart, none.

    A special case of it may be another encoding, which stands before it in the table, or undefined.
    """
    table = encodings()
    special_cases = [
        (other.mask, other.value)
        for other in table[: table.index(encoding)]
        if other.size == encoding.size
        and other.mask & ~encoding.mask
        and not (other.value ^ encoding.value) & other.mask & encoding.mask
    ]
    instances: list[int] = []
    for _ in range(TRIALS):
        drawn = chance.integers(0, 1 << 8 * encoding.size, count) & ~encoding.mask | encoding.value
        instances += [
            bits
            for bits in drawn.tolist()
            if not any(bits & mask == value for mask, value in special_cases)
            and operation(bits, encoding.size)[0] not in _APART
        ]
        if not instances or len(instances) >= count:
            break
    return instances[:count]


def operation(bits: int, size: int) -> tuple[str, Any]:
    """Name what the decoder takes an instruction for, and return its fields."""
    ffi, calls = library()
    decoded = ffi.new("struct instruction *")
    first, second = (bits, 0) if size == 2 else (bits >> 16, bits & 0xFFFF)
    calls.decode_instruction(CODE, first, second, 0, False, decoded)
    return operation_name(decoded), decoded


def explanation(name: str, decoded: Any, it_state: int, fpscr: int, outcomes: tuple[str, str]) -> str:
    """Return why the core does something else than Unicorn, by the architecture manual (DDI 0403E); or nothing."""
    if outcomes in (("UNALIGNED", RAN), ("UNALIGNED", "DATA_BUS")):
        exclusive = name.startswith(("STREX", "LDREX"))
        return (
            "B2.3.7: exclusive accesses are aligned, which is checked before the monitor"
            if exclusive
            else "A3.2.1: LDM, STM, LDRD, STRD and transfers of the FPU are aligned"
        )
    if name in ("LDRD", "LDRD_W") and (name == "LDRD_W" or decoded.mode) and decoded.n in (decoded.d, decoded.a):
        return "A7.7.50: write-back into a register that is loaded is UNPREDICTABLE"
    if name == "MRS" and (decoded.immediate == _CONTROL or decoded.immediate >= _NON_SECURE):
        return "B5.2.2: Unicorn has special registers of ARMv8-M"
    if decoded.transfer and it_state & 7:
        return "A7.3: a branch that is not the last instruction of an IT block is UNPREDICTABLE"
    if name == "VCVT_FROM_FIXED" and fpscr >> 22 & 3:
        return "VCVT (between floating-point and fixed-point) rounds to nearest; Unicorn rounds as FPSCR says"
    return ""


def compare(encoding: Encoding, count: int) -> tuple[int, Counter[str], list[str]]:
    """Execute an encoding from random states; return how many were compared, explained differences, and the others."""
    chance = np.random.default_rng(zlib.crc32(encoding.name.encode()))
    pair, size = Pair(chance), encoding.size
    instances = random_instances(chance, encoding, count)
    count = len(instances)
    states, it_states = random_states(chance, count), random_it_states(chance, count)
    states[:, 49] |= (it_states & 3) << 25 | it_states >> 2 << 10
    explained, problems = Counter[str](), list[str]()
    behind = code_of(ENDLESS_LOOP, 2) * (SLOT // 2)
    pair.write(CODE, b"".join((code_of(bits, size) + behind)[:SLOT] for bits in instances))
    for index, (bits, state, it_state) in enumerate(zip(instances, states, it_states.tolist(), strict=True)):
        name, decoded = operation(bits, size)
        place = CODE + SLOT * index
        outcomes, differing = step(pair, state, place, place + size, it_state)
        if not differing:
            continue
        if reason := explanation(name, decoded, it_state, int(state[47]), outcomes):
            explained[f"{name}: {reason}"] += 1
        else:
            problems.append(f"{bits:0{2 * size}x}, it {it_state:02x}: {'; '.join(differing[:4])}")
    return count, explained, problems


def step(pair: Pair, state: Words, place: int, behind: int, it_state: int) -> tuple[tuple[str, str], list[str]]:
    """Execute an instruction in both; return the outcomes and what differs."""
    our_outcome, ours = pair.core.run(state, place)
    their_outcome, theirs = pair.unicorn.run(state, place)
    same_data = pair.has_same_data()
    outcomes = our_outcome, their_outcome
    if it_state and ours[PC] == behind < theirs[PC] <= behind + 4:
        theirs[PC] = behind  # it does not count what an IT block skips, and has executed what is behind that
    if our_outcome == RAN and not (CODE <= ours[PC] < CODE + CODE_SIZE and ours[XPSR] & _T):
        their_outcome = RAN  # it has fetched the next instruction too, which cannot run
    differing = [] if our_outcome == their_outcome else [f"{our_outcome}, Unicorn {their_outcome}"]
    if our_outcome == RAN == their_outcome:
        for index in np.flatnonzero((ours ^ theirs) & MASKS):
            differing.append(f"{COMPARED[index]}: {ours[index]:08x}, Unicorn {theirs[index]:08x}")
        differing += [] if same_data else ["memory"]
    return outcomes, differing


@pytest.mark.parametrize("encoding", encodings(), ids=lambda encoding: encoding.name)
def test_an_encoding_does_what_unicorn_does(encoding: Encoding) -> None:
    _, _, problems = compare(encoding, STATES)
    assert not problems, f"{len(problems)} of {STATES}:\n" + "\n".join(problems[:6])


@pytest.mark.slow
@pytest.mark.ci
def test_every_encoding_does_what_unicorn_does_in_many_states(capsys: pytest.CaptureFixture[str]) -> None:
    lines, problems, too_few = [], list[str](), list[str]()
    for encoding in encodings():
        compared, explained, differing = compare(encoding, STATES_IN_CI)
        reasons = "; ".join(f"{reason}, {times} times" for reason, times in explained.items())
        lines.append(f"{encoding.name:45} {compared:5} states {reasons}")
        problems += [f"{encoding.name}: {problem}" for problem in differing]
        too_few += [encoding.name] if 0 < compared < STATES_IN_CI else []
    with capsys.disabled():
        print("", *lines, sep="\n")
    assert not problems, f"{len(problems)}:\n" + "\n".join(problems[:20])
    assert not too_few


# An ISB ends an IT block in Unicorn; by A7.3.3 and A7.7.37 it does not.
_NOT_IN_SEQUENCE = {"UNDEFINED", "BKPT", "NO_COPROCESSOR", "MSR", "MRS", "CPS", "ISB"}
LENGTH, SEQUENCE_SLOT = 20, 128  # instructions of a sequence, and bytes from one to the next


@cache
def pool() -> list[tuple[int, int]]:
    """Return instructions that may follow on one another, with their sizes: none branches or reaches the masks."""
    chance = np.random.default_rng(1)
    instructions = []
    for encoding in encodings():
        for bits in random_instances(chance, encoding, 64):
            name, decoded = operation(bits, encoding.size)
            is_explained = name.startswith(("LDREX", "STREX", "VCVT_FROM_FIXED", "LDRD"))  # see `explanation`
            sets_stack = decoded.core_writes >> 13 & 1  # see `_BITS`
            if not (decoded.transfer or is_explained or sets_stack or name in _NOT_IN_SEQUENCE):
                instructions.append((bits, encoding.size))
    return instructions


def random_sequence(chance: np.random.Generator) -> bytes:
    """Return random instructions, some in IT blocks of up to four."""
    code, remainder = b"", 0
    for index, in_block in zip(chance.integers(0, len(pool()), LENGTH), chance.random(LENGTH) < 1 / 10, strict=True):
        if in_block and not remainder:
            remainder = int(chance.integers(1, 5))
            mask = (int(chance.integers(0, 8)) << 1 | 1) << (4 - remainder) & 0xF
            code += code_of(IT | int(chance.integers(0, 14)) << 4 | mask, 2)
        bits, size = pool()[index]
        code += code_of(bits, size)
        remainder = max(remainder - 1, 0)
    return code + code_of(NOP, 2) * remainder


def compare_sequences(count: int) -> tuple[int, list[str]]:
    """Execute sequences up to their ends or faults until `count` instructions are compared; return what differs."""
    chance = np.random.default_rng(7)
    compared, problems, places = 0, list[str](), range(CODE, CODE + CODE_SIZE, SEQUENCE_SLOT)
    while compared < count:
        pair, sequences = Pair(chance), [random_sequence(chance) for _ in places]
        pair.write(CODE, b"".join(code.ljust(SEQUENCE_SLOT, b"\0") for code in sequences))
        for place, code, state in zip(places, sequences, random_states(chance, len(places)), strict=True):
            executed, problem = run_sequence(pair, place, code, state)
            compared += executed
            problems += [f"{code.hex()}: {problem}"] if problem else []
    return compared, problems


def run_sequence(pair: Pair, place: int, code: bytes, state: Words) -> tuple[int, str]:
    """Execute a sequence in both up to its end or a fault; return how many instructions, and what differs."""
    before, stop = pair.core.instructions, place + len(code)
    outcome, ours = pair.core.run(state, place, until=stop, count=1000)
    executed = pair.core.instructions - before
    if not executed or pair.core.code_at(place, len(code)) != code:
        pair.has_same_data()
        return 0, ""  # it has rewritten itself without a barrier (A3.8.3): Unicorn goes on with what was there
    if outcome != RAN:
        stop = pair.core.fault.place
    their_outcome, theirs = pair.unicorn.run(state, place, until=stop, count=0)
    differing = [COMPARED[index] for index in np.flatnonzero((ours ^ theirs) & MASKS)]
    if outcome == "DATA_BUS":  # VLDM may have loaded a part
        differing = [name for name in differing if name not in FLOATS]
    has_same_data = pair.has_same_data()
    differing += [] if has_same_data or outcome == "DATA_BUS" else ["memory"]  # STM may have stored a part
    if their_outcome == RAN and not differing:
        return executed, ""
    return executed, f"{outcome} at {stop - place:#x}, Unicorn {their_outcome}: {differing}"


def test_sequences_do_what_unicorn_does_up_to_the_same_fault() -> None:
    compared, problems = compare_sequences(INSTRUCTIONS)
    assert compared >= INSTRUCTIONS
    assert not problems, f"{len(problems)}\n" + "\n".join(problems[:5])


@pytest.mark.slow
@pytest.mark.ci
def test_long_sequences_do_what_unicorn_does() -> None:
    compared, problems = compare_sequences(INSTRUCTIONS_IN_CI)
    assert compared >= INSTRUCTIONS_IN_CI
    assert not problems, f"{len(problems)}\n" + "\n".join(problems[:5])
