"""Reading and writing a baseline file; imports pydantic, which takes its time."""

from __future__ import annotations

import json
from dataclasses import asdict
from hashlib import sha256
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from hiltest.errors import ConfigError
from hiltest.strict_json import LARGEST_BYTES, parsed, read_bounded, read_json, refuse_twice, shown
from hiltest.unknown_fields import with_unknown
from hiltest.verdict.baseline import SCHEMA, Baseline, evidence_from
from hiltest.verdict.evidence import Evidence

_SILENT = {"measurements": ("limit", "tolerance", "build_id"), "history": ("was_build_id", "revision")}
"""Left out of a line where they are null, as in a file from before they were kept: no line of it may change."""

_ADAPTER = TypeAdapter(Baseline)
_OTHERWISE = "save it again: hiltest baseline save RUN FILE"


def read_baseline(path: Path) -> Baseline:
    """Read a baseline file.

    Raises
    ------
    ConfigError
        If it is missing, not JSON, of another schema, or has a field that is missing or wrong; it says which.
    """
    return _baseline_in(path, read_bounded(path, largest_bytes=LARGEST_BYTES, otherwise=_OTHERWISE))


def read_baseline_evidence(path: Path) -> Evidence:
    """Read a baseline file as one side of a comparison.

    Raises
    ------
    ConfigError
        As `read_baseline`.
    """
    content = read_bounded(path, largest_bytes=LARGEST_BYTES, otherwise=_OTHERWISE)
    return evidence_from(_baseline_in(path, content), str(path), sha256(content).hexdigest())


def read_content(path: Path) -> Any:
    """Return what JSON says in a file that `read_baseline` has read, with fields that only a newer hiltest knows."""
    return read_json(path, largest_bytes=LARGEST_BYTES, otherwise=_OTHERWISE)


def to_json(baseline: Baseline, before: Any = None) -> str:
    """Return the text of a baseline file: a measurement a line, for readable diffs.

    Parameters
    ----------
    baseline : Baseline
    before : JSON value, optional
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


def _baseline_in(path: Path, text: bytes) -> Baseline:
    content = parsed(path, text, otherwise=_OTHERWISE)
    found = content.get("schema") if isinstance(content, dict) else None
    if found != SCHEMA:
        raise ConfigError(f"{path}: schema is {shown(found)}, this hiltest reads {shown(SCHEMA)}; {_OTHERWISE}")
    try:
        # As JSON, and strictly: a number in quotes is no number, and a list is what a tuple is written as.
        baseline = _ADAPTER.validate_json(json.dumps(content), strict=True)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(step) for step in first["loc"])
        raise ConfigError(f"{path}: {place}: {first['msg']}; {_OTHERWISE}") from error
    _check_rows(path, baseline)
    return baseline


def _check_rows(path: Path, baseline: Baseline) -> None:
    if not baseline.seeds:
        raise ConfigError(f"{path}: it is of no run at all: seeds is empty; {_OTHERWISE}")
    if not baseline.measurements:
        raise ConfigError(f"{path}: there is nothing to compare with: measurements is empty; {_OTHERWISE}")
    refuse_twice(path, "seed", baseline.seeds, otherwise=_OTHERWISE)
    refuse_twice(path, "measurement", [row.name for row in baseline.measurements], otherwise=_OTHERWISE)
    for row in baseline.measurements:
        if len(row.values) != len(baseline.seeds):
            counts = f"{len(row.values)} values for {len(baseline.seeds)} seeds"
            raise ConfigError(f"{path}: {shown(row.name)} has {counts}; {_OTHERWISE}")
        if all(value is None for value in row.values):
            raise ConfigError(f"{path}: {shown(row.name)} has no number; {_OTHERWISE}")


def _json(value: object) -> str:
    return json.dumps(value, allow_nan=False, ensure_ascii=False)


def _field(name: str, value: Any) -> str:
    if name in ("measurements", "history", "passed"):
        return "[" + ",".join(f"\n {_json(each)}" for each in value) + "]"
    return _json(value) if name == "seeds" else json.dumps(value, indent=1, allow_nan=False, ensure_ascii=False)
