"""The JSON Schema of ``run.json``.

``python -m hiltest.run_record.schema`` regenerates the shipped JSON Schema.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from hiltest.json_schema import DescribedFields
from hiltest.run_record.run import SCHEMA, Run

SCHEMA_FILE = Path(__file__).with_name("run.schema.json")

DESCRIPTION = (
    "The record of one run of hiltest, the only source of every report. The number behind the slash is the major "
    "version, and it changes when a field is removed, or is called or means something else. What changes without it "
    "is minor: a field that is new, is optional, and leaves all others as they were. Whoever reads a record "
    "ignores fields that it does not know, and keeps them when it writes the record again; it refuses another major."
)


def run_schema() -> dict[str, Any]:
    """Return the JSON Schema of ``run.json``, generated from the record's classes.

    Fields without a default are required. Fields that were added later have one, so that older records are valid.
    """
    schema = TypeAdapter(Run).json_schema(mode="validation", schema_generator=DescribedFields)
    head = {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": SCHEMA, "description": DESCRIPTION}
    about = schema.pop("description", None)
    return {**head, "$comment": about, **{key: value for key, value in schema.items() if key != "title"}}


def schema_text() -> str:
    """Return the text of the shipped ``run.schema.json``."""
    return json.dumps(run_schema(), indent=1, ensure_ascii=False) + "\n"


if __name__ == "__main__":
    SCHEMA_FILE.write_text(schema_text(), encoding="utf-8")
