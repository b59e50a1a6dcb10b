"""Timing profiles from measurements on real chips."""
