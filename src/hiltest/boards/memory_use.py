"""Memory use of firmware on a virtual board, by the names of measurements below ``firmware.``."""

from __future__ import annotations

from collections.abc import Mapping

from hiltest.virtual.board.virtual_machine import VirtualMachine


def seen_memory_use(machine: VirtualMachine, calls: Mapping[str, tuple[str, int | None]]) -> dict[str, int | str]:
    """Return each memory use [byte], or the reason why it is unknown.

    Parameters
    ----------
    calls
        For each calibrator or other watched function: its name in the firmware, and the stack that its deepest call
        took.
    """
    used: dict[str, int | str] = dict(machine.memory_use())
    bounds = machine.stack_bounds({function for function, _ in calls.values()})
    if "" in bounds:
        used["stack_bound"] = bounds[""]
    for name, (function, stack) in sorted(calls.items()):
        used[f"{name}.stack"] = f"{function} was not called on one stack" if stack is None else stack
        used[f"{name}.stack_bound"] = bounds[function]
    return used
