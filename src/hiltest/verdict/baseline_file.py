"""Reading and writing a baseline file."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import asdict
from hashlib import sha256
from pathlib import Path
from shlex import quote
from typing import Any

from hiltest.errors import ConfigError
from hiltest.json_files import JsonFile, json_line, json_text, read_as, read_json
from hiltest.verdict.baseline import SCHEMA, UNSEALED_SCHEMA, Baseline

_SILENT = {"measurements": ("limit", "tolerance", "build_id"), "history": ("was_build_id", "revision")}
"""Fields that are omitted from a line if they are null: lines of older files, which lack them, do not change."""

OTHERWISE = "save it again: hiltest baseline save RUN FILE"
"""The next step for a baseline that cannot be read."""


def read_baseline(source: Path | JsonFile, *, to_replace: bool = False) -> Baseline:
    """Read a baseline file.

    Parameters
    ----------
    to_replace
        True if only its history will be kept; the digest of its content may then be wrong.

    Raises
    ------
    ConfigError
        If it is missing, not JSON, of another schema, has a field that is missing or wrong, rows contradict each
        other, or its digest does not match its content.
    """
    file = read_json(source, otherwise=OTHERWISE) if isinstance(source, Path) else source
    schema = UNSEALED_SCHEMA if file.schema == UNSEALED_SCHEMA else SCHEMA
    baseline = read_as(file, Baseline, schema, otherwise=OTHERWISE)
    if schema == SCHEMA and not to_replace:
        _check_digest(file)
    return baseline


def _check_digest(file: JsonFile) -> None:
    digest = file.content.get("digest")
    if digest != content_digest(file.content):
        fault = "it has no digest" if digest is None else "its digest does not match its content"
        path = quote(str(file.path))
        raise ConfigError(
            f"{file.path}: {fault}: it was edited; restore it and accept changes by name (hiltest baseline update "
            f"{path} RUN --accept NAME --because TEXT), or save it again (hiltest baseline save RUN {path})"
        )


def content_digest(content: Mapping[str, Any]) -> str:
    """Return the SHA-256 of a baseline's content without its digest; layout and order of keys have no effect."""
    text = json.dumps({name: value for name, value in content.items() if name != "digest"}, sort_keys=True)
    return sha256(text.encode()).hexdigest()


def to_json(baseline: Baseline, before: Any = None) -> str:
    """Return the text of a baseline file with the digest of its content, one measurement per line for readable diffs.

    Parameters
    ----------
    before
        Previous content of the file; its unknown fields are preserved.
    """
    content = add_unknown_fields(asdict(baseline), _add_silent_fields(before))
    content |= {"schema": SCHEMA, "suites": dict(baseline.suites)}
    for kind, silent in _SILENT.items():
        content[kind] = [
            {name: value for name, value in item.items() if name not in silent or value is not None}
            for item in content[kind]
        ]
    for name in ("passed", "suites", "poses"):
        if not content[name]:
            del content[name]
    content["digest"] = content_digest(content)
    fields = ",\n".join(f"{json_line(name)}: {_field(name, value)}" for name, value in content.items())
    return "{\n" + fields + "\n}\n"


def _add_silent_fields(before: Any) -> Any:
    """Return the previous content with the fields that its lines omit, so that unchanged lines compare equal."""
    if not isinstance(before, dict):
        return before
    return before | {
        kind: [{**item, **{name: item.get(name) for name in silent}} for item in before[kind]]
        for kind, silent in _SILENT.items()
        if kind in before
    }


def _field(name: str, value: Any) -> str:
    if name in ("measurements", "history", "passed"):
        return "[" + ",".join(f"\n {json_line(item)}" for item in value) + "]"
    return json_line(value) if name in ("seeds", "poses") else json_text(value)


def add_unknown_fields(written: Any, read: Any) -> Any:
    """Return the value to write, with the fields of the previous content that the writer does not know.

    Parameters
    ----------
    written
        Value made from dataclasses, which drop unknown fields.
    read
        Previous content of the file.

    Returns
    -------
    JSON value
        An object keeps its unknown fields. An object in a list keeps them only if none of its other fields has changed,
        since they may belong to the old number.

    Examples
    --------
    >>> add_unknown_fields({"a": 2}, {"a": 1, "b": 3})
    {'a': 2, 'b': 3}
    >>> add_unknown_fields([{"name": "x", "a": 1}, {"name": "y", "a": 2}], [{"name": "y", "a": 2, "b": 3}])
    [{'name': 'x', 'a': 1}, {'name': 'y', 'a': 2, 'b': 3}]
    """
    if isinstance(written, Mapping) and isinstance(read, Mapping):
        merged = {key: add_unknown_fields(value, read.get(key)) for key, value in written.items()}
        return merged | {key: value for key, value in read.items() if key not in written}
    if not (isinstance(written, list | tuple) and isinstance(read, list)):
        return written
    before: defaultdict[str, list[Any]] = defaultdict(list)
    for item in read:
        if isinstance(item, Mapping):
            before[str(item.get("name"))].append(item)
    return [
        next((old for old in before[str(item.get("name"))] if _contains(old, item)), item)
        if isinstance(item, Mapping)
        else item
        for item in written
    ]


def _contains(old: Any, new: Any) -> bool:
    """Return whether `old` contains all of `new`."""
    if isinstance(new, Mapping):
        return isinstance(old, Mapping) and all(key in old and _contains(old[key], new[key]) for key in new)
    if isinstance(new, list | tuple):
        return isinstance(old, list) and len(old) == len(new) and all(map(_contains, old, new))
    return bool(old == new)
