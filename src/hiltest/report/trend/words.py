"""A trend in words, for the terminal and the page."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence

from hiltest.report.trend.series import ChangePoint, MeasurementTrend, Trend, TrendLine
from hiltest.text import format_number
from hiltest.verdict.evidence import Evidence
from hiltest.verdict.wording import counted_by, model_names, numbers, revision

HEADINGS = ("measurement", "runs", "first", "last", "lowest", "highest", "unit", "limit", "change points")
NUMERIC = frozenset({"runs", "first", "last", "lowest", "highest"})


def sentence(trend: Trend) -> str:
    """Return the changes of all measurements, in one sentence."""
    runs, steps = len(trend.entries), trend.change_points
    span = f"{runs} run{'s' * (runs > 1)} from {trend.entries[0].when_utc} to {trend.entries[-1].when_utc}"
    lines = f" under {len(trend.lines)} conditions that are not comparable" if len(trend.lines) > 1 else ""
    if not steps:
        return f"{span}{lines}: no change point in {len(trend.measured)} measurements."
    stepped = sum(bool(measured.change_points) for measured in trend.measured)
    newest = steps[0]
    last = f"the last in {run_name(trend, newest.after)}: {newest.difference.name} {numbers(newest.difference)}"
    many = f"{len(steps)} change point{'s' * (len(steps) > 1)} in {stepped} of {len(trend.measured)} measurements"
    return f"{span}{lines}: {many}, {last}."


def run_name(trend: Trend, index: int) -> str:
    """Return the name of an entry: its number, and its sources if they are known."""
    made_for = revision(trend.entries[index].evidence.side.revision)
    return f"run {index + 1}" + (f" ({made_for})" if made_for else "")


def models(measured: Iterable[MeasurementTrend]) -> str:
    """Return the cycle models of measurements; empty if none is a count of cycles."""
    return counted_by(_models(measured))


def under(trend: Trend, measured: MeasurementTrend) -> str:
    """Return the text after the name of a plot: the limit, and among several cycle models its own."""
    limit = f"limit {measured.limit}" if measured.limit else ""
    return "".join(f", {text}" for text in (limit, _own_model(trend, measured)) if text)


def rows(trend: Trend, measured: Iterable[MeasurementTrend]) -> Iterator[tuple[str, ...]]:
    """Yield measurements under `HEADINGS`; the last cell counts change points and names the run of the last one.

    If several models counted cycles of the trend, the unit of a count names its model.
    """
    for measurement in measured:
        counted = _own_model(trend, measurement)
        yield _row(measurement, f"{measurement.unit} {counted}" if counted else measurement.unit)


def _models(measured: Iterable[MeasurementTrend]) -> Iterator[str]:
    return (series.cycle_model for measurement in measured for series in measurement.series)


def _own_model(trend: Trend, measured: MeasurementTrend) -> str:
    several = len(set(filter(None, _models(trend.measured)))) > 1
    names = model_names(_models([measured]))
    return f"counted by {names}" if several and names else ""


def _row(measured: MeasurementTrend, unit: str) -> tuple[str, ...]:
    points = sorted((point for series in measured.series for point in series.points), key=lambda point: point.entry)
    steps = measured.change_points
    return (
        measured.name,
        str(len(points)),
        format_number(points[0].value),
        format_number(points[-1].value),
        format_number(min(point.low for point in points)),
        format_number(max(point.high for point in points)),
        unit,
        str(measured.limit or ""),
        f"{len(steps)}, last in run {steps[-1].after + 1}" if steps else "",
    )


def between(trend: Trend, step: ChangePoint) -> str:
    """Return the differences between the runs before and after a change point."""
    before, after = (trend.entries[index].evidence for index in (step.before, step.after))
    return "; ".join(_changes(before, after, step.difference.name)) or "the same build"


def changed_run(trend: Trend, after: int, steps: Sequence[ChangePoint]) -> str:
    """Return the heading of a run with change points: its name, its time, and the number of each kind of change."""
    counts = Counter(step.difference.change for step in steps)
    changes = ", ".join(f"{count} {change}" for change, count in counts.items())
    return f"{run_name(trend, after)}, {trend.entries[after].when_utc}: {changes}"


def causes(trend: Trend, steps: Sequence[ChangePoint]) -> list[str]:
    """Return the other differences from the previous run; several if a baseline has numbers of other builds."""
    return list(dict.fromkeys(between(trend, step) for step in steps))


def line_name(trend: Trend, line: TrendLine) -> str:
    """Return the name of a line: the conditions that the lines of a trend do not all share."""
    shown = dict(_conditions(line))
    others = [dict(_conditions(other)) for other in trend.lines]
    distinguishing = [text for name, text in shown.items() if any(other[name] != text for other in others)]
    return ", ".join(distinguishing) or line.rig


def _conditions(line: TrendLine) -> Iterator[tuple[str, str]]:
    yield "rig", f"rig {line.rig}"
    yield "conditions", f"conditions {line.rig_sha256[:8] or 'not recorded'}"
    yield "board", f"{line.board or 'no'} board"
    yield "seeds", seeds_in_words(line.seeds)
    yield "cycle model", line.cycle_model
    yield "poses", f"poses {line.poses}"
    yield "sensors", f"sensors {' '.join(line.sensors)}"
    yield "calibrated", f"with{'' if line.calibrated else 'out'} a calibration file"


def seeds_in_words(seeds: tuple[int | None, ...]) -> str:
    """Return seeds in short form: ``seed 1``, ``100 seeds, 1 to 100``."""
    numbered = [seed for seed in seeds if seed is not None]
    if not numbered:
        return "no seed"
    return f"seed {numbered[0]}" if len(numbered) == 1 else f"{len(numbered)} seeds, {numbered[0]} to {numbered[-1]}"


def _changes(before: Evidence, after: Evidence, measurement: str) -> Iterator[str]:
    was, now = _sources_of_number(before, measurement), _sources_of_number(after, measurement)
    for name in was:
        if name in now and was[name] != now[name]:
            yield f"{name} {was[name]} -> {now[name]}"


def _sources_of_number(evidence: Evidence, measurement: str) -> dict[str, str]:
    """Return firmware and sources of a number; for one that a baseline accepted only the build is known."""
    side = evidence.side
    if measurement in evidence.builds:
        return {"build": evidence.builds[measurement]}
    return {
        "firmware": side.firmware,
        "version": side.version,
        "build": side.build_id,
        "compiler": side.compiler,
        "made for": revision(side.revision) or "?",
    }
