"""Control of the processor from Python: runs up to an event, faults, time, calls and stacks."""
