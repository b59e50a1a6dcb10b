"""Whether Unicorn's Cortex-M4 takes an instruction as defined: it executes one, outside an IT block or inside."""

from __future__ import annotations

import struct
from typing import Any

import unicorn
from unicorn import arm_const as arm

CODE, CODE_BYTES = 0x10000, 0x8000000
DATA, DATA_BYTES = 0x20000000, 0x200000
STEP = 16  # bytes of one trial; no address is used twice, since Unicorn keeps what it has translated
NOP, IT_ALWAYS = 0xBF00, 0xBFE8
EXCEPTIONS = {17: "no coprocessor"}  # numbers of QEMU that an instruction may raise and that count here
ANSWERS = {"undefined", *EXCEPTIONS.values()}
# Each word of the data is an odd address of data, and as code it is two harmless instructions: a branch anywhere ends
# well. With even addresses accesses of several words are aligned, with odd ones branches stay in Thumb state.
POINTER = DATA + DATA_BYTES // 2


class Unicorn:
    """An emulator that tries instructions."""

    def __init__(self) -> None:
        self._engine: Any = unicorn.Uc(unicorn.UC_ARCH_ARM, unicorn.UC_MODE_THUMB | unicorn.UC_MODE_MCLASS)
        self._engine.ctl_set_cpu_model(arm.UC_CPU_ARM_CORTEX_M4)
        self._engine.mem_map(CODE, CODE_BYTES)
        self._engine.mem_map(DATA, DATA_BYTES)
        self._engine.mem_write(DATA, struct.pack("<I", POINTER + 1) * (DATA_BYTES // 4))
        self._engine.hook_add(unicorn.UC_HOOK_INTR, self._note)
        self._reset = self._engine.context_save()
        self._exception: int | None = None
        self._address = CODE

    def _note(self, engine: Any, number: int, _: object) -> None:
        self._exception = number
        engine.emu_stop()

    def answer(self, first: int, second: int, *, in_it_block: bool) -> str:
        """Return "defined", "undefined" or "no coprocessor"."""
        for pointer in (POINTER, POINTER + 1):
            answer = self._try(first, second, in_it_block, pointer)
            if answer == "defined":
                break
        return answer

    def _try(self, first: int, second: int, in_it_block: bool, pointer: int) -> str:
        engine = self._engine
        self._address += STEP
        self._exception = None
        engine.context_restore(self._reset)
        code = (IT_ALWAYS if in_it_block else NOP, first, second, NOP)
        engine.mem_write(self._address, struct.pack("<4H", *code))
        for register in (*range(arm.UC_ARM_REG_R0, arm.UC_ARM_REG_R0 + 13), arm.UC_ARM_REG_SP, arm.UC_ARM_REG_LR):
            engine.reg_write(register, pointer)
        engine.reg_write(arm.UC_ARM_REG_FPEXC, 1 << 30)
        try:
            engine.emu_start(self._address | 1, 0, count=2)
        except unicorn.UcError as error:
            if self._exception is None and error.errno == unicorn.UC_ERR_INSN_INVALID:
                return "undefined"
        return EXCEPTIONS.get(self._exception or 0, "defined")
