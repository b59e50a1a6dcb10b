"""The main job over two real ports: the host turns the table, and the headings that the board answers are right."""

from __future__ import annotations

from dataclasses import replace

from hiltest.bench_files import shipped
from hiltest.boards import open_board
from hiltest.procedures import collect_tumble, measure_known_angles, open_grbl_turntable, run_calibrators
from hiltest.rig.file import load_rig

from .conftest import Serve


def test_a_served_board_is_turned_calibrated_and_judged_without_anybody(serve: Serve) -> None:
    served = serve("--tcp", "0")
    rig = load_rig(shipped() / "rigs" / "served-k64f.toml")
    rig = replace(
        rig, board=replace(rig.board, port=served.board), turntable=replace(rig.turntable, port=served.turntable)
    )
    assert rig.mounting is not None
    with open_board(rig) as board:
        assert board.cycle_model == "cortex-m4-trm/1@sram"
        table = open_grbl_turntable(board, rig)
        # Half as many as the rig asks for: each is a question and an answer, and a busy host is slow at both.
        tumble = collect_tumble(board, table, points=150)
        assert tumble.coverage > 0.9
        run = run_calibrators(board, tumble, calibrators=["direct"])["direct"]
        angles = measure_known_angles(
            board, table, poses=rig.procedure.known_angle_poses("level")[::3],
            slots={"uncalibrated": 0, "direct": run.slot}, mounting_yaw_deg=rig.mounting.yaw_deg,
        )
        table.close()
    assert angles.reference_deg.tolist() == [1.7, 91.7, 181.7, 271.7]
    # The rig's own limit, as on every board; without calibration it does not hold.
    assert angles.summary("direct").max_deg < 1.8 < angles.max_level_deg("uncalibrated")
    assert angles.max_tilt_error_deg("direct") < 0.5
    assert served.end()[0] == 0
