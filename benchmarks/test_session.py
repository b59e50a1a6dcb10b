"""How fast a board boots, answers a call, goes back to a snapshot, and goes through the heading suite.

Boot and calls by the clock on the wall, the long suite in processor time too.
"""

from __future__ import annotations

import subprocess
import sys
import time
from statistics import median

from pytest_benchmark.fixture import BenchmarkFixture

from hiltest.boards import VirtualBench, default_firmware, open_board
from hiltest.procedures import (
    UNCALIBRATED,
    UNCALIBRATED_SLOT,
    collect_tumble,
    measure_known_angles,
    open_table,
    run_calibrators,
)
from hiltest.rig import Rig
from hiltest.virtual.board.k64f import VirtualK64F

from .conftest import Report

# What a fresh process spends behind its imports: on the first board, then on the first and the second call.
COLD = """
import time
from hiltest.rig.bench_files import shipped
from hiltest.boards import VirtualBench, default_firmware, open_board
from hiltest.rig.rig_file import load_rig
from hiltest.virtual.board.k64f import VirtualK64F
rig = load_rig(shipped() / "rigs" / "virtual-k64f.toml")
marks = [time.perf_counter()]
open_board(rig)
marks.append(time.perf_counter())
board = VirtualK64F(default_firmware())
board.call("crc32", b"123456789", 9)
marks.append(time.perf_counter())
print(*(1e3 * (after - before) for before, after in zip(marks, marks[1:])))
"""


def test_boot_to_identity_and_selected_sensors(benchmark: BenchmarkFixture, report: Report, rig: Rig) -> None:
    processor_s: list[float] = []

    def boot() -> None:
        began_s = time.process_time()
        open_board(rig)
        processor_s.append(time.process_time() - began_s)

    benchmark.pedantic(boot, rounds=20, warmup_rounds=1)
    wall_ms = 1e3 * benchmark.stats.stats.min
    report("boot to identity, in a process that has booted before", wall_ms, "ms", "at most 50")
    report("boot to identity, the same in processor time", 1e3 * min(processor_s), "ms", "")


def test_one_call(benchmark: BenchmarkFixture, report: Report) -> None:
    board = VirtualK64F(default_firmware())
    result = benchmark.pedantic(board.call, args=("crc32", b"123456789", 9), rounds=200, warmup_rounds=2)
    assert result.value == 0xCBF43926
    report("a call, on a board that was called before", 1e3 * benchmark.stats.stats.median, "ms", "at most 1")


def test_a_snapshot_and_going_back_to_it(benchmark: BenchmarkFixture, report: Report, rig: Rig) -> None:
    bench = VirtualBench(rig)
    bench.power_on()
    taken_s, restored_s = list[float](), list[float]()

    def work() -> None:
        marks = [time.perf_counter()]
        snapshot = bench.snapshot()
        marks.append(time.perf_counter())
        bench.machine.run_until(bench.time_s + 0.1)
        marks.append(time.perf_counter())
        bench.restore(snapshot)
        taken_s.append(marks[1] - marks[0])
        restored_s.append(time.perf_counter() - marks[2])
        bench.machine.run_until(bench.time_s + 0.1)

    benchmark.pedantic(work, rounds=100, warmup_rounds=2)
    report("a snapshot of the default board in its world", 1e3 * median(taken_s), "ms", "at most 1")
    report("going back to it, 0.1 s later", 1e3 * median(restored_s), "ms", "at most 1")


def test_the_first_boot_and_call_of_a_process(benchmark: BenchmarkFixture, report: Report) -> None:
    def fresh() -> list[float]:
        result = subprocess.run([sys.executable, "-c", COLD], capture_output=True, text=True, check=True, timeout=120)
        return [float(word) for word in result.stdout.split()]

    runs: list[list[float]] = []
    benchmark.pedantic(lambda: runs.append(fresh()), rounds=3)
    boot_ms, call_ms = (min(column) for column in zip(*runs, strict=True))
    report("boot to identity, the first of a process, imports not counted", boot_ms, "ms", "")
    report("a board and the first call, its types read from the DWARF", call_ms, "ms", "")


def test_the_heading_suite(benchmark: BenchmarkFixture, report: Report, rig: Rig) -> None:
    board = open_board(rig)
    table = open_table(board, rig, prompt=input)
    tumble = collect_tumble(board, table, points=rig.procedure.tumble_points)
    runs = run_calibrators(board, tumble, calibrators=board.identity.calibrators, n=rig.procedure.calibration_points)
    slots = {UNCALIBRATED: UNCALIBRATED_SLOT} | {name: run.slot for name, run in runs.items() if run.usable}
    began_s = board.virtual_seconds or 0.0

    processor_s = 0.0

    def suite() -> int:
        nonlocal processor_s
        processor_s = -time.process_time()
        poses = rig.procedure.known_angle_poses("all")
        angles = measure_known_angles(
            board, table, poses=poses, slots=slots, mounting_yaw_deg=1.7, readings=rig.procedure.readings_per_pose
        )
        processor_s += time.process_time()
        return len(angles.poses)

    assert benchmark.pedantic(suite, rounds=1) == 60
    took_s = (board.virtual_seconds or 0.0) - began_s
    wall_s = benchmark.stats.stats.min
    report("the heading suite: virtual time against wall time", took_s / wall_s, "x real time", "at least 1.0")
    report("the heading suite: virtual time against processor time", took_s / processor_s, "x real time", "")
