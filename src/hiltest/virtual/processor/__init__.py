"""The processor as Python drives it: it runs until an event, reports faults, and tells time, calls and stacks."""
