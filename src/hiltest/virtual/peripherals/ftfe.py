"""FTFE: commands that erase, program and verify the flash."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from hiltest.virtual.part.chip import ChipPeripheral
from hiltest.virtual.peripherals.bus import StoredRegisters, write_by_bytes
from hiltest.virtual.peripherals.flash_array import BLOCK, ERASED, PHRASE, RECORDS, SECTOR, SIZE, FlashArray
from hiltest.virtual.peripherals.unmodelled import UnmodelledLog
from hiltest.virtual.processor.clock import PICOSECONDS, Clock
from hiltest.virtual.processor.cpu import Processor
from hiltest.virtual.processor.schedule import Event

_FSTAT, _FCNFG, _FSEC, _FCCOB, _FCCOB4, _FCCOB8, _FPROT, _REGISTERS = 0x0, 0x1, 0x2, 0x4, 0x8, 0xC, 0x10, 0x18
_CCIF, _RDCOLERR, _ACCERR, _FPVIOL, _MGSTAT0 = 0x80, 0x40, 0x20, 0x10, 0x01
_CCIE, _RDCOLLIE = 0x80, 0x40
_PFLSH_RAMRDY = 0x06  # a part without FlexNVM
_CONFIGURATION = 0x408  # in flash: FPROT3 to 0, FSEC, FOPT
_SEC, _UNSECURED = 0x03, 0x02
_SECTION = 16
_REGIONS = 32  # each bit of FPROT protects a 32nd of the flash
_IFR_BYTES, _SWAP_IFR, _ONCE_IN_IFR = 0x400, 0x40000, 0x3C0
_LAST_MARGIN = 2
_MICROSECOND = PICOSECONDS // 10**6
_READ_RESOURCE = 0x03
_UNMODELLED = {0x0B: "program section", 0x45: "verify backdoor access key", 0x46: "swap control"}


class _Command(NamedTuple):
    """Duration of a command [us], and its check and its action, which return bits of FSTAT."""

    duration_us: int
    refuse: Callable[[], int]
    carry_out: Callable[[], int]


class FlashMemory(StoredRegisters):
    """The flash memory module.

    A command takes the typical time of the data sheet, and changes the flash at its end. A command that is launched by
    code in the affected block is a read collision; the code continues here, but the part fetches undefined data. The
    part is unsecured, as after loading by a debugger. Swap control, program section, the version ID and the backdoor
    key are not modelled: they set ACCERR, and are reported.

    Parameters
    ----------
    time
        Virtual time.
    log
        Records the commands that are not modelled.
    """

    def __init__(
        self, processor: Processor, time: Clock, module: ChipPeripheral, array: FlashArray, log: UnmodelledLog
    ) -> None:
        self._processor = processor
        self._time = time
        self._array = array
        self._log = log
        self._done, self._collided = module.interrupts
        self._running: Event | None = None
        self._commands = {
            0x00: _Command(1200, self._refuse_block, lambda: self._verify(self._block, BLOCK)),
            0x01: _Command(100, self._refuse_section, lambda: self._verify(self._address, self._section_bytes)),
            0x02: _Command(95, self._refuse_check, self._check),
            _READ_RESOURCE: _Command(40, self._refuse_resource, self._read_resource),
            0x07: _Command(90, lambda: self._refuse_change(PHRASE, self._address, PHRASE), self._program),
            0x08: _Command(435_000, lambda: self._refuse_change(_SECTION, self._block, BLOCK), self._erase_block),
            0x09: _Command(15_000, lambda: self._refuse_change(_SECTION, self._sector, SECTOR), self._erase_sector),
            0x40: _Command(2200, lambda: self._refuse_margin(self._byte(1)), lambda: self._verify(0, SIZE)),
            0x41: _Command(30, self._refuse_record, self._read_once),
            0x43: _Command(90, self._refuse_first_record, self._program_once),
            0x44: _Command(870_000, lambda: self._refuse_protected(0, SIZE), self._erase_all),
        }
        super().__init__(module.name, module.base)

    def reset(self) -> None:
        """Return to the state after reset: abort a command, and read the configuration from the flash."""
        super().reset()
        if self._running is not None:
            self._running.cancel()
            self._running = None
        configuration = self._array.read(_CONFIGURATION, 8)
        self._bytes[_FPROT : _FPROT + 4] = configuration[:4]
        self._bytes[_FSEC] = configuration[4] & ~_SEC | _UNSECURED
        self._bytes[_FSEC + 1] = configuration[5]  # FOPT
        self._bytes[_FPROT + 6 : _FPROT + 8] = configuration[6:]  # FEPROT, FDPROT: without effect on this part
        self._bytes[_FSTAT], self._bytes[_FCNFG] = _CCIF, _PFLSH_RAMRDY
        self._drive()

    # -- registers ----------------------------------------------------------------------------

    def write(self, offset: int, size: int, value: int) -> None:
        """Write registers of one byte each."""
        if size > 1:
            write_by_bytes(self, offset, size, value)
        elif offset == _FSTAT:
            self._write_status(value)
        elif offset == _FCNFG:
            self._bytes[_FCNFG] = value & (_CCIE | _RDCOLLIE) | _PFLSH_RAMRDY
            self._drive()
        elif _FCCOB <= offset < _FPROT and self._bytes[_FSTAT] & _CCIF:
            self._bytes[offset] = value
        elif _FPROT <= offset < _REGISTERS:
            self._bytes[offset] &= value  # only a reset removes protection

    def _write_status(self, value: int) -> None:
        status = self._bytes[_FSTAT]
        if not status & _CCIF:
            return
        self._bytes[_FSTAT] = status & ~(value & (_RDCOLERR | _ACCERR | _FPVIOL))
        if value & _CCIF and not status & (_ACCERR | _FPVIOL):
            self._launch()
        self._drive()

    def _drive(self) -> None:
        status, enabled = self._bytes[_FSTAT], self._bytes[_FCNFG]
        self._processor.nvic.set_line(self._done, bool(status & _CCIF and enabled & _CCIE))
        self._processor.nvic.set_line(self._collided, bool(status & _RDCOLERR and enabled & _RDCOLLIE))

    # -- commands -----------------------------------------------------------------------------

    def _byte(self, number: int) -> int:
        return self._bytes[_FCCOB + (number ^ 3)]  # FCCOB0 is the highest byte of the first word

    @property
    def _address(self) -> int:
        return self.word(_FCCOB) & 0xFFFFFF

    @property
    def _sector(self) -> int:
        return self._address & -SECTOR

    @property
    def _block(self) -> int:
        return self._address & -BLOCK

    @property
    def _section_bytes(self) -> int:
        return _SECTION * (self._byte(4) << 8 | self._byte(5))

    def _launch(self) -> None:
        self._bytes[_FSTAT] &= ~_MGSTAT0
        code = self._byte(0)
        if unmodelled := self._unmodelled_command(code):
            self._log.note_command(f"{self.name}_FCCOB0's {unmodelled}", self.base + _FCCOB + 3, code, "set ACCERR")
        command = self._commands.get(code)
        errors = _ACCERR if command is None else command.refuse()
        if command is None or errors:
            self._bytes[_FSTAT] |= errors
            return
        self._bytes[_FSTAT] &= ~_CCIF
        place = self._processor.registers.pc.get()
        if place < SIZE and (code in (0x40, 0x44) or place & -BLOCK == self._busy_block(code)):
            self._bytes[_FSTAT] |= _RDCOLERR
        self._running = self._time.call_after(command.duration_us * _MICROSECOND, lambda: self._finish(command))

    def _unmodelled_command(self, code: int) -> str | None:
        """Return the name of a command that is not modelled, or None."""
        if code == _READ_RESOURCE and self._byte(4) == 1:
            return "version ID"
        return _UNMODELLED.get(code)

    def _busy_block(self, code: int) -> int:
        """Return the block that a command occupies; the records are in the first block."""
        return 0 if code in (_READ_RESOURCE, 0x41, 0x43) else self._block

    def _finish(self, command: _Command) -> None:
        self._running = None
        self._bytes[_FSTAT] |= command.carry_out() | _CCIF
        self._drive()

    # -- checks of commands -------------------------------------------------------------------

    def _refuse_misplaced(self, alignment: int) -> int:
        return _ACCERR if self._address % alignment or self._address >= SIZE else 0

    def _refuse_margin(self, margin: int, first: int = 0) -> int:
        return 0 if first <= margin <= _LAST_MARGIN else _ACCERR

    def _refuse_protected(self, address: int, size: int) -> int:
        """Return FPVIOL if a region has a zero bit in FPROT, whose lowest byte is at the lowest address."""
        region = SIZE // _REGIONS
        bits = self.word(_FPROT)
        touched = range(address // region, (address + size - 1) // region + 1)
        return 0 if all(bits >> number & 1 for number in touched) else _FPVIOL

    def _refuse_change(self, alignment: int, address: int, size: int) -> int:
        return self._refuse_misplaced(alignment) or self._refuse_protected(address, size)

    def _refuse_block(self) -> int:
        return self._refuse_misplaced(_SECTION) | self._refuse_margin(self._byte(4))

    def _refuse_section(self) -> int:
        size = self._section_bytes
        crosses = not size or (self._address + size - 1) & -BLOCK != self._block
        return self._refuse_misplaced(_SECTION) | self._refuse_margin(self._byte(6)) | (_ACCERR if crosses else 0)

    def _refuse_check(self) -> int:
        return self._refuse_misplaced(4) | self._refuse_margin(self._byte(4), first=1)

    def _refuse_resource(self) -> int:
        inside = any(first <= self._address < first + _IFR_BYTES for first in (0, _SWAP_IFR))
        return 0 if inside and self._address % PHRASE == 0 and self._byte(4) == 0 else _ACCERR

    def _refuse_record(self) -> int:
        return 0 if self._byte(1) < RECORDS else _ACCERR

    def _refuse_first_record(self) -> int:
        return self._refuse_record() or (0 if self._record() == ERASED * PHRASE else _ACCERR)

    # -- actions of commands ------------------------------------------------------------------

    def _data(self) -> bytes:
        return bytes(self._bytes[_FCCOB4 : _FCCOB4 + PHRASE])

    def _answer(self, data: bytes) -> int:
        self._bytes[_FCCOB4 : _FCCOB4 + PHRASE] = data
        return 0

    def _verify(self, address: int, size: int) -> int:
        return 0 if self._array.is_erased(address, size) else _MGSTAT0

    def _check(self) -> int:
        return 0 if self._array.read(self._address, 4) == self._bytes[_FCCOB8 : _FCCOB8 + 4] else _MGSTAT0

    def _program(self) -> int:
        return 0 if self._array.program(self._address, self._data()) else _MGSTAT0

    def _erase_sector(self) -> int:
        self._array.erase(self._sector, SECTOR)
        return 0

    def _erase_block(self) -> int:
        self._array.erase(self._block, BLOCK)
        return 0

    def _erase_all(self) -> int:
        self._array.erase(0, SIZE)
        return 0

    def _record(self) -> bytes:
        first = PHRASE * self._byte(1)
        return bytes(self._array.once[first : first + PHRASE])

    def _read_once(self) -> int:
        return self._answer(self._record())

    def _program_once(self) -> int:
        self._array.program_once(self._byte(1), self._data())
        return 0

    def _read_resource(self) -> int:
        """Return eight bytes of the information row: erased, except for the records; the swap row is erased."""
        row = ERASED * _ONCE_IN_IFR + self._array.once if self._address < _IFR_BYTES else ERASED * _IFR_BYTES
        first = self._address % _IFR_BYTES
        return self._answer(row[first : first + PHRASE])
