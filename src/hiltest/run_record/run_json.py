"""``run.json``: the text of a run's record, and parts of the record from their text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeVar

from hiltest.json_files import adapter, json_line, json_text
from hiltest.measurement import Measurement
from hiltest.run_record.files import RUN_FILE, write_atomically
from hiltest.run_record.run import BoardRecord, Run, Table

Part = TypeVar("Part", BoardRecord, Measurement, Table)


def to_json(run: Run) -> str:
    """Return the text of ``run.json``."""
    return content_to_json(asdict(run))


def content_to_json(content: Mapping[str, Any]) -> str:
    """Return the text of a record's fields, one test, measurement or table row per line, for readable diffs."""
    fields = ",\n".join(f"{json_line(name)}: {_field(name, value)}" for name, value in content.items())
    return "{\n" + fields + "\n}\n"


def write_run(run: Run, folder: Path) -> Path:
    """Write ``run.json`` so that a reader sees the whole file or none."""
    return write_atomically(folder / RUN_FILE, to_json(run))


def part_from(kind: type[Part], content: Mapping[str, Any]) -> Part:
    """Make a part of the record from the result of `asdict`."""
    part: Part = adapter(kind).validate_python(content)
    return part


def _field(name: str, value: Any) -> str:
    if name == "tables":
        return _lines([_table_text(table) for table in value])
    if name == "comparison" and value is not None:
        return "{" + ",\n ".join(f"{json_line(key)}: {_field(key, content)}" for key, content in value.items()) + "}"
    if name == "tolerances":
        return "{" + ",".join(f"\n {json_line(key)}: {json_line(content)}" for key, content in value.items()) + "}"
    if name in ("tests", "measurements", "other_attempts", "differences"):
        return _lines([json_line(item) for item in value])
    return json_text(value)


def _table_text(table: Mapping[str, Any]) -> str:
    others = "".join(f"{json_line(key)}: {json_line(content)}, " for key, content in table.items() if key != "rows")
    rows = _lines([json_line(row) for row in table["rows"]], indent="   ")
    return f'{{{others.rstrip()}\n  "rows": {rows}}}'


def _lines(texts: Sequence[str], indent: str = " ") -> str:
    return "[" + ",".join(f"\n{indent}{text}" for text in texts) + "]"
