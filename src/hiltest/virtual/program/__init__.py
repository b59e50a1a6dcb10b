"""Firmware images: segments, symbols, source lines and types, and how much stack their code can take."""
