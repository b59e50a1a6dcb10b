"""Lines of text: what is understood of each, however the bytes are cut and whatever is in them."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hiltest.interfaces.quantities import Moment, Observation, Quantity
from hiltest.interfaces.text_interface import TextInterface
from hiltest.interfaces.text_lines import LONGEST_LINE, LineSplitter, is_intact
from hiltest.interfaces.text_table import text_interface
from hiltest.rig.text_device import TextCommands, TextDevice, TextValue

LINES = TextDevice(
    patterns=(
        r"hdg=(?P<heading>\S+)",
        r"mag=(?P<magnetometer_x>\S+) (?P<magnetometer_y>\S+) (?P<magnetometer_z>\S+)",
        r"q=(?P<quaternion>\S+)",
        r"t=(?P<temperature>\S+)",
    ),
    ready="calibration (done|restored)",
    error="ERR (?P<error>.*)",
    values={"temperature": TextValue(unit="K")},
)
JSON = TextDevice(
    format="json",
    error='"fault"',
    values={
        "heading": TextValue("att.yaw", unit="rad"),
        "magnetometer": TextValue("mag", unit="mG"),
        "accelerometer": TextValue(("a.0", "a.1", "a.2"), unit="m/s2"),
        "inverse_soft_iron": TextValue("w"),
        "calibrated": TextValue("ok"),
    },
)
COLUMNS = TextDevice(
    format="csv",
    values={
        "heading": TextValue("Yaw"),
        "gyroscope": TextValue(("gx", "gy", "gz"), unit="rad/s"),
        "calibrated": TextValue("cal"),
    },
)


def opened(device: TextDevice) -> TextInterface:
    return text_interface(device, lambda key: f"rig.toml, {key}")


def said(device: TextDevice, *lines: str) -> list[dict[str, list[float]]]:
    """What is understood of lines behind a first one, which may be the end of a line."""
    interface = opened(device)
    interface.feed(b"\n.\n", 0.0)
    return [values(item) for line in lines for item in interface.feed(line.encode() + b"\n", 1.0)]


def values(observation: Observation) -> dict[str, list[float]]:
    return {quantity.key: list(value) for quantity, value in observation.values.items()}


def test_every_pattern_is_searched_in_every_line() -> None:
    assert said(LINES, "hdg=12.5 mag=1 -2 3e1", "noise", "t=300.15 q=1,0,0,0 hdg=-.5") == [
        {"heading": [12.5], "magnetometer": [1.0, -2.0, 30.0]},
        {"heading": [-0.5], "quaternion": [1.0, 0.0, 0.0, 0.0], "temperature": [27.0]},
    ]


NMEA = TextDevice(patterns=(r"^\$HCHDM,(?P<heading>[^,]*),M", r"^\$PTNT,(?P<pitch>[^,*]*)"))


def test_a_line_with_a_check_sum_is_believed_only_where_that_is_right() -> None:
    interface = opened(NMEA)
    lines = b"$HCHDM,101.1,M*28\r\n"  # the first, which may have lost its beginning
    lines += b"$HCHDM,101.1,M*28\r\n$HCHDM,101.9,M*26\r\n$PTNT,-2.5*36\r\n$PTNT,-2.5*4F\r\n"
    lines += b"$HCHDM,101.1,M\r\n$PTNT,7*4g\r\n"
    feed = interface.feed(lines, 1.0)
    assert [(values(packet), packet.checked) for packet in feed if not packet.error] == [
        ({"heading": [101.1]}, True),
        ({"pitch": [-2.5]}, True),
        ({"heading": [101.1]}, False),
        ({"pitch": [7.0]}, False),
    ]
    assert [packet.error for packet in feed if packet.error] == 2 * ["a line has a wrong check sum"]
    assert interface.not_understood == 2


@given(text=st.text(st.characters(exclude_characters="$*\r\n", exclude_categories=["Cs"]), max_size=60))
def test_a_check_sum_is_of_all_bytes_between_its_signs(text: str) -> None:
    total = 0
    for byte in text.encode():
        total ^= byte
    assert is_intact(f"${text}*{total:02X}")
    assert is_intact(f"${text}*{total:02x} ")
    assert is_intact(f"${text}*{total ^ 0x40:02X}") is False
    assert is_intact(f"{text}*{total:02X}") is None


def test_json_is_read_by_paths_and_arrays() -> None:
    line = {
        "att": {"yaw": 1.0},
        "mag": [100, "200", -300],
        "a": [0, 0, 9.80665],
        "w": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
        "ok": True,
    }
    (understood,) = said(JSON, json.dumps(line))
    assert understood.pop("heading") == pytest.approx([57.29578])
    assert understood == {
        "magnetometer": pytest.approx([10.0, 20.0, -30.0]),
        "accelerometer": [0.0, 0.0, pytest.approx(1.0)],
        "inverse_soft_iron": [1, 0, 0, 0, 1, 0, 0, 0, 1],
        "calibrated": [1.0],
    }


def test_what_is_missing_in_json_takes_nothing_else_away() -> None:
    assert said(JSON, '{"mag": [1, 2], "ok": false, "att": null}', "[]", "12", '{"att": {"yaw": "n"}}', "{") == [
        {"calibrated": [0.0]}
    ]


def test_columns_are_found_by_the_line_that_names_them() -> None:
    rows = ["1,2,3,4,5", "cal, yaw ,gx,gy,gz", "1,90.5,0,0,1", "1,90.5,0,0", "gz,gy,gx,cal,yaw", "0,0,1,0,45"]
    turn = pytest.approx(57.29578)
    assert said(COLUMNS, *rows) == [
        {"heading": [90.5], "gyroscope": [0.0, 0.0, turn], "calibrated": [1.0]},
        {"heading": [45.0], "gyroscope": [turn, 0.0, 0.0], "calibrated": [0.0]},
    ]


def test_columns_need_no_such_line_when_the_rig_names_or_numbers_them() -> None:
    by_name = TextDevice(format="csv", separator=" ", columns=("t", "heading"), values={"heading": TextValue()})
    assert said(by_name, "5   1.5", "5 1.5 6") == [{"heading": [1.5]}]
    by_number = TextDevice(format="csv", separator=";", values={"pitch": TextValue(2), "roll": TextValue("1")})
    assert said(by_number, "5;1.5;;", "7") == [{"pitch": [1.5], "roll": [5.0]}, {"roll": [7.0]}]


def test_a_header_may_be_the_first_line_and_is_understood() -> None:
    interface = opened(COLUMNS)
    assert [values(item) for item in interface.feed(b"yaw,gx,gy,gz,cal\r\n1,0,0,0,1\r\n", 0.0)] == [
        {"heading": [1.0], "gyroscope": [0.0, 0.0, 0.0], "calibrated": [1.0]}
    ]
    assert interface.not_understood == 0


def test_a_scale_is_what_one_count_is() -> None:
    device = TextDevice(
        patterns=("m (?P<magnetometer>.*)", "a (?P<accelerometer>.*)"),
        values={
            "magnetometer": TextValue(unit="count", scale=0.1),
            "accelerometer": TextValue(unit="mg", scale=0.5),
        },
    )
    assert said(device, "m 1 -2 3", "a 2000;0; 1000") == [
        {"magnetometer": pytest.approx([0.1, -0.2, 0.3])},
        {"accelerometer": pytest.approx([1.0, 0.0, 0.5])},
    ]


@pytest.mark.parametrize(
    "number", ["nan", "-inf", "1e999", "1e9", "721", "1_0", "٣", "0x10", "--1", "1.2.3", "", "1,2", "12deg"]
)
def test_what_no_heading_can_be_is_no_value(number: str) -> None:
    assert said(LINES, f"hdg={number} t=280.15") == [{"temperature": [pytest.approx(7.0)]}]


def test_a_line_may_say_that_the_calibration_is_ready() -> None:
    assert said(LINES, "calibration done", "calibration begins") == [{"calibrated": [1.0]}]
    assert Quantity.CALIBRATED in opened(LINES).offers


def test_errors_are_reported_in_the_firmwares_words_and_bounded() -> None:
    interface = opened(LINES)
    observed = interface.feed(b"ERR boot \x07\xff\nERR sensor 2 gone hdg=3\nERR " + b"a" * 900 + b"\n", 2.5)
    assert [reading.error for reading in observed] == ["boot ⟨U+0007⟩�", "sensor 2 gone hdg=3", "a" * 200]
    assert [values(reading) for reading in observed] == [{}, {"heading": [3.0]}, {}]
    assert {reading.time_s for reading in observed} == {2.5}
    assert [item.error for item in opened(JSON).feed(b'{"fault": 3}\n', 0.0)] == ['{"fault": 3}']


def test_the_first_line_may_be_the_end_of_one() -> None:
    interface = opened(LINES)
    (first, second) = interface.readings(b"hdg=4\nhdg=345\n")
    assert (first.values, list(second.values[Quantity.HEADING])) == ({}, [345.0])
    assert "beginning" in first.remark


def test_lines_without_a_meaning_are_counted() -> None:
    interface = opened(LINES)
    interface.feed(b"hdg=1\nhdg=1\n\r\n\n?\nhdg=x\n" + b"hdg=1 " * 1000 + b"\nERR x\nhdg=2", 0.0)
    assert interface.not_understood == 3  # ?, x and the one that is too long; of the first nobody knows


def test_why_a_line_means_nothing_is_said() -> None:
    remarks = [reading.remark for reading in opened(LINES).readings(b"\n.\nhdg=x\nmag=1 2 3e9\nb\n")]
    assert remarks[1:] == [
        "heading: 'x' is not a number",
        "magnetometer: 3e+09 uT is beyond 100000; check its unit and scale",
        "no pattern matches",
    ]
    assert [reading.remark for reading in opened(JSON).readings(b".\n{\n{}\n")][1:] == [
        "no JSON",
        "nothing at att.yaw, mag, a.0, a.1, a.2, w, ok",
    ]
    rows = opened(COLUMNS).readings(b".\n1,2\ncal,yaw,gx,gy,gz\n1,2\n")
    assert [row.remark for row in rows][1:] == [
        "no line with the names cal, gx, gy, gz, yaw has arrived",
        "names of the columns",
        "2 columns, not 5",
    ]


def test_values_that_are_not_taken_are_summed_up() -> None:
    interface = opened(LINES)
    interface.readings(b"hdg=9000\n" + b"hdg=5000\n" * 3 + b"mag=1 2 3\n")
    assert interface.remarks() == ("heading ignored 3 times: 5000 deg is beyond 720; check its unit and scale",)


def test_commands_are_the_bytes_of_their_characters() -> None:
    device = TextDevice(patterns=("(?P<roll>.*)",), commands=TextCommands(start="\x03go\r\n", pose="\xff"))
    interface = opened(device)
    assert interface.commands(Moment.START) == b"\x03go\r\n"
    assert interface.commands(Moment.POSE) == b"\xff"
    assert interface.commands(Moment.AFTER_TUMBLE) == b""


def test_a_pattern_that_would_take_for_ever_is_given_up_and_holds_up_nothing() -> None:
    device = TextDevice(patterns=("^(?P<roll>(a|aa)+)$", "hdg=(?P<heading>.*)"))
    interface = opened(device)
    begin_s = time.process_time()
    observed = interface.feed(b".\n" + (b"a" * 500 + b"!\n") * 50 + b"hdg=3\n", 0.0)
    # A second for the one search that is stopped, milliseconds for the other 49.
    assert time.process_time() - begin_s < 10.0
    assert [values(reading) for reading in observed] == [{"heading": [3.0]}]
    assert interface.given_up == ("^(?P<roll>(a|aa)+)$",)


SAMPLES = {
    "lines": (LINES, ["hdg=12.5", "mag=1 2 3", "ERR gone", "calibration done", "hdg=nan", "é", "x" * 1100]),
    "json": (JSON, ['{"att":{"yaw":1},"ok":true}', '{"mag":[1,2,3]}', '{"mag":', "[[[[", '{"fault":1}']),
    "csv": (COLUMNS, ["yaw,gx,gy,gz,cal", "1,2,3,4,1", "1,2,3", "a,b,c,d,e", '"1","2",,,']),
}


def plain(observations: Sequence[Observation]) -> list[tuple[dict[str, list[float]], str]]:
    return [(values(observation), observation.error) for observation in observations]


def fed(interface: TextInterface, pieces: Sequence[bytes]) -> list[tuple[dict[str, list[float]], str]]:
    return plain([item for piece in pieces for item in interface.feed(piece, 0.0)])


@pytest.mark.parametrize("form", SAMPLES)
@given(data=st.data())
def test_lines_cut_anywhere_say_the_same(form: str, data: st.DataObject) -> None:
    device, lines = SAMPLES[form]
    ends = st.sampled_from(["\n", "\r\n", "\r", "\n\n"])
    text = "".join(data.draw(st.sampled_from(lines)) + data.draw(ends) for _ in range(data.draw(st.integers(1, 12))))
    sent = text.encode()
    cuts = sorted(data.draw(st.lists(st.integers(0, len(sent)), max_size=20)))
    pieces = [sent[a:b] for a, b in zip([0, *cuts], [*cuts, len(sent)], strict=True)]
    whole, cut = opened(device), opened(device)
    assert fed(cut, pieces) == fed(whole, [sent])
    assert cut.not_understood == whole.not_understood


GARBAGE = st.one_of(
    st.binary(max_size=300),
    st.text(alphabet='hdgmagq=t,{}[]":0123456789.-+einfNA \r\n', max_size=300).map(str.encode),
    st.integers(1, 2000).map(lambda n: b'{"mag":' + b"[" * n + b"]" * n + b"}\n"),
)


@pytest.mark.parametrize("form", SAMPLES)
@given(pieces=st.lists(GARBAGE, max_size=6))
def test_no_bytes_raise_and_every_value_is_finite_and_whole(form: str, pieces: list[bytes]) -> None:
    interface = opened(SAMPLES[form][0])
    for piece in pieces:
        for observation in interface.feed(piece, 0.0):
            assert observation.values.keys() <= interface.offers
            for quantity, value in observation.values.items():
                assert value.shape == (quantity.size,)
                assert np.isfinite(value).all()


def test_a_line_without_an_end_is_bounded() -> None:
    splitter = LineSplitter()
    for _ in range(100):
        assert list(splitter.feed(b"x" * 10_000)) == []
    assert len(splitter.unfinished) <= LONGEST_LINE + 1
    assert list(splitter.feed(b"\nwhole\n")) == [None, "whole"]
