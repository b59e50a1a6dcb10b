"""Write docs/json.md and all JSON Schemas anew from the classes of documents: ``python docs/documents.py``."""

from __future__ import annotations

import ast
import dataclasses
import inspect
import re
import textwrap
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import click
from pydantic.json_schema import GenerateJsonSchema

import hiltest
from hiltest.campaigns.bisection import FirstWorse
from hiltest.campaigns.campaign import Seeds
from hiltest.campaigns.explanation import Explanation
from hiltest.campaigns.several_boards import Boards
from hiltest.commands.baseline import Saved, Updated
from hiltest.commands.cli import every_command
from hiltest.commands.decode import Decoded
from hiltest.commands.doctor import Examined
from hiltest.commands.flash import Flashed
from hiltest.commands.init import Copied
from hiltest.commands.listen import Understood
from hiltest.commands.log import Logged
from hiltest.commands.options import Failed
from hiltest.commands.ports import Ports
from hiltest.commands.profile_worst import Worst
from hiltest.commands.report_export import ExportedNumbers
from hiltest.commands.serve import Served
from hiltest.commands.start import Started
from hiltest.commands.timing import Measured, ProfileChecked
from hiltest.json_files import adapter, json_text
from hiltest.judge.judgement import JudgeDocument
from hiltest.log_fitting.allan_page import Allan
from hiltest.log_fitting.fit_result import SampleFit
from hiltest.log_fitting.imu_fit import ImuFitDocument
from hiltest.log_fitting.sample_fit_exports import FitHead
from hiltest.procedures.imu_calibration.contents import ImuCalibration
from hiltest.procedures.recorded_motion import Played
from hiltest.report.comparison_text import Comparisons
from hiltest.report.render import Reported
from hiltest.report.trend.outputs import TrendDocument
from hiltest.run_record.run import Run
from hiltest.studies.study_page import StudyDocument
from hiltest.virtual.profiling.document import ProfileDocument
from hiltest.virtual.profiling.timing_table import Timing

PAGE = Path(__file__).with_name("json.md")
PACKAGE = Path(hiltest.__file__).parent
DOCUMENTS: dict[str, tuple[type, ...]] = {
    "hiltest.run/1": (Run,),
    "hiltest.fit/1": (FitHead, SampleFit),
    "hiltest.profile/1": (ProfileDocument,),
    "hiltest.error/1": (Failed,),
    "hiltest.seeds/1": (Seeds,),
    "hiltest.boards/1": (Boards,),
    "hiltest.comparison/1": (Comparisons,),
    "hiltest.baseline-save/1": (Saved,),
    "hiltest.baseline-update/1": (Updated,),
    "hiltest.bisection/1": (FirstWorse,),
    "hiltest.explanation/1": (Explanation,),
    "hiltest.trend/1": (TrendDocument,),
    "hiltest.report/1": (Reported,),
    "hiltest.export/1": (ExportedNumbers,),
    "hiltest.worst/1": (Worst,),
    "hiltest.timing/1": (Timing,),
    "hiltest.timing-measure/1": (Measured,),
    "hiltest.timing-check/1": (ProfileChecked,),
    "hiltest.ports/1": (Ports,),
    "hiltest.doctor/1": (Examined,),
    "hiltest.init/1": (Copied,),
    "hiltest.start/1": (Started,),
    "hiltest.device-try/1": (Understood,),
    "hiltest.serve/1": (Served,),
    "hiltest.imu-calibration/1": (ImuCalibration,),
    "hiltest.flash/1": (Flashed,),
    "hiltest.log/1": (Logged,),
    "hiltest.fit-imu/1": (ImuFitDocument,),
    "hiltest.allan/1": (Allan,),
    "hiltest.decode/1": (Decoded,),
    "hiltest.play/1": (Played,),
    "hiltest.study/1": (StudyDocument,),
    "hiltest.judge/1": (JudgeDocument,),
}
"""Classes of each schema, whose fields are the keys."""
# Documents with many keys have a page that says what they mean.
PAGES = {
    "hiltest.run/1": "record.md",
    "hiltest.fit/1": "fit.md",
    "hiltest.profile/1": "profile.md",
    "hiltest.imu-calibration/1": "calibrate.md",
    "hiltest.bisection/1": "bisect.md",
    "hiltest.explanation/1": "mcp.md",
    "hiltest.comparison/1": "compare.md",
    "hiltest.trend/1": "trend.md",
    "hiltest.fit-imu/1": "fit-imu.md",
    "hiltest.flash/1": "flash.md",
    "hiltest.play/1": "playback.md",
    "hiltest.judge/1": "judge.md",
}
# Their pages say what the keys of these mean.
LONG = {"hiltest.run/1", "hiltest.fit/1", "hiltest.profile/1"}
HEAD = """\
# JSON of every command

Every command except `hiltest mcp` has `--json`. Standard output is then one JSON document and nothing else, all other
output goes to standard error, and the exit code does not change.

```sh
hiltest compare baseline.json after --json
```

Its first key, `schema`, is a name and the number of a version. The number changes if a key is removed or renamed, or
if its meaning changes; a reader ignores keys that it does not know. Each schema has a JSON Schema (draft 2020-12) in
the folder `schemas` of the package. Every key is always present; a key without a value is null.

If a command ends with an error, it prints a document of `hiltest.error/1` instead of its own. A failed run or
a comparison with regressions is no error: its document is the usual one.

- `hiltest run` prints its record, `run.json`, at its end; a campaign prints `seeds.json`. Arguments after `--`
  belong to pytest.
- `hiltest serve` prints its document in one line as soon as the ports can be opened, and then continues.
- `hiltest calibrate` asks an operator on standard error, and reads the answers from standard input.
- After Ctrl-C `hiltest log` prints its document with exit code 2. Commands that listen until Ctrl-C print their
  document with the exit code of the result.
- `hiltest report export` writes the input of another tool, which is the key `content` with this option.
- `hiltest fit DIR`, the table of many logs, has no JSON: fit each log separately.

This page and the schemas are written by `python docs/documents.py`.

"""


def schema_file(schema: str) -> Path:
    """Return the path of a document's JSON Schema."""
    return PACKAGE / "schemas" / f"{schema.partition('/')[0].removeprefix('hiltest.')}.schema.json"


def schemas_of(command: click.Command) -> list[str]:
    """Return the schemas that the help of a command's --json names."""
    options = (each for each in command.params if isinstance(each, click.Option) and "--json" in each.opts)
    told = next((option.help or "" for option in options), "")
    return re.findall(r"hiltest\.[a-z-]+/\d+", told)


def schema_text(schema: str, *kinds: type) -> str:
    """Return the text of the JSON Schema of a document, which has the keys of the classes `kinds`.

    Descriptions are the docstrings of classes and fields. Keys without a default are required. Keys that a later
    version adds have one, and readers ignore unknown keys.
    """

    class DescribedFields(GenerateJsonSchema):
        def dataclass_schema(self, schema: Any) -> dict[str, Any]:
            described = super().dataclass_schema(schema)
            for name, text in field_descriptions(schema["cls"]).items():
                if name in described.get("properties", {}):
                    described["properties"][name]["description"] = text
            return described

        def field_title_should_be_set(self, schema: Any) -> bool:
            return False

        def nullable_schema(self, schema: Any) -> dict[str, Any]:
            nullable = super().nullable_schema(schema)
            match nullable:
                case {"anyOf": [{"type": str(kind), **details}, {"type": "null"}]} if "enum" not in details:
                    return {**details, "type": [kind, "null"]}
            return nullable

    parts = [adapter(kind).json_schema(mode="validation", schema_generator=DescribedFields) for kind in kinds]
    definitions = {name: definition for part in parts for name, definition in part.pop("$defs", {}).items()}
    for definition in definitions.values():
        definition.pop("title", None)  # its name
    content = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **({"$defs": definitions} if definitions else {}),
        **parts[-1],
        "properties": {"schema": {"const": schema}},
        "required": ["schema", *(key for part in parts for key in part["required"] if key != "schema")],
        "title": schema,
    }
    for part in parts:
        content["properties"] |= part["properties"]
    return json_text(content) + "\n"


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


def meanings(kind: type) -> Iterator[str]:
    """Yield the name of each field, with its meaning if the class states it."""
    described = field_descriptions(kind)
    for field in dataclasses.fields(kind):
        text = described.get(field.name, "").replace("``", "`")
        yield f"`{field.name}`" + (f": {text}" if text else "")


def page() -> str:
    """Return the text of the page."""
    rows = [(f"hiltest {name}", schema) for name, command in every_command() for schema in schemas_of(command)]
    lines = ["| command | schema | keys |", "|---|---|---|"]
    for name, schema in [*rows, ("any", "hiltest.error/1")]:
        file = schema_file(schema).relative_to(PACKAGE.parent)
        kind = None if schema in LONG else DOCUMENTS[schema][0]
        keys = list(meanings(kind)) if kind else []
        more = f"[{PAGES[schema]}]({PAGES[schema]})" if schema in PAGES else ""
        summary = (inspect.cleandoc(kind.__doc__ or "").splitlines()[0].replace("``", "`"),) if kind else ()
        told = "<br>".join([*summary, *keys, *([more] if more else [])])
        shown = f"`{name}`" if name != "any" else "any that ends with an error"
        lines.append(f"| {shown} | [`{schema}`](../src/{file}) | {told} |")
    return HEAD + "\n".join(lines) + "\n"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
    for name, kinds in DOCUMENTS.items():
        schema_file(name).write_text(schema_text(name, *kinds), encoding="utf-8")
