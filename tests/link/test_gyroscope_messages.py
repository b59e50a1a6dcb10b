"""The gyroscope's requests and replies are the bytes the protocol page says."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import pytest

from hiltest.calibration.gyroscope import GyroscopeTurn, TurnsStatus
from hiltest.errors import ProtocolError
from hiltest.link import gyroscope as g
from hiltest.link.request import Request, decode_reply

TURN = GyroscopeTurn(np.array([0.0, 0, 1]), np.array([1, -1, 256]), 40, 0.000256, np.zeros(3), np.zeros(3), 0.5)
SPAN = struct.pack("<QQB", 1_000_000, 3_500_000, 0)


@pytest.mark.parametrize(
    ("request_", "code", "expected"),
    [
        (g.GyroscopeRest(4096, store=True, timeout_us=2, noise=4.0), 0x0F, "0010 02000000 01 00008040"),
        (g.IntegrateGyroscope(12_000, timeout_us=3), 0x1E, "e02e 03000000"),
        (
            g.FitGyroscope([TURN]),
            0x1F,
            "01 0000000000000000 0000803f 01000000 ffffffff 00010000 2800 00010000" + " 00" * 24 + " 0000003f",
        ),
        (g.SetGyroscope(np.eye(3), [0, 0, 1]), 0x20, ("0000803f" + "00" * 12) * 2 + "0000803f" + "00" * 8 + "0000803f"),
        (g.GetGyroscope(), 0x21, ""),
        (g.LogGyroscope(128, go_on=True, timeout_us=1), 0x25, "80 01 01000000"),
    ],
)
def test_request_payloads_are_those_written_by_hand(request_: Request[Any], code: int, expected: str) -> None:
    assert request_.code == code
    assert request_.payload() == bytes.fromhex(expected)


@pytest.mark.parametrize(
    ("request_", "complaint"),
    [
        (g.GyroscopeRest(4097), "4097 samples"),
        (g.IntegrateGyroscope(39), "39 samples"),
        (g.IntegrateGyroscope(12_001), "12001 samples"),
        (g.LogGyroscope(129), "129 samples"),
        (g.LogGyroscope(-1), "-1 samples"),
        (g.FitGyroscope([]), "0 turns"),
        (g.FitGyroscope([TURN] * 9), "9 turns"),
    ],
)
def test_what_the_protocol_does_not_take_is_refused(request_: Request[Any], complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        request_.payload()


def test_a_rest_s_reply_says_when_and_whether_it_was_still() -> None:
    statistics = struct.pack("<H9fb", 500, 24, -33, 19, 3, 3, 3, 0, 0, 0.5, -7)
    reply = decode_reply(g.GyroscopeRest(500), b"\0" + statistics + SPAN + struct.pack("<BBHf", 1, 2, 640, -81.5))
    assert (reply.n, reply.die_temperature_degc, reply.corrected_mean[2]) == (500, -7, 0.5)
    assert (reply.span.duration_s, reply.span.middle_s, reply.span.lost) == (2.5, 2.25, False)
    assert reply.stillness == g.Stillness(g.StillnessKind.TURNED, g.Axis.Z, 640, -81.5)


def test_a_turn_s_reply_has_exact_sums() -> None:
    sums = struct.pack("<9i", 1_200_000, -3, 0, *range(6))
    data = struct.pack("<H", 40) + sums + struct.pack("<6hb", -32768, 0, 1, 2, 3, 32767, 25) + SPAN
    reply = decode_reply(g.IntegrateGyroscope(40), b"\0" + data)
    assert reply.total.tolist() == [1_200_000, -3, 0]
    assert (reply.begin.tolist(), reply.end.tolist()) == ([0, 1, 2], [3, 4, 5])
    assert (reply.lowest.tolist(), reply.highest.tolist()) == ([-32768, 0, 1], [2, 3, 32767])


def test_a_log_s_reply_has_its_samples() -> None:
    data = b"\0" + struct.pack("<B6hb", 2, 1, 2, 3, -4, -5, -6, 25) + struct.pack("<QQB", 0, 1, 1)
    reply = decode_reply(g.LogGyroscope(2), data)
    assert reply.samples.tolist() == [[1, 2, 3], [-4, -5, -6]]
    assert reply.span.lost


@pytest.mark.parametrize(("at_fault", "expected"), [(8, None), (2, 2)])
def test_a_fit_s_reply_names_the_turn_at_fault(at_fault: int, expected: int | None) -> None:
    data = struct.pack("<BB10fII", 2, at_fault, *range(9), 0.25, 900, 20)
    reply = decode_reply(g.FitGyroscope([TURN]), b"\0" + data)
    assert (reply.fit.status, reply.fit.at_fault, reply.fit.residual_deg) == (TurnsStatus.TOO_SMALL, expected, 0.25)
    assert reply.cost is not None
    assert (reply.cost.cycles, reply.cost.overhead_cycles) == (900, 20)


@pytest.mark.parametrize(
    ("tail", "complaint"),
    [
        (SPAN[:-1] + b"\2" + struct.pack("<BBHf", 0, 0, 0, 0), "lost"),
        (SPAN + struct.pack("<BBHf", 4, 0, 0, 0), "is not a StillnessKind"),
        (SPAN + struct.pack("<BBHf", 1, 3, 0, 0), "axis"),
        (SPAN + struct.pack("<BBHf", 1, 1, 0, float("nan")), "amount"),
        (SPAN, "kind at byte 57"),
    ],
)
def test_a_hostile_reply_is_refused_by_field(tail: bytes, complaint: str) -> None:
    with pytest.raises(ProtocolError, match=complaint):
        decode_reply(g.GyroscopeRest(1), b"\0" + struct.pack("<H9fb", 1, *[0.0] * 9, 0) + tail)
