"""A measurement: name, value, unit, limit and outcome.

This module is pure: it knows neither pytest nor a board nor a file.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import StrEnum
from numbers import Integral
from typing import Protocol, TypedDict, Unpack, runtime_checkable

from hiltest.measurement.catalogue import better_of, identify
from hiltest.measurement.cycle_range import CycleRange
from hiltest.measurement.kind import COSTS_TOO_MUCH, Better, Kind, Section
from hiltest.measurement.limit import Limit
from hiltest.text import format_number

SIGNIFICANT_DIGITS = 9
"""Significant digits of numbers that the host computes.

A float64 sum in another order differs in the 15th or 16th digit; after a chain of
solves and arc tangents a few more are lost. Nine leaves that noise out and is far
finer than anything a bench can see.
"""


WORST_OF = "worst of "
"""Beginning of the note of a measurement that is not the only one of its name."""


class Outcome(StrEnum):
    """Outcome of a measurement."""

    PASS = "pass"
    """Within its limit."""
    INFORMATION = "information"
    """Recorded without a limit."""
    FAIL = "fail"
    """Outside its limit, or not a number."""
    EXPECTED_FAIL = "expected fail"
    """Outside its limit in a test that is marked to fail (``xfail``): no run is red because of it."""
    CANNOT_TELL = "cannot tell"
    """Nearer to its limit, on either side, than the uncertainty of its reference: neither a pass nor a failure."""
    UNSET = "unset"
    """Its limit could not be evaluated, which fails closed."""
    NOT_OFFERED = "not offered"
    """This kind of board cannot know it, such as the true offset on a real board; or, with a note, this run has nothing
    to measure, such as the cost of one iteration if none was needed."""


UNDECIDED = (Outcome.CANNOT_TELL, Outcome.UNSET)
"""Outcomes of a limit that a run neither meets nor misses; the run is then not evaluated."""
_DECIDED = {True: Outcome.PASS, False: Outcome.FAIL, None: Outcome.CANNOT_TELL}


@runtime_checkable
class Counted(Protocol):
    """A cost in clock cycles with its cycle model, such as that of a called function."""

    @property
    def cycles(self) -> int:
        """Number of cycles."""

    @property
    def cycle_model(self) -> str:
        """Cycle model that counted them."""


@dataclass(frozen=True, slots=True)
class Measurement:
    """One number that a run produced."""

    name: str
    """Name, dotted and in lower case: ``heading.direct.max``."""
    value: float | int | None
    """Value; None without a number."""
    unit: str
    """Unit as written after the number: ``deg``, ``cycle``, ``uT``, ``%``."""
    limit: Limit | None = None
    information: Limit | None = None
    """Reference value shown beside the value, without a verdict."""
    outcome: Outcome = Outcome.INFORMATION
    volatile: bool = False
    """True if two runs of the same seed may differ in it, as in wall time."""
    cycle_model: str = ""
    """Cycle model of a cycle count; numbers of different models are never compared."""
    note: str = ""
    """Reason for the outcome, if the numbers do not show it."""
    test: str = ""
    """Node id of the test that measured it."""
    band: CycleRange | None = None
    """Uncertainty range of a virtual board's cycles, which follows from the cycle model."""
    place: str = ""
    """File and line of the call that measured it: ``hil/suites/test_heading.py:81``."""
    uncertainty: float | None = None
    """Expanded uncertainty of its reference, which the check of the limit included; None without one."""

    @property
    def kind(self) -> Kind | None:
        """Kind in the catalogue; None for a user's own measurement."""
        return identify(self.name).kind

    @property
    def subject(self) -> str:
        """Subject of its name, such as the calibrator of ``heading.direct.max``; empty if its kind has none."""
        return identify(self.name).subject

    @property
    def section(self) -> Section:
        """Section of the report that it belongs in."""
        return identify(self.name).section

    @property
    def next_step(self) -> str:
        """Next step if it is out of its limit and no cause is known."""
        own_cost = self.kind is None and self.unit == "cycle"
        return COSTS_TOO_MUCH if own_cost else identify(self.name).next_step

    @property
    def better(self) -> Better:
        """Better direction."""
        return better_of(self.name, self.limit, self.unit)

    @property
    def gates(self) -> bool:
        """True if this measurement alone makes a run red."""
        return self.outcome in (Outcome.FAIL, *UNDECIDED)

    @property
    def says_why_not(self) -> bool:
        """True if there is no number because there is nothing to measure."""
        return self.outcome is Outcome.NOT_OFFERED and bool(self.note) and not self.note.startswith(WORST_OF)

    @property
    def may_exceed_limit(self) -> bool:
        """True if the count is within its limit, but not at both ends of its uncertainty range."""
        if self.band is None or self.limit is None or self.outcome is not Outcome.PASS:
            return False
        return not (self.limit.holds(self.band.low) and self.limit.holds(self.band.high))

    def rounded(self) -> Measurement:
        """Return the measurement in its written form: numbers of the host have nine significant digits."""
        return replace(self, value=round_significant(self.value), uncertainty=round_significant(self.uncertainty))

    def __str__(self) -> str:
        value = "no value" if self.value is None else f"{format_number(self.value, 6)} {self.unit}".rstrip()
        limit = f", limit {self.limit}" if self.limit else ""
        limit += f" with U {format_number(self.uncertainty, 2)}" if self.limit and self.uncertainty else ""
        note = f" ({self.note})" if self.note else ""
        return f"{self.name} = {value}{limit}: {self.outcome}{note}"


class About(TypedDict, total=False):
    """Fields of `Measurement` beside its value; only the uncertainty influences the outcome."""

    information: Limit | None
    volatile: bool
    cycle_model: str
    test: str
    band: CycleRange | None
    note: str
    place: str
    uncertainty: float | None


def check(
    name: str,
    value: float | int | None,
    *,
    unit: str,
    limit: Limit | None = None,
    not_checked: str = "",
    not_offered: str = "",
    could_offer: bool = False,
    **about: Unpack[About],
) -> Measurement:
    """Make a measurement and decide its outcome.

    Parameters
    ----------
    name, value, unit, limit
        Fields of `Measurement`. A value of None means that there is no number.
    not_checked
        Reason why the limit cannot be applied. The outcome is then ``unset`` if there is a limit.
    not_offered
        Reason why there is no value, if it follows from another result and nothing is missing.
    could_offer
        True if this kind of board can know such a value, as a virtual one always can. A missing value under
        a limit is then ``unset`` instead of ``not offered``.
    **about
        Other fields of the measurement. An outcome that needs a reason replaces the note.

    Returns
    -------
    Measurement
        A measurement with outcome ``fail`` and no value if `value` is not a finite number: a heading
        that is NaN is a wrong answer, not a missing one.

    Raises
    ------
    ValueError
        If the name is empty or the unit of a cycle count comes without its cycle model.
    """
    if not name:
        raise ValueError("a measurement needs a name")
    if unit.startswith("cycle") and not about.get("cycle_model"):
        raise ValueError(f"{name}: cycles need their cycle model, or they could be compared with another's")
    note = about.get("note", "")
    if value is None and limit is not None and (could_offer or not_checked):
        outcome, note = Outcome.UNSET, not_checked or not_offered or "the board can offer it, and no value was given"
    elif value is None:
        outcome, note = Outcome.NOT_OFFERED, not_offered
    elif not math.isfinite(value := plain(value)):
        outcome, note, value = Outcome.FAIL, f"the value is {value}", None
    elif limit is not None and not_checked:
        outcome, note = Outcome.UNSET, not_checked
    elif limit is None:
        outcome = Outcome.INFORMATION
    else:
        uncertainty = about.get("uncertainty") or 0.0
        outcome = _DECIDED[limit.is_met(value, uncertainty)]
        if outcome is Outcome.CANNOT_TELL:
            note = f"it is nearer to its limit than its reference is known, U = {format_number(uncertainty, 2)} {unit}"
    about["note"] = note
    return Measurement(name, value, unit, limit, outcome=outcome, **about)


def plain(value: float | int) -> float | int:
    """Return a Python number for any number: numpy's scalars do not serialise."""
    return int(value) if isinstance(value, Integral) else float(value)


def round_significant(value: float | int | None, digits: int = SIGNIFICANT_DIGITS) -> float | int | None:
    """Round a float to `digits` significant digits; integers and None stay as they are.

    Examples
    --------
    >>> round_significant(0.97123456789)
    0.971234568
    >>> round_significant(12400)
    12400
    """
    if value is None or isinstance(value, int):
        return value
    return float(f"{value:.{digits - 1}e}") + 0.0  # adding zero makes a negative zero positive
