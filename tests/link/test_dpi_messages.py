"""FIT_DPI is the bytes that the protocol page says."""

from __future__ import annotations

import math
import struct

import numpy as np
import pytest

from hiltest.calibration import FitStatus
from hiltest.errors import ProtocolError
from hiltest.link.dpi import DpiSource, FitDpi
from hiltest.link.replies import RunCost
from hiltest.link.request import decode_reply


def reply(status: int = 0, fit: int = 0, estimates: tuple[float, float, float] = (62.0, 485.0, 0.0078125)) -> bytes:
    data = struct.pack("<BBBH", status, fit, 0, 2) + struct.pack("<13f", *range(1, 14))
    return data + struct.pack("<H3fII", 300, *estimates, 112_000, 40)


def test_the_request_is_that_written_by_hand() -> None:
    assert FitDpi(300, 5, dip_deg=-62.5).payload() == bytes.fromhex("00 2c01 05 01 00007ac2")
    assert FitDpi(38, 0, source=DpiSource.POSES).payload() == bytes.fromhex("01 2600 00 00 00000000")
    assert FitDpi(100, 5, is_joint=True).payload() == bytes.fromhex("00 6400 05 02 00000000")
    assert FitDpi(100, 5, dip_deg=-62.5, is_joint=True).payload() == bytes.fromhex("00 6400 05 03 00007ac2")


def test_the_reply_is_read_in_order() -> None:
    answer = decode_reply(FitDpi(300, 1), reply())
    assert answer.fit is FitStatus.ELLIPSOID
    assert np.array_equal(answer.calibration.soft_iron, np.arange(1.0, 10.0).reshape(3, 3))
    assert np.array_equal(answer.calibration.hard_iron, [10.0, 11.0, 12.0])
    assert (answer.coverage, answer.n_used) == (13.0, 300)
    assert (answer.dip_deg, answer.strength_counts, answer.standard_error) == (62.0, 485.0, 0.0078125)
    assert answer.cost == RunCost(112_000, 40)
    assert answer.iterations == 2


def test_numbers_that_are_not_there_are_none() -> None:
    answer = decode_reply(FitDpi(300, 1), reply(fit=4, estimates=(math.nan,) * 3))
    assert answer.fit is FitStatus.SINGULAR
    assert (answer.dip_deg, answer.strength_counts, answer.standard_error) == (None, None, None)


@pytest.mark.parametrize(
    "damaged", [reply()[:-1], reply() + b"\0", reply(fit=99), reply(estimates=(math.inf, 1.0, 1.0))]
)
def test_replies_that_are_none_are_refused(damaged: bytes) -> None:
    with pytest.raises(ProtocolError, match="FIT_DPI"):
        decode_reply(FitDpi(300, 1), damaged)
