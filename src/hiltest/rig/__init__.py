"""The rig: a bench as declared in its file, and the virtual world that is built from it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hiltest.lazy_exports import when_used

if TYPE_CHECKING:
    from hiltest.rig.rig import COUNTS_PER_UT, Rig, WorldTruth, build_parts, build_world, world_truth

__all__ = ["COUNTS_PER_UT", "Rig", "WorldTruth", "build_parts", "build_world", "world_truth"]

__getattr__ = when_used(__name__, dict.fromkeys(__all__, "rig"))
