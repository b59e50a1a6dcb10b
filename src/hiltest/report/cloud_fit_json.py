"""A fitted cloud as JSON, for programs: schema ``hiltest.fit/1``."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from hiltest import __version__
from hiltest.procedures.cloud_fit import CloudFit

SCHEMA = "hiltest.fit/1"
SCHEMA_FILE = Path(__file__).with_name("fit.schema.json")


def to_json(fit: CloudFit) -> str:
    """Return the text of a fitted cloud, checked by ``fit.schema.json``."""
    best = fit.best
    content = {
        "schema": SCHEMA, "hiltest": __version__, "verdict": best.verdict, "best": best.name, **asdict(fit),
    }  # fmt: skip
    return json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def schema_text() -> str:
    """Return the text of the shipped ``fit.schema.json``, generated from the classes."""
    from pydantic import TypeAdapter

    schema: dict[str, Any] = TypeAdapter(CloudFit).json_schema(mode="serialization")
    schema["properties"] = {
        "schema": {"const": SCHEMA}, "hiltest": {"type": "string"},
        "verdict": {"$ref": "#/$defs/Acceptance"}, "best": {"type": "string"}, **schema["properties"],
    }  # fmt: skip
    schema["required"] = list(schema["properties"])
    schema = {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema, "title": SCHEMA}
    return json.dumps(schema, indent=1, ensure_ascii=False) + "\n"
