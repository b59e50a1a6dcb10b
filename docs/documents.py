"""Write docs/json.md anew from the commands and the classes of their documents: ``python docs/documents.py``."""

from __future__ import annotations

import dataclasses
import inspect
import re
from collections.abc import Iterator
from pathlib import Path

import click

import hiltest
from hiltest.commands.cli import every_command
from hiltest.documents import DOCUMENTS, schema_file
from hiltest.json_schema import field_descriptions

PAGE = Path(__file__).with_name("json.md")
PACKAGE = Path(hiltest.__file__).parent
# Documents with many keys have a page that says what they mean.
PAGES = {
    "hiltest.run/1": "record.md",
    "hiltest.fit/1": "fit.md",
    "hiltest.profile/1": "profile.md",
    "hiltest.imu-calibration/1": "calibrate.md",
    "hiltest.bisection/1": "bisect.md",
    "hiltest.comparison/1": "compare.md",
    "hiltest.trend/1": "trend.md",
    "hiltest.fit-imu/1": "fit-imu.md",
    "hiltest.flash/1": "flash.md",
    "hiltest.play/1": "playback.md",
}
HEAD = """\
# JSON of every command

Every command has `--json`. Standard output is then one JSON document and nothing else, whatever a person would have
been shown goes to standard error, and the exit code is the one without the option.

```sh
hiltest compare baseline.json after --json
```

Its first key, `schema`, is a name and the number of a version. The number changes when a key is removed, or is called
or means something else; a reader ignores keys that it does not know. Each schema has a JSON Schema (draft 2020-12) in
the package, written from the classes in [documents.py](../src/hiltest/documents.py).

A command that cannot do what it was asked to prints a document of `hiltest.error/1` in the place of its own. A run or
a comparison that is red has done it: its document is the usual one, and says so.

- `hiltest run` prints its record, `run.json`, at its end; a campaign prints `seeds.json`. What stands behind `--` is
  pytest's.
- `hiltest serve` prints its document in one line as soon as the ports can be opened, and goes on until it is ended.
- `hiltest calibrate` asks an operator on standard error, and reads the answers from standard input.
- `hiltest log` that Ctrl-C has ended prints its document, with exit code 2. What listens until Ctrl-C prints it too,
  with the code of what it heard.
- `hiltest report export` writes what another tool reads; with the option that is the key `content`.
- `hiltest fit DIR`, the table of many logs, has none: ask for one log after the other.

The page is written by `python docs/documents.py`.

"""


def schemas_of(command: click.Command) -> list[str]:
    """Return the schemas that the help of a command's --json names."""
    options = (each for each in command.params if isinstance(each, click.Option) and "--json" in each.opts)
    told = next((option.help or "" for option in options), "")
    return re.findall(r"hiltest\.[a-z-]+/\d+", told)


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
        kind = DOCUMENTS.get(schema)
        keys = list(meanings(kind)) if kind else []
        more = f"[{PAGES[schema]}]({PAGES[schema]})" if schema in PAGES else ""
        summary = (inspect.cleandoc(kind.__doc__ or "").splitlines()[0].replace("``", "`"),) if kind else ()
        told = "<br>".join([*summary, *keys, *([more] if more else [])])
        shown = f"`{name}`" if name != "any" else "any that ends with an error"
        lines.append(f"| {shown} | [`{schema}`](../src/{file}) | {told} |")
    return HEAD + "\n".join(lines) + "\n"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
