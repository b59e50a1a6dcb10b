"""Descriptions of the board for GDB: registers and memories."""

from __future__ import annotations

from collections.abc import Sequence

from hiltest.virtual.board.debug_access import CORE_NAMES, DOUBLES, SYSTEM_NAMES
from hiltest.virtual.part.chip import MemoryMap, Region, is_in
from hiltest.virtual.processor.memory import PERIPHERALS, PRIVATE_PERIPHERALS

_TYPES = {"sp": "data_ptr", "pc": "code_ptr", "msp": "data_ptr", "psp": "data_ptr"}


def target_description() -> str:
    """Return ``target.xml``: a Cortex-M with its FPU, registers in the order of `DebugAccess`."""
    core = "".join(_register(name, 32, _TYPES.get(name, "int")) for name in CORE_NAMES)
    system = "".join(_register(name, 32, _TYPES.get(name, "int")) for name in SYSTEM_NAMES)
    doubles = "".join(_register(f"d{number}", 64, "ieee_double") for number in range(DOUBLES))
    return (
        '<?xml version="1.0"?><!DOCTYPE target SYSTEM "gdb-target.dtd"><target version="1.0">'
        "<architecture>arm</architecture>"
        f'<feature name="org.gnu.gdb.arm.m-profile">{core}</feature>'
        f'<feature name="org.gnu.gdb.arm.m-system">{system}</feature>'
        f'<feature name="org.gnu.gdb.arm.vfp">{doubles}{_register("fpscr", 32, "int")}</feature></target>'
    )


def _register(name: str, bits: int, kind: str) -> str:
    return f'<reg name="{name}" bitsize="{bits}" type="{kind}"/>'


def memory_description(memories: MemoryMap, pages: Sequence[Region] = ()) -> str:
    """Return the memory map: flash as ROM, so that breakpoints there are hardware's, and peripherals as RAM.

    Parameters
    ----------
    pages
        Pages of the chip's peripherals.
    """
    devices = PERIPHERALS, PRIVATE_PERIPHERALS
    further = [page for page in pages if not is_in(devices, page[0])]
    aliases = ((base, size) for base, (_, size) in memories.aliases)
    regions = [("rom", memory) for memory in (*memories.flash, *aliases)]
    regions += [("ram", memory) for memory in (*memories.ram, *devices, *further)]
    rows = "".join(f'<memory type="{kind}" start="0x{base:x}" length="0x{size:x}"/>' for kind, (base, size) in regions)
    return (
        '<?xml version="1.0"?><!DOCTYPE memory-map PUBLIC "+//IDN gnu.org//DTD GDB Memory Map V1.0//EN" '
        f'"http://sourceware.org/gdb/gdb-memory-map.dtd"><memory-map>{rows}</memory-map>'
    )
