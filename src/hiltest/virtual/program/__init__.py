"""Firmware images: segments, symbols, source lines and types."""
