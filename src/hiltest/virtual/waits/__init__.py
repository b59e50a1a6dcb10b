"""Turns of a loop whose state changes: in how many of them its branches go as in the last one is proved, not tried."""
