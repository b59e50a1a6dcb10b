"""Read requests back from their bytes on the line."""

from __future__ import annotations

from typing import Any

from hiltest.errors import ProtocolError
from hiltest.link import accelerometer, dpi, fusion, gyroscope, messages, poses, sequences, streams
from hiltest.link.fields import FieldReader
from hiltest.link.framing import Frame
from hiltest.link.request import Request

_BY_CODE: dict[int, type[Request[Any]]] = {
    kind.code: kind
    for module in (accelerometer, dpi, fusion, gyroscope, messages, poses, sequences, streams)
    for kind in vars(module).values()
    if isinstance(kind, type) and issubclass(kind, Request) and hasattr(kind, "code")
}


def command_of(code: int) -> str:
    """Return the name of a request's type; empty for an unknown code."""
    kind = _BY_CODE.get(code)
    return kind.command if kind else ""


def read_request(frame: Frame) -> Request[Any]:
    """Return the request that a frame carries.

    Raises
    ------
    ProtocolError
        When its type is unknown, or its payload does not fit.
    """
    kind = _BY_CODE.get(frame.type)
    if kind is None:
        raise ProtocolError(f"no request has type 0x{frame.type:02x}")
    fields = FieldReader(frame.payload, f"request {kind.command}")
    request = kind.read(fields)
    fields.end()
    return request
