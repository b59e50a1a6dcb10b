"""Tables in every form that people have, what is said of it, and rows that stay wrong."""

from __future__ import annotations

import gzip
import json
from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hiltest.errors import ConfigError
from hiltest.interfaces.sensor_files.cells import TableRows, number_in
from hiltest.interfaces.sensor_files.table import Table, open_table
from hiltest.log_fitting import read_samples

ROWS = (("1.5", "-2.0", "3.0"), ("4.0", "5.5", "-6.25"), ("7.0", "8.0", "9.5"))
LINES = [",".join(row) for row in ROWS]
BODY = "\n".join(LINES) + "\n"


def opened(folder: Path, content: str | bytes, *, fewest: int = 3) -> Table:
    path = folder / "log.txt"
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return open_table(path, fewest=fewest)


def read(folder: Path, content: str | bytes) -> tuple[Table, list[tuple[str, ...]]]:
    table = opened(folder, content)
    return table, [row.cells for row in table.rows()]


def read_numbers(folder: Path, content: str) -> None:
    """Read a table as its readers do."""
    table = opened(folder, content)
    for row in table.rows():
        for place, name in enumerate(table.names(range(table.width))):
            number_in(table.path, row, place, name, quantity="reading")


@pytest.mark.parametrize(
    ("above", "headers"),
    [
        ("Adafruit LIS3MDL test!\nLIS3MDL Found!\n\nData rate set to: 155 Hz\n", ()),
        ("Device: Nano 33\nDate: 2024-11-25 12:00\n\nmx,my,mz\n", ("mx", "my", "mz")),
        ("Device,Nano\nRate,100\nmx,my,mz\n", ("mx", "my", "mz")),
        ("Sensor,LIS3MDL,I2C\nmx,my,mz\n", ("mx", "my", "mz")),
        ("Device,Nano,33,IoT\nRate,100,Hz,\na,b,c\n", ("a", "b", "c")),
        ('[Data]\nDon\'t "move it\n"x","y","z"\n', ("x", "y", "z")),
        (",,,\nx,y,z\n", ("x", "y", "z")),
        ('{"rate": 100}\nx,y,z\n', ("x", "y", "z")),
        ("calibrating, turn slowly\nOffsets: 12 34 56\n# x,y,z\n", ("x", "y", "z")),
    ],
)
def test_a_text_above_a_table_is_skipped_and_said(tmp_path: Path, above: str, headers: tuple[str, ...]) -> None:
    table, rows = read(tmp_path, above + BODY)
    assert (table.headers, rows) == (headers, list(ROWS))
    count = sum(bool(line.strip("# ")) for line in above.splitlines()) - bool(headers)
    assert table.preamble == count
    (note,) = table.notes
    assert repr(above.splitlines()[0]) in note
    assert f"Line {1}" in note or "Lines 1 to " in note


@pytest.mark.parametrize(
    ("above", "complaint"),
    [
        ("t,mx,my,mz\n", ":1: 4 cells, and 3 in line 2, where readings begin"),
        ("mx my mz\n", ":1: 3 cells, and 3 in line 2, where readings begin"),
        ("a,b,c,d\n", ":1: 4 cells, and 3 in line 2"),
        ("boot\n1,2,3,4\nmore\n", ":3: 1 cells where the table has 4 columns"),
        ("mx,my,mz\n1,x,3\n", ":2: column my: 'x' is not a number"),
        ("mx,my,mz\nfoo,bar,baz\n", ":2: column mx: 'foo' is not a number"),
        ("1,2,3\n1,2\n", ":2: 2 cells where the table has 3 columns"),
        ("x_a,1,2,3\nx_a,1,2\n", ":1: 4 cells, and 3 in line 3, where readings begin"),
        ("mx,my,mz\n1,2\n", ":2: 2 cells where the table has 3 columns"),
        ("mx,my,mz\n1,2,3,4\n", ":2: 4 cells where the table has 3 columns"),
    ],
)
def test_what_may_be_a_header_or_a_reading_is_not_taken_for_text(tmp_path: Path, above: str, complaint: str) -> None:
    with pytest.raises(ConfigError) as raised:
        read_numbers(tmp_path, above + BODY)
    assert complaint in str(raised.value)


@pytest.mark.parametrize(
    ("content", "index", "message"),
    [
        ("0,1,2\n" + BODY, None, "Line 1, '0,1,2', was taken as pandas' numbers of the columns, not as a reading."),
        (",0,1,2\n" + "".join(f"{n},{line}\n" for n, line in enumerate(LINES)), 0, "Line 1, ',0,1,2', was taken as"),
        ("Unnamed: 0,0,1,2\n" + "".join(f"{n},{line}\n" for n, line in enumerate(LINES)), 0, "'Unnamed: 0,0,1,2'"),
        ("boot\n0,1,2\n" + BODY, None, "Line 2, '0,1,2', was taken as pandas' numbers"),
    ],
)
def test_pandas_numbers_of_columns_are_no_reading(
    tmp_path: Path, content: str, index: int | None, message: str
) -> None:
    table, rows = read(tmp_path, content)
    assert (table.headers, table.index) == ((), index)
    assert [row[-3:] for row in rows] == list(ROWS)
    assert any(message in note for note in table.notes)


@pytest.mark.parametrize("body", ["0,1,2\n3,4,5\n6,7,8\n", "0,1,2\n", "0,1,3\n" + BODY])
def test_readings_that_look_like_numbers_of_columns_stay_readings(tmp_path: Path, body: str) -> None:
    table, rows = read(tmp_path, body)
    assert rows[0] == tuple(body.splitlines()[0].split(","))
    assert table.notes == ()


def test_a_column_that_counts_is_an_index_and_one_that_does_not_is_none(tmp_path: Path) -> None:
    counted = [f"{n + 7},{line}" for n, line in enumerate(LINES)]
    assert opened(tmp_path, "\n".join(counted)).index == 0
    assert opened(tmp_path, "\n".join([*counted, "7,1,2,3"])).index is None
    assert opened(tmp_path, ",a,b,c\n2024-11-25,1,2,3\n").index == 0


RAW = "Raw:-8192,4096,8192,16,-8,0,480,-125,3"


def test_raw_lines_of_motion_cal_are_read_in_units_and_other_lines_are_skipped_and_counted(tmp_path: Path) -> None:
    table, rows = read(tmp_path, f"Boot\n{RAW}\nUni:-9.8,4.9,9.8,1,-.5,0,48,-12.5,.3\n{RAW}\r\nRa\n")
    assert dict(zip(table.headers, map(float, rows[0]), strict=True)) == {
        "ax_g": -1.0,
        "ay_g": 0.5,
        "az_g": 1.0,
        "gx_dps": 1.0,
        "gy_dps": -0.5,
        "gz_dps": 0.0,
        "mx_uT": 48.0,
        "my_uT": -12.5,
        "mz_uT": 0.3,
    }
    assert rows == rows[:1] * 2
    assert "8192 counts for 1 g" in table.notes[0]
    assert table.notes[1] == "3 lines without a named reading were skipped."


def test_a_raw_line_that_is_wrong_is_skipped_and_counted(tmp_path: Path) -> None:
    table, rows = read(tmp_path, f"{RAW}\nRaw:1,2,3\n{RAW}\nRaw:1,2,3,4,5,6,7,8,9.5\n")
    assert len(rows) == 2
    assert table.notes[1] == "2 lines without a named reading were skipped."


def test_times_of_serial_monitors_are_taken_off_and_kept(tmp_path: Path) -> None:
    lines = [
        "23:59:58.500 -> boot",
        "23:59:58.501 -> ",
        "23:59:58.502 -> x,y,z",
        *(f"23:59:59.{n}00 -> {line}" for n, line in enumerate(LINES)),
    ]
    table = opened(tmp_path, "\r\n".join(lines))
    rows = list(table.rows())
    assert (table.headers, [row.cells for row in rows]) == (("x", "y", "z"), list(ROWS))
    assert [row.arrived_s for row in rows] == pytest.approx([86399.0, 86399.1, 86399.2])
    assert "time before each line" in table.notes[0]
    assert read(tmp_path, f"9:00:00.1 > {RAW}\n")[0].headers[-1] == "mz_uT"  # as PlatformIO's
    assert read(tmp_path, "12:34:56,1,2,3\n")[1] == [("12:34:56", "1", "2", "3")]  # a cell, not a stamp


@pytest.mark.parametrize(
    ("line", "headers"),
    [
        ('{"t": 0, "mx": 1.5, "my": -2.0, "mz": 3.0}', ("t", "mx", "my", "mz")),
        ('{"mag": {"x": 1.5, "y": -2.0, "z": 3.0}, "n": null}', ("mag.x", "mag.y", "mag.z", "n")),
        ('{"imu": {"mag": [1.5, -2.0, 3.0]}}', ("imu.mag.x", "imu.mag.y", "imu.mag.z")),
        ('{"mag": ["1.5", -2.0, 3.0, true]}', ("mag.0", "mag.1", "mag.2", "mag.3")),
    ],
)
def test_lines_of_json_are_rows(tmp_path: Path, line: str, headers: tuple[str, ...]) -> None:
    table, rows = read(tmp_path, f"boot\n{line}\n{line}")
    assert (table.headers, table.preamble) == (headers, 1)
    assert len(rows) == 2
    assert set(ROWS[0]) <= set(rows[1])


def test_keys_of_json_may_miss_and_one_that_comes_late_is_said(tmp_path: Path) -> None:
    first = ['{"acc": [0, 0, 1]}', '{"mag": [1, 2, 3]}'] * 50
    table, rows = read(tmp_path, "\n".join([*first, '{"mag": [1, 2, 3], "event": "button"}', ""]))
    assert rows[:2] == [("0", "0", "1", "", "", ""), ("", "", "", "1", "2", "3")]
    assert rows[-1] == rows[1]
    assert "Lists of three numbers in JSON were taken as x, y and z." in table.notes
    assert "Keys of JSON that are not in the first 100 lines, such as 'event', were not read." in table.notes


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        ('{"x": 1}\n{"x": 1, "x": 2}\n{"x": 1}\n', ':2: key "x" stands twice in one object'),
        ('{"x": 1}\n{"x": NaN}\n', ":2: NaN is not a number"),
        ('{"x": 1}\n[1]\n{"x": 1}\n', "JSON, but neither one document nor an object on each line"),
        ('{"x": 1}\n{"x": 1}\n[1]\n', ":3: not an object"),
        ('{"a": {"b": 1}, "a.b": 2}\n{"x": 1}\n', ":1: two keys are the same when levels are joined by points"),
        ('{"x": 1,\n "y": 2}\n', "JSON, but no table of readings: no list of objects, and no lists of equal length"),
        ('[\n{"x": 1},\n{"x": 2}\n', "JSON, but no table of readings: Expecting ',' delimiter"),
    ],
)
def test_json_that_is_no_row_is_refused(tmp_path: Path, content: str, complaint: str) -> None:
    with pytest.raises(ConfigError) as raised:
        read(tmp_path, content)
    assert complaint in str(raised.value)


@pytest.mark.parametrize(
    ("content", "headers"),
    [
        ('[{"mag": [1.5, -2.0, 3.0]}, {"mag": [4.0, 5.5, -6.25]}]', ("mag.x", "mag.y", "mag.z")),
        ('{"rate": 100,\n"rows": [{"mx": 1.5, "my": -2.0, "mz": 3.0},\n{"mx": 4, "my": 5.5}]}', ("mx", "my", "mz")),
        ('{"mag": [[1.5, -2.0, 3.0], [4.0, 5.5, -6.25]]}', ("mag.x", "mag.y", "mag.z")),
        ('{"mx": [1.5, 4, 1, 1], "my": [-2.0, 5.5, 1, 1], "mz": [3.0, -6.25, 1, 1]}', ("mx", "my", "mz")),
        (
            '{"mx": {"0": 1.5, "1": 4.0}, "my": {"0": -2.0, "1": 5.5},\n"mz": {"0": 3.0, "1": -6.25}}',
            ("mx", "my", "mz"),
        ),
        ("[[1.5, -2.0, 3.0, 0], [4.0, 5.5, -6.25, 0]]", ()),
    ],
)
def test_a_document_of_json_is_a_table(tmp_path: Path, content: str, headers: tuple[str, ...]) -> None:
    table, rows = read(tmp_path, content)
    assert table.headers == headers
    assert rows[0][:3] == ROWS[0]


def test_a_document_of_json_may_be_one_long_line(tmp_path: Path) -> None:
    document = json.dumps([{"mx": row, "my": 1, "mz": 2} for row in range(10_000)])
    assert len(document) > 200_000
    _, rows = read(tmp_path, document)
    assert [row[0] for row in rows] == [str(row) for row in range(10_000)]


@pytest.mark.parametrize(
    ("lines", "headers", "rows"),
    [
        # Two sensors that log at different rates: a row has each sensor once.
        (
            ["a: 1, 2, 3 g", "a: 4, 5, 6 g", "m: 7, 8, 9 uT", "a: 1, 1, 1 g"],
            ("a.x [g]", "a.y [g]", "a.z [g]"),
            [("1", "2", "3"), ("4", "5", "6"), ("1", "1", "1")],
        ),
        # A line is lost: no row has axes of two readings.
        (
            ["mx=1", "my=2", "mz=3", "my=5", "mz=6", "mx=7", "my=8", "mz=9"],
            ("m.x", "m.y", "m.z"),
            [("1", "2", "3"), ("", "5", "6"), ("7", "8", "9")],
        ),
        # A line names the sensor of the next.
        (
            ["Accelerometer", "X: 1 Y: 2 Z: 3", "Magnetometer (uT):", "X: 4 Y: 5 Z: 6"] * 2,
            ("accelerometer.x", "magnetometer.x [ut]", "magnetometer.z [ut]"),
            [("1", "4", "6")] * 2,
        ),
        # ArduPilot's second compass is none of the first's readings.
        (
            ["MAG {T : 9, I : 0, MagX : 1, MagY : 2, MagZ : 3}", "MAG {T : 9, I : 1, MagX : 4, MagY : 5, MagZ : 6}"]
            * 2,
            (
                "i",
                "mag.x",
                "mag.y",
                "mag.z",
                "instance 1.i",
                "instance 1.mag.x",
                "instance 1.mag.y",
                "instance 1.mag.z",
            ),
            [("0", "1", "2", "3", "1", "4", "5", "6")] * 2,
        ),
    ],
)
def test_lines_that_name_their_numbers_are_joined_to_rows(
    tmp_path: Path, lines: list[str], headers: tuple[str, ...], rows: list[tuple[str, ...]]
) -> None:
    table, read_rows = read(tmp_path, "\n".join(lines) + "\n")
    places = [table.headers.index(header) for header in headers]
    assert [tuple(row[place] for place in places) for row in read_rows] == rows


@pytest.mark.parametrize("between", [";", "\t"])
def test_decimal_commas_are_read_where_no_cell_ends_at_a_comma(tmp_path: Path, between: str) -> None:
    body = BODY.replace(",", between).replace(".", ",")
    for above in ("", between.join(["a, b", "c", "d"]) + "\n", "Gerät: 1,5\n"):
        table, rows = read(tmp_path, above + body)
        assert rows == list(ROWS)
        assert "Commas within numbers were taken as decimal points." in table.notes
    assert table.preamble == 1


def test_commas_that_may_group_thousands_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"log\.txt:2: is '1,234' above one thousand, or below\?"):
        read(tmp_path, "x;y;z\n1,234;-5,678;9,012\n")


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be"])
def test_utf_16_with_its_mark_is_read(tmp_path: Path, encoding: str) -> None:
    mark = "" if encoding == "utf-16" else "\ufeff"
    content = f"{mark}mx (µT),my (µT),mz (µT)\r\n{BODY}".encode(encoding)
    table, rows = read(tmp_path, content)
    assert (table.headers[0], rows) == ("mx (µT)", list(ROWS))
    _, rows = read(tmp_path, content[:-5])  # in the middle of a character
    assert rows == list(ROWS)[:-1]
    path = tmp_path / "log.csv.gz"
    path.write_bytes(gzip.compress(content))
    assert [row.cells for row in open_table(path).rows()] == list(ROWS)


@pytest.mark.parametrize(("header", "separators"), [("x,y,z,\n", ","), ("x,y,z\n", ","), ("x,y,z,\n", ""), ("", ",")])
def test_a_separator_at_the_end_makes_no_column(tmp_path: Path, header: str, separators: str) -> None:
    table, rows = read(tmp_path, header + "".join(f"{line}{separators}\n" for line in LINES))
    assert [row[:3] for row in rows] == list(ROWS)
    assert {cell for row in rows for cell in row[3:]} <= {""}
    assert table.notes == ()
    assert header or table.places == (0, 1, 2)


@pytest.mark.parametrize("end", ["4.0,5", "4.0", "4.0,5.5,-", '4.0,5.5,"-6', "4.0,"])
def test_the_last_line_of_a_logger_that_was_stopped_is_skipped_and_said(tmp_path: Path, end: str) -> None:
    table, rows = read(tmp_path, f"x,y,z\n{LINES[0]}\n{end}")
    assert rows == [ROWS[0]]
    assert table.notes == ("The last line, 3, is cut off and was skipped.",)
    if end[-1] != ",":  # an empty cell at the end may be a reading that is missing
        with pytest.raises(ConfigError, match=r"log\.txt:3: "):
            read_numbers(tmp_path, f"x,y,z\n{LINES[0]}\n{end}\n")


def test_a_last_line_that_is_whole_is_read_without_its_end(tmp_path: Path) -> None:
    table, rows = read(tmp_path, BODY.rstrip())
    assert (rows, table.notes) == (list(ROWS), ())


@given(
    st.lists(
        st.text(st.sampled_from('0123456789.-+eE,;\t" #%/naifxRaw:>{}[]\r\ufffd'), max_size=30), min_size=1, max_size=8
    ),
    st.sampled_from(["\n", "\r\n", "\n12:00:00.1 -> ", "\nRaw:", '\n{"a": ']),
)
def test_every_row_of_any_text_has_a_cell_for_each_column(
    tmp_path_factory: pytest.TempPathFactory, lines: list[str], between: str
) -> None:
    folder = tmp_path_factory.getbasetemp()
    with suppress(ConfigError):
        table, rows = read(folder, between[1:] + between.join(lines))
        assert {len(row) for row in rows} <= {table.width}
        assert len(table.headers) in (0, table.width)


@pytest.mark.parametrize(
    "how", ["{},{},{}\n", "{};{};{}\r\n", "{}\t{}\t{}\n", "{} {} {}\n", "  {}   {}  {} \n", "{}, {}, {},\n"]
)
@pytest.mark.parametrize("packed", [False, True])
def test_most_rows_of_a_plain_table_come_many_at_once(tmp_path: Path, how: str, packed: bool) -> None:
    lines = [how.format(row, -row / 4, "1e-3") for row in range(20_000)]
    # A line that is read by itself, and those about it, take little from the others.
    for row in range(5_000, 20_000, 5_000):
        lines[row] = "# a remark\n"
    path = tmp_path / f"log.txt{'.gz' * packed}"
    path.write_bytes(gzip.compress("".join(lines).encode()) if packed else "".join(lines).encode())
    at_once = [
        (rows.line, rows.numbers)
        for rows in open_table(path).rows_of_numbers([2, 0], [1e9, 1e9])
        if isinstance(rows, TableRows)
    ]
    assert sum(len(numbers) for _, numbers in at_once) > 0.95 * len(lines)
    for line, numbers in at_once:
        assert numbers.tolist() == [[1e-3, row] for row in range(line - 1, line - 1 + len(numbers))]


@pytest.mark.parametrize(
    ("line", "complaint"),
    [
        ("1,2,x\n", "column 3: 'x' is not a number"),
        ("1,2\n", "2 cells where the table has 3 columns"),
        ("1,2,3,4\n", "4 cells where the table has 3 columns"),
        ("1,2,1_0\n", "column 3: '1_0' is not a number"),
        ("1,2\r,3\n", "carriage returns within the line"),
        ("1,2,3e10\n", "is no magnetometer reading"),
        ("1,\0,3\n", "a zero byte"),
        ("1,2," + 70_000 * "3" + "\n", "the line is longer than"),
    ],
)
@pytest.mark.parametrize("place", [101, 4_000, 9_999])
def test_a_line_that_is_refused_is_named_wherever_it_stands(
    tmp_path: Path, line: str, complaint: str, place: int
) -> None:
    lines = ["1.5,2.5,3.5\n"] * 10_000
    lines[place] = line
    path = tmp_path / "log.csv"
    path.write_text("".join(lines), newline="", encoding="utf-8")
    with pytest.raises(ConfigError, match=rf":{place + 1}: .*{complaint}"):
        read_samples(path)


def test_a_quote_in_a_table_of_rows_of_sensors_is_refused_with_its_line(tmp_path: Path) -> None:
    rows = ["sensor,t,x,y,z", *(f"{sensor},{row},1,2,{row}" for row in range(60) for sensor in ("ACC", "MAG"))]
    with pytest.raises(ConfigError, match=r"log\.txt:122: a quote is opened and not closed"):
        read(tmp_path, "\n".join([*rows, 'MAG,60,"1,2,3', "MAG,61,1,2,3"]) + "\n")
