"""Calls of an image's functions, after which the state of the processor is restored."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from typing import Any

from hiltest.errors import ConfigError
from hiltest.virtual.calls.buffers import place
from hiltest.virtual.calls.procedure_call import Argument, assign, result
from hiltest.virtual.processor.cpu import RETURN_ADDRESS, Processor
from hiltest.virtual.processor.schedule import Event
from hiltest.virtual.processor.slices import Slice
from hiltest.virtual.processor.stacks import forget_stacks, known_stacks
from hiltest.virtual.program.elf import FirmwareImage, LoadSegment, Symbol
from hiltest.virtual.program.signatures import Signature

_STACK_BYTES = 8192


@dataclass(frozen=True, slots=True)
class CallResult:
    """Value and cost of a called function."""

    value: int | float | None
    """Return value in the function's type; r0 without debug information, None for void."""
    cycles: int
    instructions: int
    """Instructions from the function's first one to its return, inclusive."""
    clock_hz: float
    """Core clock during the call [Hz]."""
    stack_bytes: int | None = field(default=None, compare=False, kw_only=True)
    """Largest use of the stack by the function and its callees; None on a board that runs firmware."""
    executed: Slice | None = field(default=None, compare=False, repr=False, kw_only=True)
    """The call as a slice that can be repeated; None if it had too many loads from devices."""

    @property
    def microseconds(self) -> float:
        """Duration at that clock [us]."""
        return self.cycles / self.clock_hz * 1e6


def _largest_gap(segments: Sequence[LoadSegment], first: int, limit: int) -> tuple[int, int]:
    """Return the largest range of RAM from `first` to `limit` that no segment uses.

    The end of RAM may be in use, because some linker scripts assign all remaining RAM to the heap.
    """
    begin, gaps = first, []
    for segment in sorted(segments, key=lambda segment: segment.run_address):
        if first <= segment.run_address < limit:
            gaps.append((begin, segment.run_address))
            begin = max(begin, segment.run_address + segment.run_size)
    gaps.append((begin, limit))
    return max(gaps, key=lambda gap: gap[1] - gap[0])


def find_function(image: FirmwareImage, name: str) -> Symbol:
    """Return a function of an image.

    Raises
    ------
    ConfigError
        If no function has the name; the message lists similar ones.
    """
    function = image.symbols.get(name)
    if function is not None and function.is_function:
        return function
    names = [symbol_name for symbol_name, entry in image.symbols.items() if entry.is_function]
    plain = name.rpartition("::")[2]
    variants = [candidate for candidate in names if candidate.startswith(f"{name}.")]  # such as fit.constprop.0
    mangled = [candidate for candidate in names if candidate.startswith("_Z") and f"{len(plain)}{plain}" in candidate]
    near = (variants + mangled)[:3] or get_close_matches(name, names, n=3)
    hint = f"; near: {', '.join(near)}" if near else ""
    if not names:
        hint = ", nor any other function: its symbols are stripped; use the ELF that the linker wrote"
    raise ConfigError(f"{image.name}: no function {name!r}{hint}")


class _Scratch:
    """RAM that the image does not use.

    Parameters
    ----------
    limit
        End of this RAM.
    from_end
        True to allocate from high to low addresses, as a caller's variables on the stack; else from low to high ones.
    """

    def __init__(self, processor: Processor, limit: int, *, from_end: bool) -> None:
        self._memory = processor.memory
        begin, self._limit = _largest_gap(processor.image.segments, processor.memory.sram.base, limit)
        self._from_end, self.lowest = from_end, self._limit & ~7
        self._next = (begin + 7) & ~7
        self._written_back: list[tuple[int, memoryview]] = []

    def place(self, buffer: Any) -> int:
        return place(buffer, self._reserve, self._write)

    def _reserve(self, size: int) -> int:
        if self._from_end:
            address = self.lowest = (self.lowest - size) & ~7
            missing = self._next + _STACK_BYTES - address
        else:
            address = self._next
            self._next = (address + size + 7) & ~7
            missing = self._next - self._limit
        if missing > 0:
            raise ConfigError(f"the arguments need {missing} bytes more RAM than the image leaves free")
        return address

    def _write(self, address: int, buffer: Any) -> None:
        view = memoryview(buffer)
        self._memory.write(address, view.tobytes())
        if not view.readonly and view.nbytes:
            self._written_back.append((address, view.cast("B")))

    def fetch(self) -> None:
        for address, view in self._written_back:
            view[:] = self._memory.read(address, view.nbytes)


def call_function(
    processor: Processor,
    symbol: str,
    arguments: Sequence[Argument],
    *,
    booted: bool,
    stack: int | None = None,
    clock_hz: float,
    timeout_s: float,
) -> CallResult:
    """Call a function; see `VirtualCortexM4.call`."""
    function = find_function(processor.image, symbol)
    registers = processor.registers
    processor.save_floats()  # otherwise saving the interrupted code's state lazily would count for this function
    saved = registers.general.read(), registers.floating_frame.read(), registers.primask.get(), processor.fpu_enabled
    control = registers.control.get()
    was_sleeping, processor.sleeping = processor.sleeping, False
    end_of_ram = processor.memory.sram.base + processor.memory.sram.size
    top = saved[0][13] if booted else stack or end_of_ram
    scratch = _Scratch(processor, top if stack else top - _STACK_BYTES, from_end=bool(stack))
    signature = processor.image.signature(symbol)
    core, floating = assign(symbol, signature, arguments, scratch.place, hard_float=processor.image.hard_float)
    on_stack = core[4:]
    pointer = ((scratch.lowest if stack else top) - 4 * len(on_stack)) & ~7
    processor.memory.write_words(pointer, on_stack)
    registers.primask.set(1)
    processor.fpu_enabled = True
    registers.xpsr.set(1 << 24)
    general = (core[:4] + [0] * 13)[:13]
    registers.general.write([*general, pointer, RETURN_ADDRESS | 1, function.address | 1, 1 << 24])
    registers.floating.write(floating)
    processor.flush_pipeline()
    machine, cycles, instructions = processor.machine, processor.cycles, processor.instructions
    if not booted:  # otherwise they are the firmware's
        forget_stacks(machine)
    begin, loads = machine.snapshot(), processor.core.device_loads
    hang_cycles = round(timeout_s * clock_hz)
    delivered, processor.delivers_faults = processor.delivers_faults, False
    try:
        if not processor.run(Event(cycles + hang_cycles)):
            allowed = f"{hang_cycles} cycles (increase the limit with --timeout or timeout_s=)"
            cause = f"hang: {symbol} did not return within {allowed}{processor.waits_for()}"
            raise processor.fault(cause, registers.pc.get())
        value = _result(processor, signature)
        cycles, instructions = processor.cycles - cycles, processor.instructions - instructions
        answers = machine.answers(loads)
        scratch.fetch()
        stacks = known_stacks(machine)
    finally:
        registers.primask.set(saved[2])
        registers.floating_frame.write(saved[1])
        registers.control.set(control)
        registers.xpsr.set(saved[0][16])
        registers.general.write([*saved[0][:15], saved[0][15] | 1, saved[0][16]])
        processor.fpu_enabled, processor.sleeping = saved[3], was_sleeping
        processor.delivers_faults = delivered
        processor.flush_pipeline()
    executed = None if answers is None else Slice(machine, begin, cycles, instructions, answers)
    stack_bytes = None if booted else max((pointer - used_stack.lowest for used_stack in stacks), default=0)
    return CallResult(value, cycles, instructions, clock_hz, stack_bytes=stack_bytes, executed=executed)


def _result(processor: Processor, signature: Signature | None) -> int | float | None:
    registers = processor.registers
    return result(
        signature.returns if signature else "unsigned",
        registers.arguments.read(),
        registers.floating.read(),
        hard_float=processor.image.hard_float,
    )
