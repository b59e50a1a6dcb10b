"""Reading a cloud: every common way of writing a table, and files that are none."""

from __future__ import annotations

import gzip
import json
import re
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hiltest.calibration.robust import repeats
from hiltest.errors import ConfigError
from hiltest.interfaces.sensor_files.parsed_lines import Lines
from hiltest.log_fitting import FieldUnit, Samples, read_samples, samples
from hiltest.measurement.units import AccelerationUnit

_CLOUD = np.random.default_rng(3).uniform(-60.0, 60.0, (60, 3)).round(3)
_NUMBERS = [[1.5, -2.0, 3.0], [4.0, 5.0, -6.25]]


def _read(folder: Path, content: str | bytes, **how: object) -> Samples:
    path = folder / "cloud.csv"
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return read_samples(path, **how)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "text",
    [
        "1.5,-2,3\n4,5,-6.25\n",
        "1.5, -2, 3\n4, 5, -6.25",
        "1.5;-2;3\r\n4;5;-6.25\r\n",
        "1.5\t-2\t3\n4\t5\t-6.25\n",
        "  1.5  -2 3\n4 5   -6.25  \n",
        "\ufeffx,y,z\n1.5,-2,3\n4,5,-6.25\n",
        "# made by hand\n\n% and more\nx y z\n1.5 -2 3\n// a remark\n4 5 -6.25\n",
        '"x","y","z"\n"1.5","-2","3"\n"4","5","-6.25"\n',
        "mx,my,mz\n1.5,-2.0e0,+3\n4,5,-.625e1\n",
        "z,t,y,x\n3,0,-2,1.5\n-6.25,1,5,4\n",
        "t,ax,ay,az,mx,my,mz,gx,gy,gz\n0,9,9,9,1.5,-2,3,9,9,9\n1,9,9,9,4,5,-6.25,9,9,9\n",
        "Time (s);Magnetometer X (µT);Magnetometer Y (µT);Magnetometer Z (µT)\n0;1.5;-2;3\n1;4;5;-6.25\n",
        "acc_x,acc_y,acc_z,MAG_X,MAG_Y,MAG_Z\n0,0,1,1.5,-2,3\n0,0,1,4,5,-6.25\n",
        "x_mag,y_mag,z_mag,x_acc,y_acc,z_acc\n1.5,-2,3,0,0,1\n4,5,-6.25,0,0,1\n",
        "imu.magnetic_field.x imu.magnetic_field.y imu.magnetic_field.z w\n1.5 -2 3 0\n4 5 -6.25 0\n",
        "# t,mx,my,mz\n0,1.5,-2,3\n1,4,5,-6.25\n",
        "mx;my;mz\n1,5;-2;3\n4;5;-6,25\n",
        '{"t": 0, "mag": {"x": 1.5, "y": -2, "z": 3}}\n{"t": 1, "mag": {"x": 4, "y": 5, "z": -6.25}}\n',
    ],
)
def test_a_table_is_read_however_it_is_written(tmp_path: Path, text: str) -> None:
    cloud = _read(tmp_path, text)
    np.testing.assert_array_equal(cloud.points, _NUMBERS)
    assert cloud.skipped == 0


@pytest.mark.parametrize(
    ("columns", "names"),
    [
        ("b,c,a", ("b", "c", "a")),
        ("2, 3, 1", ("b", "c", "a")),
        ("B,c,1", ("b", "c", "a")),
        ('"b","c",a', ("b", "c", "a")),
    ],
)
def test_columns_are_chosen_by_name_or_number(tmp_path: Path, columns: str, names: tuple[str, ...]) -> None:
    cloud = _read(tmp_path, "a,b,c,d\n3,1.5,-2,0\n-6.25,4,5,0\n", columns=columns)
    np.testing.assert_array_equal(cloud.points, _NUMBERS)
    assert cloud.columns == names


@pytest.mark.parametrize(
    ("header", "unit", "message"),
    [
        ("mx_uT,my_uT,mz_uT", FieldUnit.UT, "header"),
        ("mag x [gauss],mag y [gauss],mag z [gauss]", FieldUnit.GAUSS, "header"),
        ("mx_nT,my_nT,mz_nT", FieldUnit.NT, "header"),
        ("mag_x_mG,mag_y_mG,mag_z_mG", FieldUnit.MG, "header"),
        ("magX (mT),magY (mT),magZ (mT)", FieldUnit.MT, "header"),
        ("mx_T,my_T,mz_T", FieldUnit.T, "header"),
        ("UncalMagXMicroT,UncalMagYMicroT,UncalMagZMicroT", FieldUnit.UT, "header"),
        ("magnetometer_ga[0],magnetometer_ga[1],magnetometer_ga[2]", FieldUnit.GAUSS, "header"),
        ("Magnetometer X (µT),Magnetometer Y (µT),Magnetometer Z (µT)", FieldUnit.UT, "header"),
        ("mx (G),my (G),mz (G)", FieldUnit.GAUSS, "header"),
        ("Mag X_G,Mag Y_G,Mag Z_G", FieldUnit.GAUSS, "header"),
        ("mx_lsb,my_lsb,mz_lsb", FieldUnit.COUNTS, "header"),
        ("mx,my,mz", FieldUnit.COUNTS, "assumed"),
    ],
)
def test_the_unit_is_what_the_header_says(tmp_path: Path, header: str, unit: FieldUnit, message: str) -> None:
    cloud = _read(tmp_path, f"{header}\n1,2,3\n")
    assert (cloud.unit, cloud.unit_from) == (unit, message)
    cloud = _read(tmp_path, f"{header}\n1,2,3\n", unit=FieldUnit.GAUSS)
    assert (cloud.unit, cloud.unit_from) == (FieldUnit.GAUSS, "option")


def test_motion_cal_says_its_unit(tmp_path: Path) -> None:
    cloud = _read(tmp_path, "Raw:0,0,8192,0,0,0,15,-20,30\nUni:0,0,9.8\nRaw:0,0,8192,0,0,0,40,50,-63\n")
    np.testing.assert_array_equal(cloud.points, [[1.5, -2.0, 3.0], [4.0, 5.0, -6.3]])
    assert (cloud.unit, cloud.unit_from, cloud.acceleration_unit) == (FieldUnit.UT, "header", AccelerationUnit.G)


def test_rows_without_three_numbers_are_skipped_and_counted(tmp_path: Path) -> None:
    cloud = _read(tmp_path, "t,mx,my,mz\n0,1.5,-2,3\n1,,,\n2,nan,1,1\n3,inf,1,1\n\n4,4,5,-6.25\n")
    np.testing.assert_array_equal(cloud.points, _NUMBERS)
    assert cloud.skipped == 3


def test_repeated_readings_are_counted(tmp_path: Path) -> None:
    assert repeats(_read(tmp_path, "1,2,3\n1,2,3\n1,2,4\n1,2,4\n1,2,3\n").points).sum() == 2


def test_the_accelerometer_of_the_same_rows_and_the_time_are_read_with_the_line_of_each(tmp_path: Path) -> None:
    cloud = _read(tmp_path, "t_ms,ax_mg,ay_mg,az_mg,mx,my,mz\n# cold\n0,1,2,3,1.5,-2,3\n\n5,,,,,,\n20,4,,6,4,5,-6.25\n")
    np.testing.assert_array_equal(cloud.points, _NUMBERS)
    assert cloud.lines is not None
    assert cloud.lines.tolist() == [3, 6]
    np.testing.assert_array_equal(cloud.time_s, [0.0, 0.02])
    np.testing.assert_array_equal(cloud.acceleration, [[1.0, 2.0, 3.0], [4.0, np.nan, 6.0]])
    assert cloud.acceleration_unit is AccelerationUnit.MG


def test_times_of_a_serial_monitor_are_those_of_readings_without_a_column_of_time(tmp_path: Path) -> None:
    stamped = "12:00:00.250 -> {}1.5,-2,3\n12:00:01.000 -> {}4,5,-6.25\n"
    np.testing.assert_array_equal(_read(tmp_path, stamped.format("", "")).time_s, [43200.25, 43201.0])
    header = "12:00:00.100 -> t_ms,mx,my,mz\n"
    np.testing.assert_array_equal(_read(tmp_path, header + stamped.format("0,", "20,")).time_s, [0.0, 0.02])


@pytest.mark.parametrize("header", [",0,1,2\n", "Unnamed: 0,0,1,2\n", ",a,b,c\n", "n,a,b,c\n", ""])
def test_an_index_is_no_reading(tmp_path: Path, header: str) -> None:
    cloud = _read(tmp_path, header + "0,1.5,-2,3\n1,4,5,-6.25\n2,1,2,3\n")
    np.testing.assert_array_equal(cloud.points[:2], _NUMBERS)
    assert any("was taken as an index" in note for note in cloud.notes)


def test_what_was_skipped_above_and_cut_below_is_said(tmp_path: Path) -> None:
    cloud = _read(tmp_path, "Device: Nano\nmx,my,mz\n1.5,-2,3\n4,5,-6.25\n7,")
    np.testing.assert_array_equal(cloud.points, _NUMBERS)
    assert (cloud.preamble, len(cloud.notes)) == (1, 2)


@pytest.mark.parametrize(
    ("header", "gravity", "asked"),
    [
        ("g", 9.8, "Are these m/s2? A header that says m/s2"),
        ("m/s2", 1.0, "Are these g?"),
        ("mg", 1.02, "Are these g?"),
        ("g", 1.02, None),
        ("mg", 980.0, None),
        ("lsb", 9.8, None),
        ("g", 3.0, None),
    ],
)
def test_an_accelerometer_that_reads_gravity_of_another_unit_is_asked_about(
    tmp_path: Path, header: str, gravity: float, asked: str | None
) -> None:
    names = ",".join(f"a{axis}_{header}" for axis in "xyz")
    cloud = _read(tmp_path, f"mx,my,mz,{names}\n1.5,-2,3,0,0,{gravity}\n4,5,-6.25,0,-{gravity},0\n1,1,1,,,\n")
    assert [asked in note for note in cloud.notes] == [True] if asked else cloud.notes == ()


@pytest.mark.parametrize("times", ["5,4", "0,x", ",1", "nan,1"])
def test_times_that_go_back_or_miss_are_no_times(tmp_path: Path, times: str) -> None:
    first, second = times.split(",")
    cloud = _read(tmp_path, f"t,mx,my,mz\n{first},1.5,-2,3\n{second},4,5,-6.25\n")
    assert cloud.time_s is None
    np.testing.assert_array_equal(cloud.points, _NUMBERS)


def test_an_option_names_the_accelerometer_where_the_header_does_not(tmp_path: Path) -> None:
    text = "u,v,w,mx,my,mz\n0,0,1,1.5,-2,3\n0,1,0,4,5,-6.25\n"
    assert _read(tmp_path, text).acceleration is None
    cloud = _read(tmp_path, text, accelerometer_columns="w,v,u")
    np.testing.assert_array_equal(cloud.acceleration, [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    with pytest.raises(ConfigError, match=r"cloud\.csv:2: column w: 'x' is not a number"):
        _read(tmp_path, "u,v,w,mx,my,mz\n0,0,x,1.5,-2,3\n", accelerometer_columns="w,v,u")


def test_the_accelerometer_s_own_log_is_joined_by_time(tmp_path: Path) -> None:
    cloud = _read(tmp_path, "t,mx,my,mz\n0.01,1.5,-2,3\n0.5,4,5,-6.25\n")
    path = tmp_path / "acceleration.csv"
    path.write_text("time (ms),ax_g,ay_g,az_g\n0,0,0,1\n20,0,1,0\n40,0,1,0\n")
    joined = samples.join_accelerometer(cloud, path)
    np.testing.assert_array_equal(joined.acceleration, [[0.0, 0.5, 0.5], [np.nan] * 3])
    assert joined.acceleration_unit is AccelerationUnit.G
    assert "1 of 2 readings" in joined.notes[-1]
    with pytest.raises(ConfigError, match="no column of rising times"):
        samples.join_accelerometer(_read(tmp_path, "1,2,3\n4,5,6\n"), path)


@pytest.mark.parametrize(
    ("content", "how", "complaint"),
    [
        ("", {}, "cloud.csv: the file is empty"),
        ("# nothing\n", {}, "cloud.csv: the file is empty"),
        ("mx,my,mz\n", {}, "cloud.csv: no row has three numbers in the columns mx, my, mz"),
        ("mx,my,mz\n,,\n", {}, "no row has three numbers"),
        ("mx,my,mz\n1,2,3\n1,x,3\n", {}, "cloud.csv:3: column my: 'x' is not a number"),
        ("mx;my;mz\n1.5;2;3\n1,5;2;3\n", {}, "cloud.csv:3: column mx: '1,5' is not a number; decimals need a point"),
        ("1,2,3\n1,2,1_000\n", {}, "cloud.csv:2: column 3: '1_000' is not a number"),
        ("1,2,3\n1,2,1e300\n", {}, "cloud.csv:2: column 3: '1e300' is no magnetometer reading"),
        ("1,2,3\n1,2\n", {}, "cloud.csv:2: 2 cells where the table has 3 columns; correct or delete the line"),
        ('1,2,3\n1,"2,3\n', {}, "cloud.csv:2: a quote is opened and not closed on the line"),
        ("mx,my,mz\r1,2,3\r4,5,6\r", {}, "cloud.csv:1: carriage returns within the line; save with line ends LF"),
        (
            "1,2,3,4\n",
            {},
            "cannot tell which columns are the magnetometer: no header and 4 columns; choose --columns 1,2,3 or",
        ),
        ("a,b,c,d\n1,2,3,4\n", {}, "the columns are a, b, c, d; choose --columns a,b,c or --columns b,c,d"),
        (
            "mag_x,mag_y,mag_z,compass_x,compass_y,compass_z\n1,2,3,4,5,6\n",
            {},
            "choose --columns mag_x,mag_y,mag_z or --columns compass_x,compass_y,compass_z",
        ),
        ("ax,ay,az,gx,gy,gz\n1,2,3,4,5,6\n", {}, "the columns are ax, ay, az, gx, gy, gz"),
        ("mx_uT,my_uT,mz_gauss\n1,2,3\n", {}, "different units"),
        ("t,X (m/s^2),Y (m/s^2),Z (m/s^2)\n0,1,2,3\n", {}, "cannot tell which columns are the magnetometer"),
        ("mx=34,59 my=-10,36 mz=54,82\n" * 3, {}, "cannot tell which columns are the magnetometer"),
        ("gravity: [1, 2, 3]\n" * 3, {}, "the columns are gravity.x, gravity.y, gravity.z"),
        ("a,b,c\n1,2,3\n", {"columns": ""}, "0 columns; give three or two"),
        ("a,b,c\n1,2,3\n", {"columns": "a"}, "--columns a: 1 columns; give three or two"),
        ("a,b,c\n1,2,3\n", {"columns": "a,b,a"}, "a column is named twice"),
        ("a,b,c\n1,2,3\n", {"columns": "a,b,e"}, "no column 'e' among 3; the columns are a, b, c"),
        ("1,2,3\n", {"columns": "1,2,4"}, "no column '4' among 3"),
        ("1,2,3\n", {"columns": "0,1,2"}, "no column '0' among 3"),
        ("a,a,b,c\n1,2,3,4\n", {"columns": "a,b,c"}, "2 columns are called 'a'; give numbers from 1"),
        (b"\x7fELF\x02\x01\x01\0\0\0", {}, "cloud.csv:1: a zero byte: this is a binary file"),
        (b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR", {}, "cloud.csv:1: this is a binary file, not a text table"),
        (b"mx,my,mz (\xb5T)\n1,2,3\n", {}, "cloud.csv:1: byte 0xb5 is not UTF-8; save the file as UTF-8"),
        ("x,y,z\n1,2,3\n".encode("utf-16-le"), {}, "cloud.csv:1: a zero byte: this is a binary file"),
        ("1" * 100_000, {}, "cloud.csv:1: the line is longer than 65536 bytes"),
    ],
)
def test_what_is_wrong_is_said_with_file_line_and_column(
    tmp_path: Path, content: str | bytes, how: dict[str, str], complaint: str
) -> None:
    with pytest.raises(ConfigError) as raised:
        _read(tmp_path, content, **how)
    assert complaint in str(raised.value)
    assert "cloud.csv" in str(raised.value)


def test_two_columns_are_a_compass_with_two_axes(tmp_path: Path) -> None:
    for text in ("x,y\n1.5,-2\n4,5\n", "mx=1.5 my=-2\nmx=4 my=5\n"):
        cloud = _read(tmp_path, text)
        np.testing.assert_array_equal(cloud.points, [[1.5, -2.0, 0.0], [4.0, 5.0, 0.0]])
        assert len(cloud.columns) == 2
    # More rows than a reader looks at one by one.
    rows = np.arange(1000.0).reshape(500, 2)
    cloud = _read(tmp_path, "a,b,c\n" + "".join(f"0,{a},{b}\n" for a, b in rows), columns="b,c")
    np.testing.assert_array_equal(cloud.points, np.column_stack([rows, np.zeros(500)]))


@pytest.mark.parametrize(
    ("header", "count"),
    [
        ("time,n,a,b,c,still,d,e,f", 2),
        ("", 2),
        ("time,n,pos x,pos y,pos z,still,raw x,raw y,raw z", 2),
        ("time,n,ax,ay,az,still,gx,gy,gz", 0),
        ("time,n,a,a,b,still,c,d,d", 0),
    ],
)
def test_a_hint_is_a_command_that_reads_readings(tmp_path: Path, header: str, count: int) -> None:
    random = np.random.default_rng(1)
    rows = [[row * 20, row, *random.normal(size=3), 7, *random.normal(size=3)] for row in range(30)]
    text = "\n".join([*([header] if header else []), *(",".join(map(str, row)) for row in rows)]) + "\n"
    with pytest.raises(ConfigError) as raised:
        _read(tmp_path, text)
    hints = re.findall(r"--columns '?([^' ]+(?: [^' ]+)*?)'?(?: or |$)", str(raised.value))
    assert len(hints) == count
    for hint in hints:
        points = _read(tmp_path, text, columns=hint).points
        assert any(np.array_equal(points, np.array(rows)[:, first : first + 3]) for first in (2, 6))


def test_a_file_with_the_name_of_another_sensor_needs_names(tmp_path: Path) -> None:
    for file, header, is_refused in (
        ("Accelerometer", "time,z,y,x", True),
        ("Accelerometer", "time,mz,my,mx", False),
        ("run_a", "time,z,y,x", False),
        ("log-g", "time,z,y,x", False),
    ):
        path = tmp_path / f"{file}.csv"
        path.write_text(f"{header}\n0,3,-2,1.5\n1,-6.25,5,4\n")
        np.testing.assert_array_equal(read_samples(path, columns="4,3,2").points, _NUMBERS)
        if is_refused:
            with pytest.raises(ConfigError, match="the file has the name of another sensor"):
                read_samples(path)
        else:
            np.testing.assert_array_equal(read_samples(path).points, _NUMBERS)


@pytest.mark.parametrize(("path", "complaint"), [("gone.csv", "No such file"), (".", "Is a directory")])
def test_a_file_that_cannot_be_read_is_named(tmp_path: Path, path: str, complaint: str) -> None:
    with pytest.raises(ConfigError, match=f"{path}: {complaint}"):
        read_samples(tmp_path / path)


def test_a_device_without_end_is_refused_at_once() -> None:
    with pytest.raises(ConfigError, match="/dev/zero:1: a zero byte"):
        read_samples(Path("/dev/zero"))


def test_too_many_readings_are_refused_before_they_fill_the_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(samples, "MAX_ROWS", 10)
    assert len(_read(tmp_path, "1,2,3\n" * 10).points) == 10
    with pytest.raises(ConfigError, match="more than 10 readings; keep every tenth line"):
        _read(tmp_path, "1,2,3\n" * 11)


# More lines than a reader looks at for the form of the table, so that what is behind them may be read many at once.
_FORM = 100
_HEADERS = (["t_s", "mx", "my", "mz"], ["mx", "my", "mz", "ok"], ["ax", "ay", "az", "mx", "my", "mz"])
_CELLS = st.one_of(
    st.floats(allow_nan=False).map(repr),
    st.sampled_from(
        [
            "",
            " 7 ",
            "+8",
            "-0",
            ".5",
            "5.",
            "1e3",
            "1E-400",
            "1e400",
            "nan",
            "inf",
            "-Infinity",
            "1_000",
            "0x10",
            "1,5",
            "1.5.2",
            "--1",
            "1e",
            "4294967296",
            "4294967297",
            "1e20",
            "2e20",
            "1 2",
            "x",
            "\u0661",
            "\u00a02",
            '"3"',
            '"4',
            "'5'",
            "#6",
            "7%",
            "8/9",
            "//",
            "1\r",
            "\x0c1",
            "\x1c2",
            "\0",
            "12:00:00 -> 1",
            "1*",
            "2026-11-26T10:00:00",
        ]
    ),
)
_LINES = st.sampled_from(
    ["", "  ", "\t", "# a remark", "%", "// a, b", ",,,", ";;;", "\t\t\t", "#1,2,3", "boot", "1,2,3", "1 2", "1;2;3;"]
)


@st.composite
def _tables(draw: st.DrawFn) -> bytes:
    """Draw a table of many plain rows, some cells and lines of which are not."""
    separator = draw(st.sampled_from([",", ",", ";", "\t", " ", ", ", "   "]))
    decimal = "," if "," not in separator and draw(st.integers(0, 4)) == 0 else "."
    header = draw(st.sampled_from(_HEADERS))
    rows = [[f"{row}{decimal}{place}" for place in range(len(header))] for row in range(_FORM + 60)]
    for _ in range(draw(st.integers(0, 3))):
        rows[draw(st.integers(_FORM, len(rows) - 1))][draw(st.integers(0, len(header) - 1))] = draw(_CELLS)
    lines = [separator.join(cells) + separator * (draw(st.integers(0, 99)) == 0) for cells in [header, *rows]]
    for _ in range(draw(st.sampled_from([0, 0, 1, 2]))):
        lines.insert(draw(st.integers(_FORM + 1, len(lines))), draw(_LINES))
    end = draw(st.sampled_from(["\n", "\n", "\r\n"]))
    last = draw(st.sampled_from([end, end, "", f"{end}1{separator}2", f"{end}x{end}"]))
    return (end.join(lines) + last).encode()


_FIELDS = {"uT": 1.0, "nT": 1e3, "mT": 1e-3, "T": 1e-6, "gauss": 1e-2, "mG": 10.0}
_STEPS = {"s": 0.02, "ms": 20.0, "us": 2e4, "ns": 2e7}


@st.composite
def _dialects(draw: st.DrawFn) -> tuple[str, FieldUnit, bool]:
    """Draw a log of 60 readings in some form, its unit, and whether it has times."""
    unit, step = draw(st.sampled_from(sorted(_FIELDS))), draw(st.sampled_from(sorted(_STEPS)))
    points = _CLOUD * _FIELDS[unit]
    names = draw(
        st.sampled_from(
            [
                ("mx", "my", "mz"),
                ("imu_mx", "imu_my", "imu_mz"),
                ("MAG_X", "MAG_Y", "MAG_Z"),
                ("magADC[0]", "magADC[1]", "magADC[2]"),
                ("Magnetic field x", "Magnetic field y", "Magnetic field z"),
            ]
        )
    )
    has_times, label = draw(st.booleans()), draw(st.sampled_from(["Mag", "MAG", "magnetometer", "Compass field"]))
    times = [f"{_STEPS[step] * row:.6f}".rstrip("0").rstrip(".") for row in range(60)]
    cells = [[f"{value:.7g}" for value in point] for point in points]
    prefix = draw(
        st.sampled_from(["", "", "I ({}) compass: ", "[00:00:01.{:03}] ", "\x1b[0;32m", "12:00:00.{:03} -> "])
    )
    style = draw(
        st.sampled_from(["table", "units row", "bars", "pairs", "list", "axes", "sentence", "json", "document"])
    )
    if style in ("table", "units row"):
        separator = draw(st.sampled_from([",", ";", "\t"]))
        heads = [*(["time"] if has_times else []), *names]
        units = [*([step] if has_times else []), *[unit] * 3]
        if style == "table":
            lines = [separator.join(f"{head} ({word})" for head, word in zip(heads, units, strict=True))]
        else:
            lines = [separator.join(heads), separator.join(units)]
        rows = [separator.join([*([time] if has_times else []), *row]) for time, row in zip(times, cells, strict=True)]
        return "\n".join([*lines, *rows]) + "\n", FieldUnit(unit), has_times
    if style == "bars":
        heads = [*(["time"] if has_times else []), *(f"{name} [{unit}]" for name in names)]
        heads[0] = heads[0].replace("time", f"time_{step}")
        rows = [[*([time] if has_times else []), *row] for time, row in zip(times, cells, strict=True)]
        bars = [f"| {' | '.join(row)} |" for row in (heads, ["---"] * len(heads), *rows)]
        return "\n".join(bars) + "\n", FieldUnit(unit), has_times
    if style == "sentence":
        counts = draw(st.sampled_from(["{},", "{} ", "0x{:04X} ", "7,", ""]))
        lines = [f"{counts.format(row)}{x}, {y}, {z}" for row, (x, y, z) in enumerate(cells)]
        if counts.startswith("0x"):
            lines = [f"{counts.format(row)}{label}: {x} {y} {z} {unit}" for row, (x, y, z) in enumerate(cells)]
        else:
            lines = [f"${label.split()[0]},{line} {unit}, |m| = 50" for line in lines]
        return "\n".join(lines) + "\n", FieldUnit(unit), False
    if style in ("json", "document"):
        beside = draw(st.booleans())
        objects = [
            {
                **({f"time_{step}": float(time)} if has_times else {}),
                ("mag" if beside else f"mag_{unit}"): dict(zip("xyz", point, strict=True))
                | ({"unit": unit} if beside else {}),
            }
            for time, point in zip(times, points.tolist(), strict=True)
        ]
        text = json.dumps(objects, indent=draw(st.sampled_from([None, 1]))) if style == "document" else ""
        return text or "\n".join(map(json.dumps, objects)) + "\n", FieldUnit(unit), has_times
    mark = draw(st.sampled_from(["=", ": ", " = ", ":"]))
    lines = []
    for row, (time, (x, y, z)) in enumerate(zip(times, cells, strict=True)):
        start = f"t_{step}{mark}{time}, " if has_times else ""
        if style == "pairs":
            body = ", ".join(f"{name}{mark}{cell} {unit}" for name, cell in zip(names, (x, y, z), strict=True))
        elif style == "list":
            body = f"{label} ({unit}){mark}[{x}, {y}, {z}]"
        else:
            body = f"{label} x{mark}{x} y{mark}{y} z{mark}{z} {unit}"
        lines.append(prefix.format(20 * row) + start + body + ("\x1b[0m" if "\x1b" in prefix else ""))
    return "\n".join(["boot", *lines]) + "\n", FieldUnit(unit), has_times


@given(_dialects())
def test_a_cloud_in_any_form_and_unit_comes_back(
    tmp_path_factory: pytest.TempPathFactory, log: tuple[str, FieldUnit, bool]
) -> None:
    text, unit, has_times = log
    cloud = _read(tmp_path_factory.getbasetemp(), text)
    assert (cloud.unit, cloud.unit_from) == (unit, "header")
    np.testing.assert_allclose(cloud.points, _CLOUD * _FIELDS[unit], rtol=1e-6)
    if has_times:
        assert cloud.time_s is not None
        np.testing.assert_allclose(np.diff(cloud.time_s), 0.02, rtol=1e-6)


@pytest.mark.parametrize(
    "form",
    [
        # Four numbers of which the first is no counter, and two sensors with numbers of their own.
        "MAG,{x},{y},{z},{x}",
        "MAG,{odd},{x},{y},{z}",
        # Which of two readings with one name is meant?
        "x: {x} y: {y} z: {z} x: {y} y: {z} z: {x}",
        # Rows of two boards, A and B, not of acceleration and field.
        "A,{x},{y},{z}\nB,{y},{z},{x}",
        # Accelerations and rates.
        "X: {x} Y: {y} Z: {z} m/s^2",
        "AR,{x},{y},{z}\nGR,{y},{z},{x}",
        # Readings of particulate matter by the numbers of their channels.
        "sensor@1e (channel 23): {x}\nsensor@1e (channel 24): {y}\nsensor@1e (channel 25): {z}",
        # Two instances of one sensor.
        "MAG_X[0]: {x}, MAG_Y[0]: {y}, MAG_Z[0]: {z}\nMAG_X[1]: {y}, MAG_Y[1]: {z}, MAG_Z[1]: {x}",
    ],
)
def test_a_log_that_has_two_meanings_is_refused(tmp_path: Path, form: str) -> None:
    lines = [form.format(x=f"{x:.3f}", y=f"{y:.3f}", z=f"{z:.3f}", odd=row % 2) for row, (x, y, z) in enumerate(_CLOUD)]
    with pytest.raises(ConfigError, match=r"cannot tell which columns are the magnetometer|more than one magnetometer"):
        _read(tmp_path, "\n".join(lines) + "\n")


@pytest.mark.parametrize("first", ["{row}", "{clock}", "7"])
def test_a_number_before_three_readings_is_none_of_them(tmp_path: Path, first: str) -> None:
    lines = [
        f"MAG {first.format(row=row, clock=f'12:00:{row // 50:02}.{row % 50 * 20:03}')} {x:.3f} {y:.3f} {z:.3f}"
        for row, (x, y, z) in enumerate(_CLOUD)
    ]
    np.testing.assert_allclose(_read(tmp_path, "\n".join(lines)).points, _CLOUD, atol=1e-3)
    with pytest.raises(ConfigError, match="cannot tell which columns are the magnetometer"):
        _read(tmp_path, "\n".join(lines[:10]))  # too few rows to know


def test_a_magnetometer_that_is_written_twice_is_one(tmp_path: Path) -> None:
    lines = [f"magnetometro X={x:.3f}, Y={y:.3f}, Z={z:.3f}\nMAG,{x:.3f},{y:.3f},{z:.3f}" for x, y, z in _CLOUD]
    np.testing.assert_allclose(_read(tmp_path, "\n".join(lines)).points, _CLOUD, atol=1e-3)


def _what_is_read(path: Path) -> list[object] | str:
    """Return the samples of a file as what compares, or the message that refuses it."""
    try:
        read = read_samples(path)
    except ConfigError as error:
        return str(error)
    values = (getattr(read, field.name) for field in fields(read))
    return [(value.shape, value.tobytes()) if isinstance(value, np.ndarray) else value for value in values]


@given(_tables(), st.booleans())
def test_rows_that_are_read_at_once_are_what_they_are_one_by_one(
    tmp_path_factory: pytest.TempPathFactory, table: bytes, packed: bool
) -> None:
    path = tmp_path_factory.getbasetemp() / f"table.csv{'.gz' * packed}"
    path.write_bytes(gzip.compress(table) if packed else table)
    at_once = _what_is_read(path)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Lines, "ahead", lambda _: b"")
        assert _what_is_read(path) == at_once
