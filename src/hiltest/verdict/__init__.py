"""The verdict of a run: its evidence, causes of failures, the comparison with a baseline, and one sentence."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hiltest.lazy_exports import when_used

if TYPE_CHECKING:
    from hiltest.verdict.baseline import Baseline, baseline_of
    from hiltest.verdict.baseline_file import read_baseline
    from hiltest.verdict.evidence import Evidence, evidence_of
    from hiltest.verdict.evidence_reader import read_evidence
    from hiltest.verdict.verdict import decide

__all__ = ["Baseline", "Evidence", "baseline_of", "decide", "evidence_of", "read_baseline", "read_evidence"]

__getattr__ = when_used(
    __name__,
    {
        "Baseline": "baseline",
        "Evidence": "evidence",
        "baseline_of": "baseline",
        "decide": "verdict",
        "evidence_of": "evidence",
        "read_baseline": "baseline_file",
        "read_evidence": "evidence_reader",
    },
)
