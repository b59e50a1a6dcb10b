"""Counting with the K64F's memories: flash and its controller, banks that code and data share, unaligned data.

Every instruction and every access to data is looked at, in Python: some hundred times slower than counting by block.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable

from hiltest.virtual.accounting import InstructionAccounting
from hiltest.virtual.blocks import CodeBlock, ReadCode, price_block
from hiltest.virtual.code_hook import CodeHook
from hiltest.virtual.flash_waits import FlashController
from hiltest.virtual.instructions import Instruction, decode
from hiltest.virtual.memory import FLASH, SRAM
from hiltest.virtual.pipeline import NEUTRAL
from hiltest.virtual.timing import TimingProfile

_SRAM_U = 0x20000000
_FLASH_END, _SRAM_END = sum(FLASH), sum(SRAM)
_DATA_CALLBACK = ctypes.CFUNCTYPE(
    None, ctypes.c_void_p, ctypes.c_int, ctypes.c_uint64, ctypes.c_int, ctypes.c_int64, ctypes.c_void_p
)
_PARTS = 100  # conflicts are priced in hundredths of a clock an access: what was measured is a mean


class MemoryAccounting(InstructionAccounting):
    """Counts instruction by instruction, by a profile that has memory rows.

    Attributes
    ----------
    memory_cycles : int
        Part of the total that accesses waited for memory.
    flash : FlashController
        Makes accesses to flash wait; the FMC's registers switch it.
    """

    def __init__(
        self, profile: TimingProfile, read_code: ReadCode, attend: Callable[[CodeBlock], bool], stop: Callable[[], None]
    ) -> None:
        super().__init__(profile, read_code, attend, stop)
        self.memory_cycles = 0
        self.flash = FlashController(profile.memory)
        self._unaligned = profile.memory["unaligned"].value if "unaligned" in profile.memory else 0
        self._parts_owed = 0
        self._has_accessed = False  # the instruction that runs
        self._known: dict[tuple[int, bytes], CodeBlock] = {}

    def begins(self, address: int, size: int) -> None:
        """Take note that the emulator is about to run an instruction: it is fetched first."""
        super().begins(address, size)
        self._has_accessed = False
        if self._last is not None and address < _FLASH_END:
            self._wait(self.flash.wait(address, size, self.cycles))

    def _jumps(self, last: Instruction) -> None:
        super()._jumps(last)
        self.flash.forget_word()

    def data_hook(self, forget_condition: Callable[[], None], abort: Callable[[BaseException], None]) -> CodeHook:
        """Return a callback that takes note of accesses, and calls `abort` with whatever goes wrong.

        For this hook the emulator writes down where in an IT block an access stands, as it does for one to a device,
        and leaves it there: without `forget_condition` the next block would begin with this one's condition.
        """

        def on_access(_engine: int, _kind: int, address: int, size: int, _value: int, _data: int) -> None:
            """Take note of an access; what goes wrong ends the run, for the emulator takes no exception."""
            try:
                self._accesses(address, size)
                forget_condition()
            except BaseException as error:  # re-raised by the processor; ctypes would print and drop it
                abort(error)

        return CodeHook(_DATA_CALLBACK(on_access), None)

    def _accesses(self, address: int, size: int) -> None:
        if self._last is None or address >= _SRAM_END:
            return
        if address % min(size, 4):  # pairs of words are two; words at odd addresses are a byte, two and a byte
            self._wait(self._unaligned * (2 if size == 4 and address % 2 else 1))
        if address < _FLASH_END:
            self._wait(self.flash.wait(address, size, self.cycles, fetched=False))
        elif not self._has_accessed:
            self._parts_owed += self._conflict(self._last, address)
            whole, self._parts_owed = divmod(self._parts_owed, _PARTS)
            self._wait(whole)
        self._has_accessed = True

    def _conflict(self, instruction: Instruction, address: int) -> int:
        code, data = _bank(instruction.address), _bank(address)
        if (code, data) not in (("lower", "lower"), ("upper", "upper"), ("flash", "lower")):
            return 0
        place = code if code == data else f"{code}_{data}"
        return self._profile.memory[f"{place}_{'multiple' if instruction.words > 1 else 'single'}"].value

    def _wait(self, cycles: int) -> None:
        self.cycles += cycles
        self.memory_cycles += cycles

    def _look(self, address: int, size: int) -> CodeBlock:
        # Which instruction it is, and whether it needs attention, does not depend on the state before it.
        code = self._read_code(address, size)
        if (address, code) not in self._known:
            self._known[address, code] = price_block(self._profile, decode(address, code), NEUTRAL)
        return self._known[address, code]

    def flush_pipeline(self) -> None:
        """Forget fetched words: an exception was entered or left, or a call begins."""
        super().flush_pipeline()
        self._parts_owed = 0  # else a call would take a clock more because of what was called before it
        self.flash.forget_word()

    def forget_code(self) -> None:
        """Drop cached code and the controller's lines: memory was loaded anew."""
        self._known = {}
        self.flash.reset()


def _bank(address: int) -> str:
    return "flash" if address < _FLASH_END else "lower" if address < _SRAM_U else "upper"
