"""DMA1 and DMA2: eight streams, each of which serves the request of one of eight channels."""

from __future__ import annotations

from collections.abc import Mapping

from hiltest.virtual.part.chip import ChipPeripheral
from hiltest.virtual.peripherals.bus import PeripheralBus
from hiltest.virtual.peripherals.stm32.block import Block
from hiltest.virtual.processor.clock import Clock
from hiltest.virtual.processor.cpu import Processor
from hiltest.virtual.processor.schedule import Event

_CLEAR, _FIRST, _STREAM_BYTES, _STREAMS = 0x08, 0x10, 0x18, 8
_CR, _NDTR, _PAR, _M0AR, _FCR = 0x00, 0x04, 0x08, 0x0C, 0x14
_EN, _CIRC, _PINC, _MINC, _DBM, _CT = 1, 1 << 8, 1 << 9, 1 << 10, 1 << 18, 1 << 19
_TO_PERIPHERAL, _TO_MEMORY = 1, 2  # DIR; the second is from memory to memory
_FCR_AFTER_RESET = 0x21
_FLAG_SHIFTS = (0, 6, 16, 22)  # of the four streams of a status register
_TEIF, _HTIF, _TCIF, _FLAGS = 1 << 3, 1 << 4, 1 << 5, 0x3D
#: Clocks of the bus for an item from memory to memory, a read and a write of two each.
_ITEM_CLOCKS = 4


class Dma(Block):
    """A controller. FIFOs, bursts and priorities change no transferred byte, and have no model.

    Parameters
    ----------
    requests
        Places of requests: streams and channels such as ``6.4``, by the names of requests such as ``USART2_TX``.
    """

    bus: PeripheralBus

    def __init__(self, processor: Processor, module: ChipPeripheral, clock: Clock, requests: Mapping[str, str]) -> None:
        self._clock = clock
        self.requests = {place: name for name, places in requests.items() for place in places.split()}
        self._raised: set[str] = set()
        self._copies: list[Event | None] = [None] * _STREAMS
        self._is_moving = False
        super().__init__(processor, module)

    def reset(self) -> None:
        super().reset()
        self._counts = [0] * _STREAMS  # NDTR as it was programmed
        for stream in range(_STREAMS):
            self._cancel(stream)
            self.store_word(self._place(stream, _FCR), _FCR_AFTER_RESET)
            self._drive(stream)

    @staticmethod
    def _place(stream: int, register: int) -> int:
        return _FIRST + _STREAM_BYTES * stream + register

    def _cancel(self, stream: int) -> None:
        if (event := self._copies[stream]) is not None:
            event.cancel()
            self._copies[stream] = None

    def take_request(self, name: str, is_raised: bool) -> None:
        """Follow a request of a block."""
        if not is_raised:
            self._raised.discard(name)
        elif name not in self._raised:
            self._raised.add(name)
            self._serve()

    # -- transfers ----------------------------------------------------------------------------

    def _serve(self) -> None:
        """Move items while a stream has a request; the lowest stream goes first."""
        if self._is_moving or not self.clocked:
            return
        self._is_moving = True
        while (stream := next(filter(self._is_ready, range(_STREAMS)), None)) is not None:
            self._move(stream)
        self._is_moving = False

    def _is_ready(self, stream: int) -> bool:
        control = self.word(self._place(stream, _CR))
        if not control & _EN or control >> 6 & 3 == _TO_MEMORY:
            return False
        return self.requests.get(f"{stream}.{control >> 25 & 7}") in self._raised

    def _move(self, stream: int) -> None:
        """Move an item, and count it."""
        control, left = (self.word(self._place(stream, register)) for register in (_CR, _NDTR))
        size, moved = 1 << (control >> 11 & 3), self._counts[stream] - left
        memory = self.word(self._place(stream, _M0AR + 4 * bool(control & _CT)))
        source = self.word(self._place(stream, _PAR)) + (moved * size if control & _PINC else 0)
        target = memory + (moved * size if control & _MINC else 0)
        if control >> 6 & 3 == _TO_PERIPHERAL:
            source, target = target, source
        try:
            self._store(target, size, self._load(source, size))
        except ValueError:
            self.change_word(self._place(stream, _CR), clear=_EN)
            self._set(stream, _TEIF)
            return
        left -= 1
        self.store_word(self._place(stream, _NDTR), left)
        self._set(stream, (_HTIF if left == self._counts[stream] // 2 else 0) | (0 if left else _TCIF))
        if left:
            return
        if control & (_CIRC | _DBM):
            self.store_word(self._place(stream, _NDTR), self._counts[stream])
            self.store_word(self._place(stream, _CR), control ^ (_CT if control & _DBM else 0))
        else:
            self.change_word(self._place(stream, _CR), clear=_EN)

    def _load(self, address: int, size: int) -> int:
        if self.bus.has(address):
            self._check(address, size)
            return self.bus.read(address, size)
        return int.from_bytes(self.processor.memory.read(address, size), "little")

    def _store(self, address: int, size: int, value: int) -> None:
        value &= (1 << 8 * size) - 1
        if self.bus.has(address):
            self._check(address, size)
            self.bus.write(address, size, value)
        elif self.processor.memory.holds_stack(address, size):
            self.processor.memory.write(address, value.to_bytes(size, "little"))
        else:
            raise ValueError(f"no RAM at 0x{address:08x}")

    def _check(self, address: int, size: int) -> None:
        if (reason := self.bus.reason_against(address, size)) is not None:
            raise ValueError(reason)

    def _copy(self, stream: int) -> None:
        """Move all items from memory to memory."""
        self._copies[stream] = None
        while self.word(self._place(stream, _CR)) & _EN:
            self._move(stream)

    # -- registers ----------------------------------------------------------------------------

    def _set(self, stream: int, flags: int) -> None:
        if flags:
            self.change_word(4 * (stream // 4), put=flags << _FLAG_SHIFTS[stream % 4])
            self._drive(stream)

    def _drive(self, stream: int) -> None:
        """Interrupt if an enabled flag is set: DMEIE, TEIE, HTIE and TCIE are one bit below their flags."""
        flags = self.word(4 * (stream // 4)) >> _FLAG_SHIFTS[stream % 4]
        self.drive_interrupt(bool(flags & self.word(self._place(stream, _CR)) << 1 & 0x3C), stream)

    def write_word(self, offset: int, value: int, mask: int) -> None:
        stream, register = divmod(offset - _FIRST, _STREAM_BYTES)
        if offset < _CLEAR:
            return
        if offset < _FIRST:
            self.change_word(offset - _CLEAR, clear=value)
            for number in range(_STREAMS):
                self._drive(number)
        elif register == _CR:
            self._control(stream, self.word(offset) & ~mask | value)
        elif register == _FCR or not self.word(self._place(stream, _CR)) & _EN:  # otherwise read-only
            super().write_word(offset, value, mask)
            if register == _NDTR:
                self._counts[stream] = self.word(offset) & 0xFFFF
                self.store_word(offset, self._counts[stream])

    def _control(self, stream: int, after: int) -> None:
        place = self._place(stream, _CR)
        before = self.word(place)
        self.store_word(place, after)
        if before & ~after & _EN:
            self._cancel(stream)
            self._set(stream, _TCIF)  # the sign for firmware that the stream has ended
        elif after & ~before & _EN:
            self._begin(stream, after)
        self._drive(stream)
        self._serve()

    def _begin(self, stream: int, control: int) -> None:
        if not self.word(self._place(stream, _NDTR)):
            self.store_word(self._place(stream, _NDTR), self._counts[stream])
        if not self._counts[stream]:
            self.change_word(self._place(stream, _CR), clear=_EN)
        elif control >> 6 & 3 == _TO_MEMORY:
            clocks = _ITEM_CLOCKS * self._counts[stream]
            self._copies[stream] = self._clock.call_after(clocks, lambda: self._copy(stream))
