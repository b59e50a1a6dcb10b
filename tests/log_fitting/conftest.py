"""The board that procedures are tested on."""

from ..procedures.conftest import bench_rig, simulated_turntable, virtual_board

__all__ = ["bench_rig", "simulated_turntable", "virtual_board"]
