"""A timing profile with memory rows on a rig: the firmware waits longer, and computes what it computes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from hiltest.boards import VirtualBoard, default_firmware, open_board
from hiltest.link.messages import Calibrate, Points
from hiltest.measurement import CycleRange
from hiltest.procedures import run_streams, upload_points
from hiltest.procedures.golden_points import golden_points
from hiltest.rig import Rig

CLOUD = golden_points(30)
CALIBRATORS = ("direct", "direct-fast", "corrected")


def opened(rig: Rig, timing: str, firmware: Path | None = None) -> VirtualBoard:
    board = open_board(replace(rig, board=replace(rig.board, timing=timing)), firmware=firmware)
    assert isinstance(board, VirtualBoard)
    return board


def answers(board: VirtualBoard) -> tuple[list[list[int]], dict[str, tuple[object, ...]], dict[str, int]]:
    """Upload the cloud, read it back, and fit it: points, answers with their instructions, and clocks."""
    upload_points(board, CLOUD)
    replies = [board.session.request(Points(first, 10)) for first in range(0, len(CLOUD), 10)]
    results, clocks = {}, {}
    for name in CALIBRATORS:
        reply = board.session.request(Calibrate(len(CLOUD), name))
        assert reply.cost is not None
        fit = reply.calibration
        counted = board.instructions_counted(reply.cost.cycles + reply.cost.overhead_cycles)
        results[name] = (
            reply.fit,
            reply.iterations,
            reply.coverage,
            fit.soft_iron.tolist(),
            fit.hard_iron.tolist(),
            counted,
        )
        clocks[name] = reply.cost.cycles
    return [point for reply in replies for point in reply.magnetometer.tolist()], results, clocks


def test_memories_add_clocks_and_leave_every_answer_alone(rig: Rig) -> None:
    with opened(rig, "cortex-m4-trm/3") as board:
        points, result, clocks = answers(board)
    with opened(rig, "cortex-m4-k64f/3") as board:
        points_with_memories, found_with_memories, clocks_with_memories = answers(board)
    assert points_with_memories == points == CLOUD.tolist()
    assert found_with_memories == result
    # The kernels run from SRAM_L with their data in SRAM_U: only their constants, in SRAM_L beside them, meet a fetch.
    for name, plain in clocks.items():
        assert plain <= clocks_with_memories[name] <= 1.005 * plain, name


@pytest.fixture
def flash_elf(tmp_path: Path) -> Path:
    """The firmware that ships, which would say so in the same place had it been linked to run from flash."""
    own, says = default_firmware().read_bytes(), b"frdm-k64f\0\0\0%s\0\0\0"
    assert own.count(says % b"sram\0") == 1
    (tmp_path / "flash.elf").write_bytes(own.replace(says % b"sram\0", says % b"flash"))
    return tmp_path / "flash.elf"


def test_a_count_of_code_in_flash_carries_what_the_memory_rows_state_and_nothing_without_them(
    rig: Rig, flash_elf: Path
) -> None:
    bands = {}
    for timing in ("cortex-m4-trm/3", "cortex-m4-k64f/3"):
        with opened(rig, timing, flash_elf) as board:
            assert board.cycle_model == f"{timing}@flash"
            upload_points(board, CLOUD[:20])
            cost = board.session.request(Calibrate(20, "direct")).cost
            assert cost is not None
            bands[timing] = cost.cycles, board.cycle_range(cost)
    assert bands["cortex-m4-trm/3"][1] is None
    cycles, band = bands["cortex-m4-k64f/3"]
    assert band == CycleRange(round(0.85 * cycles), round(1.15 * cycles))


def test_so_does_the_total_of_a_stream(rig: Rig, flash_elf: Path) -> None:
    bands = {}
    for timing in ("cortex-m4-trm/3", "cortex-m4-k64f/3"):
        with opened(rig, timing, flash_elf) as board:
            upload_points(board, CLOUD[:20])
            run = run_streams(board, 20)["direct-stream"]
            assert run.total is not None
            bands[timing] = run.total, run.total_range
    assert bands["cortex-m4-trm/3"][1] is None
    total, band = bands["cortex-m4-k64f/3"]
    assert band == CycleRange(round(0.85 * total), round(1.15 * total))
