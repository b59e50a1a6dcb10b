"""Unique id of virtual boards, by which they are recognised on any serial line."""

from __future__ import annotations

#: What stands in SIM_UIDH to SIM_UIDL, most significant byte first, where a chip has a number of its own.
VIRTUAL_UNIQUE_ID = b"virtual-frdmk64f"
#: What `hiltest serve --replay` puts in the place of the recorded board's.
REPLAYED_UNIQUE_ID = b"replayed-session"
