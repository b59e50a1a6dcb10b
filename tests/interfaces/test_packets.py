"""Packets of NXP's sensor fusion: what each byte is, and nothing is changed on the way to the line and back."""

from __future__ import annotations

import dataclasses
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.interfaces.conftest import KINDS_OF_RELEASES, packets_of

from hiltest.errors import FrameError
from hiltest.interfaces.packet_fields import Packet, sent_fields
from hiltest.interfaces.packets import (
    KINDS,
    AccelerometerPacket,
    Algorithm,
    AltitudePacket,
    AnglesPacket,
    AxisConvention,
    DebugPacket,
    KalmanPacket422,
    KalmanPacket500,
    MagneticPacket7,
    MagneticPacket422,
    MainPacket,
    RatePacket,
    Release,
    Shield,
    Shown,
    decode,
    encode,
)
from hiltest.interfaces.toolbox_commands import ToolboxCommand


@pytest.mark.parametrize(("release", "kind"), KINDS_OF_RELEASES, ids=lambda item: str(getattr(item, "__name__", item)))
@given(data=st.data())
def test_every_packet_of_every_release_comes_back_as_it_was(
    release: Release, kind: type[Packet], data: st.DataObject
) -> None:
    packet = data.draw(packets_of(kind))
    wire = encode(packet)
    assert wire[:1] == wire[-1:] == b"\x7e"
    assert b"\x7e" not in wire[1:-1]
    assert decode(wire) == packet
    assert decode(wire[1:-1]) == packet


# Bytes with both delimiters and without stuffing, as the releases send them.
@pytest.mark.parametrize(
    ("release", "sizes"),
    [
        (Release.V4_22, {1: 36, 2: 8, 3: 14, 4: 14, 5: 14, 6: 16, 7: 22}),
        (Release.V5_00, {1: 36, 2: 8, 3: 14, 4: 14, 5: 14, 6: 16, 7: 48}),
        (Release.V7, {1: 36, 2: 8, 3: 14, 4: 14, 5: 14, 6: 18, 7: 48, 8: 47}),
    ],
)
def test_packets_have_the_sizes_of_their_release(release: Release, sizes: dict[int, int]) -> None:
    assert {kind.type: len(encode(zeros(kind))) for kind in release.value} == sizes


def zeros(kind: type[Packet]) -> Packet:
    return kind(*((0,) * sent.count if sent.count else 0 for _, sent in sent_fields(kind)))


def body(kind: int, form: str, *numbers: int) -> bytes:
    return struct.pack(f"<BB{form}", kind, 9, *numbers)


# Each by the place of its bytes: type, number, then little-endian fields.
BODIES: list[tuple[bytes, Packet, dict[str, object]]] = [
    (
        body(1, "I13hBB", 2_000_001, 8192, -4096, 0, 503, -10, 0, 20, -30, 1, 30_000, 0, -15_000, 0, 0x18, 0x45),
        MainPacket(9, 2_000_001, (8192, -4096, 0), (503, -10, 0), (20, -30, 1), (30_000, 0, -15_000, 0), 0x18, 0x45),
        {
            "acceleration_g": (1.0, -0.5, 0.0),
            "field_ut": (50.3, -1.0, 0.0),
            "rate_dps": (1.0, -1.5, 0.05),
            "rotation": (1.0, 0.0, -0.5, 0.0),
            "algorithm": Algorithm.NINE_AXES,
            "frame": AxisConvention.ANDROID,
            "board_number": 5,
            "shield": Shield.AGM01,
        },
    ),
    (body(2, "hH", 720, 3000), DebugPacket(9, 720, 3000), {"firmware_release": 7.2, "algorithm_ticks": 60_000.0}),
    (body(3, "I3h", 7, 20, 0, -1), RatePacket(9, 7, (20, 0, -1)), {"rate_dps": (1.0, 0.0, -0.05)}),
    (
        body(4, "I3h", 7, -1800, 905, 3599),
        AnglesPacket(9, 7, -1800, 905, 3599),
        {"roll_deg": -180.0, "pitch_deg": 90.5, "compass_deg": 359.9},
    ),
    (
        body(5, "Iih", 7, -100_500, 2150),
        AltitudePacket(9, 7, -100_500, 2150),
        {"altitude_m": -100.5, "temperature_degc": 21.5},
    ),
    (
        body(6, "6h", 120, 35, 1, 113, -159, 100),
        MagneticPacket422(9, 120, 35, 1, (113, -159, 100)),
        {
            "fit_error_percent": 3.5,
            "shown": Shown.HARD_IRON,
            "shown_values": {"hard_iron_x_uT": 11.3, "hard_iron_y_uT": -15.9, "hard_iron_z_uT": 10.0},
        },
    ),
    (
        body(6, "6h", 120, 35, 0, 0, 500, 621),
        MagneticPacket422(9, 120, 35, 0, (0, 500, 621)),
        {"shown": Shown.STRENGTH, "shown_values": {"field_strength_uT": 50.0, "inclination_deg": 62.1}},
    ),
    (
        body(6, "7h", 120, 350, 500, 0, 0, 0, 621),
        MagneticPacket7(9, 120, 350, 500, 0, (0, 0, 621)),
        {"fit_error_percent": 3.5, "field_strength_ut": 50.0, "shown_values": {"inclination_deg": 62.1}},
    ),
    (
        body(6, "7h", 1, 1, 1, 401, -300, 0, 7),
        MagneticPacket7(9, 1, 1, 1, 401, (-300, 0, 7)),
        {
            "buffer_cell": 391,
            "shown_values": {"magnetometer_x_uT": -30.0, "magnetometer_y_uT": 0.0, "magnetometer_z_uT": 0.7},
        },
    ),
    (
        body(6, "7h", 1, 1, 1, -10, -300, 0, 7),
        MagneticPacket7(9, 1, 1, 1, -10, (-300, 0, 7)),
        {"buffer_cell": 0, "shown": Shown.EMPTY_CELL, "shown_values": {}},
    ),
    (
        body(6, "7h", 1, 1, 1, 3, 1000, -2, 0),
        MagneticPacket7(9, 1, 1, 1, 3, (1000, -2, 0)),
        {
            "buffer_cell": None,
            "shown_values": {"inverse_soft_iron_xy": 1.0, "inverse_soft_iron_xz": -0.002, "inverse_soft_iron_yz": 0.0},
        },
    ),
    (
        body(7, "9h", 1, 2, 3, 1000, -2000, 0, 10_000, 0, 5),
        KalmanPacket422(9, (1, 2, 3), (1000, -2000, 0), (10_000, 0, 5)),
        {
            "orientation_error_deg": (0.001, 0.002, 0.003),
            "gyroscope_offset_dps": (1.0, -2.0, 0.0),
            "gyroscope_offset_error_dps": (1.0, 0.0, 0.0005),
        },
    ),
    (
        body(7, "22h", *range(1, 13), -2100, 0, 1600, 6210, 8192, 0, 0, 0, 0, -50),
        KalmanPacket500(
            9, (1, 2, 3), (4, 5, 6), (7, 8, 9), (10, 11, 12), (-2100, 0, 1600), 6210, (8192, 0, 0), (0, 0, -50)
        ),
        {
            "gyroscope_offset_dps": (-2.1, 0.0, 1.6),
            "inclination_deg": 62.1,
            "linear_acceleration_g": (1.0, 0.0, 0.0),
            "displacement_m": (0.0, 0.0, -0.5),
            "gravity_error_parts": (4 / 30_000, 5 / 30_000, 6 / 30_000),
        },
    ),
    (
        body(8, "b21h", 12, 8192, 0, 0, -32_768, 0, 0, 100, 0, 0, *range(12)),
        AccelerometerPacket(
            9, 12, (8192, 0, 0), (-32_768, 0, 0), (100, 0, 0), (0, 1, 2), (3, 4, 5), (6, 7, 8, 9, 10, 11)
        ),
        {
            "stored_g": (1.0, 0.0, 0.0),
            "offset_g": (-1.0, 0.0, 0.0),
            "inverse_gain_less_1": (0.01, 0.0, 0.0),
            "rotation_other_parts": (0.0006, 0.0007, 0.0008, 0.0009, 0.001, 0.0011),
        },
    ),
]


@pytest.mark.parametrize(("sent", "packet", "in_units"), BODIES)
def test_bytes_are_read_as_the_fields_and_units_they_stand_for(
    sent: bytes, packet: Packet, in_units: dict[str, object]
) -> None:
    assert decode(sent.replace(b"\x7d", b"\x7d\x5d").replace(b"\x7e", b"\x7d\x5e")) == packet
    assert {name: getattr(packet, name) for name in in_units} == in_units


def test_every_kind_is_among_them() -> None:
    assert {type(packet) for _, packet, _ in BODIES} == set(KINDS)


@pytest.mark.parametrize("kind", KINDS)
def test_a_number_beyond_its_form_is_refused_before_it_is_sent(kind: type[Packet]) -> None:
    with pytest.raises(ValueError, match="cannot be sent"):
        encode(dataclasses.replace(zeros(kind), number=256))


@given(data=st.binary(max_size=120))
def test_other_bytes_are_refused_or_are_the_packet_that_they_are(data: bytes) -> None:
    try:
        packet = decode(data)
    except FrameError:
        return
    assert decode(encode(packet)) == packet


@pytest.mark.parametrize("kind", KINDS)
def test_what_a_packet_says_has_the_names_that_its_kind_declares(kind: type[Packet]) -> None:
    shown = set()
    for variable_id in (*range(5), 10, -10) if "variable_id" in kind.__dataclass_fields__ else (0,):
        packet = zeros(kind)
        if kind in (MagneticPacket422, MagneticPacket7):
            packet = dataclasses.replace(packet, variable_id=variable_id)
        shown |= packet.values().keys()
    assert shown == set(kind.columns())


def test_commands_have_four_characters_and_no_two_are_the_same() -> None:
    assert all(len(command.value) == 4 and command.value.decode("ascii").isprintable() for command in ToolboxCommand)
    assert len({command.value for command in ToolboxCommand}) == len(ToolboxCommand) == 45
    of_422 = {command.value for command in ToolboxCommand if command.is_known_to(Release.V4_22)}
    assert of_422 == {
        b"VG+ ",
        b"VG- ",
        b"DB+ ",
        b"DB- ",
        b"RPC+",
        b"RPC-",
        b"ALT+",
        b"ALT-",
        b"Q3  ",
        b"Q3M ",
        b"Q3G ",
        b"Q6MA",
        b"Q6AG",
        b"Q9  ",
        b"RST ",
    }
    assert all(command.is_known_to(Release.V7) for command in ToolboxCommand)
