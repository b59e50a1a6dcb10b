"""The faults of a line, each by itself: on a virtual board's port, whose clock they have, and on a port without one."""

from __future__ import annotations

import os
import time
import tty
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
import serial
from hypothesis import given
from hypothesis import strategies as st

from hiltest.boards import VirtualBench, open_board
from hiltest.boards.faulty_port import FaultyPort, heard_at
from hiltest.boards.virtual_port import VirtualPort
from hiltest.calibration.gyroscope import NOMINAL_DPS_PER_COUNT
from hiltest.errors import DeviceTimeoutError, LinkLostError
from hiltest.link.gyroscope import Axis
from hiltest.link.messages import LinkStatistics
from hiltest.link.ports import READ_SLICE_S, WRITE_TIMEOUT_S, open_port
from hiltest.link.session import Session
from hiltest.procedures import SimulatedTurntable, collect_tumble, measure_turn
from hiltest.rig import Rig
from hiltest.rig.faults import Absence, Faults, Late, OtherBaud, Span

BAUD = 115_200


class Echo:
    """A port with a clock of its own, on which all that is written comes back at once."""

    name = "echo"
    timeout = READ_SLICE_S

    def __init__(self) -> None:
        self.time_s = 7.0
        self._there = bytearray()

    def now(self) -> float:
        return self.time_s

    def read_until(self, expected: bytes) -> bytes:
        at = self._there.find(expected)
        return self.read(len(self._there) if at < 0 else at + 1)

    def read(self, size: int) -> bytes:
        if not self._there:
            self.time_s += self.timeout
        data = bytes(self._there[:size])
        del self._there[:size]
        return data

    def write(self, data: bytes) -> int:
        self._there += data
        return len(data)

    def reset_input_buffer(self) -> None:
        self._there.clear()

    def close(self) -> None:
        pass


def faulty(**faults: Any) -> FaultyPort:
    return FaultyPort(Echo(), Faults(**faults), baud=BAUD)


def heard(port: FaultyPort, seconds: float) -> list[tuple[float, bytes]]:
    """Return the pieces that come within a time, and when, from now on."""
    began_s, pieces = port.now(), []
    while port.now() - began_s < seconds:
        if piece := port.read(10_000):
            pieces.append((port.now() - began_s, piece))
    return pieces


SENT = bytes(range(256)) * 40


def test_bytes_are_lost_doubled_and_flipped_as_often_as_the_rig_says_and_the_same_ones_each_time() -> None:
    for key, longer in (("lose", -1), ("double", 1), ("flip", 0)):
        came = []
        for seed in (1, 1, 2):
            port = faulty(seed=seed, direction="to-board", **{key: 0.1})
            for at in range(0, len(SENT), 100):
                port.write(SENT[at : at + 100])
            came.append(b"".join(piece for _, piece in heard(port, 1.0)))
            # 1024 are expected of 10 240; 5 sigma of a binomial are 152.
            assert abs(port.happened[key] - 1024) < 152
            assert len(came[-1]) == len(SENT) + longer * port.happened[key]
        assert came[0] == came[1] != came[2]
    assert {(a ^ b).bit_count() for a, b in zip(came[0], SENT, strict=True)} == {0, 1}


def test_a_byte_s_fate_depends_on_its_number_alone() -> None:
    whole, single = faulty(lose=0.2, direction="to-board"), faulty(lose=0.2, direction="to-board")
    whole.write(SENT[:500])
    for byte in SENT[:500]:
        single.write(bytes([byte]))
    assert b"".join(piece for _, piece in heard(whole, 1.0)) == b"".join(piece for _, piece in heard(single, 1.0))


def test_late_and_split_bytes_all_come_in_their_order() -> None:
    late, split = faulty(late=Late(0.01, 0.3), direction="to-host"), faulty(split=0.05, direction="to-host")
    for port in (late, split):
        port.write(SENT[:1000])
    pieces = heard(late, 10.0)
    assert b"".join(piece for _, piece in pieces) == SENT[:1000]
    # Late by 0.3 s, and by one read more at most.
    assert 0.3 <= pieces[-1][0] <= 0.3 + 2 * READ_SLICE_S
    assert len(pieces) > 1
    parts = heard(split, 1.0)
    assert b"".join(piece for _, piece in parts) == SENT[:1000]
    assert len(parts) == split.happened["split"] + 1


def test_what_is_stalled_comes_when_that_is_over() -> None:
    port = faulty(stall=Span(0.0, 1.0), direction="to-host")
    port.write(b"first")
    port.write(b"second")
    pieces = heard(port, 3.0)
    assert b"".join(piece for _, piece in pieces) == b"firstsecond"
    assert 1.0 <= pieces[0][0] <= 1.0 + 2 * READ_SLICE_S


def test_a_device_that_is_gone_fails_as_a_pulled_cable_does_and_what_was_on_its_way_is_lost() -> None:
    port = faulty(late=Late(1.0, 0.2), disappear=Absence(1.0, 2.0))
    assert heard(port, 0.9) == []
    port.write(b"lost")
    port._port.time_s += 0.2
    for use in (lambda: port.write(b"x"), lambda: port.read(1), lambda: port.read_until(b"x")):
        with pytest.raises(serial.SerialException, match="Input/output error"):
            use()
    port._port.time_s += 1.0
    port.write(b"back")
    assert b"".join(piece for _, piece in heard(port, 1.0)) == b"back"


def test_a_full_output_buffer_delays_a_write_and_then_fails_it() -> None:
    port = faulty(full_output=Span(0.0, 1.0))
    port.write(b"late")
    assert 1.0 <= port.now() - 7.0 <= 1.0 + READ_SLICE_S
    full = faulty(full_output=Span(0.0, 10.0))
    with pytest.raises(serial.SerialTimeoutException):
        full.write(b"never")
    assert WRITE_TIMEOUT_S <= full.now() - 7.0 <= WRITE_TIMEOUT_S + READ_SLICE_S


@given(st.binary(max_size=60), st.integers(-3, 3))
def test_a_receiver_whose_speed_is_off_by_3_percent_hears_every_byte(data: bytes, percent: int) -> None:
    # The last bit of a byte is sampled 8.5 bits behind its edge, half a bit from where it ends: 5.9 % is too much.
    assert heard_at(data, BAUD, BAUD * (100 + percent) // 100) == data


@given(st.binary(min_size=8, max_size=60))
def test_a_receiver_at_half_the_speed_hears_about_half_as_many(data: bytes) -> None:
    assert len(heard_at(data, BAUD, BAUD // 2)) <= len(data) // 2 + 1


def test_a_receiver_at_half_the_speed_hears_what_the_levels_say() -> None:
    # 0xaa is 0 01010101 1 on the line, and the middle of a bit as heard lies 3, 5, 7, 9 ... half bits behind the edge:
    # three zeros, the stop bit, and the idle line.
    assert heard_at(b"\xaa", BAUD, BAUD // 2) == bytes([0b11111000])


def test_another_speed_makes_other_bytes_of_both_ways_from_its_time_on() -> None:
    port = faulty(baud=OtherBaud(1.0, BAUD // 2), direction="to-host")
    port.write(b"before")
    assert b"".join(piece for _, piece in heard(port, 1.0)) == b"before"
    port.write(b"behind")
    assert b"".join(piece for _, piece in heard(port, 1.0)) != b"behind"


def test_a_port_without_a_clock_has_faults_in_wall_time_and_offers_the_session_none() -> None:
    far, near = os.openpty()
    tty.setraw(near)
    port = FaultyPort(open_port(os.ttyname(near)), Faults(stall=Span(0.0, 0.4), direction="to-host"), baud=BAUD)
    try:
        assert Session(port).clock == "wall"
        os.write(far, b"a reply~")
        began_s = time.monotonic()
        data = b""
        while not data and time.monotonic() - began_s < 10.0:
            data = port.read_until(b"~")
        assert data == b"a reply~"
        assert time.monotonic() - began_s >= 0.3  # opened a moment before
    finally:
        port.close()
        os.close(far)
        os.close(near)


@pytest.fixture(scope="module")
def bench(rig: Rig) -> VirtualBench:
    bench = VirtualBench(rig)
    bench.power_on()
    return bench


OpenOn = Callable[..., Session]


@pytest.fixture
def session_on(bench: VirtualBench) -> OpenOn:
    """Return a function that opens a session with the virtual board, synchronised, whose faults begin in 0.5 s."""

    def opened(**faults: Any) -> Session:
        port = VirtualPort()
        port.port, port.timeout = "hil://", READ_SLICE_S
        port.attach(bench.machine)
        port.open()
        session = Session(FaultyPort(port, Faults(**faults), baud=BAUD), nonce_seed=1)
        session.synchronise()
        bench.machine.run_until(bench.time_s + 0.5)
        return session

    return opened


def test_a_session_is_good_again_when_the_device_is_back(session_on: OpenOn, bench: VirtualBench) -> None:
    session = session_on(disappear=Absence(0.5, 1.0))
    with pytest.raises(LinkLostError, match=r"Input/output error.*Check cable"):
        session.request(LinkStatistics())
    bench.machine.run_until(bench.time_s + 1.0)
    session.synchronise()
    session.request(LinkStatistics())


def test_a_stalled_request_ends_by_its_deadlines_and_a_full_port_by_that_of_a_write(session_on: OpenOn) -> None:
    session = session_on(stall=Span(0.5, 100.0))
    began_s = session.now()
    with pytest.raises(DeviceTimeoutError):
        session.request(LinkStatistics())
    assert 3.0 <= session.now() - began_s <= 3.0 + 3 * READ_SLICE_S
    session = session_on(full_output=Span(0.5, 100.0))
    began_s = session.now()
    with pytest.raises(LinkLostError, match=r"a write of \d+ bytes did not go out"):
        session.request(LinkStatistics())
    assert WRITE_TIMEOUT_S <= session.now() - began_s <= WRITE_TIMEOUT_S + READ_SLICE_S


@pytest.mark.slow  # half a minute of a board that moves
def test_a_tumble_and_a_turn_that_the_line_made_late_are_taken_again(rig: Rig) -> None:
    with open_board(replace(rig, faults=Faults(direction="to-board", stall=Span(0.3, 1.5)))) as board:
        # The table, which does not wait, has turned by 0.5 s before the first point: these cover 0.55 of the sphere.
        assert collect_tumble(board, SimulatedTurntable(board.stage, uncertainty_deg=0.1), points=100).coverage > 0.8
    with open_board(replace(rig, faults=Faults(direction="to-board", stall=Span(1.5, 1.5)))) as board:
        # It has begun the turn before the first sample.
        turn = measure_turn(
            board, SimulatedTurntable(board.stage, uncertainty_deg=0.1), Axis.Z, rate_dps=90.0, rest_s=2.0
        ).turn
        assert board.now_s() > 10.0
        assert abs(abs(NOMINAL_DPS_PER_COUNT * turn.integral[2]) - 360.0) < 10.0  # gains are within 2 %
