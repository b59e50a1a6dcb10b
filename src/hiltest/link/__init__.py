"""The link to a board: frames, messages, requests with deadlines, and serial ports."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hiltest.lazy_exports import when_used

if TYPE_CHECKING:
    from hiltest.link.framing import Frame, FrameDecoder, encode_frame
    from hiltest.link.ports import open_port
    from hiltest.link.request import Request
    from hiltest.link.session import Session
    from hiltest.link.transcript import Transcript

__all__ = ["Frame", "FrameDecoder", "Request", "Session", "Transcript", "encode_frame", "open_port"]

__getattr__ = when_used(
    __name__,
    {
        "Frame": "framing",
        "FrameDecoder": "framing",
        "Request": "request",
        "Session": "session",
        "Transcript": "transcript",
        "encode_frame": "framing",
        "open_port": "ports",
    },
)
