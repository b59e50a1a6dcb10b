"""The processor in Python: runs until an event, faults, time, calls and stacks."""
