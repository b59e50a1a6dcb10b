"""pytest-benchmark's tables of device cycles, beside its tables of seconds.

Every pytest run with pytest-benchmark and its command line import this module, so it imports nothing heavy.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

CYCLES, CYCLE_MODEL, CORE_CLOCK_HZ = "cycles", "cycle_model", "core_clock_hz"
FROM_FLOAT64_DEG = "from_float64_deg"
"""Keys of the extra_info of a benchmark of device cycles."""

#: One row: a mapping.
Row = Any
Groups = Iterable[tuple[str | None, list[Row]]]

_PREFIXES = {"ns": ("n", 1e9), "us": ("u", 1e6), "ms": ("m", 1e3), "s": ("", 1.0)}


def group_name(kernel: str | None, cycle_model: str) -> str:
    """Name the table of one kernel under one cycle model: numbers of two models are never ranked together."""
    return ", ".join(filter(None, (kernel, f"cycles of {cycle_model}")))


def cycle_model_of(row: Row) -> str:
    """Return the cycle model of a benchmark; empty for one that a host clock has timed."""
    return str(_extra_info(row).get(CYCLE_MODEL, ""))


def scale_cycles(
    unit: str, rows: Sequence[Row], best: Mapping[str, float], time_unit: str | None
) -> tuple[str, float] | None:
    """Return unit and factor of a table of device cycles, like ``pytest_benchmark_scale_unit``.

    Parameters
    ----------
    unit
        ``seconds``, or ``operations`` for the operations per second.
    rows
        Rows of one table.
    best
        Best number of each column; from `rows` if a release of pytest-benchmark gives none.
    time_unit
        Value of ``--benchmark-time-unit``: time at the board's core clock instead of cycles.

    Returns
    -------
    tuple of str and float, or None
        Prefix of the unit before the "s", and a factor; None for a table that is not all cycles.
    """
    if not rows or not all(map(cycle_model_of, rows)):
        return None
    clock_hz = float(_extra_info(rows[0])[CORE_CLOCK_HZ])
    if unit == "operations":
        ops = clock_hz * best.get("ops", rows[0]["ops"])
        prefix, factor = ("M", 1e-6) if ops > 1e6 else ("K", 1e-3) if ops > 1e3 else ("", 1.0)
        return prefix, clock_hz * factor
    if time_unit in _PREFIXES:
        prefix, factor = _PREFIXES[time_unit]
        return prefix, factor / clock_hz
    _name_unit_in_histograms()
    return "cycle", 1.0


def split_by_cycle_model(groups: Groups) -> list[tuple[str | None, list[Row]]]:
    """Split the device cycles by model and core clock into separate tables, for any grouping of the rows.

    The title has the distance of the rows from float64 if known, because speed is never shown without accuracy.
    """
    tables: list[tuple[str | None, list[Row]]] = []
    for name, rows in groups:
        of_model: dict[tuple[str, float], list[Row]] = defaultdict(list)
        for row in rows:
            of_model[cycle_model_of(row), _extra_info(row).get(CORE_CLOCK_HZ, 0.0)].append(row)
        clocks = {clock_hz for _, clock_hz in of_model if clock_hz}
        for (model, clock_hz), model_rows in sorted(of_model.items()):
            # A conftest.py and the plugin may both call this.
            named_already = not model or group_name(None, model) in (name or "")
            title, accuracy = name if named_already else group_name(name, model), _accuracy(model_rows)
            title = f"{title}, at {clock_hz / 1e6:g} MHz" if clock_hz and len(clocks) > 1 else title
            tables.append((title if accuracy in (title or "") else f"{title}; {accuracy}", model_rows))
    return tables


def _accuracy(rows: Sequence[Row]) -> str:
    distances = [float(_extra_info(row)[FROM_FLOAT64_DEG]) for row in rows if FROM_FLOAT64_DEG in _extra_info(row)]
    return f"at most {max(distances):.2g} deg from float64 of the same points" if distances else ""


def _extra_info(row: Row) -> Mapping[str, Any]:
    return row.get("extra_info") or {}


def _name_unit_in_histograms() -> None:
    """Add the unit's name for ``--benchmark-histogram``, whose titles only know prefixes of seconds."""
    from pytest_benchmark.utils import TIME_UNITS

    TIME_UNITS.setdefault("cycle", "cycles")
