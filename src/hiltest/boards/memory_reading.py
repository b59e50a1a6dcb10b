"""Reading variables of a board: over the in-process GDB session of a virtual one, or through a real one's server."""

from __future__ import annotations

from collections.abc import Callable
from typing import NoReturn

from hiltest.boards.gdb_session import GdbSession
from hiltest.errors import ConfigError, VersionMismatchError
from hiltest.interfaces.gdb_client import GdbClient
from hiltest.interfaces.gdb_wire import TcpWire, Wire
from hiltest.interfaces.memory_interface import MemoryInterface, read_descriptions
from hiltest.interfaces.variables import Variables, function_address
from hiltest.rig import Rig
from hiltest.rig.memory_device import MemoryDevice
from hiltest.virtual.board.debugger import Debugger
from hiltest.virtual.board.virtual_machine import VirtualMachine
from hiltest.virtual.program.elf import FirmwareImage

_RAM = range(0x1C00_0000, 0x4000_0000)
_SECURITY_BYTES = range(0x400, 0x410)  # security bytes of the flash, which some programmers do not write


class _Halted(Exception):
    """Signal that the processor has halted, which ends the current run."""


class BoardWire:
    """A wire to a virtual board's GDB session in the same thread: the board runs while the host waits for an answer.

    Its clock is the board's, which advances only while the processor runs. Between two readings the board is not held.

    Parameters
    ----------
    machine
        Not running.
    """

    name = "of the virtual board"

    def __init__(self, machine: VirtualMachine) -> None:
        self._machine = machine
        self._session = GdbSession(machine, Debugger(machine, on_stop=_leave))
        machine.debugged = False  # a fault is reported as the firmware's, as without a debugger
        self._reply = b""

    def now(self) -> float:
        """Return virtual time [s]."""
        return self._machine.time_s

    def send(self, data: bytes) -> None:
        """Send bytes to the session; its answer takes no virtual time."""
        self._reply += self._session.feed(data)

    def receive(self, timeout_s: float) -> bytes:
        """Return the session's reply; let the board run if the reply needs a halt.

        Raises
        ------
        BoardFault
            When the firmware faults, or hangs.
        """
        if not self._reply and self._session.awaits_halt:
            try:
                self._machine.run_until(self._machine.time_s + timeout_s)
            except _Halted:
                self._reply += self._session.stopped()
        reply, self._reply = self._reply, b""
        return reply

    def close(self) -> None:
        """Detach, and let the board run. Idempotent."""
        self._session.close()


def _leave() -> NoReturn:
    raise _Halted


def memory_kind(image: FirmwareImage | None, machine: VirtualMachine | None) -> Callable[[Rig], MemoryInterface]:
    """Return a function that opens the interface of kind ``memory`` of a rig; see `open_memory` for the arguments."""

    def opened(rig: Rig) -> MemoryInterface:
        assert rig.device is not None
        assert rig.device.memory is not None
        if image is None:
            raise ConfigError(
                f"{_place(rig, 'device', 'kind')}: memory needs the ELF of the board: name it with --firmware"
            )
        return open_memory(rig, rig.device.memory, image, machine)

    return opened


def open_memory(
    rig: Rig, device: MemoryDevice, image: FirmwareImage, machine: VirtualMachine | None
) -> MemoryInterface:
    """Connect to a board's memory, and find the variables that a rig names.

    Parameters
    ----------
    rig
        Locates the keys for error messages.
    device
        Its ``[device.memory]`` table.
    image
        The ELF that runs on the board.
    machine
        The virtual board; None for a real one.

    Raises
    ------
    ConfigError
        When a variable or function does not exist, or no server is named for a real board.
    DebugServerError
        When the server cannot be reached.
    VersionMismatchError
        When another build runs on a real board.
    """
    keys = ("device", "memory")
    readings = read_descriptions(device.values, Variables(image), lambda name: _place(rig, *keys, "values", name))
    try:
        entry = None if device.at_return_of is None else function_address(image, device.at_return_of)
    except ConfigError as error:
        raise ConfigError(f"{_place(rig, *keys, 'at_return_of')}: {error}") from error
    client = GdbClient(_wire(rig, device, machine))
    try:
        if machine is None:
            refuse_other_firmware(client, image)
        return MemoryInterface(client, readings, at_return_of=entry)
    except BaseException:
        client.close()
        raise


def refuse_other_firmware(client: GdbClient, image: FirmwareImage) -> None:
    """Raise an error if a board's flash differs from the ELF whose addresses are used to read its memory.

    Raises
    ------
    VersionMismatchError
        If they differ.
    """
    for segment in image.segments:
        if segment.address in _RAM:
            continue  # RAM, which the firmware may have written since
        read = client.read(segment.address, len(segment.data))
        for offset, (flash_byte, file_byte) in enumerate(zip(read, segment.data, strict=True)):
            if flash_byte != file_byte and segment.address + offset not in _SECURITY_BYTES:
                at = segment.address + offset
                raise VersionMismatchError(
                    f"{image.name} is not the program on the board of debug server {client.name}: at 0x{at:08x} it has "
                    f"0x{file_byte:02x}, and the flash has 0x{flash_byte:02x}. Name the ELF of that build with "
                    "--firmware, or flash this one"
                )


def _wire(rig: Rig, device: MemoryDevice, machine: VirtualMachine | None) -> Wire:
    place = _place(rig, "device", "memory", "server")
    if machine is not None:
        if device.server is not None:
            raise ConfigError(f"{place}: a virtual board needs no server; leave it out")
        return BoardWire(machine)
    if device.address is None:
        raise ConfigError(f'{place} is missing: name the GDB server of the board\'s probe, such as "localhost:3333"')
    return TcpWire(*device.address, rig=rig.name)


def _place(rig: Rig, *key: str) -> str:
    return f"{rig.where(*key)}: {'.'.join(key)}"
