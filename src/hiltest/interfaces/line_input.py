"""The reason, in one sentence, why the bytes of a serial line cannot be interpreted."""

from __future__ import annotations

import re

_LINE_END = re.compile(rb"[\r\n]")


class LineInput:
    """Counter of received bytes and line ends.

    Attributes
    ----------
    count : int
        Number of bytes.
    has_line_end : bool
    """

    def __init__(self) -> None:
        self.count, self.has_line_end = 0, False

    def take(self, data: bytes) -> None:
        """Count bytes."""
        self.count += len(data)
        self.has_line_end = self.has_line_end or _LINE_END.search(data) is not None

    def remark(self, seconds: float, *, wrong_speed: str, is_text: bool) -> str:
        """Return why the input cannot be interpreted: a wrong speed, silence, or no line end; empty if none of these.

        Parameters
        ----------
        seconds
            Duration of listening [s].
        wrong_speed
            Sentence of `Uart.wrong_speed`; empty if both speeds are equal, or those of a real board are unknown.
        is_text
            True if lines are expected.
        """
        if wrong_speed:
            return wrong_speed
        if not self.count:
            return f"nothing arrived in {seconds:.1f} s: the firmware sends nothing on this port"
        if is_text and not self.has_line_end:
            return f"{self.count} bytes arrived without a line end: the firmware sends no text, or at another speed"
        return ""
