"""Calls of functions by the host, and counts of the calls that firmware makes."""
