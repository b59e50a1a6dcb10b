"""eDMA: sixteen channels that move data while the processor does something else."""

from __future__ import annotations

from dataclasses import dataclass

from hiltest.state import Restorable
from hiltest.virtual.part.chip import ChipPeripheral
from hiltest.virtual.peripherals.bus import ALL_STEADY, PeripheralBus, read_by_bytes, write_by_bytes
from hiltest.virtual.peripherals.dma_descriptor import SIZE, Control, Descriptor, DescriptorError
from hiltest.virtual.peripherals.dma_descriptors import DescriptorRegisters
from hiltest.virtual.peripherals.dmamux import CHANNELS, DmaMultiplexer
from hiltest.virtual.processor.cpu import Processor
from hiltest.virtual.processor.memory import PERIPHERALS
from hiltest.virtual.processor.schedule import Event

_CR, _ES, _ERQ, _EEI, _INT, _ERR, _HRS, _DCHPRI = 0x0, 0x4, 0xC, 0x14, 0x24, 0x2C, 0x34, 0x100
_CEEI, _SEEI, _CERQ, _SERQ, _CDNE, _SSRT, _CERR, _CINT = range(0x18, 0x20)
_ERCA, _HOE, _HALT, _EMLM = 1 << 2, 1 << 4, 1 << 5, 1 << 7
_WRITABLE = 0xFE  # of CR; a transfer is never cancelled
_DBE, _SBE, _CPE, _VLD = 1 << 0, 1 << 1, 1 << 14, 1 << 31
_ALL = (1 << CHANNELS) - 1
_ERROR_INTERRUPT = 16
_BUS_BYTES = 4
# Core clocks, as the manual's section on performance counts them: to begin and to end a minor loop, and for an access
# of up to four bytes to memory, to read a peripheral, to write one.
_BEGIN, _END, _MEMORY, _READ, _WRITE = 4, 3, 1, 3, 4
_ACCESSES = 256  # that are made in one event at most: the longest minor loop has thousands of millions


class _BusError(Exception):
    """An access has no answer."""


@dataclass
class _Transfer(Restorable):
    """The minor loop that is under way: bytes that are left, and bytes that the next event moves."""

    channel: int
    descriptor: Descriptor
    left: int
    moving: int = 0

    def parts(self) -> tuple[Descriptor]:
        """Return the descriptor, which changes meanwhile."""
        return (self.descriptor,)


class DmaController(Restorable):
    """The direct memory access controller.

    Minor loops are carried out one after the other and not interrupted (DCHPRI's ECP and DPA are kept, and
    nothing else), chosen by fixed priority or round robin as CR says. What a loop moves reaches memory and peripherals
    at the end of the time it takes, in pieces where it is long. CX and ECX do nothing.

    Parameters
    ----------
    processor : Processor
        Memory, interrupts and time.
    module : ChipPeripheral
        Its addresses and interrupts.
    multiplexer : DmaMultiplexer
        Says which channels are requested.

    Attributes
    ----------
    descriptors : DescriptorRegisters
        Its second page.
    bus : PeripheralBus or None
        Where the peripherals are.
    """

    steady = ALL_STEADY  # what it moves and reports, and who requests it, changes at events

    def __init__(self, processor: Processor, module: ChipPeripheral, multiplexer: DmaMultiplexer) -> None:
        self.name = module.name
        self.base = module.base
        self.clocked = True
        self.bus: PeripheralBus | None = None
        self._processor = processor
        self._interrupts = module.interrupts
        self._multiplexer = multiplexer
        self._active: _Transfer | None = None
        self._event: Event | None = None
        self._driven = 0  # levels of the interrupt lines, a bit each
        self.descriptors = DescriptorRegisters(module, self.look)
        multiplexer.on_request = self.look
        self.reset()

    def parts(self) -> tuple[_Transfer, ...]:
        """Return the minor loop that is under way."""
        return () if self._active is None else (self._active,)

    def reset(self) -> None:
        """Return to the state after reset."""
        if self._event is not None:
            self._event.cancel()
        self._active = self._event = None
        self._control = self._error = 0
        self._words = dict.fromkeys((_ERQ, _EEI, _INT, _ERR), 0)
        self._priorities = list(range(CHANNELS))
        self._last = 0  # the channel that was served last
        self._drive()

    # -- registers ----------------------------------------------------------------------------

    def read(self, offset: int, size: int) -> int:
        """Answer a register, or a part of it."""
        if _DCHPRI <= offset < _DCHPRI + CHANNELS:
            return read_by_bytes(self, offset, size) if size > 1 else self._priorities[offset - _DCHPRI ^ 3]
        register = offset & ~3
        if register == _CR:
            word = self._control
        elif register == _ES:
            word = self._error | (_VLD if self._words[_ERR] else 0)
        elif register == _HRS:
            word = sum(1 << channel for channel in range(CHANNELS) if self._multiplexer.requests(channel))
        else:
            word = self._words.get(register, 0)
        return word >> 8 * (offset & 3)

    def write(self, offset: int, size: int, value: int) -> None:
        """Take a register, or a part of it."""
        if _CEEI <= offset <= _CINT or _DCHPRI <= offset < _DCHPRI + CHANNELS:
            if size > 1:
                write_by_bytes(self, offset, size, value)
            elif offset < _DCHPRI:
                self._command(offset, value)
            else:
                self._priorities[offset - _DCHPRI ^ 3] = value & 0xCF
        else:
            self._write_word(offset & ~3, value << 8 * (offset & 3), (1 << 8 * size) - 1 << 8 * (offset & 3))
        self._drive()
        self.look()

    def _write_word(self, register: int, value: int, mask: int) -> None:
        if register == _CR:
            self._control = (self._control & ~mask | value) & _WRITABLE
        elif register in (_INT, _ERR):
            self._words[register] &= ~value
        elif register in self._words:
            self._words[register] = (self._words[register] & ~mask | value) & _ALL

    def _command(self, offset: int, value: int) -> None:
        """Carry out a write to one of the registers that set or clear one bit, or all."""
        if value & 0x80:
            return
        bits = _ALL if value & 0x40 else 1 << (value & 0xF)
        if offset in (_SEEI, _SERQ):
            self._words[_EEI if offset == _SEEI else _ERQ] |= bits
        elif offset in (_CDNE, _SSRT):
            for channel in range(CHANNELS):
                if bits >> channel & 1:
                    clear, put = (Control.DONE, 0) if offset == _CDNE else (0, Control.START)
                    self.descriptors.change_control(channel, clear=clear, put=put)
        else:
            self._words[{_CEEI: _EEI, _CERQ: _ERQ, _CERR: _ERR, _CINT: _INT}[offset]] &= ~bits

    def _drive(self) -> None:
        nvic, words = self._processor.nvic, self._words
        levels = words[_INT] | bool(words[_ERR] & words[_EEI]) << _ERROR_INTERRUPT
        changed, self._driven = levels ^ self._driven, levels
        while changed:
            line = changed.bit_length() - 1
            nvic.set_line(self._interrupts[line], bool(levels >> line & 1))
            changed ^= 1 << line

    # -- which channel is next ----------------------------------------------------------------

    def look(self) -> None:
        """Begin a minor loop, if one is wanted and none is under way."""
        if self._event is None:
            self._begin(self._processor.now())

    def _begin(self, cycle: int) -> None:
        channel = None if self._control & _HALT else self._next_channel()
        if channel is None:
            return
        self._last = channel
        self._multiplexer.served(channel)
        self.descriptors.change_control(channel, clear=Control.START | Control.DONE, put=Control.ACTIVE)
        descriptor = self.descriptors.get(channel, offsets=bool(self._control & _EMLM))
        if error := self._error_before(descriptor):
            self._event = self._processor.schedule.at(cycle + _BEGIN + _END, lambda: self._refuse(channel, error))
            return
        self._active = _Transfer(channel, descriptor, descriptor.minor_bytes)
        self._plan(self._active, cycle + _BEGIN)

    def _next_channel(self) -> int | None:
        started, enabled = self.descriptors.started, self._words[_ERQ]
        if not (started or enabled):
            return None
        requests = self._multiplexer.requests
        wanted = [
            channel for channel in range(CHANNELS)
            if started >> channel & 1 or (enabled >> channel & 1 and requests(channel))
        ]  # fmt: skip
        if not wanted:
            return None
        if self._control & _ERCA:  # from high numbers to low, behind the one before
            return max(wanted, key=lambda channel: (channel < self._last, channel))
        return max(wanted, key=lambda channel: self._priorities[channel] & 0xF)

    def _error_before(self, descriptor: Descriptor) -> int:
        if not self._control & _ERCA and len({priority & 0xF for priority in self._priorities}) < CHANNELS:
            return _CPE
        return int(descriptor.error())

    # -- one minor loop -----------------------------------------------------------------------

    def _plan(self, active: _Transfer, cycle: int) -> None:
        """Move the next piece at the end of the time that it takes from a cycle on."""
        descriptor = active.descriptor
        source, destination = descriptor.source_bytes, descriptor.destination_bytes
        active.moving = min(active.left, max(source, destination) * _ACCESSES)
        reads = active.moving // source * max(source // _BUS_BYTES, 1)
        writes = active.moving // destination * max(destination // _BUS_BYTES, 1)
        cycles = reads * (_READ if _is_peripheral(descriptor.saddr) else _MEMORY)
        cycles += writes * (_WRITE if _is_peripheral(descriptor.daddr) else _MEMORY)
        last = active.moving == active.left
        self._event = self._processor.schedule.at(cycle + cycles + (_END if last else 0), self._move)

    def _move(self) -> None:
        active = self._active
        assert active is not None  # whoever takes it away cancels the event
        cycle = int(self._processor.schedule.time)
        try:
            self._move_piece(active.descriptor, active.moving)
        except _BusError as error:
            self.descriptors.put(active.channel, active.descriptor)
            self._refuse(active.channel, error.args[0])
            return
        active.left -= active.moving
        if active.left:
            self._plan(active, cycle)
            return
        self._active = None
        self._end(active.channel, active.descriptor)
        self._go_on(cycle)

    def _move_piece(self, descriptor: Descriptor, size: int) -> None:
        source, destination = descriptor.source_bytes, descriptor.destination_bytes
        together = max(source, destination)
        for _ in range(size // together):
            data = b""
            for _ in range(together // source):
                data += self._load(descriptor.saddr, source)
                descriptor.step_source()
            for first in range(0, together, destination):
                self._store(descriptor.daddr, data[first : first + destination])
                descriptor.step_destination()

    def _load(self, address: int, size: int) -> bytes:
        if _is_peripheral(address):
            assert self.bus is not None
            width = min(size, _BUS_BYTES)
            places = range(address, address + size, width)
            if any(self.bus.reason_against(place, width) for place in places):
                raise _BusError(_SBE)
            mask = (1 << 8 * width) - 1
            return b"".join((self.bus.read(place, width) & mask).to_bytes(width, "little") for place in places)
        try:
            return self._processor.memory.read(address, size)
        except ValueError:
            raise _BusError(_SBE) from None

    def _store(self, address: int, data: bytes) -> None:
        if self._processor.memory.holds_stack(address, len(data)):
            self._processor.memory.write(address, data)
            return
        width = min(len(data), _BUS_BYTES)
        places = range(address, address + len(data), width)
        if self.bus is None or any(
            not _is_peripheral(place) or self.bus.reason_against(place, width) for place in places
        ):
            raise _BusError(_DBE)
        for place in places:
            first = place - address
            self.bus.write(place, width, int.from_bytes(data[first : first + width], "little"))

    # -- the end of it ------------------------------------------------------------------------

    def _end(self, channel: int, descriptor: Descriptor) -> None:
        """Count the minor loop; at the end of the major loop do what is to be done then."""
        link = descriptor.minor_link
        descriptor.end_minor_loop()
        if not descriptor.count:
            link = self._end_major(channel, descriptor)
        elif descriptor.csr & Control.INTHALF and descriptor.count == descriptor.half:
            self._words[_INT] |= 1 << channel
        again = self.descriptors.control(channel) & Control.START  # set while it ran
        descriptor.csr = descriptor.csr & ~Control.ACTIVE | again
        self.descriptors.put(channel, descriptor)
        if link is not None:
            self.descriptors.change_control(link, clear=0, put=Control.START)

    def _end_major(self, channel: int, descriptor: Descriptor) -> int | None:
        link, control = descriptor.major_link, descriptor.csr
        descriptor.end_major_loop()
        if control & Control.INTMAJOR:
            self._words[_INT] |= 1 << channel
        if control & Control.DREQ:
            self._words[_ERQ] &= ~(1 << channel)
        if control & Control.ESG:
            self._gather(channel, descriptor)
        return link

    def _gather(self, channel: int, descriptor: Descriptor) -> None:
        """Load the next descriptor from memory."""
        address = descriptor.dlast & 0xFFFFFFFF
        try:
            if address % SIZE:
                raise _BusError(DescriptorError.SGE)
            following = Descriptor.unpack(self._load(address, SIZE), offsets=descriptor.offsets)
        except _BusError as error:
            self._fail(channel, error.args[0])
            return
        for name in vars(following):
            setattr(descriptor, name, getattr(following, name))

    def _refuse(self, channel: int, error: int) -> None:
        """End a minor loop with an error."""
        self._active = None
        self.descriptors.change_control(channel, clear=Control.ACTIVE, put=0)
        self._fail(channel, error)
        self._go_on(int(self._processor.schedule.time))

    def _fail(self, channel: int, error: int) -> None:
        self._error = channel << 8 | error
        self._words[_ERR] |= 1 << channel
        if self._control & _HOE:
            self._control |= _HALT

    def _go_on(self, cycle: int) -> None:
        self._event = None
        self._drive()
        self._begin(cycle)


def _is_peripheral(address: int) -> bool:
    return PERIPHERALS[0] <= address < sum(PERIPHERALS)
