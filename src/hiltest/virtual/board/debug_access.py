"""Registers and memory of a halted board, as a debug probe accesses them."""

from __future__ import annotations

import struct

from hiltest.virtual.board.virtual_machine import VirtualMachine
from hiltest.virtual.part.chip import is_in
from hiltest.virtual.processor.memory import PERIPHERALS, PRIVATE_PERIPHERALS
from hiltest.virtual.processor.registers import RegisterGroup

CORE_NAMES = (*(f"r{number}" for number in range(13)), "sp", "lr", "pc", "xpsr")
SYSTEM_NAMES = ("msp", "psp", "primask", "basepri", "faultmask", "control")
DOUBLES = 16
_SYSTEM_FIRST = len(CORE_NAMES)
_DOUBLES_FIRST = _SYSTEM_FIRST + len(SYSTEM_NAMES)
_FPSCR = _DOUBLES_FIRST + DOUBLES
COUNT = _FPSCR + 1
_PC = 15
_DEVICES = (PERIPHERALS, PRIVATE_PERIPHERALS)


class DebugAccess:
    """Access to registers and memory for a debugger.

    Registers are numbered r0 to r12, sp, lr, pc, xpsr, msp, psp, primask, basepri, faultmask, control, d0 to d15,
    fpscr.

    Parameters
    ----------
    machine
        Must be halted during every access.
    """

    def __init__(self, machine: VirtualMachine) -> None:
        self._machine, self._processor = machine, machine.processor
        core_machine = self._processor.machine
        self._groups = [RegisterGroup(core_machine, [name.upper()]) for name in (*CORE_NAMES, *SYSTEM_NAMES)]
        self._groups += [RegisterGroup(core_machine, [f"S{2 * n}", f"S{2 * n + 1}"]) for n in range(DOUBLES)]
        self._groups.append(RegisterGroup(core_machine, ["FPSCR"]))

    def register(self, number: int) -> bytes:
        """Read a register, little-endian: 4 bytes, or 8 for a double."""
        words = self._groups[number].read()
        if number == _PC:
            words = [words[0] & ~1]
        return struct.pack(f"<{len(words)}I", *words)

    def registers(self) -> bytes:
        return b"".join(map(self.register, range(COUNT)))

    def width(self, number: int) -> int:
        """Return the size of a register in bytes.

        Raises
        ------
        IndexError
            If no register has this number.
        """
        if not 0 <= number < COUNT:
            raise IndexError(number)
        return 8 if _DOUBLES_FIRST <= number < _FPSCR else 4

    def write_register(self, number: int, value: bytes) -> None:
        """Write a register; the firmware continues at a new PC, asleep or not."""
        words = list(struct.unpack(f"<{self.width(number) // 4}I", value))
        if number == _PC:
            changed = words[0] & ~1 != self._groups[_PC].get() & ~1
            words[0] |= 1
            if changed:
                self._processor.sleeping = False
        self._groups[number].write(words)

    def write_registers(self, values: bytes) -> None:
        """Write all registers.

        Raises
        ------
        ValueError
            If the size is not that of all registers.
        """
        if len(values) != sum(map(self.width, range(COUNT))):
            raise ValueError(f"{len(values)} bytes are not the size of all registers")
        offset = 0
        for number in range(COUNT):
            width = self.width(number)
            self.write_register(number, values[offset : offset + width])
            offset += width

    def read(self, address: int, size: int) -> bytes:
        """Read memory, or registers of a peripheral word by word, with the side effects of a read.

        Raises
        ------
        ValueError
            If the address has no memory and no peripheral.
        """
        if not self._is_device(address):
            return self._processor.memory.read(address, size)
        read = b""
        while len(read) < size:
            width = self._access(address + len(read), size - len(read))
            with self._machine.pause_unmodelled():
                read += self._machine.bus.read(address + len(read), width).to_bytes(4, "little")[:width]
        return read

    def write(self, address: int, data: bytes) -> None:
        """Write memory, including flash, or registers of a peripheral.

        Raises
        ------
        ValueError
            If the address has no memory and no peripheral.
        """
        if not self._is_device(address):
            self._processor.memory.write(address, data)
            return
        while data:
            width = self._access(address, len(data))
            with self._machine.pause_unmodelled():
                self._machine.bus.write(address, width, int.from_bytes(data[:width], "little"))
            address, data = address + width, data[width:]

    def _is_device(self, address: int) -> bool:
        return is_in(_DEVICES, address) or self._machine.bus.has(address)

    def _access(self, address: int, size: int) -> int:
        """Return the bytes of a peripheral that one access covers."""
        width = next(width for width in (4, 2, 1) if address % width == 0 and width <= size)
        reason = self._machine.bus.reason_against(address, width)
        if reason is not None:
            raise ValueError(reason)
        return width
