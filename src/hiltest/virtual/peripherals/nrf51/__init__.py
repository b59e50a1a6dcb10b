"""Blocks of the nRF51 series, from its reference manual (nRF51 Series Reference Manual, version 3.0.1)."""
