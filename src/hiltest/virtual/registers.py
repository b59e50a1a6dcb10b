"""Core registers of the emulated processor, read and written in groups.

The emulator's Python binding spends ten microseconds on a group; an interrupt
needs several. These call its C interface with arrays made once.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from functools import partial
from typing import Any

from unicorn import arm_const as arm
from unicorn.unicorn_py3.unicorn import uclib

# Addresses as integers, and the interpreter not let go for so little: a third of the time of the binding's prototypes.
_BATCH = ctypes.PYFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int)
_READ_BATCH = _BATCH(("uc_reg_read_batch", uclib))
_WRITE_BATCH = _BATCH(("uc_reg_write_batch", uclib))

_IT_STATE = 0x0600FC00  # in XPSR
_FRAME = ("R0", "R1", "R2", "R3", "R12", "LR", "PC", "XPSR")


def register_number(name: str) -> int:
    """Translate a register's name (``R0``, ``XPSR``, ``S15``) to the emulator's number."""
    number: int = getattr(arm, f"UC_ARM_REG_{name.upper()}")
    return number


class RegisterGroup:
    """A fixed set of registers, transferred in one call.

    Parameters
    ----------
    engine : Uc
        The emulator.
    names : sequence of str
        Which registers, in which order.
    """

    def __init__(self, engine: Any, names: Sequence[str]) -> None:
        count = len(names)
        self._numbers = (ctypes.c_int * count)(*(register_number(name) for name in names))
        self._values = (ctypes.c_uint32 * count)()
        address = ctypes.addressof(self._values)
        self._pointers = (ctypes.c_void_p * count)(*(address + 4 * index for index in range(count)))
        batch = (engine._uch.value, ctypes.addressof(self._numbers), ctypes.addressof(self._pointers), count)
        self._fetch = partial(_READ_BATCH, *batch)
        self._store = partial(_WRITE_BATCH, *batch)

    def read(self) -> list[int]:
        """Read all of them."""
        self._fetch()
        return self._values[:]

    def get(self) -> int:
        """Read the first of them."""
        self._fetch()
        return self._values[0]

    def write(self, values: Sequence[int]) -> None:
        """Write all of them."""
        self._values[:] = list(values)
        self._store()


class Register(RegisterGroup):
    """One register."""

    def __init__(self, engine: Any, name: str) -> None:
        super().__init__(engine, [name])

    def set(self, value: int) -> None:
        """Write it."""
        self.write([value])


class CoreRegisters:
    """The registers that exceptions and calls move about."""

    def __init__(self, engine: Any) -> None:
        # In the order in which they must be written: XPSR decides which stack pointer SP is, and only in
        # thread mode can CONTROL.SPSEL be cleared.
        self.entry = RegisterGroup(engine, ["SP", "CONTROL", "XPSR", "CONTROL", "LR", "PC"])
        self.interrupted = RegisterGroup(engine, [*_FRAME, "SP", "CONTROL"])
        # CONTROL first without nPRIV: unprivileged thread mode could not change it.
        self.resumed = RegisterGroup(engine, ["CONTROL", "XPSR", "CONTROL", "SP", *_FRAME])
        self.returning = RegisterGroup(engine, ["MSP", "PSP", "CONTROL", "FAULTMASK"])
        self.masks = RegisterGroup(engine, ["PRIMASK", "FAULTMASK", "BASEPRI"])
        self.floating_frame = RegisterGroup(engine, [f"S{n}" for n in range(16)] + ["FPSCR"])
        self.general = RegisterGroup(engine, [f"R{n}" for n in range(13)] + ["SP", "LR", "PC", "XPSR"])
        self.arguments = RegisterGroup(engine, [f"R{n}" for n in range(4)])
        self.floating = RegisterGroup(engine, [f"S{n}" for n in range(16)])
        self._engine = engine
        self._cores: dict[tuple[int, ...], RegisterGroup] = {}
        self.pc = Register(engine, "PC")
        self.msp = Register(engine, "MSP")
        self.psp = Register(engine, "PSP")
        self.xpsr = Register(engine, "XPSR")
        self.control = Register(engine, "CONTROL")
        self.primask = Register(engine, "PRIMASK")
        self.basepri = Register(engine, "BASEPRI")
        self.faultmask = Register(engine, "FAULTMASK")

    def forget_condition(self) -> None:
        """Clear the IT state that the emulator kept from an access that was inspected.

        The emulator writes it down and forgets it there: the next block would begin with this one's condition.
        """
        xpsr = self.xpsr.get()
        if xpsr & _IT_STATE:
            self.xpsr.set(xpsr & ~_IT_STATE)

    def cores(self, numbers: tuple[int, ...]) -> RegisterGroup:
        """Return the group of some of r0 to r14, made once."""
        group = self._cores.get(numbers)
        if group is None:
            group = self._cores[numbers] = RegisterGroup(self._engine, [f"R{number}" for number in numbers])
        return group

    def snapshot(self) -> dict[str, int]:
        """Name and value of every core register, for a fault's report."""
        names = [f"r{n}" for n in range(13)] + ["sp", "lr", "pc", "xpsr"]
        return dict(zip(names, self.general.read(), strict=True))
