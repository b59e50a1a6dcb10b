"""The rig: a bench as declared in its file, and the virtual world that is built from it."""

from hiltest.rig.rig import COUNTS_PER_UT, Rig, WorldTruth, build_sensors, build_world, world_truth

__all__ = ["COUNTS_PER_UT", "Rig", "WorldTruth", "build_sensors", "build_world", "world_truth"]
