"""The core's registers, by name and in groups."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence

from hiltest.virtual.core.library import lib
from hiltest.virtual.core.machine import Machine

_FRAME = ("R0", "R1", "R2", "R3", "R12", "LR", "PC", "XPSR")
_ALIASES = {"SP": "R13", "LR": "R14", "PC": "R15"}
# Fields of the structure, and the bits that each register has.
_FIELDS = {
    "PRIMASK": ("primask", 1),
    "FAULTMASK": ("faultmask", 1),
    "BASEPRI": ("basepri", 0xFF),
    "FPSCR": ("fpscr", 0xF7C0009F),
}

_Access = tuple[Callable[[], int], Callable[[int], None]]


def _access(machine: Machine, name: str) -> _Access:
    """Return the functions that read and write a register."""
    core, handle = machine.core, machine.handle
    name = _ALIASES.get(name, name)
    if match := re.fullmatch("([RS])([0-9]+)", name):
        words, number = (core.r if match[1] == "R" else core.s), int(match[2])
        bits = 0xFFFF_FFFF & ~{"R13": 3, "R15": 1}.get(name, 0)

        def read_word() -> int:
            value: int = words[number]
            return value

        def write_word(value: int) -> None:
            words[number] = value & bits

        return read_word, write_word
    if name in _FIELDS:
        field, bits = _FIELDS[name]
        return lambda: getattr(core, field), lambda value: setattr(core, field, value & bits)
    if name in ("MSP", "PSP"):
        process = name == "PSP"
        return (
            lambda: lib.machine_stack_pointer(handle, process),
            lambda value: lib.machine_set_stack_pointer(handle, process, value),
        )
    if name == "XPSR":
        return lambda: lib.machine_xpsr(handle), lambda value: lib.machine_set_xpsr(handle, value)
    if name == "CONTROL":
        return lambda: core.control, lambda value: lib.machine_set_control(handle, value)
    raise KeyError(name)


class RegisterGroup:
    """Registers by name: ``R0`` to ``R15``, ``SP``, ``S0`` to ``S31``, ``XPSR``, ``PRIMASK`` and so on."""

    def __init__(self, machine: Machine, names: Sequence[str]) -> None:
        accesses = [_access(machine, name) for name in names]
        self._reads = [read for read, _ in accesses]
        self._writes = [write for _, write in accesses]

    def read(self) -> list[int]:
        """Read all registers, in order."""
        return [read() for read in self._reads]

    def get(self) -> int:
        """Read the first register."""
        return self._reads[0]()

    def write(self, values: Sequence[int]) -> None:
        """Write all registers, in order."""
        for write, value in zip(self._writes, values, strict=True):
            write(value)


class Register(RegisterGroup):
    def __init__(self, machine: Machine, name: str) -> None:
        super().__init__(machine, [name])

    def set(self, value: int) -> None:
        self._writes[0](value)


class CoreRegisters:
    """The registers that calls and debuggers use."""

    def __init__(self, machine: Machine) -> None:
        self._machine = machine
        self.floating_frame = RegisterGroup(machine, [f"S{n}" for n in range(16)] + ["FPSCR"])
        self.general = RegisterGroup(machine, [f"R{n}" for n in range(16)] + ["XPSR"])
        self.arguments = RegisterGroup(machine, [f"R{n}" for n in range(4)])
        self.floating = RegisterGroup(machine, [f"S{n}" for n in range(16)])
        self.pc = Register(machine, "PC")
        self.msp = Register(machine, "MSP")
        self.psp = Register(machine, "PSP")
        self.xpsr = Register(machine, "XPSR")
        self.control = Register(machine, "CONTROL")
        self.primask = Register(machine, "PRIMASK")
        self.basepri = Register(machine, "BASEPRI")
        self.faultmask = Register(machine, "FAULTMASK")

    def snapshot(self) -> dict[str, int]:
        """Return name and value of every core register, for a fault report."""
        names = [f"r{n}" for n in range(13)] + ["sp", "lr", "pc", "xpsr"]
        return dict(zip(names, self.general.read(), strict=True))
