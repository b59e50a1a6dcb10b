"""The event register: what WFE takes, and sleeps without."""

from __future__ import annotations

from hiltest.virtual.nvic import Nvic


class EventRegister:
    """Set by SEV and by every entry to and return from an exception.

    Parameters
    ----------
    nvic : Nvic
        Whose newly pending exceptions are events too, where firmware says so.

    Attributes
    ----------
    on_pend : bool
        SCR.SEVONPEND: an exception that becomes pending is an event, enabled or not.
    """

    def __init__(self, nvic: Nvic) -> None:
        self._nvic = nvic
        self.reset()

    def reset(self) -> None:
        """State after a processor reset."""
        self.on_pend = False
        self._set = False
        self._nvic.newly_pending = False

    def send(self) -> None:
        """Set it."""
        self._set = True

    def take(self) -> bool:
        """Clear it; say whether it was set."""
        was_set = self._set or (self.on_pend and self._nvic.newly_pending)
        self._set = self._nvic.newly_pending = False
        return was_set
