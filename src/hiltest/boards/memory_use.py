"""What a virtual board sees of the memory that firmware takes, by the names of measurements below ``firmware.``."""

from __future__ import annotations

from collections.abc import Mapping

from hiltest.virtual.board.k64f import VirtualK64F


def seen_memory_use(machine: VirtualK64F, calls: Mapping[str, tuple[str, int | None]]) -> dict[str, int | str]:
    """Return bytes, or why they are not known.

    Parameters
    ----------
    calls
        Of each calibrator or other function that was watched: its name in the firmware, and the stack that the deepest
        of its calls took.
    """
    used: dict[str, int | str] = dict(machine.memory_use())
    bounds = machine.stack_bounds({function for function, _ in calls.values()})
    if "" in bounds:
        used["stack_bound"] = bounds[""]
    for name, (function, taken) in sorted(calls.items()):
        used[f"{name}.stack"] = f"{function} was not called on one stack" if taken is None else taken
        used[f"{name}.stack_bound"] = bounds[function]
    return used
