"""The parts of a rig by bus."""

from __future__ import annotations

from hiltest.rig import Rig, build_parts
from hiltest.world import World
from hiltest.world.sensors import RegisterDevice
from hiltest.world.sensors.faulty_part import FaultyPart


def parts_on_buses(rig: Rig, world: World, seed: int) -> dict[str, list[RegisterDevice | FaultyPart]]:
    """Return the devices of each bus, in the order of the rig."""
    buses: dict[str, list[RegisterDevice | FaultyPart]] = {"i2c0": [], "i2c1": []}
    for name, part in build_parts(rig, world, seed).items():
        buses.setdefault(rig.parts[name].bus, []).extend((part, *part.companions))
    return buses
