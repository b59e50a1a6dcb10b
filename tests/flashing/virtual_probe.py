"""A debug probe for pyOCD with a virtual board behind it: what pyOCD loads into its RAM runs, flash algorithms too.

It is what pyOCD's plugins are: a class of `DebugProbe`. Of the debug port there are the registers that pyOCD uses, of
the core those that halt it, let it go and reach its registers (ARMv7-M architecture reference manual, C1.6).
"""

from __future__ import annotations

import struct
from collections.abc import Collection, Sequence
from typing import Any, ClassVar

from pyocd.core.memory_interface import MemoryInterface
from pyocd.probe.debug_probe import DebugProbe
from tests.usb_tree import K64F

from hiltest.errors import BoardFault, ConfigError
from hiltest.virtual.board.debug_access import DebugAccess
from hiltest.virtual.board.k64f import VirtualK64F

_DHCSR, _DCRSR, _DCRDR, _DEMCR, _AIRCR = 0xE000EDF0, 0xE000EDF4, 0xE000EDF8, 0xE000EDFC, 0xE000ED0C
_HALT, _HALTED, _READY, _WAS_RESET = 1 << 1, 1 << 17, 1 << 16, 1 << 25
_DEVICES_OF_CORE = range(0xE0000000, 0xE0100000)
_ROM_TABLE = 0xE00FF000
# What they are, as they say themselves: part number of Arm's components, and the class of a ROM table.
_COMPONENTS = {_ROM_TABLE: (0x4C4, 0x10), 0xE000E000: (0x00C, 0xE0), 0xE0002000: (0x003, 0xE0)}
_FIXED = {
    _ROM_TABLE: 0xFFF0F003,
    _ROM_TABLE + 4: 0xFFF03003,
    _ROM_TABLE + 8: 0,
    0xE000ED00: 0x410FC241,
    0xE000EF40: 0x10110021,
    0xE0002000: 0x00000260,
}
_BUS, _MDM = {0xFC: 0x24770011, 0xF8: _ROM_TABLE | 3, 0x00: 0x23000042}, {0xFC: 0x001C0000, 0x00: 0x10022}
_SLICE_S = 0.05
"""How long the processor runs between two looks at whether it has halted [virtual s]."""


def _identification() -> dict[int, int]:
    result = dict(_FIXED)
    for base, (part, kind) in _COMPONENTS.items():
        peripheral = (4, 0, 0, 0, part & 0xFF, 0xB0 | part >> 8, 0x0B, 0)
        component = (0x0D, kind, 0x05, 0xB1)
        result |= {base + 0xFD0 + 4 * at: item for at, item in enumerate((*peripheral, *component))}
    return result


class _Halted(Exception):
    """The processor is at a breakpoint."""


class VirtualProbe(DebugProbe):
    """The only probe; `machine` is the board behind it, which is halted."""

    machine: ClassVar[VirtualK64F]

    @classmethod
    def get_all_connected_probes(cls, unique_id: str | None = None, is_explicit: bool = False) -> list[DebugProbe]:
        return [cls()]

    @classmethod
    def get_probe_with_id(cls, unique_id: str, is_explicit: bool = False) -> DebugProbe | None:
        return cls() if unique_id == K64F else None

    def __init__(self) -> None:
        super().__init__()
        self.memory = Memory(self.machine)
        self._open = False
        self._select = 0

    vendor_name = "hiltest"
    product_name = "virtual probe"
    unique_id = K64F
    wire_protocol = DebugProbe.Protocol.SWD
    supported_wire_protocols: Collection[Any] = [DebugProbe.Protocol.DEFAULT, DebugProbe.Protocol.SWD]
    capabilities = {  # noqa: RUF012 - a property of pyOCD's class
        DebugProbe.Capability.MANAGED_AP_SELECTION,
        DebugProbe.Capability.MANAGED_DPBANKSEL,
        DebugProbe.Capability.BANKED_DP_REGISTERS,
        DebugProbe.Capability.APv2_ADDRESSES,
    }

    @property
    def is_open(self) -> bool:
        return self._open

    def open(self) -> None:
        self._open = True

    def close(self) -> None:
        self._open = False

    def connect(self, protocol: Any = None) -> None:
        """Nothing is to be switched on."""

    disconnect = flush = lambda self: None

    def set_clock(self, frequency: float) -> None:
        """A wire that is none has any speed."""

    def reset(self) -> None:
        self.memory.reset()

    def assert_reset(self, asserted: bool) -> None:
        if not asserted:
            self.memory.reset()

    def is_reset_asserted(self) -> bool:
        return False

    def read_dp(self, addr: int, now: bool = True) -> Any:
        value = {0: 0x2BA01477, 4: 0xF0000000}.get(addr & 0xF, 0)
        return value if now else lambda: value

    def write_dp(self, addr: int, data: int) -> None:
        """Power is on, and no error sticks."""

    def read_ap(self, addr: int, now: bool = True) -> Any:
        value = {0: _BUS, 1: _MDM}.get(addr >> 24, {}).get(addr & 0xFF, 0)
        return value if now else lambda: value

    def write_ap(self, addr: int, data: int) -> None:
        """Neither is erased nor reset over the access ports."""

    def get_memory_interface_for_ap(self, ap_address: Any) -> MemoryInterface | None:
        return self.memory if ap_address.nominal_address == 0 else None


class Memory(MemoryInterface):
    """Memory as the bus of a debug port sees it, with the registers that debug the core."""

    def __init__(self, machine: VirtualK64F) -> None:
        self._machine, self._access = machine, DebugAccess(machine)
        self._registers = _identification()
        self._halted, self._was_reset = True, False
        machine.processor.at_breakpoint = self._at_breakpoint

    def _at_breakpoint(self, address: int) -> None:
        self._at = address & ~1
        raise _Halted

    def reset(self) -> None:
        """Reset the chip; it halts before its first instruction if DEMCR.VC_CORERESET says so."""
        self._halted, self._was_reset = bool(self._registers.get(_DEMCR, 0) & 1), True
        try:
            self._machine.reset()
        except ConfigError:  # an erased chip has no first instruction
            self._halted = True

    def _run(self) -> None:
        try:
            self._machine.run_until(self._machine.time_s + _SLICE_S)
        except BoardFault:
            """Firmware that ends in a fault does not halt."""
        except _Halted:
            self._halted = True
            self._access.write_register(15, struct.pack("<I", self._at))

    def _read_core(self, address: int) -> int:
        if address != _DHCSR:
            return self._registers.get(address, 0)
        if not self._halted:
            self._run()
        state = _READY | _HALTED * self._halted | _WAS_RESET * self._was_reset | self._registers.get(_DHCSR, 0)
        self._was_reset = False
        return state

    def _write_core(self, address: int, value: int) -> None:
        if address == _DHCSR:
            self._registers[_DHCSR] = value & 0xF
            self._halted = bool(value & _HALT)
        elif address == _AIRCR and value & 4:
            self.reset()
        elif address == _DCRSR:
            number = value & 0x7F
            if number > 18:  # masks and floats keep what they have
                self._registers[_DCRDR] = 0
            elif value & 1 << 16:
                self._access.write_register(number, struct.pack("<I", self._registers.get(_DCRDR, 0)))
            else:
                (self._registers[_DCRDR],) = struct.unpack("<I", self._access.register(number))
        elif address not in _FIXED:
            self._registers[address] = value

    def read_memory(self, addr: int, transfer_size: int = 32, now: bool = True, **_attributes: Any) -> Any:
        if addr in _DEVICES_OF_CORE:
            value = self._read_core(addr)
        else:
            value = int.from_bytes(self._access.read(addr, transfer_size // 8), "little")
        return value if now else lambda: value

    def write_memory(self, addr: int, data: int, transfer_size: int = 32, **_attributes: Any) -> None:
        if addr in _DEVICES_OF_CORE:
            self._write_core(addr, data)
        else:
            self._access.write(addr, data.to_bytes(transfer_size // 8, "little"))

    def read_memory_block32(self, addr: int, size: int, **_attributes: Any) -> Sequence[int]:
        if addr in _DEVICES_OF_CORE:
            return [self._read_core(addr + 4 * at) for at in range(size)]
        return list(struct.unpack(f"<{size}I", self._access.read(addr, 4 * size)))

    def write_memory_block32(self, addr: int, data: Sequence[int], **_attributes: Any) -> None:
        if addr in _DEVICES_OF_CORE:
            for at, item in enumerate(data):
                self._write_core(addr + 4 * at, item)
        else:
            self._access.write(addr, struct.pack(f"<{len(data)}I", *data))

    def read_memory_block8(self, addr: int, size: int, **_attributes: Any) -> Sequence[int]:
        return list(self._access.read(addr, size))

    def write_memory_block8(self, addr: int, data: Sequence[int], **_attributes: Any) -> None:
        self._access.write(addr, bytes(data))
