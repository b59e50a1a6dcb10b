"""Calls of functions, by the host or by firmware while it is watched."""
