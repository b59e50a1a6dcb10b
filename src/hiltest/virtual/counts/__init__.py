"""Analysis of cycles: profiles of calls, uncertainty ranges, and counts by other timing profiles."""
