"""Cycles in detail: profiles of calls, uncertainty ranges, and counts with other timing profiles."""
