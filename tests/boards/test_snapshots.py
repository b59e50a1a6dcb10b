"""A bench goes back to a snapshot and does again what it did: the same bytes at the same cycles, in the same world."""

from __future__ import annotations

from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hiltest.boards import VirtualBench, default_firmware
from hiltest.boards.bench import firmware_of
from hiltest.errors import BenchError, SnapshotError
from hiltest.link.framing import Frame, encode_frame
from hiltest.link.messages import Average, Identify, Sync
from hiltest.link.request import Request
from hiltest.orientation.angles import Pose
from hiltest.rig.bench_files import shipped
from hiltest.rig.rig_file import load_rig
from hiltest.virtual.board.k64f import VirtualK64F

RIGS = shipped() / "rigs"
# Those of the FRDM-K64F; tests/virtual/test_microbit.py has the other board.
VIRTUAL_RIGS = sorted(
    file.stem
    for file in RIGS.glob("*.toml")
    if 'kind = "virtual"' in (text := file.read_text()) and "\nmachine = " not in text
)


def bench_of(rig: str) -> VirtualBench:
    """Return a bench that has started; a rig that is for others' firmware and names none gets ours."""
    described = load_rig(RIGS / f"{rig}.toml")
    bench = VirtualBench(described, firmware=firmware_of(described) if described.board.firmware else default_firmware())
    bench.power_on()
    return bench


def ask(bench: VirtualBench, sequence: int, request: Request[Any]) -> None:
    """Put a request on the line, which firmware with a language of its own takes for noise."""
    bench.machine.uart0.host_write(encode_frame(Frame(request.code, sequence, request.payload())))


def heard_in(bench: VirtualBench, seconds: float) -> list[tuple[int, bytes]]:
    """Let virtual time pass; return what came over the serial line, with the cycle at which it was there."""
    machine, heard = bench.machine, list[tuple[int, bytes]]()

    def listen() -> bool:
        if machine.uart0.host_waiting:
            heard.append((machine.cycles, machine.uart0.host_read(machine.uart0.host_waiting)))
        return False

    machine.run_until(machine.time_s + seconds, wake=listen)
    return heard


def state_of(bench: VirtualBench) -> tuple[Any, ...]:
    """Return what can be seen of a bench that stands still."""
    processor = bench.machine.processor
    core, memory = processor.core, processor.memory
    memories = [sha256(memory.read(base, size)).hexdigest() for base, size in (*memory.map.flash, *memory.map.ram)]
    return (
        core.cycles,
        core.instructions,
        core.idle_cycles,
        tuple(core.r),
        tuple(core.s),
        memories,
        bench.machine.events,
        bench.machine.cycle_counter.readings,
        bench.temperature_degc,
        bench.next_move_s(),
    )


def work(bench: VirtualBench) -> tuple[Any, ...]:
    """Turn the table, ask for readings, and return all that comes within a second, and what the bench is then."""
    bench.begin_turn(Pose(40.0, 10.0, -5.0))
    ask(bench, 0, Sync(7))
    ask(bench, 1, Identify())
    ask(bench, 2, Average(16))
    return *heard_in(bench, 1.0), state_of(bench)


@pytest.mark.parametrize("rig", VIRTUAL_RIGS)
def test_a_bench_does_again_what_it_did_since_a_snapshot(rig: str) -> None:
    bench = bench_of(rig)
    heard_in(bench, 0.2)
    snapshot, begin = bench.snapshot(), state_of(bench)
    once = work(bench)
    assert len(b"".join(data for _, data in once[:-1])) > 50
    bench.restore(snapshot)
    assert state_of(bench) == begin
    assert work(bench) == once


def test_a_bench_can_go_back_to_any_of_several_snapshots() -> None:
    bench = bench_of("virtual-k64f")
    snapshots = []
    for _ in range(3):
        heard_in(bench, 0.05)
        snapshots.append((bench.snapshot(), work(bench)))
    for snapshot, once in [*reversed(snapshots), *snapshots]:
        bench.restore(snapshot)
        assert work(bench) == once


# What a host does to a bench; a request is over when 0.3 s have passed.
ACTIONS: dict[str, Callable[[VirtualBench, float], object]] = {
    "wait": lambda bench, amount: heard_in(bench, 0.2 * amount),
    "identify": lambda bench, _amount: [ask(bench, 5, Identify()), heard_in(bench, 0.3)][-1],
    "average": lambda bench, amount: [ask(bench, 9, Average(1 + round(4 * amount))), heard_in(bench, 0.3)][-1],
    "turn": lambda bench, amount: bench.begin_turn(Pose(360.0 * amount, 5.0, 0.0)),
    "tumble": lambda bench, amount: bench.begin_tumble(5.0 + amount),
    "press": lambda bench, _amount: bench.machine.press("SW2"),
    "release": lambda bench, _amount: bench.machine.release("SW2"),
    "reset": lambda bench, _amount: bench.machine.reset(),
    "call": lambda bench, _amount: bench.machine.call("crc32", b"123456789", 9).cycles,
    "write a sensor": lambda bench, amount: bench.write_sensor(1, 0x0E, 0x09, round(255 * amount)),
}
STEPS = st.lists(st.tuples(st.sampled_from(sorted(ACTIONS)), st.floats(0.0, 1.0)), max_size=4)


@pytest.fixture(scope="module")
def default_bench() -> VirtualBench:
    return bench_of("virtual-k64f")


@given(before=STEPS, moment=st.floats(0.0, 0.1), behind=STEPS, elsewhere=STEPS)
@settings(max_examples=40)
def test_a_snapshot_at_any_time_between_requests_is_gone_back_to(
    default_bench: VirtualBench, before: Any, moment: float, behind: Any, elsewhere: Any
) -> None:
    def done(steps: list[tuple[str, float]]) -> list[object]:
        return [*(ACTIONS[name](default_bench, amount) for name, amount in steps), state_of(default_bench)]

    first = default_bench.snapshot()
    done(before)
    heard_in(default_bench, moment)
    snapshot = default_bench.snapshot()
    once = done(behind)
    default_bench.restore(snapshot)
    done(elsewhere)
    default_bench.restore(snapshot)
    assert done(behind) == once
    default_bench.restore(first)


# -- what is refused --------------------------------------------------------------------------


def test_a_snapshot_is_refused_while_a_request_is_on_the_line(default_bench: VirtualBench) -> None:
    ask(default_bench, 1, Identify())
    with pytest.raises(SnapshotError, match=r"a request is open: [0-9]+ bytes of the host are on the line to UART0"):
        default_bench.snapshot()
    heard_in(default_bench, 0.1)
    default_bench.snapshot()


def test_a_snapshot_and_a_restore_are_refused_while_somebody_waits_for_the_board(default_bench: VirtualBench) -> None:
    machine, snapshot = default_bench.machine, default_bench.snapshot()
    for refused in (default_bench.snapshot, lambda: default_bench.restore(snapshot)):
        with pytest.raises(SnapshotError, match="the board is running"):
            machine.run_until(machine.time_s + 0.1, wake=refused)  # type: ignore[arg-type]
    default_bench.snapshot()


def test_a_snapshot_of_another_board_is_refused(default_bench: VirtualBench) -> None:
    with pytest.raises(SnapshotError, match="the snapshot belongs to another board"):
        default_bench.restore(bench_of("virtual-k64f").snapshot())


def test_a_board_whose_flash_a_file_holds_has_no_snapshot(tmp_path: Path) -> None:
    board = VirtualK64F(default_firmware(), flash_file=tmp_path / "flash.bin")
    with pytest.raises(SnapshotError, match=r"flash\.bin stores the board's flash"):
        board.snapshot()
    assert issubclass(SnapshotError, BenchError)


# -- beside the bytes -------------------------------------------------------------------------


def test_a_board_goes_back_to_before_it_was_booted() -> None:
    board = VirtualK64F(default_firmware())
    snapshot = board.snapshot()
    called = board.call("crc32", b"123456789", 9)
    board.run_until(0.05)
    board.restore(snapshot)
    assert (board.cycles, board.time_s, board.faults) == (0, 0.0, ())
    assert board.call("crc32", b"123456789", 9) == called


def test_nothing_is_under_way_behind_a_restore(default_bench: VirtualBench) -> None:
    machine, snapshot = default_bench.machine, default_bench.snapshot()
    ask(default_bench, 1, Identify())
    machine.run_until(machine.time_s + 0.1)
    assert machine.uart0.host_waiting > 10
    ask(default_bench, 2, Identify())
    default_bench.restore(snapshot)
    assert (machine.uart0.host_waiting, machine.uart0.host_arriving) == (0, 0)
    assert heard_in(default_bench, 0.3) == []


def test_calls_that_were_under_way_at_a_snapshot_are_abandoned() -> None:
    bench = bench_of("virtual-k64f")
    watch = bench.machine.watch_calls(["main"])
    bench.machine.reset()
    heard_in(bench, 0.1)
    snapshot = bench.snapshot()
    assert (watch.summary("main").open, watch.summary("main").abandoned) == (1, 0)
    bench.restore(snapshot)
    assert (watch.summary("main").open, watch.summary("main").abandoned) == (0, 1)
