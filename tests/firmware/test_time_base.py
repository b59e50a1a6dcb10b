"""The clock of the firmware over times longer than those of a run."""

from __future__ import annotations

import itertools
import struct

import pytest

from .bench import READ, bench_with

MAG3110, PERIOD_US = 0, 12_500


def test_the_clock_goes_on_when_its_low_word_wraps() -> None:
    bench = bench_with("i2c1")
    wraps_us = 1 << 32  # 71.6 minutes
    bench.board.run_until(1e-6 * wraps_us - 0.4)
    data = bench.ask(READ, struct.pack("<BBI", MAG3110, 64, 2_000_000))
    times_us = [struct.unpack_from("<Q", data, 1 + 14 * k)[0] for k in range(64)]
    assert times_us[0] < wraps_us < times_us[-1]
    # Looks come at most an eighth of a period after the sample, and a transaction of 0.15 ms.
    apart_us = [after - before for before, after in itertools.pairwise(times_us)]
    assert apart_us == pytest.approx([PERIOD_US] * 63, abs=PERIOD_US / 8 + 150)
