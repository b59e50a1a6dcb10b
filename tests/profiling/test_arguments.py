"""Arguments as one writes them on a command line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hiltest.errors import ConfigError
from hiltest.virtual.calls.buffers import Address, Structure
from hiltest.virtual.profiling.arguments import parse_argument


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("42", 42),
        ("-7", -7),
        ("0x2a", 42),
        ("4294967295", 0xFFFFFFFF),
        ("-2147483648", -(1 << 31)),
        ("007", 7),
        ("2.5", 2.5),
        ("1e-3", 1e-3),
        ("-inf", float("-inf")),
    ],
)
def test_numbers(text: str, value: float) -> None:
    parsed = parse_argument(text)
    assert (parsed, type(parsed)) == (value, type(value))


@pytest.mark.parametrize(
    ("text", "kind", "values"),
    [
        ("int16:1,-2,3", "int16", [1, -2, 3]),
        ("uint8:0xff", "uint8", [255]),
        ("uint64:18446744073709551615", "uint64", [2**64 - 1]),
        ("float32:1e+3, 2.5", "float32", [1000.0, 2.5]),
        ("zeros:float64:2", "float64", [0.0, 0.0]),
    ],
)
def test_numbers_of_a_type(text: str, kind: str, values: list[float]) -> None:
    array = parse_argument(text)
    assert array.dtype == np.dtype(kind)
    assert array.tolist() == values


def test_plain_buffers(tmp_path: Path) -> None:
    file = tmp_path / "data+more.bin"
    file.write_bytes(b"\x00\x01")
    assert parse_argument("zeros:3") == bytearray(3)
    assert parse_argument("text:a+b:c") == b"a+b:c\0"
    assert parse_argument(f"@{file}") == b"\x00\x01"


def test_the_numbers_of_a_file(tmp_path: Path) -> None:
    file = tmp_path / "cloud.csv"
    file.write_text("1, -2, 3\n\n4 5;6\n")
    assert parse_argument(f"int16:@{file}").tolist() == [1, -2, 3, 4, 5, 6]


def test_members_of_a_structure_are_laid_out_as_c_does() -> None:
    parsed = parse_argument("uint8:1+ptr:int16:1,2+uint16:7+float64:0.5+zeros:1")
    assert isinstance(parsed, Structure)
    offsets = [offset for offset, _ in parsed.layout()]
    assert offsets == [0, 4, 8, 16, 24]
    assert parsed.size == 32
    pointer = parsed.members[1]
    assert isinstance(pointer, Address)
    assert pointer.buffer.tolist() == [1, 2]


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("hello", "'hello' is not an argument; write an integer"),
        ("", "'' is not an argument"),
        ("18446744073709551616", "does not fit into 64 bits"),
        ("int16:1,x", "int16:1,x: 'x' is not a number"),
        ("int16:40000", "40000 is not of type int16 (-32768 to 32767)"),
        ("int16:1.5", "1.5 is not of type int16"),
        ("float32:1e40", "1e40 is beyond the largest float32"),
        ("int16:", "contains no numbers"),
        ("zeros:0", "write zeros:64"),
        ("zeros:99999999999", "within the size of the RAM"),
        ("zeros:int17:4", "write zeros:64"),
        ("@gone.bin", "cannot read 'gone.bin' for an argument: No such file"),
        ("int16:@gone.csv", "cannot read 'gone.csv'"),
        ("@.", "Is a directory"),
        ("int16:1+int17:2", "'1+int17:2' is not a number"),
    ],
)
def test_a_wrong_argument_is_refused_with_what_to_write(
    text: str, complaint: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError) as caught:
        parse_argument(text)
    assert complaint in str(caught.value)


def test_a_wrong_number_in_a_file_is_found_by_its_line(tmp_path: Path) -> None:
    file = tmp_path / "cloud.csv"
    file.write_text("1,2,3\n4,five,6\n")
    with pytest.raises(ConfigError, match=r"cloud.csv, line 2: 'five' is not a number"):
        parse_argument(f"int16:@{file}")


def test_a_file_larger_than_the_ram_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "big.bin"
    file.write_bytes(bytes(0x40001))
    with pytest.raises(ConfigError, match="larger than the board's RAM"):
        parse_argument(f"@{file}")
