"""What a test found, and how it travels: on the item while the test runs, then as plain data on its reports."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

    from hiltest.measurement import Measurement
    from hiltest.report.record import Table

# Attributes of a report, plain data, so that they survive the way from a worker.
CAUSE = "hil_cause"
"""Whose fault a failure is, when it is not the test's own."""
REASON = "hil_reason"
"""What the bench or the firmware did, in one line."""
TRACE = "hil_trace"
"""The wire trace of a failed test, relative to the run's folder."""
FOUND_HERE = "hil_found"
"""Measurements and tables, as `pack` made them."""
BENCH = "hil_bench"
"""From a worker: whether there is a rig, and which board with which seed."""


@dataclass(slots=True)
class Found:
    """What one test measured since its last report."""

    measurements: list[Measurement] = field(default_factory=list)
    tables: list[Table] = field(default_factory=list)


FOUND: pytest.StashKey[Found] = pytest.StashKey()
FOUND_AT_ITS_END: pytest.StashKey[Found] = pytest.StashKey()
"""What the report of a tear-down took of it."""
GATING: pytest.StashKey[list[Measurement]] = pytest.StashKey()


def carry_over(item: pytest.Item) -> None:
    """Take again, at the set-up of another attempt, what the tear-down of the one before measured.

    pytest-rerunfailures before 16 shows nobody the reports that follow a failed one.
    """
    before = item.stash.get(FOUND_AT_ITS_END, None)
    if before is not None:
        item.stash.setdefault(FOUND, Found()).measurements.extend(before.measurements)


def pack(found: Found) -> dict[str, Any]:
    """Return plain data that a report can carry from a worker to the controller: no enum, no number of numpy's."""
    return {
        "measurements": [plain_data(each.rounded()) for each in found.measurements],
        "tables": [plain_data(each.rounded()) for each in found.tables],
    }


def plain_data(record: DataclassInstance) -> dict[str, Any]:
    """Return what `asdict` makes of a part of the record, of JSON's own kinds alone."""
    plain: dict[str, Any] = json.loads(json.dumps(asdict(record)))
    return plain


def properties_of(measurement: Measurement) -> list[tuple[str, object]]:
    """Return what junit.xml says of a measurement."""
    name = f"hil.{measurement.name}"
    shown = measurement.rounded()
    properties: list[tuple[str, object]] = [
        (name, "" if shown.value is None else shown.value), (f"{name}.unit", shown.unit),
        (f"{name}.outcome", str(shown.outcome)),
    ]
    if shown.limit is not None:
        properties.append((f"{name}.limit", str(shown.limit)))
    if shown.cycle_model:
        properties.append((f"{name}.cycle_model", shown.cycle_model))
    return properties
