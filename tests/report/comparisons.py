"""Comparisons written by hand, with round numbers."""

from __future__ import annotations

from dataclasses import replace

from hiltest.measurement import EXACT, Better, Limit, Tolerance
from hiltest.run_record.comparison import Change, Comparison, Difference, Side

MODEL = "cortex-m4-trm/3@sram"
BASE = Side(
    file="hil/baselines/virtual-k64f.json",
    sha256="ef" * 32,
    firmware="hiltest-frdm-k64f",
    version="0.1.0",
    build_id="0123456789abcdef",
    compiler="GCC 12.2.1",
    cycle_model=MODEL,
    rig="virtual-k64f",
    seeds=(1,),
    saved_utc="2026-01-01T00:00:00Z",
)
NEW = replace(BASE, file="", sha256="", build_id="fedcba9876543210", saved_utc="2026-01-02T03:05:00Z")


def difference(name: str, change: Change, base: float | None, new: float | None, **more: object) -> Difference:
    """Return a difference with its delta worked out."""
    delta = None if base is None or new is None else new - base
    result = Difference(
        name=name,
        unit="deg",
        change=change,
        sense=Better.LOWER,
        base=base,
        new=new,
        delta=delta,
        interval=None,
        seeds=1,
        tolerance=Tolerance(0.05, 0.02),
        limit=Limit(max=1.8),
        outcome="pass",
        cycle_model="",
    )
    return replace(result, **more)  # type: ignore[arg-type]


def comparison(*differences: Difference, obstacles: tuple[str, ...] = ()) -> Comparison:
    """Return a comparison of all kinds of changes, or of those given."""
    cycles = {"unit": "cycle", "tolerance": EXACT, "limit": Limit(max=12_500), "cycle_model": MODEL}
    result = differences or (
        difference("cycles.direct.total", Change.WORSE, 11_061, 11_161, **cycles),
        difference("fit.direct.residual", Change.UNCHANGED, 0.80, 0.81),
        difference("fusion.kalman.max", Change.GONE, 1.2, None, limit=None, outcome=""),
        difference("heading.direct.max", Change.BETTER, 0.97, 0.75),
        difference("heading.direct.worst_sector", Change.CHANGED, 200, 230, sense=Better.NEITHER),
        difference("link.errors", Change.NEW, None, 0, unit=""),
    )
    return Comparison(
        BASE,
        NEW,
        tuple(sorted(result, key=lambda item: item.name)),
        obstacles,
        "1 of 6 measurements got worse: cycles.direct.total 11 061 -> 11 161 cycles.",
    )
