"""A request: bytes for the board, and the type of its reply.

A reply's payload is a status byte and, if that is one of the request's `answered_with`, the data that its `parse`
reads.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar, Generic, TypeVar, get_args, get_origin

from hiltest.errors import DeviceError
from hiltest.link.fields import U32, FieldReader, Message
from hiltest.link.replies import Status

REPLY_BIT = 0x80

R = TypeVar("R")

_HINTS = {
    Status.UNKNOWN_COMMAND: "the firmware is older than this hiltest; flash the packaged one (hiltest flash)",
    Status.SENSOR_ABSENT: "check that the FRDM-FXS-MULTI-B shield is attached",
    Status.SENSOR_TIMEOUT: "the sensor answers, but has no new sample in time",
    Status.BUS_ERROR: "the I2C bus failed; check shield and jumpers, then reset the board",
    Status.NO_CALIBRATION: "the slot is empty; run a calibrator or set a calibration first",
    Status.DEGENERATE_FIELD: "gravity and magnetic field are parallel or zero",
}


@dataclass(frozen=True)
class Request(Message, Generic[R]):
    """A request; `R` is the type of its parsed reply."""

    code: ClassVar[int]
    command: ClassVar[str]
    # Statuses of replies with data; most requests have only OK.
    answered_with: ClassVar[frozenset[Status]] = frozenset({Status.OK})
    _reply: ClassVar[Any]

    def __init_subclass__(cls) -> None:
        """Store the class in ``Request[...]``."""
        super().__init_subclass__()
        for base in cls.__dict__.get("__orig_bases__", ()):
            if get_origin(base) is Request:
                (cls._reply,) = get_args(base)

    def parse(self, fields: FieldReader) -> R:
        """Read the data of an OK reply, by default with the `read` of its class."""
        reply: R = self._reply.read(fields)
        return reply

    @property
    def board_time_s(self) -> float:
        """Longest time until the board answers, without the line itself [s]."""
        return 0.0


@dataclass(frozen=True)
class Plain(Request[None]):
    """A request whose reply is only a status."""

    def parse(self, fields: FieldReader) -> None:
        """Read nothing."""


@dataclass(frozen=True)
class Timed:
    """Mixin of requests that wait for samples, at most `timeout_us` in total."""

    timeout_us: U32 = field(default=5_000_000, kw_only=True)

    @property
    def board_time_s(self) -> float:
        """Longest time that the board waits for its sensors [s]."""
        return self.timeout_us * 1e-6


def decode_reply(request: Request[R], payload: bytes) -> R:
    """Return the data of a reply to this request.

    Raises
    ------
    DeviceError
        When the board answers with an error status.
    ProtocolError
        When the payload is not a reply to this request; the message names the field and its position.
    """
    fields = FieldReader(payload, f"reply to {request.command}")
    status = fields.choice(Status, "status")
    if status not in request.answered_with:
        fields.end()
        raise DeviceError(request.command, status.name, _HINTS.get(status, ""))
    data = request.parse(fields)
    fields.end()
    return data
