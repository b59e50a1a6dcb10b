"""Quantiles of a study with their confidence intervals, as columns of its table and as measurements."""

from __future__ import annotations

from hiltest.measurement import Measurement, check
from hiltest.measurement.estimates import Estimate
from hiltest.run_record.run import Column

ENDS = ("at least", "at most")
"""Ends of a column's 95 % interval, which are the next two columns."""


def quantile_columns(name: str, unit: str = "") -> tuple[Column, ...]:
    """Return the columns of an `Estimate`: its value, and the ends of its interval."""
    return Column(name, unit), *(Column(f"{name}, {end}", unit) for end in ENDS)


def quantile_measurement(name: str, estimate: Estimate, unit: str) -> Measurement:
    """Return a measurement whose note is the interval."""
    return check(name, estimate.value, unit=unit, note=f"95 % confidence interval {estimate.interval}")
