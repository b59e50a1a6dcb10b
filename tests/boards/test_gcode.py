"""One line of G-code: what it asks for, and by which of Grbl's numbers it is refused."""

from __future__ import annotations

import pytest

from hiltest.boards.gcode import GcodeBlock, GcodeError, Modals, Refusal, read_block

FED = Modals(motion=1, feed_dpm=600.0)


def test_a_move_names_its_axes_and_the_modes_hold_on() -> None:
    first = read_block("G91G1X10Y-.5F600", Modals())
    assert first == GcodeBlock(Modals(motion=1, relative=True, feed_dpm=600.0), {"X": 10.0, "Y": -0.5}, None)
    assert read_block("Z+5.", first.modals) == GcodeBlock(first.modals, {"Z": 5.0}, None)
    assert read_block("G90G0X1", first.modals).modals == Modals(motion=0, relative=False, feed_dpm=600.0)


def test_a_dwell_has_its_seconds_and_may_stand_before_a_move() -> None:
    assert read_block("G4P0.25", Modals()) == GcodeBlock(Modals(), {}, 0.25)
    assert read_block("G4P1X5", Modals()) == GcodeBlock(Modals(), {"X": 5.0}, 1.0)


def test_the_preamble_of_senders_is_understood() -> None:
    assert read_block("N10G17G21G40G49G54G61G80G90G94", Modals()) == GcodeBlock(Modals(motion=80), {}, None)


@pytest.mark.parametrize(
    ("line", "number"),
    [
        ("10", 1),
        ("X-", 2),
        ("G", 2),
        (f"G{10**309}", 2),
        (f"G0X{10**309}", 2),
        ("X1E3", 20),
        ("G1X1F-1", 4),
        ("G4P-1", 4),
        ("G38.2X1", 20),
        ("G2X1Y1I1", 20),
        ("G20", 20),
        ("M3", 20),
        ("A5", 20),
        ("G-1", 20),
        ("G0G1X1", 21),
        ("G90G91", 21),
        ("G1.5X1", 23),
        ("X1X2", 25),
        ("N10000000", 27),
        ("G4", 28),
        ("G0X1P1", 36),
        ("G0X1R2", 36),
        ("@", 1),
    ],
)
def test_a_wrong_line_is_refused_by_number(line: str, number: int) -> None:
    with pytest.raises(GcodeError, match=rf"^error:{number}$"):
        read_block(line, FED)


def test_a_feed_move_without_a_feed_rate_is_refused() -> None:
    for feed in (None, 0.0):
        with pytest.raises(GcodeError) as caught:
            read_block("G1X1", Modals(feed_dpm=feed))
        assert caught.value.number is Refusal.NO_FEED_RATE
    with pytest.raises(GcodeError) as caught:
        read_block("X1", Modals(motion=80))
    assert caught.value.number is Refusal.AXES_WITHOUT_MOTION
