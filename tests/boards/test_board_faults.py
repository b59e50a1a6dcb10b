"""A virtual board's faults: a reset is noticed, and a sensor or a bus that fails is known by what comes of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.patched_firmware import patched

from hiltest.boards import Board, default_firmware, open_board
from hiltest.boards.sample_checks import SAME_SAMPLES, longest_run
from hiltest.errors import BoardResetError, DeviceError, ProtocolError, SensorAbsentError, SensorFaultError
from hiltest.link.gyroscope import GyroscopeRest, IntegrateGyroscope
from hiltest.link.messages import Average, Points, Read, Reset, Select, Sensors, SetCalibration, Upload
from hiltest.link.poses import AddPose
from hiltest.link.replies import SensorKind
from hiltest.procedures import collect_tumble, open_table
from hiltest.rig.bench_files import shipped
from hiltest.rig.board_faults import BoardReset, HeldLine, SensorFault
from hiltest.rig.faults import Faults
from hiltest.rig.parts import PARTS
from hiltest.rig.rig_file import load_rig

RIG = load_rig(shipped() / "rigs" / "virtual-k64f.toml")
BEGIN_S = 1.5
NOT_SUPPORTED = (0x200F, 0x4770)  # movs r0, #15; bx lr


@contextmanager
def board_with(**faults: SensorFault | HeldLine | BoardReset) -> Iterator[Board]:
    with open_board(replace(RIG, faults=Faults(**faults))) as board:  # type: ignore[arg-type]
        yield board


def sensor(part: str, fault: str, *, after_s: float = BEGIN_S, for_s: float | None = None) -> dict[str, SensorFault]:
    return {"sensor": SensorFault(part, fault, after_s, for_s)}  # type: ignore[arg-type]


def refused(ask: Callable[[], object]) -> str:
    with pytest.raises((DeviceError, SensorFaultError)) as raised:
        ask()
    return str(raised.value)


# -- resets -----------------------------------------------------------------------------------


@pytest.mark.parametrize("by", ["button", "brown-out"])
def test_a_reset_that_no_request_meets_is_noticed(by: str) -> None:
    with board_with(reset=BoardReset(by, BEGIN_S)) as board:  # type: ignore[arg-type]
        board.session.request(SetCalibration(1, np.eye(3), np.zeros(3)))
        board.session.refuse_reset()
        board.sleep(BEGIN_S + 0.5)
        board.session.request(Sensors())
        with pytest.raises(BoardResetError, match="was reset"):
            board.session.refuse_reset()


def test_nothing_is_asked_of_a_board_that_has_answered_nothing_since_the_last_look() -> None:
    with board_with(reset=BoardReset("button", 100.0)) as board:
        board.session.refuse_reset()
        asked = len(board.session.attempts)
        board.session.refuse_reset()
        assert len(board.session.attempts) == asked


def test_a_reset_that_was_asked_for_is_no_fault() -> None:
    with open_board(RIG) as board:
        board.session.request(Reset())
        board.sleep(0.5)
        board.session.request(Sensors())
        board.session.refuse_reset()


# -- sensors ----------------------------------------------------------------------------------


def test_a_sensor_that_is_gone_is_absent_and_back_as_after_power_on() -> None:
    with board_with(**sensor("mag3110", "absent", for_s=0.5)) as board:
        (mag,) = (item for item in board.sensors if item.name == "MAG3110")
        board.session.request(Read(mag.sensor_id, 1))
        board.sleep(BEGIN_S)
        assert "SENSOR_ABSENT" in refused(lambda: board.session.request(Read(mag.sensor_id, 1)))
        board.sleep(0.5)
        board.session.request(Select(mag.sensor_id))  # which sets it up again
        board.session.request(Read(mag.sensor_id, 1))


def test_a_sensor_that_goes_while_the_board_is_opened_is_missing_for_who_needs_it() -> None:
    # After SENSORS has found it, and before SELECT sets it up.
    with board_with(**sensor("fxos8700cq", "absent", after_s=0.05)) as board:
        with pytest.raises(SensorAbsentError, match="no FXOS8700CQ accelerometer answers"):
            board.sensor(SensorKind.ACCELEROMETER)
        assert board.sensor(SensorKind.MAGNETOMETER).name == "MAG3110"


def test_firmware_that_refuses_the_first_words_is_not_ours(tmp_path: Path) -> None:
    elf = tmp_path / "refuses.elf"
    elf.write_bytes(patched(default_firmware(), ["command_sensors"], NOT_SUPPORTED))
    with pytest.raises(ProtocolError, match="the firmware refused the first request: the board answered SENSORS"):
        open_board(RIG, firmware=elf)


@pytest.mark.parametrize("part", ["mag3110", "fxos8700cq", "fxas21002c"])
def test_another_part_at_the_address_of_a_sensor_is_not_that_sensor(part: str) -> None:
    with board_with(**sensor(part, "other part")) as board:
        board.sleep(BEGIN_S)
        missing = {item.name for item in board.session.request(Sensors()) if not item.present}
        assert missing == set(PARTS[part].sensors.values())


FROZEN: dict[str, tuple[str, Callable[[Board], object]]] = {
    "mag3110": ("MAG3110", lambda board: board.session.request(Average(16))),
    "fxos8700cq": ("FXOS8700CQ accelerometer", lambda board: board.session.request(AddPose(16))),
    "fxas21002c": ("FXAS21002C", lambda board: board.session.request(GyroscopeRest(100, noise=4.0))),
}


@pytest.mark.parametrize("part", FROZEN)
@pytest.mark.parametrize(("fault", "words"), [("frozen", "identical on all axes"), ("saturated", "end of its range")])
def test_a_sensor_that_is_stuck_or_at_the_end_of_its_range_is_named(part: str, fault: str, words: str) -> None:
    name, ask = FROZEN[part]
    with board_with(**sensor(part, fault)) as board:
        ask(board)
        board.sleep(BEGIN_S)
        refusal = refused(lambda: ask(board))
        assert refusal.startswith(f"{name}: ")
        assert words in refusal


def test_a_gyroscope_that_is_stuck_while_it_turns_is_named() -> None:
    with board_with(**sensor("fxas21002c", "frozen")) as board:
        board.sleep(BEGIN_S)
        refusal = refused(lambda: board.session.request(IntegrateGyroscope(200)))
        assert refusal.startswith("FXAS21002C: 200 consecutive samples are identical")


@pytest.mark.parametrize(("fault", "words"), [("frozen", "consecutive samples"), ("saturated", "of 100 samples")])
def test_a_tumble_with_a_sensor_that_is_stuck_for_a_part_of_it_is_refused(fault: str, words: str) -> None:
    with board_with(**sensor("mag3110", fault, after_s=2.0, for_s=0.2)) as board:
        table = open_table(board, RIG, prompt=lambda _: "")
        assert words in refused(lambda: collect_tumble(board, table, points=100))


def test_points_that_a_host_uploaded_are_no_samples() -> None:
    with open_board(RIG) as board:
        board.session.request(Upload(0, [[32_767, -32_768, 20_000]] * 20))
        board.session.request(Points(0, 20))


def test_a_world_without_noise_has_equal_samples() -> None:
    world = RIG.world
    assert world is not None
    quiet = replace(RIG, world=replace(world, mag3110_noise_ut=(0.0, 0.0, 0.0, 0.0)))
    with open_board(quiet) as board:
        assert not np.any(board.session.request(Average(SAME_SAMPLES)).magnetometer.spread)


def test_a_run_is_of_equal_rows_beside_each_other() -> None:
    assert longest_run([]) == 0
    assert longest_run([[1, 2, 3], [1, 2, 4], [1, 2, 4], [1, 2, 3]]) == 2


# -- buses ------------------------------------------------------------------------------------


@pytest.mark.parametrize("line", ["sda", "scl"])
def test_a_line_that_is_held_low_is_a_bus_error_of_that_bus_alone(line: str) -> None:
    with board_with(held_line=HeldLine(1, line, BEGIN_S)) as board:  # type: ignore[arg-type]
        onboard = next(item for item in board.sensors if item.name.startswith("on-board"))
        shield = board.sensor(SensorKind.MAGNETOMETER)
        board.session.request(Read(shield.sensor_id, 1))
        board.sleep(BEGIN_S)
        assert "BUS_ERROR" in refused(lambda: board.session.request(Read(shield.sensor_id, 1)))
        board.session.request(Select(onboard.sensor_id))
        board.session.request(Read(onboard.sensor_id, 1))


@pytest.mark.parametrize("line", ["sda", "scl"])
def test_a_line_that_is_let_go_is_used_again_at_the_next_request(line: str) -> None:
    with board_with(held_line=HeldLine(1, line, BEGIN_S, 0.2)) as board:  # type: ignore[arg-type]
        shield = board.sensor(SensorKind.MAGNETOMETER)
        board.sleep(BEGIN_S)
        assert "BUS_ERROR" in refused(lambda: board.session.request(Read(shield.sensor_id, 1)))
        board.sleep(0.2)
        board.session.request(Read(shield.sensor_id, 1))


def test_a_clock_that_is_stretched_costs_time_alone() -> None:
    samples = {}
    for for_s in (None, 0.003):
        faults = {} if for_s is None else {"held_line": HeldLine(1, "scl", BEGIN_S, for_s)}
        with board_with(**faults) if faults else open_board(RIG) as board:
            shield = board.sensor(SensorKind.MAGNETOMETER)
            samples[for_s] = [board.session.request(Read(shield.sensor_id, 40)).counts for _ in range(3)]
    assert np.array_equal(samples[None], samples[0.003])


def test_faults_of_a_board_leave_its_line_as_it_is() -> None:
    with board_with(**sensor("mag3110", "frozen")) as board:
        assert board.line_is_exact
        assert not board.sensors_are_sound
    with board_with(reset=BoardReset("button", 100.0)) as board:
        assert board.sensors_are_sound
