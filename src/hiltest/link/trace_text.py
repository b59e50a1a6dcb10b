"""A transcript for people: one line for each frame, decoded, with the time of the board's clock."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, is_dataclass
from enum import Enum
from typing import Any

import numpy as np

from hiltest.errors import DeviceError, ProtocolError
from hiltest.link.framing import DamagedFrame, Frame, FrameDecoder
from hiltest.link.request import REPLY_BIT, Request, decode_reply
from hiltest.link.request_reading import command_of, read_request
from hiltest.link.transcript import Direction, Transcript

_NUMBERS_SHOWN = 12
_BYTES_SHOWN = 32


@dataclass(frozen=True, slots=True)
class _TimedItem:
    """A frame, or damaged bytes, with the time of its last byte."""

    time_s: float
    direction: Direction
    item: Frame | DamagedFrame


def trace_lines(transcript: Transcript) -> Iterator[str]:
    """Yield a line for each frame: time [s], direction, sequence number, command and fields."""
    asked: dict[int, Request[Any]] = {}
    decoders = {Direction.TO_BOARD: FrameDecoder(), Direction.TO_HOST: FrameDecoder()}
    for entry in transcript.entries:
        if entry.direction is Direction.CLOCK:
            continue
        if entry.call is not None or entry.direction is Direction.MARK:
            text = entry.data.decode(errors="replace") if entry.call is None else json.dumps(entry.call)
            yield _line(entry.time_s, entry.direction, "", text)
            continue
        for item in decoders[entry.direction].feed(entry.data):
            yield _format_item(_TimedItem(entry.time_s, entry.direction, item), asked)
    for direction, decoder in decoders.items():
        if decoder.unfinished:
            yield f"{'':>14}  {direction}       unfinished: {_hex(decoder.unfinished)}"


def frames_in_words(data: bytes) -> str:
    """Describe the bytes of one write: commands with their fields, a text, or hexadecimal digits."""
    descriptions = [_describe(Direction.TO_BOARD, item, {}) for item in FrameDecoder().feed(data)]
    text = data.decode("latin-1")
    if descriptions:
        return "; ".join(descriptions)
    return repr(text) if data and text.isascii() and text.rstrip().isprintable() else _hex(data)


def _format_item(item: _TimedItem, asked: dict[int, Request[Any]]) -> str:
    sequence = "" if isinstance(item.item, DamagedFrame) else str(item.item.sequence)
    return _line(item.time_s, item.direction, sequence, _describe(item.direction, item.item, asked))


def _describe(direction: Direction, item: Frame | DamagedFrame, asked: dict[int, Request[Any]]) -> str:
    if isinstance(item, DamagedFrame):
        return f"damaged: {item.reason}; {_hex(item.data)}"
    return _request(item, asked) if direction is Direction.TO_BOARD else _reply(item, asked)


def _line(time_s: float, direction: Direction, sequence: str, text: str) -> str:
    return f"{time_s:14.6f}  {direction}  {sequence:>3}  {text}"


def _request(frame: Frame, asked: dict[int, Request[Any]]) -> str:
    try:
        request = read_request(frame)
    except ProtocolError as error:
        asked.pop(frame.sequence, None)
        return f"{command_of(frame.type) or f'type 0x{frame.type:02x}'} not understood: {error}; {_hex(frame.payload)}"
    asked[frame.sequence] = request
    return f"{request.command} {_fields(request)}".rstrip()


def _reply(frame: Frame, asked: dict[int, Request[Any]]) -> str:
    code = frame.type & ~REPLY_BIT
    name = command_of(code) or f"type 0x{frame.type:02x}"
    request = asked.get(frame.sequence)
    if request is None or request.code != code or not frame.type & REPLY_BIT:
        return f"{name} does not answer a request of this trace; {_hex(frame.payload)}"
    try:
        answer = decode_reply(request, frame.payload)
    except DeviceError as error:
        return f"{name} {error.status}"
    except ProtocolError as error:
        return f"{name} not understood: {error}; {_hex(frame.payload)}"
    text = _fields(answer) if is_dataclass(answer) else _value(answer) if answer is not None else ""
    return f"{name} OK {text}".rstrip()


def _fields(record: Any) -> str:
    return " ".join(f"{field.name}={_value(getattr(record, field.name))}" for field in fields(record))


def _value(value: Any) -> str:
    if isinstance(value, Enum):
        return value.name
    if is_dataclass(value):
        return f"({_fields(value)})"
    if isinstance(value, float):
        return f"{value:.9g}"
    if isinstance(value, np.ndarray) or (isinstance(value, list) and value and not is_dataclass(value[0])):
        return _numbers(np.asarray(value))
    if isinstance(value, Sequence) and not isinstance(value, str):
        return f"[{', '.join(map(_value, value))}]"
    return str(value)


def _numbers(array: np.ndarray[Any, Any]) -> str:
    flat = array.ravel().tolist()
    more = f", ... {' x '.join(map(str, array.shape))} in all" if len(flat) > _NUMBERS_SHOWN else ""
    return f"[{', '.join(_value(number) for number in flat[:_NUMBERS_SHOWN])}{more}]"


def _hex(data: bytes) -> str:
    more = " ..." if len(data) > _BYTES_SHOWN else ""
    return f"{len(data)} bytes {data[:_BYTES_SHOWN].hex(' ')}{more}".rstrip()
