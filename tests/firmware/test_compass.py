"""The sample compass: it prints at its rate, calibrates itself when it is turned, and points to where it should."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np
import pytest
from numpy.typing import NDArray
from pydantic import TypeAdapter

from hiltest.boards.bench import VirtualBench
from hiltest.interfaces.packet_fields import Packet
from hiltest.interfaces.packet_stream import PacketDecoder
from hiltest.interfaces.packets import (
    Algorithm,
    AnglesPacket,
    AxisConvention,
    MagneticPacket7,
    MainPacket,
    Release,
    Shown,
)
from hiltest.interfaces.quantities import Observation, Quantity
from hiltest.interfaces.text_interface import TextInterface
from hiltest.interfaces.text_table import text_interface
from hiltest.orientation.angles import Pose, circular_mean_deg, heading_error_deg
from hiltest.orientation.quaternions import from_pose
from hiltest.rig.rig_file import load_rig
from hiltest.rig.text_device import TextDevice
from hiltest.virtual.board.k64f import VirtualK64F

P = TypeVar("P", bound=Packet)

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
ELFS = {
    output: ROOT / "src" / "hiltest" / "firmware" / f"compass-{output}.elf"
    for output in ("lines", "packets", "lis3mdl", "stm32f411")
}
RIGS = ROOT / "hil" / "rigs"
WORLD = RIGS / "virtual-k64f.toml"
DISCO = RIGS / "stm32f411-disco.toml"
MOUNTING_DEG = 1.7
POSES = (Pose(0.0), Pose(120.0), Pose(240.0), Pose(90.0, 20.0), Pose(200.0, 0.0, -20.0), Pose(310.0, -20.0))
HARD_IRON_UT = (2.4, -2.2, 4.0)


def interface() -> TextInterface:
    """What the rig text-compass understands of the lines."""
    rig = tomllib.loads((ROOT / "hil" / "rigs" / "text-compass.toml").read_text(encoding="utf-8"))
    table = TypeAdapter(TextDevice).validate_python(rig["device"]["text"], strict=False)
    return text_interface(table, str)


class Compass:
    """The firmware on the default bench, from power-on."""

    def __init__(self, elf: Path, rig: Path = WORLD) -> None:
        self.bench = VirtualBench(load_rig(rig), firmware=elf)
        self.bench.power_on()

    def listened(self, seconds: float) -> bytes:
        """What it sends in a time."""
        self.bench.machine.run_until(self.bench.time_s + seconds)
        uart = self.bench.machine.uart0
        return uart.host_read(uart.host_waiting)


class Said:
    """Lines as a session hears them: before a calibration, during a tumble, and at known angles behind it."""

    def __init__(self, compass: Compass, lines_per_s: float, noise_ut: float) -> None:
        text = interface()
        self.lines_per_s, self.noise_ut = lines_per_s, noise_ut
        self.all: list[Observation] = []

        def heard(seconds: float) -> list[Observation]:
            observed = text.feed(compass.listened(seconds), 0.0)
            self.all += observed
            return observed

        def at_known_angle(pose: Pose) -> list[Observation]:
            compass.bench.turn_to(pose)
            heard(0.2)  # what began before it stood
            return heard(1.0)

        heard(0.5)
        self.at_rest = heard(2.0)
        self.before = [at_known_angle(pose) for pose in POSES[:3]]
        self.tumble_s = compass.bench.tumble(20.0)
        heard(0.0)
        self.tumbled = heard(self.tumble_s)
        self.after = [at_known_angle(pose) for pose in POSES]
        self.not_understood = text.not_understood


@pytest.fixture(
    scope="module",
    params=[
        ("lines", WORLD, 10.0, 0.4),
        ("lis3mdl", RIGS / "lis3mdl-compass.toml", 10.0, 0.4),
        ("stm32f411", DISCO, 12.5, 0.3),
    ],
    ids=["MAG3110", "LIS3MDL", "LSM303AGR"],
)
def output(request: pytest.FixtureRequest) -> Said:
    elf, rig, lines_per_s, noise_ut = request.param
    return Said(Compass(ELFS[elf], rig), lines_per_s, noise_ut)


def of(quantity: Quantity, observed: Sequence[Observation]) -> list[NDArray[np.float64]]:
    return [reading.values[quantity] for reading in observed if quantity in reading.values]


def errors_deg(heard: Sequence[Sequence[Observation]]) -> list[float]:
    """Errors of the mean headings, of which the mounting is known."""
    means = [circular_mean_deg(float(item[0]) for item in of(Quantity.HEADING, observed)) for observed in heard]
    return [heading_error_deg(mean, pose.heading_deg + MOUNTING_DEG) for mean, pose in zip(means, POSES, strict=False)]


def test_a_line_for_eight_samples_is_understood(output: Said) -> None:
    # Two seconds hold 20 or 25 lines, one more or less at the edges.
    assert len(of(Quantity.HEADING, output.at_rest)) == pytest.approx(2.0 * output.lines_per_s, abs=1)
    assert output.not_understood == 0
    (gravity,) = {tuple(np.round(item, 1)) for item in of(Quantity.ACCELEROMETER, output.at_rest)}
    assert gravity == (0.0, 0.0, 1.0)


def test_without_a_tumble_it_says_that_it_is_not_calibrated_and_errs(output: Said) -> None:
    assert {float(item[0]) for item in of(Quantity.CALIBRATED, output.at_rest)} == {0.0}
    assert of(Quantity.HARD_IRON, output.at_rest) == []
    # A hard iron of 3.3 uT beside a horizontal field of 22.8 turns a heading by up to 8 degrees.
    assert max(map(abs, errors_deg(output.before))) > 3.0


def test_it_calibrates_itself_while_it_is_tumbled_and_goes_on_sampling(output: Said) -> None:
    calibrated = [float(item[0]) for item in of(Quantity.CALIBRATED, output.tumbled)]
    assert (calibrated[0], calibrated[-1]) == (0.0, 1.0)
    assert calibrated == sorted(calibrated)
    assert len(calibrated) == pytest.approx(output.lines_per_s * output.tumble_s, abs=2)


def test_it_knows_the_worlds_iron_then(output: Said) -> None:
    result = of(Quantity.HARD_IRON, output.tumbled)
    assert len(result) > 5  # the fits of ever more points
    # 100 points of 0.4 uT: an axis of the centre has 0.06 to 0.08 uT rms.
    np.testing.assert_allclose(result[-1], HARD_IRON_UT, atol=0.3)
    assert of(Quantity.FIELD_STRENGTH, output.tumbled)[-1] == pytest.approx(48.5, abs=0.5)
    assert of(Quantity.FIT_ERROR, output.tumbled)[-1] == pytest.approx(100 * output.noise_ut / 48.5, rel=0.3)


def test_headings_are_within_two_degrees_then_level_and_tilted(output: Said) -> None:
    assert max(map(abs, errors_deg(output.after))) < 2.0
    for pose, observed in zip(POSES, output.after, strict=True):
        assert np.mean(of(Quantity.PITCH, observed)) == pytest.approx(pose.pitch_deg, abs=0.5)
        assert np.mean(of(Quantity.ROLL, observed)) == pytest.approx(pose.roll_deg, abs=0.5)


def test_what_it_prints_of_its_calibration_is_what_it_does(output: Said) -> None:
    soft_iron = of(Quantity.INVERSE_SOFT_IRON, output.all)[-1].reshape(3, 3)
    hard_iron = of(Quantity.HARD_IRON, output.all)[-1]
    last = output.all[-1].values
    field = soft_iron @ (last[Quantity.MAGNETOMETER] - hard_iron)
    # Half a unit of each last decimal: of three numbers of 0.01 uT, and of three of 0.0001 times at most 50 uT.
    np.testing.assert_allclose(last[Quantity.MAGNETOMETER_CALIBRATED], field, atol=0.0225)


@pytest.mark.parametrize(("elf", "magnetometer"), [("lines", "MAG3110"), ("lis3mdl", "LIS3MDL")])
def test_a_board_without_sensors_says_so_once_a_second(elf: str, magnetometer: str) -> None:
    machine = VirtualK64F(ELFS[elf])
    machine.run_until(2.5)
    observed = interface().feed(machine.uart0.host_read(machine.uart0.host_waiting), 2.5)
    assert [reading.error for reading in observed] == [magnetometer] * 3


class Sent:
    """Packets from power-on, and at a known angle behind a tumble; and bytes that are in none."""

    pose = Pose(200.0, 0.0, -20.0)

    def __init__(self) -> None:
        compass, self.decoder, self.lost_bytes = Compass(ELFS["packets"]), PacketDecoder(Release.V7), 0
        self.first = self.packets(compass.listened(1.0))
        self.packets(compass.listened(compass.bench.tumble(20.0) + 0.1))
        compass.bench.turn_to(self.pose)
        self.packets(compass.listened(0.2))
        self.last = self.packets(compass.listened(1.0))

    def packets(self, data: bytes) -> list[Packet]:
        batch = self.decoder.feed(data)
        self.lost_bytes += batch.lost_bytes
        return batch.packets()

    def last_of(self, kind: type[P]) -> list[P]:
        return [item for item in self.last if isinstance(item, kind)]


@pytest.fixture(scope="module")
def sent() -> Sent:
    return Sent()


def test_every_state_is_three_packets_of_release_7(sent: Sent) -> None:
    assert sent.lost_bytes == 0
    assert [packet.number for packet in sent.first] == list(range(len(sent.first)))
    assert [item.type for item in sent.first[:6]] == [1, 4, 6, 1, 4, 6]
    assert len(sent.last_of(MainPacket)) in (9, 10, 11)
    main = sent.last_of(MainPacket)[0]
    assert main.algorithm is Algorithm.ACCELEROMETER_MAGNETOMETER
    assert (main.frame, main.board_number) == (AxisConvention.NED, 5)


def test_the_packets_point_to_where_the_lines_do(sent: Sent) -> None:
    angles = sent.last_of(AnglesPacket)
    heading_deg = circular_mean_deg(angle.compass_deg for angle in angles)
    assert heading_error_deg(heading_deg, sent.pose.heading_deg + MOUNTING_DEG) == pytest.approx(0.0, abs=2.0)
    assert np.mean([angle.roll_deg for angle in angles]) == pytest.approx(sent.pose.roll_deg, abs=0.5)
    for main, item in zip(sent.last_of(MainPacket), angles, strict=False):
        rotation = np.roll(from_pose(Pose(item.compass_deg, item.pitch_deg, item.roll_deg)), 1)  # the scalar first
        # Angles are cut off at 0.1 degree, which turns a quaternion by 0.0009 at most: a cosine of 1 - 4e-7.
        assert abs(np.dot(rotation, main.rotation)) == pytest.approx(1.0, abs=1e-4)


def test_the_packets_show_the_calibration(sent: Sent) -> None:
    magnetic = {item.shown: item for item in sent.last_of(MagneticPacket7)}
    strength = magnetic[Shown.STRENGTH]
    assert (strength.field_strength_ut, strength.variable[2] / 10) == pytest.approx((48.5, 62.0), abs=0.6)
    assert strength.fit_error_percent == pytest.approx(100 * 0.4 / 48.5, rel=0.3)
    hard_iron_ut = np.array(magnetic[Shown.HARD_IRON].variable) / 10
    np.testing.assert_allclose(hard_iron_ut, HARD_IRON_UT, atol=0.4)  # cut off at 0.1 uT
    diagonal = np.array(magnetic[Shown.INVERSE_SOFT_IRON_DIAGONAL].variable) / 1000
    np.testing.assert_allclose(diagonal, [1 / 1.022, 1 / 0.982, 1 / 1.004], atol=0.01)
