"""A profile as a JSON document and as folded stacks."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from hiltest.measurement import CycleRange
from hiltest.virtual.calls.buffers import Address, Structure
from hiltest.virtual.calls.call_clock import CALL_HZ
from hiltest.virtual.calls.procedure_call import Argument
from hiltest.virtual.counts.placement import LoopPlacement
from hiltest.virtual.counts.profiling import AddressCost, CallProfile, FunctionCost, LineCost, StackCost
from hiltest.virtual.part.chip import MemoryMap
from hiltest.virtual.part.part_file import Part
from hiltest.virtual.processor.memory import MK64FN1M0

SCHEMA: Literal["hiltest.profile/1"] = "hiltest.profile/1"


@dataclass(frozen=True, slots=True)
class Share:
    """A class of cycles, and its share of the total."""

    kind: Literal["work", "stall", "asleep", "memory"]
    name: str
    cycles: int
    percent: float


@dataclass(frozen=True, slots=True)
class ChangedBuffer:
    """Contents of a buffer that the function changed; `argument` counts from 1, and `type` is a name of numpy.

    In JSON, NaN and infinity are null, also as the value that the function `returned`.
    """

    argument: int
    type: str
    values: tuple[float | int | None, ...]


@dataclass(frozen=True, slots=True)
class ProfileDocument:
    """Document of `hiltest profile` with all its results."""

    schema: Literal["hiltest.profile/1"]
    elf: str
    elf_sha256: str
    function: str
    arguments: tuple[str, ...]
    returned: float | int | None
    buffers: tuple[ChangedBuffer, ...]
    cycles: int
    instructions: int
    core_clock_hz: int
    cycle_model: str
    notes: tuple[str, ...]
    """Effects that the cycle model omits for this code."""
    shares: tuple[Share, ...]
    """Their cycles add up to `cycles`, their percentages to 100."""
    functions: tuple[FunctionCost, ...]
    lines: tuple[LineCost, ...]
    addresses: tuple[AddressCost, ...]
    stacks: tuple[StackCost, ...]
    band: CycleRange | None = None
    loops: tuple[LoopPlacement, ...] = ()
    stack_bytes: int | None = None
    """Largest use of the stack by the function and its callees."""


def document(
    profile: CallProfile,
    elf: Path,
    texts: Sequence[str],
    arguments: Sequence[Argument],
    results: Sequence[Argument],
    *,
    memory: MemoryMap = MK64FN1M0,
    part: Part | None = None,
) -> ProfileDocument:
    """Create the document of a profile.

    Parameters
    ----------
    elf
        ELF file of the function.
    texts, arguments, results
        The arguments as texts, as values before the call, and as values after it.
    memory
        Memories that the function was called with.
    part
        Chip that the user named, if any.
    """
    return ProfileDocument(
        SCHEMA,
        str(elf),
        hashlib.sha256(elf.read_bytes()).hexdigest(),
        profile.function,
        tuple(texts),
        profile.value,
        tuple(_changed_buffers(arguments, results)),
        profile.cycles,
        profile.instructions,
        round(profile.clock_hz),
        profile.cycle_model,
        tuple(_notes(profile, memory, part)),
        tuple(shares(profile)),
        profile.functions,
        profile.lines,
        profile.addresses,
        profile.stacks,
        profile.band,
        profile.loops,
        profile.stack_bytes,
    )


def shares(profile: CallProfile) -> Iterator[Share]:
    """Yield the classes of cycles: work by class, waits by cause, and sleep."""
    for work, cycles in profile.work.items():
        yield Share("work", str(work), cycles, profile.share(cycles))
    for stall, cycles in profile.stalls.items():
        yield Share("stall", str(stall), cycles, profile.share(cycles))
    yield Share("asleep", "asleep", profile.asleep_cycles, profile.share(profile.asleep_cycles))
    if profile.memory_cycles is not None:
        yield Share("memory", "memory", profile.memory_cycles, profile.share(profile.memory_cycles))


def replace_nan(content: ProfileDocument) -> ProfileDocument:
    """Return the document with None for NaN and infinity, which JSON cannot represent."""
    buffers = tuple(replace(buffer, values=tuple(map(_finite, buffer.values))) for buffer in content.buffers)
    return replace(content, returned=_finite(content.returned), buffers=buffers)


def folded(content: ProfileDocument) -> str:
    """Return stacks as flame graph tools read them: ``main;f;g cycles``."""
    return "".join(f"{';'.join(stack.functions)} {stack.cycles}\n" for stack in content.stacks)


def _notes(profile: CallProfile, memory: MemoryMap, part: Part | None) -> Iterator[str]:
    placement = profile.cycle_model.partition("@")[2]
    if part is not None:
        yield f"called with the memories of {part.title}, without peripherals"
    elif memory != MK64FN1M0:
        yield f"called on {memory}, without peripherals"
    if profile.counts_memories:
        if part is None and profile.clock_hz != CALL_HZ:
            yield "waits for flash have the clocks of the timing profile, regardless of the core clock"
    elif "flash" in placement and part is None:
        counted = "; the profile cortex-m4-k64f/3 counts them" if memory == MK64FN1M0 else ""
        yield (
            "code ran from flash with zero wait states, because they are not modelled: silicon takes more cycles"
            f"{counted}"
        )
    if part is not None and "sram_u" in placement and not part.counts_system_bus:
        yield "code ran from RAM at 0x20000000 or above: what it waits for the system bus is not known on this part"
    if part is None and "sram_u" in placement and not profile.counts_memories:
        yield "code ran from SRAM_U, where it competes with data for the bus: silicon takes more cycles"
    if not profile.lines:
        yield "no debug information (build with -g): no source lines, and only integers and buffers can be passed"


def _changed_buffers(arguments: Sequence[Argument], results: Sequence[Argument]) -> Iterator[ChangedBuffer]:
    for position, (before, after) in enumerate(zip(arguments, results, strict=True), start=1):
        for old, new in zip(_writable(before), _writable(after), strict=True):
            if bytes(memoryview(old)) != bytes(memoryview(new)):
                array = np.frombuffer(new, np.uint8) if isinstance(new, bytearray) else np.asarray(new)
                yield ChangedBuffer(position, str(array.dtype), tuple(array.ravel().tolist()))


def _finite(number: float | None) -> float | None:
    return number if number is None or math.isfinite(number) else None


def _writable(argument: Any) -> Iterator[Any]:
    if isinstance(argument, Structure):
        for member in argument.members:
            yield from _writable(member)
    elif isinstance(argument, Address):
        yield from _writable(argument.buffer)
    elif not isinstance(argument, int | float | bytes):
        yield argument
