"""Check and read ``run.json``. The only report module that imports pydantic."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from hiltest.errors import ConfigError
from hiltest.report.record import SCHEMA, Run

SCHEMA_FILE = Path(__file__).with_name("run.schema.json")

_ADAPTER = TypeAdapter(Run)


def run_schema() -> dict[str, Any]:
    """Return the JSON Schema of ``run.json``, generated from the record's classes."""
    schema = _ADAPTER.json_schema(mode="serialization")
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": SCHEMA, **_without_title(schema)}


def schema_text() -> str:
    """Return the text of the shipped ``run.schema.json``."""
    return json.dumps(run_schema(), indent=1, ensure_ascii=False) + "\n"


def load_run(path: Path) -> Run:
    """Read a ``run.json``.

    Raises
    ------
    ConfigError
        If the file is missing, not JSON, of another schema, or lacks a field; it says which.
    """
    try:
        text = path.read_text(encoding="utf-8")
        content = json.loads(text)
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}") from error
    except ValueError as error:
        raise ConfigError(f"{path}: not JSON: {error}") from error
    found = content.get("schema") if isinstance(content, dict) else None
    if found != SCHEMA:
        raise ConfigError(f"{path}: schema is {found!r}, this hiltest reads {SCHEMA!r}; use the version that wrote it")
    try:
        return _ADAPTER.validate_json(text)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(step) for step in first["loc"])
        raise ConfigError(f"{path}: {place}: {first['msg']}") from error


def _without_title(schema: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in schema.items() if key != "title"}
