"""Bugs that people published, rebuilt in the sample compass, and the run that looks for each."""

from __future__ import annotations

import gc
import json
import math
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hiltest.rig.bench_files import shipped

from ..end_to_end.firmware_edits import Edit, FirmwareCopy
from ..in_process import hiltest

FILE = Path(__file__).with_name("exhibits.toml")
PAGE = Path(__file__).parents[2] / "docs" / "museum.md"
UNCHANGED = Edit("compass/main.c", "int main(void)", "int main(void)")
"""Builds the fixed twin of every exhibit."""
# Changes to the shipped rig of the sample compass: shorter waits, and no cycles.
_CHANGES = {
    'kind = "text"\n': 'kind = "text"\nwindow_s = 0.5\nsettle_s = 3.0\n',
    'fit = "magnetometer_direct"\ntilt = "tilt_heading"\n': "",
}


@dataclass(frozen=True)
class Exhibit:
    """One published bug."""

    name: str
    project: str
    report: str
    """Address of the report."""
    bug: str
    cause: str
    """Short key of the cause that hiltest must name."""
    says: str
    """Words of the verdict if it names the cause today; else empty."""
    edit: Edit


@dataclass(frozen=True)
class Visit:
    """Result of one run."""

    code: int
    sentence: str
    """Sentence of the verdict."""
    level_deg: float
    tilted_deg: float
    """Largest heading errors; NaN if the run measured no heading."""


def exhibits() -> tuple[Exhibit, ...]:
    """Return all exhibits, in the order of the file."""
    rows = tomllib.loads(FILE.read_text(encoding="utf-8"))["exhibit"]
    keys = ("name", "project", "report", "bug", "cause")
    return tuple(
        Exhibit(*(row[key] for key in keys), row.get("says", ""), Edit(row["file"], row["old"], row["new"]))
        for row in rows
    )


def visit(firmware: FirmwareCopy, edit: Edit, folder: Path) -> Visit:
    """Build the sample compass with an edit, and run hiltest on it in a folder."""
    elf = firmware.build_compass(edit, folder / "exhibit.elf")
    rig = (shipped() / "rigs" / "text-compass.toml").read_text(encoding="utf-8")
    for old, new in _CHANGES.items():
        assert rig.count(old) == 1, f"{old!r} is there {rig.count(old)} times"
        rig = rig.replace(old, new)
    (folder / "museum.toml").write_text(rig, encoding="utf-8")
    ended = hiltest("run", "--rig", "museum.toml", "--firmware", elf, folder=folder)
    gc.unfreeze()  # a run freezes its objects, which are its board and its record, before its process ends
    gc.collect()
    record = json.loads((folder / "hil-out" / "run.json").read_text(encoding="utf-8"))
    level_deg, tilted_deg = _largest_errors(record["tables"])
    return Visit(ended.returncode, record["verdict"]["sentence"], level_deg, tilted_deg)


def _largest_errors(tables: Sequence[dict[str, Any]]) -> tuple[float, float]:
    """Return the largest heading error of the level poses and that of the tilted ones [deg], from a record's tables."""
    errors: dict[bool, list[float]] = {True: [], False: []}
    for table in tables:
        if table["name"] == "heading.poses":
            columns = [column["name"] for column in table["columns"]]
            for row in table["rows"]:
                errors[row[columns.index("level")]].append(abs(row[columns.index("error.firmware")]))
    return max(errors[True], default=math.nan), max(errors[False], default=math.nan)


def page_row(exhibit: Exhibit, result: Visit) -> str:
    """Return the row of the page for an exhibit."""
    cause = result.sentence.partition(" Next: ")[0].partition("Likely cause: ")[2]
    verdict = cause or result.sentence.removeprefix("FAIL. ").partition(". ")[0]
    degrees = ["-" if math.isnan(value) else f"{value:.1f}" for value in (result.level_deg, result.tilted_deg)]
    link = f"[{exhibit.project}]({exhibit.report})"
    return f"| {exhibit.bug} | {link} | {' | '.join(degrees)} | {verdict.rstrip('.')} | {exhibit.cause} |"
