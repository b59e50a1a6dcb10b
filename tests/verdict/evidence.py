"""Evidence that tests make of numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from hiltest.measurement import Limit, Measurement, Outcome, Tolerance
from hiltest.run_record.comparison import Side
from hiltest.verdict.evidence import Conditions, Evidence

MODEL = "cortex-m4-trm/3@sram"
CONDITIONS = Conditions(
    board="virtual",
    rig_sha256="ab" * 32,
    calibrators=("direct", "iterative"),
    sensors=("MAG3110",),
    protocol_version=4,
    compiler_flags=("-O2", "-g"),
    poses="all",
    suite="gate",
    calibrated=False,
)


def measurement(
    name: str,
    value: float | None,
    *,
    limit: Limit | None = None,
    outcome: Outcome = Outcome.INFORMATION,
    unit: str = "",
    volatile: bool = False,
) -> Measurement:
    """Return one measurement; cycles carry their model."""
    model = MODEL if name.startswith("cycles.") else ""
    return Measurement(name, value, unit, limit, outcome=outcome, volatile=volatile, cycle_model=model)


def evidence(
    *by_seed: Sequence[Measurement],
    seeds: Sequence[int] | None = None,
    conditions: Conditions | None = CONDITIONS,
    tolerances: Mapping[str, Tolerance] | None = None,
    file: str = "run.json",
) -> Evidence:
    """Return a side with the measurements of each seed, seeds 1, 2, ... unless given."""
    numbered = tuple(seeds or range(1, len(by_seed) + 1))
    side = Side(
        file=file,
        sha256="cd" * 32,
        firmware="hiltest-frdm-k64f",
        version="0.1.0",
        build_id="0123456789abcdef",
        compiler="GCC 12.2.1",
        cycle_model=MODEL,
        rig="virtual-k64f",
        seeds=numbered,
        saved_utc="2026-01-02T03:04:05Z",
    )
    measured = {seed: {item.name: item for item in result} for seed, result in zip(numbered, by_seed, strict=True)}
    return Evidence(side, conditions, measured, tolerances or {})


def over_seeds(name: str, *values: float | None, **more: object) -> Evidence:
    """Return a side with one measurement that has a value on each of seeds 1, 2, ..."""
    return evidence(*([measurement(name, value, **more)] for value in values))  # type: ignore[arg-type]
