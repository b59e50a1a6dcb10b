"""The parts of a virtual board with the faults of a rig's ``[faults]``; this module imports the models."""

from __future__ import annotations

from collections.abc import Callable

from hiltest.rig.board_faults import SensorFault, span_of
from hiltest.rig.faults import Faults
from hiltest.rig.parts import PARTS, Part
from hiltest.world.sensors import RegisterDevice
from hiltest.world.sensors.faulty_part import FaultyPart


def fitted_part(
    name: str, part: Part, make: Callable[[Part], RegisterDevice], faults: Faults | None, *, began_s: float
) -> RegisterDevice | FaultyPart:
    """Create a part with its faults, whose times count from `began_s` [virtual s]."""
    if faults and faults.sensor and faults.sensor.part == name:
        return _faulty(faults.sensor, part, make, *span_of(faults.sensor, began_s))
    if faults and faults.reset and faults.reset.by == "brown-out":
        at_s = began_s + faults.reset.after_s
        return FaultyPart(lambda: make(part), at_s, at_s)
    return make(part)


def _faulty(
    fault: SensorFault, part: Part, make: Callable[[Part], RegisterDevice], begin_s: float, end_s: float
) -> RegisterDevice | FaultyPart:
    if fault.fault in ("absent", "other part"):
        return FaultyPart(
            lambda: make(part),
            begin_s,
            end_s,
            _another(fault.part, part, make) if fault.fault == "other part" else None,
        )
    device = make(part)
    for output in (output for one in (device, *device.companions) for output in one.outputs):
        (output.freeze if fault.fault == "frozen" else output.saturate)(begin_s, end_s)
    return device


def _another(name: str, part: Part, make: Callable[[Part], RegisterDevice]) -> RegisterDevice:
    """Create a part of another kind at the address of a part."""
    other = make(PARTS["fxas21002c" if "fxos8700cq" in name else "fxos8700cq"])
    other.address = part.address
    return other
