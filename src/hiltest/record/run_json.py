"""``run.json``: the text of a run's record, and parts of the record from their text."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from hiltest.measurement import CycleBand, Limit, Measurement, Outcome, RowEffect
from hiltest.record.files import RUN_FILE, write_atomically
from hiltest.record.run import BoardRecord, Column, Run, SensorRecord, Table


def to_json(run: Run) -> str:
    """Return the text of ``run.json``."""
    return content_to_json(asdict(run))


def content_to_json(content: Mapping[str, Any]) -> str:
    """Return the text of a record's fields: one test, measurement or table row a line, for readable diffs."""
    fields = ",\n".join(f"{_json(name)}: {_field(name, value)}" for name, value in content.items())
    return "{\n" + fields + "\n}\n"


def write_run(run: Run, folder: Path) -> Path:
    """Write ``run.json`` so that a reader sees the whole file or none."""
    return write_atomically(folder / RUN_FILE, to_json(run))


def measurement_from(content: Mapping[str, Any]) -> Measurement:
    """Make a measurement from what `asdict` made of one."""
    limits = {key: content[key] and Limit(**content[key]) for key in ("limit", "information")}
    band = content.get("band") and CycleBand(
        content["band"]["low"], content["band"]["high"], tuple(RowEffect(**each) for each in content["band"]["rows"])
    )
    return Measurement(**{**content, **limits, "outcome": Outcome(content["outcome"]), "band": band})


def board_from(content: Mapping[str, Any]) -> BoardRecord:
    """Make a board's record from what `asdict` made of one."""
    sensors = tuple(SensorRecord(**sensor) for sensor in content["sensors"])
    return BoardRecord(**{**content, "sensors": sensors, "calibrators": tuple(content["calibrators"])})


def table_from(content: Mapping[str, Any]) -> Table:
    """Make a table from what `asdict` made of one."""
    return Table(
        content["name"],
        tuple(Column(**column) for column in content["columns"]),
        tuple(tuple(row) for row in content["rows"]),
    )


def _json(value: object) -> str:
    return json.dumps(value, allow_nan=False, ensure_ascii=False)


def _field(name: str, value: Any) -> str:
    if name == "tables":
        return _lines([_table_text(table) for table in value])
    if name == "comparison" and value is not None:
        return "{" + ",\n ".join(f"{_json(key)}: {_field(key, each)}" for key, each in value.items()) + "}"
    if name == "tolerances":
        return "{" + ",".join(f"\n {_json(key)}: {_json(each)}" for key, each in value.items()) + "}"
    if name in ("tests", "measurements", "other_attempts", "differences"):
        return _lines([_json(each) for each in value])
    return json.dumps(value, indent=1, allow_nan=False, ensure_ascii=False)


def _table_text(table: Mapping[str, Any]) -> str:
    others = "".join(f"{_json(key)}: {_json(each)}, " for key, each in table.items() if key != "rows")
    return f"{{{others.rstrip()}\n  {_json('rows')}: {_lines([_json(row) for row in table['rows']], indent='   ')}}}"


def _lines(texts: Sequence[str], indent: str = " ") -> str:
    return "[" + ",".join(f"\n{indent}{text}" for text in texts) + "]"
