"""A trend for programs."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from itertools import groupby
from typing import Any

from hiltest.measurement import Outcome
from hiltest.trend.folder import Skipped
from hiltest.trend.series import Measured, Point, RunEntry, Series, Step, Trend

SCHEMA = "hiltest.trend/1"


def to_json(trend: Trend, skipped: Sequence[Skipped]) -> str:
    """Return the text of ``hiltest trend --json``; entries and lines are numbered from 0, in their order here."""
    content = {
        "schema": SCHEMA,
        "entries": [_entry(each) for each in trend.entries],
        "lines": [asdict(each) for each in trend.lines],
        "measurements": [_measured(each) for each in trend.measured],
        "skipped": [asdict(each) for each in skipped],
    }
    return json.dumps(content, ensure_ascii=False, allow_nan=False) + "\n"


def _entry(entry: RunEntry) -> dict[str, Any]:
    side = asdict(entry.evidence.side)
    return {**side, "file": entry.file, "when_utc": entry.when_utc, "faults": list(entry.evidence.faults)}


def _measured(measured: Measured) -> dict[str, Any]:
    return {"name": measured.name, "unit": measured.unit, "series": [_series(each) for each in measured.series]}


def _series(series: Series) -> dict[str, Any]:
    points = series.points
    spread = any(point.low < point.high for point in points)
    return {
        "line": series.line, "cycle_model": series.cycle_model, "entries": [point.entry for point in points],
        "values": [point.value for point in points],
        "lowest": [point.low for point in points] if spread else None,
        "highest": [point.high for point in points] if spread else None,
        "limits": [_limit(stretch) for _, stretch in groupby(points, key=lambda point: point.limit)],
        "failed": [point.entry for point in points if point.outcome == Outcome.FAIL],
        "steps": [_step(each) for each in series.steps],
    }  # fmt: skip


def _limit(stretch: Iterator[Point]) -> dict[str, Any]:
    """Return a limit and the first entry that has it."""
    first = next(stretch)
    return {"entry": first.entry, "limit": first.limit and asdict(first.limit)}


def _step(step: Step) -> dict[str, Any]:
    found = step.difference
    return {
        "before": step.before, "after": step.after, "change": found.change, "base": found.base, "new": found.new,
        "delta": found.delta, "interval": found.interval, "tolerance": asdict(found.tolerance),
    }  # fmt: skip
