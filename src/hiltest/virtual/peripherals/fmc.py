"""FMC: registers that enable the flash controller's line buffer, prefetching and cache."""

from __future__ import annotations

from typing import Protocol

from hiltest.virtual.core.machine import BankSwitches
from hiltest.virtual.part.chip import mk64f12
from hiltest.virtual.peripherals.bus import StoredRegisters

_PFAPR, _PFB0CR, _PFB1CR = 0x0, 0x4, 0x8
_M0PFD = 1 << 16  # disables prefetching for the core's code bus
_SEBE, _IPE, _DPE, _ICE, _DCE = (1 << bit for bit in range(5))
_S_B_INV, _CINV_WAY, _WAYS = 1 << 19, 20, 4
# Bits that can be written. CRC and CLCK_WAY have no effect; memory width and wait states are fixed.
_BANKS = 2
_WRITABLE = {_PFAPR: 0x00FFFFFF, _PFB0CR: 0x0F0000FF, _PFB1CR: 0x0000001F}


class FlashController(Protocol):
    """The methods of `Machine` that the registers control."""

    def switch_flash_bank(self, bank: int, switches: BankSwitches) -> None:
        """Set the switches of half 0 or 1 of the flash."""
        ...

    def forget_flash_lines(self) -> None:
        """Drop the last line read and the prefetched line."""
        ...

    def forget_flash_way(self, way: int) -> None:
        """Empty one way of the cache."""
        ...


class FlashControl(StoredRegisters):
    """PFAPR, PFB0CR and PFB1CR; tags and data of the cache only store writes."""

    def __init__(self, controller: FlashController) -> None:
        self._controller = controller
        base = 0x4001F000
        super().__init__("FMC", base, mk64f12().reset_bytes(base))

    def reset(self) -> None:
        """Return to the state after reset, in which all functions are enabled."""
        super().reset()
        self._switch()

    def write(self, offset: int, size: int, value: int) -> None:
        """Store the writable bits, set the switches, and invalidate buffers and cache as requested."""
        register = offset & ~3
        before = self.word(register)
        super().write(offset, size, value)
        if register not in _WRITABLE:
            return
        written, writable = self.word(register), _WRITABLE[register]
        super().write(register, 4, before & ~writable | written & writable)
        self._switch()
        if register == _PFB0CR:
            self._forget(written)

    def _forget(self, written: int) -> None:
        """Carry out S_B_INV and CINV_WAY, which apply to both banks and read as zero."""
        if written & _S_B_INV:
            self._controller.forget_flash_lines()
        for way in range(_WAYS):
            if written >> _CINV_WAY + way & 1:
                self._controller.forget_flash_way(way)

    def _switch(self) -> None:
        ahead = not self.word(_PFAPR) & _M0PFD
        for bank in range(_BANKS):
            control = self.word(_PFB0CR + 4 * bank)
            switches = BankSwitches(
                keeps_line=bool(control & _SEBE),
                reads_ahead_code=ahead and bool(control & _IPE),
                reads_ahead_data=ahead and bool(control & _DPE),
                caches_code=bool(control & _ICE),
                caches_data=bool(control & _DCE),
            )
            self._controller.switch_flash_bank(bank, switches)
