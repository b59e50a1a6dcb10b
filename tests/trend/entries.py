"""Entries of a trend, written by hand."""

from __future__ import annotations

from collections.abc import Mapping

from hiltest.measurement import Limit, Measurement, Tolerance, check
from hiltest.report.trend.series import RunEntry
from hiltest.run_record.comparison import Side
from hiltest.verdict.evidence import Conditions, Evidence

MODEL = "cortex-m4-trm/3@sram"


def entry(
    day: int,
    *measurements: Measurement,
    build: str = "",
    model: str = MODEL,
    rig: str = "aa",
    poses: str = "all",
    compiler: str = "GCC 12.2.1",
    seeds: Mapping[int, tuple[Measurement, ...]] | None = None,
    tolerances: Mapping[str, Tolerance] | None = None,
    file: str = "",
) -> RunEntry:
    """Return a run of a day in January on the default rig, or with `seeds` a campaign."""
    by_seed = seeds or {1: measurements}
    side = Side(
        file=file or f"{day}/run.json",
        sha256="",
        firmware="hiltest-frdm-k64f",
        version="0.1.0",
        build_id=build or f"{day:016x}",
        compiler=compiler,
        cycle_model=model,
        rig="virtual-k64f",
        seeds=tuple(by_seed),
        saved_utc="",
    )
    conditions = Conditions(
        board="virtual",
        rig_sha256=rig,
        calibrators=("direct",),
        sensors=("MAG3110",),
        protocol_version=3,
        compiler_flags=(),
        poses=poses,
        suite="gate",
        calibrated=False,
    )
    evidence = Evidence(
        side,
        conditions,
        {seed: {item.name: item for item in result} for seed, result in by_seed.items()},
        tolerances=tolerances or {},
    )
    return RunEntry(side.file, f"2026-01-{day:02d}T00:00:00Z", evidence)


def cycles(value: float, *, limit: float | None = 12_500, model: str = MODEL) -> Measurement:
    most = None if limit is None else Limit(max=limit)
    return check("cycles.direct.total", value, unit="cycle", limit=most, cycle_model=model)


def degrees(value: float, name: str = "heading.direct.max") -> Measurement:
    return check(name, value, unit="deg")
