"""What only a newer version knows is written again, with what it was said of."""

from __future__ import annotations

import json
from itertools import permutations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hiltest.verdict.baseline_file import add_unknown_fields

LEAVES = st.none() | st.booleans() | st.integers() | st.text(max_size=3)
KNOWN = st.dictionaries(st.sampled_from(["name", "a", "b"]), LEAVES)
ROWS = st.lists(KNOWN, max_size=6)


@pytest.mark.parametrize(
    ("written", "read", "result"),
    [
        ({"a": 2}, {"a": 1, "new": 3}, {"a": 2, "new": 3}),
        ({"side": {"a": 2}}, {"side": {"a": 1, "new": 3}}, {"side": {"a": 2, "new": 3}}),
        ({"a": (1, 2)}, {"a": [1, 2], "new": 3}, {"a": [1, 2], "new": 3}),
        ([{"name": "x", "a": 1}], [{"name": "x", "a": 1, "new": 3}], [{"name": "x", "a": 1, "new": 3}]),
        ([{"name": "x", "a": 2}], [{"name": "x", "a": 1, "new": 3}], [{"name": "x", "a": 2}]),
        ([{"name": "x", "a": (1,)}], [{"name": "x", "a": [1], "new": 3}], [{"name": "x", "a": [1], "new": 3}]),
        # An entry of a history is told from another of the same name by all that it says.
        (
            [{"name": "x", "a": 1}, {"name": "x", "a": 2}],
            [{"name": "x", "a": 1, "new": 3}],
            [{"name": "x", "a": 1, "new": 3}, {"name": "x", "a": 2}],
        ),
        ({"a": 1}, None, {"a": 1}),
        ([1, 2], [3], [1, 2]),
        ([{"a": {"b": 1}}], [{"a": {"b": 1, "new": 2}}], [{"a": {"b": 1, "new": 2}}]),
    ],
)
def test_examples(written: object, read: object, result: object) -> None:
    assert json.loads(json.dumps(add_unknown_fields(written, read))) == result


@given(ROWS, st.data())
def test_what_was_only_read_is_written_as_it_was(rows: list[dict[str, object]], data: st.DataObject) -> None:
    read = {"rows": [row | {"new": data.draw(LEAVES)} for row in rows], "new": 1}
    told_apart = not any(one.items() <= other.items() for one, other in permutations(rows, 2))
    written = add_unknown_fields({"rows": rows}, read)
    if told_apart:
        assert written == read
    assert [{key: item[key] for key in row} for row, item in zip(rows, written["rows"], strict=True)] == rows


@given(ROWS)
def test_without_a_file_before_nothing_is_added(rows: list[dict[str, object]]) -> None:
    assert add_unknown_fields({"rows": rows}, None) == {"rows": rows}
