"""A machine of the core's library, owned by Python."""

from __future__ import annotations

from collections.abc import Callable
from errno import ENOMEM
from typing import Any, NamedTuple

from hiltest.errors import ConfigError
from hiltest.virtual.core.library import ffi, guarded_callback, lib
from hiltest.virtual.model.timing import TimingProfile

#: Later than any cycle: `core.deadline` without a due event.
NEVER = 2**63 - 1

#: Returns the value of a load, from its address and its size in bytes; raises `RefusedAccess` for a bus error.
ReadRegister = Callable[[int, int], int]
WriteRegister = Callable[[int, int, int], None]


class BankSwitches(NamedTuple):
    """Switches of the flash controller for one half of the flash.

    Attributes
    ----------
    keeps_line : bool
        True if the last line read is kept.
    reads_ahead_code, reads_ahead_data : bool
        True if a fetch, or an access to data, prefetches the next line.
    caches_code, caches_data : bool
        True if fetched words, or accessed data, enter the cache. Words in the cache are used in any case.
    """

    keeps_line: bool = True
    reads_ahead_code: bool = True
    reads_ahead_data: bool = True
    caches_code: bool = True
    caches_data: bool = True


class Snapshot:
    """State of a machine with its memories at one moment.

    Parameters
    ----------
    handle : struct snapshot
        Snapshot of the library, which is freed with this object.
    machine : Machine, optional
        Machine of the peripherals in the snapshot, which must outlive the snapshot.
    """

    __slots__ = ("_machine", "handle")

    def __init__(self, handle: Any, machine: Machine | None = None) -> None:
        if handle == ffi.NULL:
            raise MemoryError
        self._machine = machine
        self.handle = ffi.gc(handle, lib.machine_forget_snapshot)

    @property
    def core(self) -> Any:
        """State of the core, see machine.h; for reading only."""
        return lib.machine_snapshot_core(self.handle)

    def read(self, address: int, size: int) -> bytes:
        """Return the content of a memory.

        Raises
        ------
        ValueError
            If no memory contains the range.
        """
        data = ffi.new("uint8_t[]", size)
        if not lib.machine_read_snapshot(self.handle, address, size, data):
            raise ValueError(f"no memory at 0x{address:08x}..+0x{size:x}")
        return bytes(data)


class RefusedAccess(Exception):
    """Error for an access that is a bus error on the part; the text has place and reason."""


class Machine:
    """A core with its memories; `core` is the structure of the same name in machine.h.

    Parameters
    ----------
    profile : TimingProfile
        Prices of instructions.
    baseline : bool
        True for a core of ARMv6-M, as the Cortex-M0.

    Attributes
    ----------
    refusal : str
        Reason of the latest bus error.
    """

    def __init__(self, profile: TimingProfile, *, baseline: bool = False) -> None:
        self.handle = ffi.gc(lib.machine_create(baseline), lib.machine_destroy)
        if self.handle == ffi.NULL:
            raise MemoryError
        self.core: Any = lib.machine_core(self.handle)
        self.core.deadline = NEVER
        self.refusal = ""
        self._bus: list[Any] = []
        for name, row in profile.rows.items():
            # The core ignores rows that price no instruction, such as the uncertainty of all counts.
            lib.machine_set_price(self.handle, 0, name.encode(), row.value)
        for name, row in profile.memory.items():
            if not lib.machine_set_memory_row(self.handle, name.encode(), row.value):
                raise ConfigError(f"{profile.name}: memory.{name} of {row.value} is not supported")
        if profile.waiting is not None:
            lib.machine_set_flash(self.handle, *profile.waiting.flash)
            for begin in profile.waiting.blocks:
                if not lib.machine_add_block(self.handle, begin):
                    raise ConfigError(f"{profile.name}: too many memories: {len(profile.waiting.blocks)}")
            for ram in profile.waiting.late:
                if not lib.machine_add_late_ram(self.handle, *ram):
                    raise ConfigError(f"{profile.name}: too many RAMs that answer late: {profile.waiting.late}")

    def add_memory(self, base: int, size: int, *, writable: bool) -> memoryview:
        """Add a memory; return its bytes, for reading only.

        Raises
        ------
        ConfigError
            If it overlaps another one, or there are too many memories.
        MemoryError
            If the computer has no memory left for it.
        """
        ffi.errno = 0
        pointer = lib.machine_add_memory(self.handle, base, size, writable)
        if pointer == ffi.NULL and ffi.errno == ENOMEM:
            raise MemoryError(f"no memory is left for the board's memory of {size} bytes")
        if pointer == ffi.NULL:
            raise ConfigError(f"the memory 0x{base:08x}..+0x{size:x} overlaps another one, or there are too many")
        return memoryview(ffi.buffer(pointer, size)).toreadonly()

    def add_alias(self, base: int, target: int, size: int) -> memoryview:
        """Show a memory at a second address; return its bytes, for reading only.

        Raises
        ------
        ConfigError
            If there is no memory at `target`, it overlaps another one, or there are too many.
        """
        pointer = lib.machine_add_alias(self.handle, base, target)
        if pointer == ffi.NULL:
            raise ConfigError(f"0x{target:08x} cannot be shown at 0x{base:08x}, too")
        return memoryview(ffi.buffer(pointer, size)).toreadonly()

    def switch_flash_bank(self, bank: int, switches: BankSwitches) -> None:
        """Set the switches for half 0 or 1 of the flash; without memory rows in the profile, do nothing."""
        lib.machine_switch_flash_bank(self.handle, bank, *switches)

    def forget_flash_lines(self) -> None:
        """Drop the line of flash that was read last, and the prefetched one."""
        lib.machine_forget_flash_lines(self.handle)

    def forget_flash_way(self, way: int) -> None:
        """Empty one way of the flash's cache."""
        lib.machine_forget_flash_way(self.handle, way)

    def add_clock(self) -> int:
        """Add a clock for peripherals in C; return its number.

        Raises
        ------
        ConfigError
            If there are too many clocks.
        """
        number: int = lib.machine_add_clock(self.handle)
        if number < 0:
            raise ConfigError("too many clocks for the peripherals in C")
        return number

    def set_clock(self, number: int, since: int, ticks: int, remainder: int, numerator: int, denominator: int) -> None:
        """Change the rate of a clock from a cycle on, and replan its events; see machine_set_clock."""
        lib.machine_set_clock(self.handle, number, since, ticks, remainder, numerator, denominator)

    def set_request(self, source: int, level: bool) -> None:
        lib.machine_set_request(self.handle, source, level)

    def snapshot(self, *, with_devices: bool = False) -> Snapshot:
        """Return a snapshot; during an access to a device, of the state before the current instruction.

        Parameters
        ----------
        with_devices : bool
            True to include the peripherals in C and their events: only this machine can restore such a snapshot.
        """
        return Snapshot(lib.machine_snapshot(self.handle, with_devices), self if with_devices else None)

    def restore(self, snapshot: Snapshot) -> None:
        """Restore a snapshot of this machine, or of another one with the same memories.

        Raises
        ------
        ConfigError
            If the memories differ, the peripherals are another machine's, or an instruction is being executed.
        """
        if not lib.machine_restore(self.handle, snapshot.handle):
            raise ConfigError(
                "the snapshot has other memories or peripherals, or the machine is executing an instruction"
            )

    def log_accesses(self, report: Callable[[Any], None], abort: Callable[[BaseException], None]) -> None:
        """Report accesses to unmodelled registers (struct machine_access); `abort` is called with exceptions."""
        self._accessed = guarded_callback("void(void *, const struct machine_access *)", report, abort)
        lib.machine_log_accesses(self.handle, self._accessed, ffi.NULL)

    def answers(self, first: int) -> Any:
        """Return the answers of devices to all loads since a load; None if they are no longer stored.

        Parameters
        ----------
        first : int
            Number of the first load, as counted in `core.device_loads`.
        """
        count = self.core.device_loads - first
        answers = ffi.new("uint32_t[]", count) if 0 <= count <= lib.MOST_ANSWERS else ffi.NULL
        return answers if answers and lib.machine_answers(self.handle, first, count, answers) else None

    def connect(self, read: ReadRegister, write: WriteRegister, abort: Callable[[BaseException], None]) -> None:
        """Set the handlers of accesses to devices; `abort` is called with any exception except `RefusedAccess`."""

        @ffi.callback("uint32_t(void *, uint32_t, uint32_t, bool *)")  # type: ignore[untyped-decorator]
        def read_register(_context: Any, address: int, size: int, refused: Any) -> int:
            try:
                return read(address, size) & (1 << 8 * size) - 1
            except RefusedAccess as error:
                self.refusal, refused[0] = str(error), True
            except BaseException as error:  # the library cannot pass it on; `abort` raises it later
                abort(error)
            return 0

        @ffi.callback("void(void *, uint32_t, uint32_t, uint32_t, bool *)")  # type: ignore[untyped-decorator]
        def write_register(_context: Any, address: int, size: int, value: int, refused: Any) -> None:
            try:
                write(address, size, value)
            except RefusedAccess as error:
                self.refusal, refused[0] = str(error), True
            except BaseException as error:  # as above
                abort(error)

        self._bus = [read_register, write_register]  # the library keeps only the pointers
        lib.machine_connect(self.handle, ffi.new("struct machine_bus *", (ffi.NULL, *self._bus))[0])
