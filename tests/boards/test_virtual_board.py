"""The virtual board behind its port: reproducible time, named faults, and a truth that is the world's."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import serial

from hiltest.boards import BoardKind, VirtualBench, VirtualBoard, default_firmware, open_board
from hiltest.errors import ConfigError, DeviceError, NotOfferedError, SensorAbsentError, VersionMismatchError
from hiltest.link.framing import Frame, FrameDecoder, encode_frame
from hiltest.link.gyroscope import GyroscopeRest
from hiltest.link.messages import PROTOCOL_VERSION, Average, Calibrate, LinkStatistics, Read, Reset, Sync
from hiltest.link.replies import DPS_PER_COUNT, G_PER_COUNT, MICROTESLA_PER_COUNT, CycleSource, SensorKind
from hiltest.link.transcript import Transcript
from hiltest.orientation.angles import Pose, rotation_body_from_ned
from hiltest.procedures import SimulatedTurntable, collect_tumble, measure_cycles, run_calibrators
from hiltest.procedures.cycles import upload_points
from hiltest.procedures.golden_points import golden_points
from hiltest.rig import Rig
from hiltest.rig.bench_files import shipped
from hiltest.rig.rig_file import load_rig


def test_the_default_board_boots_identifies_and_selects_the_rig_s_sensors(rig: Rig) -> None:
    with open_board(rig) as board:
        assert isinstance(board, VirtualBoard)
        assert board.kind is BoardKind.VIRTUAL
        assert (board.clock, board.seed) == ("virtual", rig.seed)
        assert board.cycle_model == "cortex-m4-trm/3@sram"
        assert {board.sensor(kind).name for kind in SensorKind} == {
            rig.sensors.magnetometer,
            rig.sensors.accelerometer,
            rig.sensors.gyroscope,
        }
        assert board.firmware_sha256 == hashlib.sha256(default_firmware().read_bytes()).hexdigest()
        before = board.now_s()
        board.session.request(LinkStatistics())
        assert board.virtual_seconds is not None
        assert board.virtual_seconds > before
        assert board.virtual_seconds == board.now_s()


def test_a_range_of_cycles_is_of_the_readings_around_the_call_in_the_latest_request(rig: Rig) -> None:
    with open_board(rig) as board:
        upload_points(board, golden_points(100))
        costs = {name: board.timed(Calibrate(100, name), name).cost for name in ("corrected", "direct")}
        assert board.cycle_range(costs["direct"], "direct") == board.cycle_range(costs["direct"])
        assert board.cycle_range(costs["direct"]) is not None
        assert board.cycle_range(costs["corrected"], "corrected") is None  # of the request before
        assert board.cycle_range(costs["direct"], "corrected") is None  # another call than the one that is reported
        board.session.request(LinkStatistics())
        assert board.cycle_range(costs["direct"], "direct") is None


def wire(rig: Rig, seed: int) -> Transcript:
    transcript = Transcript("virtual")
    with open_board(rig, seed=seed, transcript=transcript) as board:
        assert board.stage is not None
        board.stage.turn_to(Pose(30.0, 20.0, 0.0), known_angle=0)
        board.session.request(Average(16, 0b1))
    return transcript


def test_the_same_seed_gives_the_same_bytes_at_the_same_virtual_times(rig: Rig) -> None:
    first, again, other = wire(rig, 5), wire(rig, 5), wire(rig, 6)
    assert first.entries == again.entries
    assert first.entries != other.entries


def test_the_host_s_pace_does_not_move_the_virtual_clock(rig: Rig) -> None:
    with open_board(rig) as board:
        before = board.now_s()
        board.session.send_raw(encode_frame(Frame(Sync.code, 9, bytes(4))))
        assert board.now_s() == before
        assert board.session.listen(1.0) is not None
        assert board.now_s() > before


def test_the_truth_is_what_the_sensors_measure(rig: Rig) -> None:
    with open_board(rig) as board:
        truth = board.truth
        assert truth is not None
        assert board.stage is not None
        assert rig.mounting is not None
        pose = Pose(120.0, 20.0, 0.0)
        board.stage.turn_to(pose)
        reply = board.session.request(Average(64))
        rest = board.session.request(GyroscopeRest(200))
    body = rotation_body_from_ned(Pose(pose.heading_deg + rig.mounting.yaw_deg, pose.pitch_deg, pose.roll_deg))
    dip = np.radians(truth.dip_deg)
    field_ut = body @ (truth.field_ut * np.array([np.cos(dip), 0.0, np.sin(dip)]))
    expected_ut = truth.soft_iron @ field_ut + truth.hard_iron_ut
    # Means of 64 readings: 4.5 sigma / 8, and half a count of rounding.
    tolerance_ut = 4.5 * truth.magnetometer_sigma_ut / 8.0 + 0.05
    assert np.allclose(reply.magnetometer.mean * MICROTESLA_PER_COUNT, expected_ut, atol=tolerance_ut)
    # The default accelerometer is wrong by up to 3 mg and 0.3 %, and noisy by less than a tenth of that.
    assert np.allclose(reply.accelerometer.mean * G_PER_COUNT, body @ [0.0, 0.0, 1.0], atol=0.007)
    # At rest the gyroscope shows its bias; 0.1 dps is the limit that the corrected mean must keep.
    assert np.allclose(rest.rate.mean * DPS_PER_COUNT, truth.gyroscope_bias_dps, atol=0.1)
    assert reply.headings == {}


def test_a_virtual_board_without_its_shield_says_so(rig_without_shield: Rig) -> None:
    with open_board(rig_without_shield) as board, pytest.raises(SensorAbsentError, match="FRDM-FXS-MULTI-B"):
        board.sensor(SensorKind.GYROSCOPE)


def test_a_sensor_that_the_firmware_does_not_know_is_refused_with_its_line(rig: Rig) -> None:
    asked_for = replace(rig, sensors=replace(rig.sensors, magnetometer="BMM150"))
    lines = enumerate(rig.path.read_text(encoding="utf-8").splitlines(), start=1)
    (line,) = [number for number, text in lines if text.startswith("magnetometer = ")]
    with pytest.raises(ConfigError, match=rf":{line}: sensors\.magnetometer: no magnetometer 'BMM150'; known: MAG"):
        open_board(asked_for)


def test_an_elf_for_another_processor_is_a_configuration_error(rig: Rig, tmp_path: Path) -> None:
    own = bytearray(default_firmware().read_bytes())
    own[18:20] = (62).to_bytes(2, "little")  # e_machine of x86-64
    (tmp_path / "other.elf").write_bytes(own)
    with pytest.raises(ConfigError, match=r"other\.elf"):
        open_board(rig, firmware=tmp_path / "other.elf")


def test_any_program_with_pyserial_can_open_the_board_by_its_url(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(Path(__file__).parents[2])
    with serial.serial_for_url("hil://?seed=3", timeout=1.0) as port:
        port.write(encode_frame(Frame(Sync.code, 1, b"\x01\x02\x03\x04")))
        assert port.in_waiting == 0  # the clock has not moved
        (frame,) = FrameDecoder().feed(port.read(64))
        assert isinstance(frame, Frame)
        assert frame.payload == b"\x00\x01\x02\x03\x04" + PROTOCOL_VERSION.to_bytes(2, "little")
        # Nothing more is coming: a read ends after its timeout, in virtual time.
        before = port.now()
        assert port.read(1) == b""
        # A basic block more or less: 1 us is 120 cycles.
        assert port.now() - before == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize(
    ("url", "message"),
    [
        ("hil://?sead=3", "'sead' is not a part of a hil:// URL; known: base, firmware, gdb, rig, seed"),
        ("hil://?gdb=65536", "gdb='65536' is no TCP port"),
        ("hil://?base=-4", "base='-4' is no address"),
        ("hil://?seed=x", "seed='x' is no whole number"),
        ("hil://?rig=no-such-rig", "no-such-rig"),
        ("hil://?firmware=no-such.elf", "no-such.elf"),
    ],
)
def test_a_wrong_url_says_which_part(url: str, message: str) -> None:
    with pytest.raises(serial.SerialException, match=message):
        serial.serial_for_url(url)


def test_a_core_without_a_cycle_counter_fits_and_gives_no_cycle_number(rig: Rig) -> None:
    bench = VirtualBench(rig)
    bench.machine.cycle_counter.present = False
    with VirtualBoard(bench) as board:
        assert board.identity.cycle_source is CycleSource.NONE
        assert board.cycle_model == "none"
        with pytest.raises(DeviceError, match="NO_CYCLE_COUNTER: this core has no cycle counter"):
            measure_cycles(board, ["direct"], point_sets=1)
        tumble = collect_tumble(board, SimulatedTurntable(board.stage, uncertainty_deg=0.1), points=100)
        run = run_calibrators(board, tumble, calibrators=["direct"])["direct"]
    assert run.usable
    assert run.cost is None


def test_another_firmware_is_named_with_what_it_calls_itself(rig: Rig, tmp_path: Path) -> None:
    own = default_firmware().read_bytes()
    assert own.count(b"hiltest-frdm-k64f\0") == 1
    (tmp_path / "other.elf").write_bytes(own.replace(b"hiltest-frdm-k64f\0", b"another-frdm-k64f\0"))
    with pytest.raises(VersionMismatchError, match="'another-frdm-k64f'"):
        open_board(rig, firmware=tmp_path / "other.elf")


@pytest.mark.parametrize("after_reset", [False, True])
def test_the_true_attitude_is_that_of_a_time_of_the_firmwares_clock(rig: Rig, after_reset: bool) -> None:
    """The gyroscope samples every 5 ms of virtual time; a look finds a sample at most an eighth of that later."""
    with open_board(rig) as board:
        if after_reset:
            board.session.request(Reset())
            board.sleep(0.3)
            board.session.synchronise()
        samples = board.session.request(Read(board.sensor(SensorKind.GYROSCOPE).sensor_id, 64))
        assert isinstance(board.stage, VirtualBench)
        behind_us = 1e6 * board.stage.firmware_clock_began_s
        assert behind_us > 250_000 if after_reset else 0 < behind_us < 5_000  # start-up copies 64 KiB at 20.97 MHz
        # The time is taken before the status is asked for over I2C, which takes a tenth of a millisecond.
        late_us = (samples.time_us + behind_us + 100) % 5_000 - 100
        assert late_us.max() < 5_000 / 8
        board.stage.begin_turn(Pose(90.0))
        began_s = board.now_s()
        at_us = round(1e6 * began_s - behind_us)
        assert board.true_attitude(at_us) == board.true_attitude(at_us - 1000) == Pose(pytest.approx(1.7), 0.0, 0.0)
        assert board.true_attitude(at_us + 2_000_000) == Pose(pytest.approx(91.7), 0.0, 0.0)


@pytest.mark.parametrize(("rig_name", "interface"), [("text-compass", "session"), ("virtual-k64f", "output")])
def test_an_interface_that_the_rig_does_not_have_is_not_offered(rig_name: str, interface: str) -> None:
    with open_board(load_rig(shipped() / "rigs" / f"{rig_name}.toml")) as board, pytest.raises(NotOfferedError):
        getattr(board, interface)
