"""JSON Schemas of dataclasses, whose property descriptions are the docstrings of the fields."""

from __future__ import annotations

import ast
import inspect
import textwrap
from itertools import pairwise
from typing import Any

from pydantic.json_schema import GenerateJsonSchema


def field_descriptions(kind: type) -> dict[str, str]:
    """Return the docstring of each field of a class that has one, in one line."""
    (definition,) = ast.parse(textwrap.dedent(inspect.getsource(kind))).body
    assert isinstance(definition, ast.ClassDef)
    return {
        field.target.id: " ".join(text.value.value.split())
        for field, text in pairwise(definition.body)
        if isinstance(field, ast.AnnAssign)
        and isinstance(field.target, ast.Name)
        and isinstance(text, ast.Expr)
        and isinstance(text.value, ast.Constant)
        and isinstance(text.value.value, str)
    }


class DescribedFields(GenerateJsonSchema):
    """Generator of schemas whose properties have descriptions: ``TypeAdapter.json_schema(schema_generator=...)``."""

    def dataclass_schema(self, schema: Any) -> dict[str, Any]:
        """Return the schema of a dataclass."""
        described = super().dataclass_schema(schema)
        for name, text in field_descriptions(schema["cls"]).items():
            if name in described.get("properties", {}):
                described["properties"][name]["description"] = text
        return described
