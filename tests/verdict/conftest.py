"""A real record, and copies of it with something changed."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from ..written_run import board, findings, good, heading

__all__ = ["board", "findings", "good", "heading"]

Changed = Callable[..., Path]


@pytest.fixture(scope="session")
def real_record(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """``run.json`` of the main job on the default bench."""
    folder = tmp_path_factory.mktemp("real")
    environment = {name: value for name, value in os.environ.items() if not name.startswith("HIL_")}
    done = subprocess.run(
        [sys.executable, "-m", "hiltest", "run"], cwd=folder, env=environment, capture_output=True, text=True,
        check=False, timeout=300,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    record: dict[str, Any] = json.loads((folder / "hil-out" / "run.json").read_text(encoding="utf-8"))
    return record


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
        names = {each["name"]: each for each in record["measurements"]}
        for name, value in (values or {}).items():
            names[name]["value"] = value
        (tmp_path / folder).mkdir(parents=True, exist_ok=True)
        file = tmp_path / folder / "run.json"
        file.write_text(json.dumps(record), encoding="utf-8")
        return file

    return write
