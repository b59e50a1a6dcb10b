"""Identity: firmware, calibrators and sensors."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from hiltest.boards import Board
from hiltest.measurement import Limit
from hiltest.session.fixtures import Measure

pytestmark = pytest.mark.hil


def test_the_firmware_names_itself(board: Board) -> None:
    assert board.identity.name
    assert board.identity.version
    assert len(board.identity.build_id) == 16


def test_there_are_calibrators_to_judge(board: Board, measure: Measure) -> None:
    measure("identity.calibrators", len(board.identity.calibrators), "", limit=Limit(min=1))


def test_the_core_runs_at_its_full_clock(board: Board, measure: Measure) -> None:
    measure("identity.core_clock", board.identity.core_clock_hz / 1e6, "MHz", limit=Limit(min=120, max=120))


def test_every_sensor_that_answers_is_the_part_it_should_be(
    board: Board, record_settings: Callable[..., int | None]
) -> None:
    wrong = [
        sensor.name for sensor in board.sensors if sensor.present and sensor.seen_who_am_i != sensor.expected_who_am_i
    ]
    record_settings("set_up")
    assert not wrong, f"another part answers at the address of {', '.join(wrong)}"
