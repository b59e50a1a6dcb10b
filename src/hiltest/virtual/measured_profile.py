"""A timing profile made from measurements: clocks of known sequences of instructions, solved for the rows.

The first half of every sequence of the firmware costs a sum of rows, by the rules of `hiltest.virtual.timing`: what a
run costs at its edges is in no row, and stands in the whole one and in that of the second half alike. Solved one after
the other they give every row. Those that are left over are compared with what the rows make of them: where they differ,
a rule does not hold on that core.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from fractions import Fraction

from hiltest.virtual.profile_file import AT_LEAST, DEFAULT_PROFILE, load_profile
from hiltest.virtual.timing import CostRow, TimingProfile


@dataclass(frozen=True, slots=True)
class Equation:
    """Cost of half a sequence: ``times`` of `row`, other rows, clocks that are no row's, and half of another one."""

    sequence: str
    row: str
    times: int
    others: Mapping[str, int] = field(default_factory=dict)
    clocks: int = 0
    less: str = ""

    def measured(self, clocks: Mapping[str, int]) -> int:
        """Return the clocks of its sequence, less those of the other one."""
        return clocks[self.sequence] - (clocks[self.less] if self.less else 0)


#: In an order in which each has only one row that is not known yet.
EQUATIONS = (
    Equation("data", "data", 32),
    Equation("divide", "divide", 8),
    Equation("load_chain", "load", 32),
    Equation("loads", "load_behind_load", 32),
    Equation("stores", "store", 32),
    Equation("stores_by_register", "store_register_offset", 32),
    Equation("load_behind_store", "load_behind_store", 16, {"data": 16, "store": 16, "load": 16}),
    Equation("store_behind_load", "store_behind_load", 16, {"data": 16, "load": 16}),
    Equation("load_multiple", "multiple_base", 16, clocks=16 * 8),
    Equation("branch_not_taken", "branch", 32),
    Equation("branch_taken", "refill_direct", 16, {"branch": 16}),
    Equation("call_and_return", "refill_indirect", 8, {"branch": 16, "refill_direct": 8}),
    Equation("table_branch", "table_branch", 8, {"refill_indirect": 8}),
    Equation("if_then", "it", 16, {"data": 16}),
    Equation("barrier", "barrier", 16),
    Equation("system", "system", 32),
    Equation("exclusive", "exclusive", 16),
    Equation("fp", "fp", 32),
    Equation("fp_chain", "fp_use", 32, {"fp": 32}),
    Equation("accumulate", "fp_accumulate", 32),
    Equation("accumulate_over_integers", "fp_accumulate_hidden", -16, {"fp_accumulate": 16, "data": 64}),
    Equation("fp_divide", "fp_divide", 4),
    Equation("fp_divide_result", "fp_divide_use", 4, {"fp": 4}),
    Equation("fp_loads", "fp_load", 32),
    Equation("fp_stores", "fp_store", 32),
    Equation("fp_pairs", "fp_move_pair", 16),
    # From one reading of the counter to the next. Around a NOP it is the same: an SVC costs what that does.
    Equation("exception_entry", "exception_entry", 8, less="readings"),
    Equation(
        "exception_return", "exception_return", 8, {"branch": 8, "refill_indirect": 8, "system": -8}, less="readings"
    ),
)
#: Instead of those of the same sequences, for a profile that has the row.
_OF_RULES = {
    "table_branch": Equation("table_branch", "refill_table", 8, {"table_branch": 8}),
    "if_then": Equation("if_then", "it_folded", 16, {"data": 16}),
}
#: What must come out as the rows have it.
CHECKS = (
    Equation("load_store_pairs", "load", 16, {"store_behind_load": 16, "load_behind_store": 16}),
    Equation("store_multiple", "multiple_base", 16, clocks=16 * 8),
    Equation("accumulate_chain", "fp_accumulate", 32),
    Equation("accumulate_and_multiply", "fp_accumulate", 16, {"fp": 16}),
    Equation("square_root", "fp_divide", 4),
    # Classes that share a row with another one, as the kernels use them.
    Equation("data_independent", "data", 32),
    Equation("multiply", "data", 32),
    Equation("multiply_chain", "data", 32),
    Equation("multiply_long", "data", 32),
    Equation("multiply_long_chain", "data", 32),
    Equation("multiply_pairs", "data", 32),
    Equation("multiply_pairs_chain", "data", 32),
    Equation("pack_halves", "data", 32),
    Equation("loads_of_halves", "load_behind_load", 32),
    Equation("stores_of_halves", "store", 32),
    Equation("fp_multiply", "fp", 32),
    Equation("fp_multiply_chain", "fp", 32, {"fp_use": 32}),
    Equation("fp_convert", "fp", 32),
    Equation("fp_moves", "fp", 32),
    Equation("fp_compare", "fp", 32),
    Equation("fp_load_multiple", "multiple_base", 16, clocks=16 * 8),
    Equation("fp_store_multiple", "multiple_base", 16, clocks=16 * 8),
)


#: Where sequences run from, as users read it: the last three are flash, too, with parts of its controller off.
PLACES = {
    "sram": "SRAM_L", "flash": "flash", "flash_without_cache": "cache off", "flash_without_prefetch": "prefetch off",
    "flash_alone": "all off",
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class MeasuredProfile:
    """Rows solved from measurements.

    Attributes
    ----------
    rows : dict of str to CostRow
        Those that were measured. One that came out as no whole number has both neighbours as its range.
    remarks : tuple of str
        What does not fit the rules.
    """

    rows: dict[str, CostRow]
    remarks: tuple[str, ...]


def equations(base: TimingProfile) -> list[Equation]:
    """Return the equations for the rows that a profile has, in an order in which they can be solved."""
    by_rule = {name: each for name, each in _OF_RULES.items() if each.row in base.rows}
    return [by_rule.get(each.sequence, each) for each in EQUATIONS]


def solve(clocks: Mapping[str, int], about: str, base: TimingProfile | None = None) -> MeasuredProfile:
    """Find the rows that give these clocks.

    Parameters
    ----------
    clocks : mapping of str to int
        Clocks of half of each sequence, run from SRAM_L with its data in SRAM_U.
    about : str
        What was measured, and with what: ends the source of each row.
    base : TimingProfile, optional
        Has the rows that no sequence gives; by default the default profile.
    """
    base = base or load_profile(DEFAULT_PROFILE)
    exact = {name: Fraction(row.value) for name, row in base.rows.items()}
    rows: dict[str, CostRow] = {}
    remarks: list[str] = []
    for each in equations(base):
        rest = each.clocks + sum(times * exact[row] for row, times in each.others.items())
        value = exact[each.row] = Fraction(each.measured(clocks) - rest, 1) / each.times
        what = f"{each.sequence} less {each.less}" if each.less else each.sequence
        source = f"measured: {abs(each.times)} in {each.measured(clocks)} clocks of sequence {what}; {about}"
        rows[each.row], remark = _row(each.row, value, source)
        remarks += remark
    for each in CHECKS:
        wanted = each.clocks + each.times * exact[each.row] + sum(
            times * exact[row] for row, times in each.others.items()
        )
        if wanted != each.measured(clocks):
            remarks.append(
                f"{each.sequence}: {each.measured(clocks)} clocks, and the rows make {float(wanted):g}: "
                "a rule of the model does not hold here"
            )
    late = rows["fp_divide_use"].value - rows["fp_divide"].value
    if not 0 <= late <= 1:
        remarks.append(f"fp_divide_use: {late} clocks behind fp_divide, where the model knows none or one")
        rows["fp_divide_use"] = replace(rows["fp_divide"], source=rows["fp_divide_use"].source)
    hidden, most = rows["fp_accumulate_hidden"], rows["fp_accumulate"].value - 1
    if hidden.band[1] > most:
        remarks.append(f"fp_accumulate_hidden: {hidden.value} clocks, where the model knows at most {most}")
        band = min(hidden.band[0], most), most
        rows["fp_accumulate_hidden"] = replace(hidden, value=min(hidden.value, most), band=band)
    return MeasuredProfile(rows, tuple(remarks))


def _row(row: str, value: Fraction, source: str) -> tuple[CostRow, list[str]]:
    least = AT_LEAST.get(row, 0)
    low, high = max(math.floor(value), least), max(math.ceil(value), least)
    remarks = []
    if value < least:
        remarks.append(f"{row}: {float(value):.3f} clocks, where the model knows at least {least}")
    elif value.denominator != 1:
        remarks.append(f"{row}: {float(value):.3f} clocks, no whole number of them: its band is {low} to {high}")
    return CostRow(min(max(round(value), low), high), (low, high), source), remarks


def profile_text(name: str, measured: MeasuredProfile, raw: Mapping[str, Mapping[str, int]]) -> str:
    """Return the file of a measured profile.

    Parameters
    ----------
    name : str
        Name of the profile.
    measured : MeasuredProfile
    raw : mapping of str to mapping
        Clocks of each sequence, by the memory that it ran from: kept, so that they can be evaluated again later.
    """
    return "\n".join(_lines(name, measured, raw)) + "\n"


def _lines(name: str, measured: MeasuredProfile, raw: Mapping[str, Mapping[str, int]]) -> Iterator[str]:
    default = load_profile(DEFAULT_PROFILE)
    yield "# Measured by `hiltest timing measure`. What it does not give is the base's."
    yield f'name = "{name}"'
    yield f'base = "{default.name}"'
    for remark in measured.remarks:
        yield f"# {remark}"
    for row, cost in measured.rows.items():
        yield ""
        yield f"[cost.{row}]"
        yield f"value = {cost.value}"
        yield f"band = [{cost.band[0]}, {cost.band[1]}]"
        yield f'source = "{cost.source}"'
    for place, clocks in raw.items():
        yield ""
        yield f"[measured.{place}]  # clocks of half of each sequence from {PLACES[place]}"
        yield from (f"{sequence} = {count}" for sequence, count in clocks.items())
