"""Reading and writing a baseline file; imports pydantic, which is slow to import."""

from __future__ import annotations

import json
from collections import Counter, defaultdict
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from hiltest.errors import ConfigError
from hiltest.strict_json import JsonFile, read_json, shown
from hiltest.verdict.baseline import SCHEMA, Baseline, evidence_from
from hiltest.verdict.evidence import Evidence, Seed

_SILENT = {"measurements": ("limit", "tolerance", "build_id"), "history": ("was_build_id", "revision")}
"""Left out of a line where they are null, as in a file from before they were kept: no line of it may change."""

_ADAPTER = TypeAdapter(Baseline)
OTHERWISE = "save it again: hiltest baseline save RUN FILE"
"""The next step for a baseline that cannot be read."""


def read_baseline(path: Path) -> Baseline:
    """Read a baseline file.

    Raises
    ------
    ConfigError
        If it is missing, not JSON, of another schema, or has a field that is missing or wrong; it says which.
    """
    return baseline_in(read_json(path, otherwise=OTHERWISE))


def evidence_in(file: JsonFile) -> Evidence:
    """Return the content of a baseline file as one side of a comparison.

    Raises
    ------
    ConfigError
        If it is of another schema, or has a field that is missing or wrong; it says which.
    """
    return evidence_from(baseline_in(file), str(file.path), file.sha256)


def to_json(baseline: Baseline, before: Any = None) -> str:
    """Return the text of a baseline file: a measurement a line, for readable diffs.

    Parameters
    ----------
    before
        The file as it was, of which fields that are not known here are kept.
    """
    content = with_unknown(asdict(baseline), _with_silent(before))
    for kind, silent in _SILENT.items():
        content[kind] = [
            {name: value for name, value in each.items() if name not in silent or value is not None}
            for each in content[kind]
        ]
    if not content["passed"]:
        del content["passed"]
    fields = ",\n".join(f"{_json(name)}: {_field(name, value)}" for name, value in content.items())
    return "{\n" + fields + "\n}\n"


def _with_silent(before: Any) -> Any:
    """Return a file as it was with the fields that its lines lack, so that a line that is the same is seen to be."""
    if not isinstance(before, dict):
        return before
    return before | {
        kind: [{**each, **{name: each.get(name) for name in silent}} for each in before[kind]]
        for kind, silent in _SILENT.items() if kind in before
    }  # fmt: skip


def baseline_in(file: JsonFile) -> Baseline:
    """Check the content of a baseline file.

    Raises
    ------
    ConfigError
        As `evidence_in`.
    """
    if file.schema != SCHEMA:
        said = f"schema is {shown(file.schema)}, this hiltest reads {shown(SCHEMA)}"
        raise ConfigError(f"{file.path}: {said}; {OTHERWISE}")
    try:
        # As JSON, and strictly: a number in quotes is no number, and a list is what a tuple is written as.
        baseline = _ADAPTER.validate_json(json.dumps(file.content), strict=True)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(step) for step in first["loc"])
        raise ConfigError(f"{file.path}: {place}: {first['msg']}; {OTHERWISE}") from error
    if fault := _fault(baseline):
        raise ConfigError(f"{file.path}: {fault}; {OTHERWISE}")
    return baseline


def _fault(baseline: Baseline) -> str:
    """Return what is wrong with rows that are each valid, together; empty where nothing is."""
    if not baseline.seeds:
        return "it is of no run at all: seeds is empty"
    if not baseline.measurements:
        return "there is nothing to compare with: measurements is empty"
    for kind, each in (("seed", baseline.seeds), ("measurement", [row.name for row in baseline.measurements])):
        twice = [value for value, count in Counter[Seed | str](each).items() if count > 1]
        if twice:
            return f"{kind} {shown(twice[0])} stands twice"
    for row in baseline.measurements:
        if len(row.values) != len(baseline.seeds):
            return f"{shown(row.name)} has {len(row.values)} values for {len(baseline.seeds)} seeds"
        if all(value is None for value in row.values):
            return f"{shown(row.name)} has no number"
    return ""


def _json(value: object) -> str:
    return json.dumps(value, allow_nan=False, ensure_ascii=False)


def _field(name: str, value: Any) -> str:
    if name in ("measurements", "history", "passed"):
        return "[" + ",".join(f"\n {_json(each)}" for each in value) + "]"
    return _json(value) if name == "seeds" else json.dumps(value, indent=1, allow_nan=False, ensure_ascii=False)


def with_unknown(written: Any, read: Any) -> Any:
    """Return what is to be written, with every field of what was read that the writer does not know.

    Parameters
    ----------
    written
        Made of classes, which have lost what they do not know.
    read
        The file as it was.

    Returns
    -------
    JSON value
        An object keeps its unknown fields. An object in a list keeps them as long as nothing else of it has changed:
        the fields of another number are not kept with this one.

    Examples
    --------
    >>> with_unknown({"a": 2}, {"a": 1, "b": 3})
    {'a': 2, 'b': 3}
    >>> with_unknown([{"name": "x", "a": 1}, {"name": "y", "a": 2}], [{"name": "y", "a": 2, "b": 3}])
    [{'name': 'x', 'a': 1}, {'name': 'y', 'a': 2, 'b': 3}]
    """
    if isinstance(written, Mapping) and isinstance(read, Mapping):
        known = {key: with_unknown(value, read.get(key)) for key, value in written.items()}
        return known | {key: value for key, value in read.items() if key not in written}
    if not (isinstance(written, list | tuple) and isinstance(read, list)):
        return written
    before: defaultdict[str, list[Any]] = defaultdict(list)
    for each in read:
        if isinstance(each, Mapping):
            before[str(each.get("name"))].append(each)
    return [
        next((old for old in before[str(each.get("name"))] if _says_as_much(old, each)), each)
        if isinstance(each, Mapping) else each for each in written
    ]  # fmt: skip


def _says_as_much(old: Any, new: Any) -> bool:
    """Say whether `old` contains all of `new`."""
    if isinstance(new, Mapping):
        return isinstance(old, Mapping) and all(key in old and _says_as_much(old[key], new[key]) for key in new)
    if isinstance(new, list | tuple):
        return isinstance(old, list) and len(old) == len(new) and all(map(_says_as_much, old, new))
    return bool(old == new)
