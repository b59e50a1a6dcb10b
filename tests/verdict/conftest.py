"""A real record, and copies of it with something changed."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from ..written_run import board, findings, good, heading

__all__ = ["board", "findings", "good", "heading"]

Changed = Callable[..., Path]


@pytest.fixture
def changed(real_record: dict[str, Any], tmp_path: Path) -> Changed:
    """Return a function that writes the real record, with changes by path or by measurement, into a folder."""

    def write(folder: str, fields: dict[str, Any] | None = None, values: dict[str, Any] | None = None) -> Path:
        record = json.loads(json.dumps(real_record))
        for path, value in (fields or {}).items():
            *parents, last = path.split(".")
            place = record
            for step in parents:
                place = place[step]
            assert last in place, path
            place[last] = value
        names = {measurement["name"]: measurement for measurement in record["measurements"]}
        for name, value in (values or {}).items():
            names[name]["value"] = value
        (tmp_path / folder).mkdir(parents=True, exist_ok=True)
        file = tmp_path / folder / "run.json"
        file.write_text(json.dumps(record), encoding="utf-8")
        return file

    return write
