"""RCM: the source of the latest reset."""

from __future__ import annotations

from enum import Enum

from hiltest.virtual.peripherals.bus import StoredRegisters


class ResetSource(Enum):
    """Source of a reset; the value has SRS0 in its low byte and SRS1 in its high byte."""

    POWER_ON = 0x0082  # includes LVD, because the supply starts below that limit
    WATCHDOG = 0x0020
    PIN = 0x0040
    SOFTWARE = 0x0400
    WAKE_UP = 0x0001


class ResetRequested(Exception):
    """Signal that the part is to be reset: by AIRCR, by the watchdog, or at the end of VLLS."""

    def __init__(self, source: ResetSource) -> None:
        texts = {ResetSource.WATCHDOG: "the watchdog reset it", ResetSource.WAKE_UP: "a wake-up from VLLS reset it"}
        super().__init__(texts.get(source, "the firmware reset itself"))
        self.source = source


class ResetControl(StoredRegisters):
    """The RCM; only its registers with the reset source have a function."""

    def __init__(self) -> None:
        super().__init__("RCM", 0x4007F000, {0: ResetSource.POWER_ON.value})

    def set_source(self, source: ResetSource) -> None:
        """Set the source that the firmware reads after the reset."""
        self._bytes[0:2] = source.value.to_bytes(2, "little")
