"""The gyroscope's commands over the wire: rests, stillness, exact sums, gapless logs, and its calibration."""

from __future__ import annotations

import math
import struct

import numpy as np
import pytest

from hiltest.link.replies import Status
from hiltest.orientation.angles import Pose
from hiltest.rig.rig_file import load_rig
from hiltest.world.earth_field import EarthField
from hiltest.world.sensors.fxas21002c import Fxas21002c
from hiltest.world.world import World

from .bench import AVERAGE, READ, REST, ROOT, SELECT, Bench, bench_with

INTEGRATE, FIT, SET, GET, LOG = 0x1E, 0x1F, 0x20, 0x21, 0x25
SECOND_US = 1_000_000
GYROSCOPE = 3
REST_FORM, TURN_FORM, SPAN_FORM = struct.Struct("<H9fbQQBBBHf"), struct.Struct("<H9i6hbQQB"), struct.Struct("<bQQB")
STILL, TURNED, SHAKEN, NOT_TESTED = range(4)
NOISE = 4.0  # counts: 25 mdps/sqrt(Hz) over the 100 Hz that 200 samples a second can show
BIAS_DPS = (1.5, -2.1, 1.2)


def ask_rest(bench: Bench, n: int, *, store: bool = False, noise: float = NOISE) -> tuple[float, ...]:
    return REST_FORM.unpack(bench.ask(REST, struct.pack("<HIBf", n, 20 * SECOND_US, store, noise)))


def bench_in(world: World, **errors: tuple[float, float, float] | float) -> Bench:
    given = {"bias_dps": BIAS_DPS} | errors
    return Bench(i2c1=[Fxas21002c(world, seed=5, **given)])  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def bench() -> Bench:
    return bench_with("i2c1")


def test_the_stored_bias_is_taken_off_the_next_rest() -> None:
    bench = bench_with("i2c1")
    first, second = ask_rest(bench, 50, store=True), ask_rest(bench, 50)
    assert first[0] == second[0] == 50
    assert first[7:10] == first[1:4]  # nothing was stored before
    assert second[7:10] == pytest.approx([now - before for now, before in zip(second[1:4], first[1:4], strict=True)])
    assert struct.unpack("<12f", bench.ask(GET))[9:] == first[1:4]
    assert all(math.isnan(spread) for spread in ask_rest(bench, 1)[4:7])  # one reading has none


def test_a_rest_says_when_it_was_and_how_long(bench: Bench) -> None:
    n = 400
    *_, degc, first_us, last_us, lost, still, _, _, _ = ask_rest(bench, n)
    assert (lost, still) == (0, STILL)
    assert 33 <= degc <= 41  # the course of the rig
    # Both ends are found within a sixteenth of a period, and a transaction of 0.15 ms.
    assert last_us - first_us == pytest.approx((n - 1) * 5000, abs=5000 / 16 + 150)


@pytest.mark.parametrize(("axis", "pose"), [(2, Pose(4.0)), (1, Pose(0.0, 4.0)), (0, Pose(0.0, 0.0, 4.0))])
def test_a_board_that_is_moved_is_refused_with_axis_and_time(axis: int, pose: Pose) -> None:
    world = World(EarthField(48.5, 62.0))
    bench = bench_in(world)
    before = struct.unpack("<12f", bench.ask(GET))
    world.turn_to(pose, time_s=2.5)  # moves from 2.55 to 2.65 s
    found = ask_rest(bench, 1000, store=True)
    first_us, (kind, axis_found, sample, amount) = found[11], found[14:]
    assert (kind, axis_found) == (TURNED, axis)
    assert amount > 16 * 10.0  # 4 degrees in 0.1 s
    moved_s = first_us * 1e-6 + sample / 200.0
    # A window is 0.1 s: the one told is the first that the motion touches.
    assert moved_s - 1e-3 <= 2.65
    assert moved_s + 0.1 >= 2.55
    assert struct.unpack("<12f", bench.ask(GET)) == before, "the bias of a moved board is not stored"


def test_a_board_that_is_shaken_about_a_still_mean_is_refused() -> None:
    quiet, loud = (World(EarthField(48.5, 62.0)) for _ in range(2))
    assert ask_rest(bench_in(quiet), 200)[14] == STILL
    assert ask_rest(bench_in(loud, noise_density=0.08), 200)[14] == SHAKEN


def test_stillness_is_not_judged_where_nobody_says_the_noise(bench: Bench) -> None:
    assert ask_rest(bench, 100, noise=0.0)[14] == NOT_TESTED


def test_stillness_is_not_judged_of_fewer_samples_than_a_window() -> None:
    bench = bench_with("i2c1")
    assert [ask_rest(bench, n, store=True)[14] for n in (1, 19)] == [NOT_TESTED, NOT_TESTED]
    assert struct.unpack("<12f", bench.ask(GET))[9:] == (0, 0, 0), "what was not found still is not stored"
    found = ask_rest(bench, 20, store=True)
    assert found[14] == STILL
    assert struct.unpack("<12f", bench.ask(GET))[9:] == found[1:4]
    untested = ask_rest(bench, 19, store=True, noise=0.0)
    assert struct.unpack("<12f", bench.ask(GET))[9:] == untested[1:4], "without a noise nobody asked for a test"


@pytest.mark.slow
def test_noise_is_no_motion() -> None:
    """475 windows of 20: six sigma on three axes are exceeded in three of a million such tests."""
    for seed in range(5):
        bench = Bench(i2c1=[Fxas21002c(World(EarthField(48.5, 62.0)), seed=seed, bias_dps=BIAS_DPS)])
        assert ask_rest(bench, 1900)[14] == STILL


def test_a_turn_s_sums_are_those_of_its_samples() -> None:
    world = World(EarthField(48.5, 62.0))
    bench = bench_in(world)
    world.turn_to(Pose(90.0), time_s=0.5)
    n = 400
    count, *sums, degc, first_us, last_us, lost = TURN_FORM.unpack(
        bench.ask(INTEGRATE, struct.pack("<HI", n, 5 * SECOND_US))
    )
    assert (count, degc, lost) == (n, 25, 0)
    first = tick_of(bench, first_us)
    samples = body_samples(world, range(first, first + n))
    assert sums[0:3] == samples.sum(axis=0).tolist()
    assert sums[3:6] == samples[:20].sum(axis=0).tolist()
    assert sums[6:9] == samples[-20:].sum(axis=0).tolist()
    assert sums[9:12] == samples.min(axis=0).tolist()
    assert sums[12:15] == samples.max(axis=0).tolist()
    assert last_us - first_us == pytest.approx((n - 1) * 5000, abs=5000 / 16 + 150)


def tick_of(bench: Bench, time_us: int) -> int:
    """Number of the sample at a time of the firmware's clock, which begins when start-up code has run."""
    return round((time_us * 1e-6 + bench.board.timers.enabled_s(0)) * 200.0)


def body_samples(world: World, ticks: range) -> np.ndarray:
    """Read samples off a part like the bench's, without FIFO and without firmware."""
    part = Fxas21002c(world, seed=5, bias_dps=BIAS_DPS)
    part.write_register(0x13, 0x0A, 0.06)
    rows = []
    for tick in ticks:
        time_s = tick / 200.0 + 1e-6
        words = [part.read_register(0x01 + k, time_s) for k in range(6)]
        part.release()
        x, y, z = struct.unpack(">3h", bytes(words))
        rows.append((-y, -x, -z))
    return np.array(rows)


def ask_log(bench: Bench, n: int, *, go_on: bool) -> tuple[np.ndarray, tuple[int, ...]]:
    data = bench.ask(LOG, struct.pack("<BBI", n, go_on, SECOND_US))
    assert data[0] == n
    return np.frombuffer(data[1 : 1 + 6 * n], dtype="<i2").reshape(n, 3), SPAN_FORM.unpack(data[1 + 6 * n :])


def test_a_log_goes_on_from_request_to_request_without_a_gap() -> None:
    world = World(EarthField(48.5, 62.0))
    bench = bench_in(world)
    rows, (_, first_us, *_, lost) = ask_log(bench, 64, go_on=False)
    parts, losses = [rows], [lost]
    for _ in range(5):
        rows, (*_, lost) = ask_log(bench, 64, go_on=True)
        parts.append(rows)
        losses.append(lost)
    first = tick_of(bench, first_us)
    assert losses == [0] * 6
    assert np.array_equal(np.concatenate(parts), body_samples(world, range(first, first + 6 * 64)))


def test_a_log_of_what_waits_takes_all_of_it_and_waits_for_one_when_there_is_none() -> None:
    world = World(EarthField(48.5, 62.0))
    bench = bench_in(world)
    _, (_, first_us, *_) = first = ask_log(bench, 16, go_on=False)
    parts = [first[0]]
    for pause_s in (0.1, 0.0, 0.05):
        bench.board.run_until(bench.board.time_s + pause_s)
        data = bench.ask(LOG, struct.pack("<BBI", 0, 1, SECOND_US))
        parts.append(np.frombuffer(data[1 : 1 + 6 * data[0]], dtype="<i2").reshape(-1, 3))
        assert max(1, 200 * pause_s - 1) <= data[0] <= 200 * pause_s + 5  # frames on the line take some ms
    rows = np.concatenate(parts)
    begin = tick_of(bench, first_us)
    assert np.array_equal(rows, body_samples(world, range(begin, begin + len(rows))))


def test_a_log_that_is_asked_too_late_says_that_samples_are_lost() -> None:
    bench = bench_in(World(EarthField(48.5, 62.0)))
    ask_log(bench, 64, go_on=False)
    bench.board.run_until(bench.board.time_s + 0.1)
    assert ask_log(bench, 64, go_on=True)[1][-1] == 0
    bench.board.run_until(bench.board.time_s + 0.2)
    assert ask_log(bench, 64, go_on=True)[1][-1] == 1
    assert ask_log(bench, 64, go_on=True)[1][-1] == 0


def test_another_command_that_uses_the_fifo_ends_a_log(bench: Bench) -> None:
    for other in (REST, INTEGRATE):
        ask_log(bench, 16, go_on=False)
        if other == REST:
            ask_rest(bench, 40)
        else:
            bench.ask(INTEGRATE, struct.pack("<HI", 40, SECOND_US))
        assert ask_log(bench, 16, go_on=True)[1][-1] == 1
        assert ask_log(bench, 16, go_on=True)[1][-1] == 0


def test_what_reads_the_sensor_by_itself_ends_a_log(bench: Bench) -> None:
    ask_log(bench, 16, go_on=False)
    bench.ask(SELECT, bytes([GYROSCOPE]))
    assert ask_log(bench, 16, go_on=True)[1][-1] == 1
    data = bench.ask(READ, struct.pack("<BBI", GYROSCOPE, 32, SECOND_US))
    rows = [struct.unpack_from("<Q3h", data, 1 + 14 * k) for k in range(32)]
    assert rows[-1][0] - rows[0][0] == pytest.approx(31 * 5000, abs=5000 / 4)
    assert ask_log(bench, 16, go_on=True)[1][-1] == 1


def test_an_average_leaves_a_log_alone(bench: Bench) -> None:
    ask_log(bench, 16, go_on=False)
    bench.ask(AVERAGE, struct.pack("<HIH", 4, SECOND_US, 0))  # 50 ms; the FIFO holds 160
    assert ask_log(bench, 16, go_on=True)[1][-1] == 0


def test_the_calibration_is_held_and_a_bias_leaves_its_matrix_alone() -> None:
    bench = bench_with("i2c1")
    assert struct.unpack("<12f", bench.ask(GET)) == (0.0625, 0, 0, 0, 0.0625, 0, 0, 0, 0.0625, 0, 0, 0)
    values = struct.pack("<12f", *np.arange(12) / 8)
    bench.ask(SET, values)
    assert bench.ask(GET) == values
    mean = ask_rest(bench, 50, store=True)[1:4]
    assert struct.unpack("<12f", bench.ask(GET)) == (*(np.arange(9) / 8), *mean)


TURN = struct.pack("<3f3iHI3f3ff", 0, 0, 360, 0, 0, 1_000_000, 1000, 5_000_000, *[0.0] * 7)


@pytest.mark.parametrize(
    ("kind", "payload"),
    [
        (REST, struct.pack("<HIBf", 1, SECOND_US, 0, -1.0)),
        (REST, struct.pack("<HIBf", 1, SECOND_US, 0, math.nan)),
        (INTEGRATE, struct.pack("<HI", 39, SECOND_US)),
        (INTEGRATE, struct.pack("<HI", 12_001, SECOND_US)),
        (INTEGRATE, struct.pack("<HI", 40, 60 * SECOND_US + 1)),
        (LOG, struct.pack("<BBI", 129, 0, SECOND_US)),
        (LOG, struct.pack("<BBI", 1, 2, SECOND_US)),
        (SET, struct.pack("<12f", *[0.0] * 11, math.inf)),
        (FIT, b"\0"),
        (FIT, b"\x09" + 9 * TURN[: 58 - 7]),
        (FIT, b"\1" + struct.pack("<f", math.nan) + TURN[4:]),
    ],
)
def test_an_argument_out_of_range_is_refused(bench: Bench, kind: int, payload: bytes) -> None:
    assert bench.status(kind, payload) == Status.BAD_ARGUMENT


@pytest.mark.parametrize("payload", [b"\2" + TURN, b"\1" + TURN + b"\0", b"\1" + TURN[:-1]])
def test_turns_that_do_not_fit_their_number_are_refused(bench: Bench, payload: bytes) -> None:
    assert bench.status(FIT, payload) == Status.BAD_LENGTH


def test_too_few_turns_are_told(bench: Bench) -> None:
    assert bench.ask(FIT, b"\2" + TURN * 2)[:2] == bytes([1, 8])


def test_a_timeout_ends_in_time(bench: Bench) -> None:
    for kind, payload in (
        (REST, struct.pack("<HIBf", 200, 200_000, 0, 0.0)),
        (INTEGRATE, struct.pack("<HI", 200, 200_000)),
        (LOG, struct.pack("<BBI", 128, 0, 200_000)),
        (REST, struct.pack("<HIBf", 1, 20_000, 0, 0.0)),
    ):
        started_s = bench.board.time_s
        assert bench.status(kind, payload) == Status.SENSOR_TIMEOUT
        assert bench.board.time_s - started_s < 0.2 + 0.01


def test_without_a_gyroscope_nothing_is_sampled() -> None:
    bench = bench_with("i2c0")
    assert bench.status(REST, struct.pack("<HIBf", 1, SECOND_US, 0, 0.0)) == Status.SENSOR_ABSENT
    assert bench.status(INTEGRATE, struct.pack("<HI", 40, SECOND_US)) == Status.SENSOR_ABSENT
    assert bench.status(LOG, struct.pack("<BBI", 1, 0, SECOND_US)) == Status.SENSOR_ABSENT


def test_the_rig_declares_the_noise_used_here() -> None:
    rig = load_rig(ROOT / "hil" / "rigs" / "virtual-k64f.toml")
    assert rig.sensors.gyroscope_noise_mdps_per_rthz * 1e-3 * math.sqrt(100.0) * 16.0 == NOISE
