"""A measurement, its limit and outcome, and the catalogue of all kinds. Pure: it needs no pytest, board or file."""

from __future__ import annotations

from hiltest.measurement.catalogue import (
    KINDS,
    better_of,
    deviation_of,
    identify,
    is_compared,
    is_direction,
    nearest_name,
    tolerance_of,
)
from hiltest.measurement.cycle_range import DOUBT, PUBLISHED, CycleRange, RowEffect
from hiltest.measurement.kind import (
    EXACT,
    NEXT_STEP,
    Allowance,
    Better,
    Deviation,
    Kind,
    NamedKind,
    Reference,
    Section,
    Tolerance,
)
from hiltest.measurement.limit import Limit
from hiltest.measurement.measurement import (
    SIGNIFICANT_DIGITS,
    UNDECIDED,
    WORST_OF,
    Counted,
    Measurement,
    Outcome,
    check,
    plain,
    round_significant,
)
from hiltest.measurement.ranking import (
    FLASH_TIE,
    cannot_be_ranked,
    is_beyond,
    ratio_range,
    runs_from_flash,
    waits_for_flash,
)

__all__ = [
    "DOUBT",
    "EXACT",
    "FLASH_TIE",
    "KINDS",
    "NEXT_STEP",
    "PUBLISHED",
    "SIGNIFICANT_DIGITS",
    "UNDECIDED",
    "WORST_OF",
    "Allowance",
    "Better",
    "Counted",
    "CycleRange",
    "Deviation",
    "Kind",
    "Limit",
    "Measurement",
    "NamedKind",
    "Outcome",
    "Reference",
    "RowEffect",
    "Section",
    "Tolerance",
    "better_of",
    "cannot_be_ranked",
    "check",
    "deviation_of",
    "identify",
    "is_beyond",
    "is_compared",
    "is_direction",
    "nearest_name",
    "plain",
    "ratio_range",
    "round_significant",
    "runs_from_flash",
    "tolerance_of",
    "waits_for_flash",
]
