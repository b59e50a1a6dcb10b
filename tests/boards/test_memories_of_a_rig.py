"""A timing profile with memory rows on a rig: the firmware waits longer, and computes what it computes."""

from __future__ import annotations

from dataclasses import replace

from hiltest.boards import VirtualBoard, open_board
from hiltest.link.messages import Calibrate, Points
from hiltest.procedures import upload_cloud
from hiltest.procedures.clouds import golden_cloud
from hiltest.rig import Rig
from hiltest.virtual.memory_waits import MemoryAccounting

CLOUD = golden_cloud(30)
CALIBRATORS = ("direct", "direct-fast", "corrected")  # the others take half a minute by instruction


def opened(rig: Rig, timing: str) -> VirtualBoard:
    board = open_board(replace(rig, board=replace(rig.board, timing=timing)))
    assert isinstance(board, VirtualBoard)
    return board


def answers(board: VirtualBoard) -> tuple[list[list[int]], dict[str, tuple[object, ...]], dict[str, int]]:
    """Upload the cloud, read it back, and fit it: points, answers with their instructions, and clocks."""
    upload_cloud(board, CLOUD)
    replies = [board.session.request(Points(first, 10)) for first in range(0, len(CLOUD), 10)]
    found, clocks = {}, {}
    for name in CALIBRATORS:
        reply = board.session.request(Calibrate(len(CLOUD), name))
        assert reply.cost is not None
        fit = reply.calibration
        counted = board.instructions_counted(reply.cost.cycles + reply.cost.overhead_cycles)
        found[name] = (
            reply.fit, reply.iterations, reply.coverage, fit.soft_iron.tolist(), fit.hard_iron.tolist(), counted
        )  # fmt: skip
        clocks[name] = reply.cost.cycles
    return [point for each in replies for point in each.magnetometer.tolist()], found, clocks


def test_memories_add_clocks_and_leave_every_answer_alone(rig: Rig) -> None:
    with opened(rig, "cortex-m4-trm/1") as board:
        points, found, clocks = answers(board)
    with opened(rig, "cortex-m4-k64f/1") as board:
        assert isinstance(board._machine.processor.accounting, MemoryAccounting)
        points_with_memories, found_with_memories, clocks_with_memories = answers(board)
    assert points_with_memories == points == CLOUD.tolist()
    assert found_with_memories == found
    # The kernels run from SRAM_L with their data in SRAM_U: only their constants, in SRAM_L beside them, meet a fetch.
    for name, plain in clocks.items():
        assert plain <= clocks_with_memories[name] <= 1.005 * plain, name
