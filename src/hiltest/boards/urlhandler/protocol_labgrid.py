"""``labgrid://PLACE``: the serial port of a place of labgrid, which is acquired while the port is open."""

from __future__ import annotations

from typing import Any

from serial import rfc2217

from hiltest.boards.labgrid import place_of


class Serial(rfc2217.Serial):  # type: ignore[misc]
    """pyserial's RFC 2217 client on the exporter's port of a place."""

    def open(self) -> None:
        """Acquire the place, power cycle it on request, and connect."""
        self._place = place_of(self.portstr)
        self._acquired = self._place.acquire()
        try:
            if self._place.power_cycle:
                self._place.cycle()
            super().open()
        except BaseException:
            self._give_back()
            raise

    def from_url(self, _url: str) -> tuple[str, int]:
        """Return host and port of the exporter, and keep the options, for pyserial's ``open``."""
        address: tuple[str, int] = super().from_url(self._place.port())
        return address

    def close(self) -> None:
        """Disconnect, and release the place."""
        try:
            super().close()
        finally:
            self._give_back()

    def _give_back(self) -> None:
        place: Any = getattr(self, "_place", None)
        if place is not None and self._acquired:
            self._acquired = False
            place.release()
