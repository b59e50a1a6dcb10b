"""Check and read ``run.json``. The only report module that imports pydantic.

``python -m hiltest.record.schema`` writes the shipped JSON Schema anew.
"""

from __future__ import annotations

import json
from hashlib import sha256
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from hiltest.errors import ConfigError
from hiltest.record.run import SCHEMA, Run
from hiltest.strict_json import LARGEST_BYTES, parsed, read_bounded, refuse_twice, shown

SCHEMA_FILE = Path(__file__).with_name("run.schema.json")

DESCRIPTION = (
    "The record of one run of hiltest, the only source of every report. The number behind the slash is the major "
    "version, and it changes when a field is removed, or is called or means something else. What changes without it "
    "is minor: a field that is new, is optional, and leaves all others as they were. Whoever reads a record "
    "ignores fields that it does not know, and keeps them when it writes the record again; it refuses another major."
)

_ADAPTER = TypeAdapter(Run)
OTHERWISE = "render another record, or run again: hiltest run"
"""The next step for a record that cannot be read."""


def run_schema() -> dict[str, Any]:
    """Return the JSON Schema of ``run.json``, generated from the record's classes.

    Required is what has no default: a field that was added later has one, so that older records are valid.
    """
    schema = _ADAPTER.json_schema(mode="validation")
    head = {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": SCHEMA, "description": DESCRIPTION}
    about = schema.pop("description", None)
    return {**head, "$comment": about, **{key: value for key, value in schema.items() if key != "title"}}


def schema_text() -> str:
    """Return the text of the shipped ``run.schema.json``."""
    return json.dumps(run_schema(), indent=1, ensure_ascii=False) + "\n"


def load_content(path: Path, *, otherwise: str = OTHERWISE) -> tuple[dict[str, Any], str]:
    """Read what JSON says in a ``run.json``, with every field that only a newer hiltest knows, and its SHA-256.

    Parameters
    ----------
    path : Path
    otherwise : str, optional
        What to do where it is no JSON.

    Raises
    ------
    ConfigError
        If the file is missing, not JSON, or of another schema.
    """
    text = read_bounded(path, largest_bytes=LARGEST_BYTES, otherwise=otherwise)
    content = parsed(path, text, otherwise=otherwise)
    check_schema(path, content)
    checked: dict[str, Any] = content
    return checked, sha256(text).hexdigest()


def check_schema(path: Path, content: object) -> None:
    """Refuse what is no record of a run, and what is one of another major version.

    Raises
    ------
    ConfigError
        It says what to do.
    """
    found = content.get("schema") if isinstance(content, dict) else None
    if found == SCHEMA:
        return
    said = f"{path}: schema is {shown(found)}, this hiltest reads {shown(SCHEMA)}"
    if not isinstance(found, str) or found.partition("/")[0] != SCHEMA.partition("/")[0]:
        raise ConfigError(f"{said}: it is no record of a run")
    raise ConfigError(f"{said}: use the version that wrote it{_writer(content)}, or make the run again with this one")


def run_from(content: dict[str, Any], path: Path) -> Run:
    """Make a record of what JSON says.

    Raises
    ------
    ConfigError
        If a field is missing or wrong; it says which. Unknown fields are no error.
    """
    try:
        # As JSON, and strictly: a number in quotes is no number, and a list is what a tuple is written as.
        run = _ADAPTER.validate_json(json.dumps(content), strict=True)
    except ValidationError as error:
        first = error.errors()[0]
        place = "".join(f"{step}." for step in first["loc"])[:-1]
        raise ConfigError(f"{path}: {place or 'as a whole'}: {first['msg']}; {OTHERWISE}") from error
    _check_tables(run, path)
    refuse_twice(path, "measurement", [each.name for each in run.measurements], otherwise=OTHERWISE)
    return run


def _check_tables(run: Run, path: Path) -> None:
    refuse_twice(path, "table", [each.name for each in run.tables], otherwise=OTHERWISE)
    for table in run.tables:
        kind, columns = f"column of table {shown(table.name)}:", [each.name for each in table.columns]
        refuse_twice(path, kind, columns, otherwise=OTHERWISE)
        for number, row in enumerate(table.rows, 1):
            if len(row) != len(table.columns):
                cells = f"{len(row)} cells in {len(table.columns)} columns"
                raise ConfigError(f"{path}: table {shown(table.name)}, row {number}: {cells}; {OTHERWISE}")


def _writer(content: object) -> str:
    """Return which version wrote a record, as far as one can tell of another schema."""
    try:
        return f" (hiltest {shown(content['environment']['versions']['hiltest'])})"  # type: ignore[index]
    except (LookupError, TypeError):
        return ""


if __name__ == "__main__":
    SCHEMA_FILE.write_text(schema_text(), encoding="utf-8")
