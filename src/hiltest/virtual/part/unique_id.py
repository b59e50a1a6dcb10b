"""Unique ids that identify virtual and replayed boards on a serial line."""

from __future__ import annotations

#: SIM_UIDH to SIM_UIDL, most significant byte first; a real chip has a number of its own.
VIRTUAL_UNIQUE_ID = b"virtual-frdmk64f"
#: Replacement for the id of a recorded board in `hiltest serve --replay`.
REPLAYED_UNIQUE_ID = b"replayed-session"
