"""Programs that others wrote for the FRDM-K64F do on the virtual board what their pages say."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from hiltest.virtual.k64f import VirtualK64F

FOREIGN = Path(__file__).parents[3] / "shared/data/foreign"

# Name, virtual seconds, what is sent after 0.3 s (a character every 50 ms), and what must come, in this order.
PROGRAMS: list[tuple[str, float, bytes, list[str]]] = [
    ("sdk_lptmr", 3.5, b"", ["Low Power Timer Example", "LPTMR interrupt No.1", "No.2", "No.3"]),
    ("riot_hello", 0.3, b"", ["Hello World!", "frdm-k64f board", "kinetis CPU"]),
    # It stops at its TIMER 2, on any board: of 1 Hz it expects a neighbour that is not below 1 - 2, unsigned.
    ("riot_timer", 1.5, b"s", ["TIMER 0", "[OK] (no spurious IRQs)", "TIMER 1", "[OK] (no spurious IRQs)", "TIMER 2"]),
    ("riot_ztimer_msg", 6.5, b"s", ["2.0s: Hello World", "5.0s: This is a Test", "sec=1", "sec=3", "sec=4", "sec=5"]),
]  # fmt: skip


@pytest.fixture
def foreign() -> Path:
    """The folder of programs; where it is not there, as `require_tool`."""
    if not FOREIGN.is_dir():
        reason = f"{FOREIGN} is not there"
        if os.environ.get("HILTEST_REQUIRE_TOOLS"):
            pytest.fail(f"{reason}, and HILTEST_REQUIRE_TOOLS is set", pytrace=False)
        pytest.skip(reason)
    return FOREIGN


@pytest.mark.parametrize(("name", "seconds", "sent", "expected"), PROGRAMS, ids=[row[0] for row in PROGRAMS])
def test_it_prints_what_it_should(foreign: Path, name: str, seconds: float, sent: bytes, expected: list[str]) -> None:
    board = VirtualK64F(foreign / f"{name}.elf")
    board.run_until(0.3)
    for byte in sent:
        board.uart0.host_write(bytes([byte]))
        board.run_until(board.time_s + 0.05)
    board.run_until(seconds)
    printed = board.uart0.host_read(100_000).decode()
    at = 0
    for text in expected:
        assert text in printed[at:]
        at = printed.index(text, at) + len(text)
    assert board.faults == ()
