"""Flashing of firmware: refused images, DAPLink's drive or a debug probe, and the check of the identity."""
