"""Firmware put onto a board: what is refused, the drive of its DAPLink or a debug probe, and who answers then."""
