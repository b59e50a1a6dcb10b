"""What a board that answers is like: found on the real firmware, in worlds with one thing wrong."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import replace

import pytest

from hiltest.boards import Board, open_board
from hiltest.doctor.board_checks import (
    BOARD_CHECKS,
    see_accelerometer_noise,
    see_clock,
    see_cycle_counter,
    see_gyroscope_noise,
    see_identity,
    see_magnetometer_noise,
    see_sensors,
)
from hiltest.doctor.check import Health
from hiltest.link.replies import CycleSource
from hiltest.rig import Rig


@pytest.fixture(scope="module")
def board(rig: Rig) -> Iterator[Board]:
    with open_board(rig) as opened:
        yield opened


def test_the_default_board_is_all_right(board: Board, rig: Rig) -> None:
    checks = [look(board, rig) for look in BOARD_CHECKS.values()]
    assert [check.finding for check in checks if check.health is not Health.OK] == []
    assert [check.name for check in checks] == [*BOARD_CHECKS]


def test_a_board_without_its_shield_names_what_is_missing_where(rig: Rig, rig_without_shield: Rig) -> None:
    with open_board(rig_without_shield) as opened:
        result = see_sensors(opened, rig)
    assert result.health is Health.FAILED
    assert "MAG3110 (I2C1 0x0E): no answer" in result.finding
    assert "shield" in result.remedy
    assert "on-board FXOS8700CQ" in result.remedy


@pytest.mark.parametrize(("declared_ut", "health"), [(0.4, Health.OK), (0.15, Health.WARNING), (1.0, Health.WARNING)])
def test_the_magnetometers_noise_is_judged_by_what_the_rig_declares(
    board: Board, rig: Rig, declared_ut: float, health: Health
) -> None:
    declaring = replace(
        rig,
        world=None,
        board=replace(rig.board, kind="real"),
        turntable=replace(rig.turntable, kind="operator"),
        sensors=replace(rig.sensors, magnetometer_noise_ut=declared_ut),
    )
    result = see_magnetometer_noise(board, declaring)
    assert result.health is health
    assert ("magnetometer_noise_ut" in result.remedy) is (health is Health.WARNING)


def test_a_board_that_turns_is_not_at_rest(board: Board, rig: Rig) -> None:
    assert board.stage is not None
    takes_s = board.stage.turn_round(360.0, rate_dps=60.0, after_s=0.5)
    result = see_gyroscope_noise(board, rig)
    board.sleep(takes_s)
    assert result.health is Health.WARNING
    assert "the board moved" in result.finding
    assert result.remedy


def test_a_sensor_that_gives_the_same_reading_for_ever_has_failed(rig: Rig) -> None:
    assert rig.world is not None
    with open_board(replace(rig, world=replace(rig.world, mag3110_noise_ut=(0.0,) * 4))) as frozen:
        result = see_magnetometer_noise(frozen, rig)
        assert see_accelerometer_noise(frozen, rig).health is Health.OK
    assert result.health is Health.FAILED
    assert "axis x and y and z" in result.finding


@pytest.mark.parametrize(("rate", "health"), [(1.005, Health.OK), (1.03, Health.WARNING), (0.97, Health.WARNING)])
def test_a_clock_that_is_off_by_more_than_a_hundredth_is_a_warning(
    board: Board, rig: Rig, rate: float, health: Health, monkeypatch: pytest.MonkeyPatch
) -> None:
    true_s = board.now_s
    monkeypatch.setattr(board, "now_s", lambda: rate * true_s())  # as if the board's oscillator were off
    assert see_clock(board, rig).health is health


def test_time_that_asking_takes_is_no_wrong_clock(board: Board, rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    true_s, calls = board.now_s, itertools.count()
    # Each answer comes half a second late.
    monkeypatch.setattr(board, "now_s", lambda: true_s() + 0.5 * (next(calls) % 2))
    assert see_clock(board, rig).health is Health.OK


def test_a_build_of_someone_else_is_a_warning(board: Board, rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    others = replace(board.identity, build_id="0123456789abcdef", unique_id=bytes(15) + b"1")
    monkeypatch.setattr(board.protocol, "identity", others)
    result = see_identity(board, rig, "hiltest flash --port usb://0240")
    assert result.health is Health.WARNING
    assert "0123456789abcdef" in result.finding
    assert result.remedy.startswith("hiltest flash --port usb://0240, ")


def test_a_virtual_board_is_not_told_to_be_flashed(board: Board, rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(board.protocol, "identity", replace(board.identity, build_id="0123456789abcdef"))
    assert "hiltest serve" in see_identity(board, rig, "hiltest flash").remedy


def test_a_core_without_a_cycle_counter_is_a_warning(board: Board, rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(board.protocol, "identity", replace(board.identity, cycle_source=CycleSource.NONE))
    assert see_cycle_counter(board, rig).health is Health.WARNING


def test_the_same_work_takes_the_same_cycles(board: Board, rig: Rig) -> None:
    first, second = (see_cycle_counter(board, rig) for _ in range(2))
    assert first == second
    assert "cortex-m4-trm" in first.finding
