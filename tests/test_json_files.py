"""JSON that is hostile until it is parsed: what is refused, in what words, and that all else is what json says."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hiltest.budgets import RECORD
from hiltest.errors import ConfigError
from hiltest.json_files import parse_json, read_as, read_bounded, read_json

VALUES = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(10**17), 10**17)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(st.characters(exclude_categories=["Cs"])),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=4), inner, max_size=4),
    max_leaves=20,
)


@given(VALUES)
def test_what_json_writes_is_read_as_it_was(value: object) -> None:
    assert parse_json(json.dumps(value).encode()) == value


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ('{"a": NaN}', "NaN is not a number"),
        ("[-Infinity]", "-Infinity is not a number"),
        ("1e999", '"1e999" is too large for a number'),
        ("-1" + "0" * 18, "too large for a whole number"),
        ("1" * 5000, r'"1{56}\.\.\. is too large for a whole number'),
        ('{"a": 1, "b": 2, "a": 3}', 'key "a" stands twice'),
        ('[{"b": {"": 1, "": 1}}]', 'key "" stands twice'),
        ("[" * 100_000, f"nested more than {RECORD.nesting} levels deep"),
        ('{"a":' * 100_000, f"nested more than {RECORD.nesting} levels deep"),
        ("[" * (RECORD.nesting + 1) + "]" * (RECORD.nesting + 1), f"nested more than {RECORD.nesting} levels deep"),
        ("{", "Expecting property name"),
        ("", "Expecting value"),
        ("1 2", "Extra data"),
        ("\ufeff1", "BOM"),
    ],
)
def test_what_is_refused(text: str, complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        parse_json(text)


def test_as_deep_as_allowed_is_read() -> None:
    assert (
        json.dumps(parse_json("[" * RECORD.nesting + "]" * RECORD.nesting))
        == "[" * RECORD.nesting + "]" * RECORD.nesting
    )


def test_bytes_that_are_no_utf8_are_refused() -> None:
    with pytest.raises(ValueError, match="utf-8"):
        parse_json(b'"\xff"')


def test_a_file_is_refused_by_name_and_with_what_to_do(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    path.write_text("NaN")
    with pytest.raises(ConfigError, match=f"^{path}: not JSON: NaN is not a number; ask again$"):
        read_json(path, budget=replace(RECORD, bytes=10), otherwise="ask again")


def test_a_file_larger_than_its_bound_is_not_read(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    path.write_bytes(b"x" * 10)
    assert read_bounded(path, replace(RECORD, bytes=10), otherwise="") == b"x" * 10
    os.truncate(path, 100 * 1024 * 1024)  # 100 MB of nothing
    with pytest.raises(ConfigError, match="larger than 10 bytes, the budget of a record; ask again"):
        read_bounded(path, replace(RECORD, bytes=10), otherwise="ask again")


def test_pipes_and_devices_may_never_end_and_are_refused(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for path, what in (
        (tmp_path / "pipe", "not a regular file"),
        (Path("/dev/zero"), "not a regular file"),
        (tmp_path, "a folder"),
    ):
        with pytest.raises(ConfigError, match=what):
            read_bounded(path, replace(RECORD, bytes=10), otherwise="")


@pytest.mark.parametrize("name", ["gone", "a\0b", "x" * 300])
def test_a_file_that_is_not_there_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(ConfigError, match=r"No such file|null byte|name too long"):
        read_bounded(tmp_path / name, replace(RECORD, bytes=10), otherwise="")


@dataclass(frozen=True, slots=True)
class Point:
    """A document."""

    schema: str
    axes: tuple[float, float]


def read_point(path: Path, text: str) -> Point:
    path.write_text(text, encoding="utf-8")
    return read_as(path, Point, "test.point/1", otherwise="ask again")


def test_a_file_is_read_as_its_type_without_the_keys_of_a_newer_version(tmp_path: Path) -> None:
    text = '{"schema": "test.point/1", "axes": [1, 2.5], "newer": true}'
    assert read_point(tmp_path / "a.json", text) == Point("test.point/1", (1.0, 2.5))


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ('{"schema": "test.point/1", "axes": [1, "2"]}', 'axes.1: input should be a valid number, not "2"'),
        ('{"schema": "test.point/1"}', "axes is missing"),
        ('{"schema": "test.point/2", "axes": [1, 2]}', 'schema is "test.point/2", this hiltest reads "test.point/1"'),
        ('[{"schema": "test.point/1"}]', 'schema is null, this hiltest reads "test.point/1"'),
    ],
)
def test_a_file_that_does_not_fit_its_type_is_refused_with_the_place(tmp_path: Path, text: str, fault: str) -> None:
    with pytest.raises(ConfigError) as refused:
        read_point(tmp_path / "a.json", text)
    assert str(refused.value).startswith(f"{tmp_path / 'a.json'}: {fault};")
    assert str(refused.value).endswith("ask again")
