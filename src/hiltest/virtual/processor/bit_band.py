"""Bit-band aliases: one word for each bit of the first megabyte of SRAM_U, and of the peripherals."""

from __future__ import annotations

_WINDOW = 0x02000000  # 32 bytes of aliases for each byte of a megabyte
ALIASES = ((0x22000000, _WINDOW), (0x42000000, _WINDOW))
