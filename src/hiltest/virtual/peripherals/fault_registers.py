"""Registers of the SCB about faults: SHCSR, CFSR, HFSR, MMFAR, BFAR."""

from __future__ import annotations

from hiltest.virtual.exceptions import ExceptionUnit
from hiltest.virtual.nvic import BUS_FAULT, MEM_MANAGE, PENDSV, SVCALL, SYSTICK, USAGE_FAULT, Nvic

SHCSR, CFSR, HFSR, MMFAR, BFAR = 0xD24, 0xD28, 0xD2C, 0xD34, 0xD38
_ENABLES = {16: MEM_MANAGE, 17: BUS_FAULT, 18: USAGE_FAULT}
_ACTIVES = {0: MEM_MANAGE, 1: BUS_FAULT, 3: USAGE_FAULT, 7: SVCALL, 10: PENDSV, 11: SYSTICK}
_PENDINGS = {12: USAGE_FAULT, 13: MEM_MANAGE, 14: BUS_FAULT, 15: SVCALL}


class FaultRegisters:
    """System handler control and fault status.

    Parameters
    ----------
    exceptions : ExceptionUnit
        Unit that the registers show.
    nvic : Nvic
        What is pending and active.
    """

    offsets = frozenset({SHCSR, CFSR, HFSR, MMFAR, BFAR})

    def __init__(self, exceptions: ExceptionUnit, nvic: Nvic) -> None:
        self._status = exceptions.status
        self._nvic = nvic

    def read(self, offset: int) -> int:
        """Answer a word; MMFAR reads as zero, for no MPU forbids an access."""
        if offset == SHCSR:
            sets = ((_ENABLES, self._status.enabled), (_ACTIVES, self._nvic.active), (_PENDINGS, self._nvic.pending))
            return sum(1 << bit for bits, members in sets for bit, exception in bits.items() if exception in members)
        return {CFSR: self._status.cfsr, HFSR: self._status.hfsr, BFAR: self._status.bfar}.get(offset, 0)

    def write(self, offset: int, value: int) -> None:
        """Take a word; ones clear the bits of CFSR and HFSR."""
        status = self._status
        if offset == SHCSR:
            status.enabled = {exception for bit, exception in _ENABLES.items() if value >> bit & 1}
            for bit, exception in _PENDINGS.items():
                if value >> bit & 1:
                    self._nvic.pend(exception)
                else:
                    self._nvic.pending.discard(exception)
        elif offset == CFSR:
            status.cfsr &= ~value
        elif offset == HFSR:
            status.hfsr &= ~value
        elif offset == BFAR:
            status.bfar = value
