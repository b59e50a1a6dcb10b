"""What NXP's packets say becomes quantities in their units; the commands are those of its Toolbox."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.interfaces.conftest import ANY_PACKET

from hiltest.interfaces.fsflk import FsflkInterface
from hiltest.interfaces.packet_fields import Packet
from hiltest.interfaces.packets import (
    AnglesPacket,
    KalmanPacket500,
    MagneticPacket7,
    MagneticPacket422,
    MainPacket,
    Release,
    encode,
)
from hiltest.interfaces.quantities import Moment, Observation, Quantity

SHOWN = {0: (0, 481, 620), 1: (114, -162, 101), 2: (991, 1012, 997), 3: (-9, 7, -10), 10: (5, -6, 7)}


def observed(*packets: Packet, release: Release = Release.V7) -> list[Observation]:
    return [*FsflkInterface(release).feed(b"".join(map(encode, packets)), 2.5)]


def shown(variable_id: int) -> MagneticPacket7:
    return MagneticPacket7(1, 300, 127, 486, variable_id, SHOWN.get(variable_id, (0, 0, 0)))


def said(observations: list[Observation]) -> dict[Quantity, list[float]]:
    return {key: values.tolist() for observation in observations for key, values in observation.values.items()}


def test_angles_are_heading_pitch_and_roll() -> None:
    (one,) = observed(AnglesPacket(1, 25_000, -15, 205, 3599))
    assert one.time_s == 2.5
    assert said([one]) == {Quantity.HEADING: [359.9], Quantity.PITCH: [20.5], Quantity.ROLL: [-1.5]}


def test_a_sensor_that_the_algorithm_leaves_out_is_not_said() -> None:
    (with_all,) = observed(MainPacket(1, 0, (0, 0, 8192), (228, 0, 428), (30, 0, 0), (30_000, 0, 0, 0), 8, 5))
    assert said([with_all])[Quantity.MAGNETOMETER_CALIBRATED] == [22.8, 0.0, 42.8]
    assert said([with_all])[Quantity.GYROSCOPE] == [1.5, 0.0, 0.0]
    (without,) = observed(MainPacket(1, 0, (0, 0, 8192), (0, 0, 0), (0, 0, 0), (30_000, 0, 0, 0), 1, 5))
    assert set(without.values) == {Quantity.ACCELEROMETER_CALIBRATED, Quantity.QUATERNION}


def test_the_magnetic_calibration_comes_in_pieces() -> None:
    first = said(observed(shown(0), shown(1)))
    assert first[Quantity.DIP] == [62.0]
    assert first[Quantity.HARD_IRON] == [11.4, -16.2, 10.1]
    assert first[Quantity.CALIBRATED] == [1.0]
    assert first[Quantity.FIELD_STRENGTH] == [48.6]
    assert first[Quantity.FIT_ERROR] == [1.27]
    both = said(observed(shown(2), shown(3)))[Quantity.INVERSE_SOFT_IRON]
    assert both == pytest.approx([0.991, -0.009, 0.007, -0.009, 1.012, -0.010, 0.007, -0.010, 0.997])
    assert Quantity.INVERSE_SOFT_IRON not in said(observed(shown(3))), "not from its other elements alone"


def test_an_older_release_sends_its_strength_with_the_dip() -> None:
    packet = MagneticPacket422(1, 200, 35, 0, (0, 481, 620))
    assert said(observed(packet, release=Release.V4_22))[Quantity.FIELD_STRENGTH] == [48.1]


def test_without_a_hard_iron_it_is_not_calibrated() -> None:
    packet = MagneticPacket7(1, 3, 10_000, 500, 1, (0, 0, 0))
    assert said(observed(packet))[Quantity.CALIBRATED] == [0.0]


def test_the_filters_offset_is_the_gyroscopes_bias() -> None:
    packet = KalmanPacket500(1, *((1, 2, 3),) * 4, (1171, -352, 808), 6200, (0, 0, 0), (0, 0, 0))
    assert said(observed(packet)) == {Quantity.GYROSCOPE_BIAS: [1.171, -0.352, 0.808]}


def test_the_buffer_is_what_its_cells_have_shown_last() -> None:
    interface = FsflkInterface(Release.V7)
    interface.feed(encode(shown(10)), 0.0)
    assert interface.buffer == {0: (5, -6, 7)}
    interface.feed(encode(MagneticPacket7(2, 300, 127, 486, -10, (5, -6, 7))), 0.0)
    assert interface.buffer == {}, "a cell that was emptied"


def test_the_algorithm_is_asked_for_once_in_four_letters() -> None:
    interface = FsflkInterface(Release.V7, "Q9")
    assert [interface.commands(moment) for moment in Moment] == [b"Q9  ", b"", b"", b"", b""]
    assert FsflkInterface(Release.V7).commands(Moment.START) == b""


@given(packets=st.lists(ANY_PACKET, max_size=5), cut=st.integers(0, 400), noise=st.binary(max_size=20))
def test_every_value_is_offered_and_has_its_size(packets: list[Packet], cut: int, noise: bytes) -> None:
    interface = FsflkInterface(Release.V7)
    data = noise + b"".join(map(encode, packets))
    for feed in [*interface.feed(data[:cut], 0.0), *interface.feed(data[cut:], 0.1)]:
        assert set(feed.values) <= interface.offers
        assert all(values.shape == (quantity.size,) for quantity, values in feed.values.items())
