"""A timing profile made from measurements: clocks of known sequences of instructions, solved for the rows.

The first half of every sequence of the firmware costs a sum of rows, by the rules of
`hiltest.virtual.model.timing`: what a run costs at its edges is in no row, and stands in the whole one and in that of
the second half alike. Solved one after the other they give every row. Those that are left over are compared with what
the rows make of them: where they differ, a rule does not hold on that core. Rows of rules of fetching and of addresses
are those of the candidates that survive (`hiltest.virtual.silicon.rule_candidates`).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from fractions import Fraction

from hiltest.virtual.model.profile_file import AT_LEAST, load_profile
from hiltest.virtual.model.timing import CostRow, TimingProfile
from hiltest.virtual.program.elf import FirmwareImage
from hiltest.virtual.silicon.rule_candidates import Judgement, judge

#: Profiles without and with the rules of fetching and of addresses; the second has the rows of the first.
PLAIN, WITH_RULES = "cortex-m4-trm/1", "cortex-m4-trm/2"


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
    Equation("wide_compare_if_then", "it", 8, {"data": 16}),
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
#: TBB has one sequence and two rows: it gives the second where rules hold, and the first where none does.
_REFILL_OF_TABLES = Equation("table_branch", "refill_table", 8, {"table_branch": 8})
_TABLES = Equation("table_branch", "table_branch", 8, {"refill_indirect": 8})
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
    """Rows solved from measurements."""

    rows: dict[str, CostRow]
    """Those that were measured. One that came out as no whole number has both neighbours as its range."""
    remarks: tuple[str, ...]
    """What does not fit the rules."""
    judgements: tuple[Judgement, ...]
    """Of each rule of fetching and of addresses, which candidate survives."""
    base: TimingProfile
    """Has the rows that no sequence gives: with those of the rules where one of them holds, or may."""


def solve(clocks: Mapping[str, int], about: str, image: FirmwareImage) -> MeasuredProfile:
    """Find the rows that give these clocks.

    Parameters
    ----------
    clocks
        Clocks of half of each sequence, run from SRAM_L with its data in SRAM_U.
    about
        What was measured, and with what: ends the source of each row.
    image
        Has the sequences, from which candidates are priced.
    """
    rows, remarks, exact = _solved(clocks, about)
    base = load_profile(WITH_RULES)
    priced = TimingProfile(base.name, base.rows | rows, shipped=False)
    judgements = tuple(judge(clocks, priced, image))
    if any(judgement.shows_rule for judgement in judgements if judgement.question.row not in ("", "refill_table")):
        of_rules, more = _decided(judgements, about)
        rows |= of_rules
        remarks += more
        _solve_for(_REFILL_OF_TABLES, clocks, about, exact, rows, remarks)
    else:
        base = load_profile(PLAIN)
        _solve_for(_TABLES, clocks, about, exact, rows, remarks)
    return MeasuredProfile(rows, tuple(remarks), judgements, base)


def _solved(
    clocks: Mapping[str, int], about: str
) -> tuple[dict[str, CostRow], list[str], dict[str, Fraction]]:
    """Return the rows that equations give, what does not fit them, and the rows as they came out."""
    exact = {name: Fraction(row.value) for name, row in load_profile(PLAIN).rows.items()}
    rows: dict[str, CostRow] = {}
    remarks: list[str] = []
    for each in EQUATIONS:
        _solve_for(each, clocks, about, exact, rows, remarks)
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
    return rows, remarks, exact


def _solve_for(
    each: Equation, clocks: Mapping[str, int], about: str, exact: dict[str, Fraction], rows: dict[str, CostRow],
    remarks: list[str],
) -> None:
    rest = each.clocks + sum(times * exact[row] for row, times in each.others.items())
    value = exact[each.row] = Fraction(each.measured(clocks) - rest, 1) / each.times
    what = f"{each.sequence} less {each.less}" if each.less else each.sequence
    source = f"measured: {abs(each.times)} in {each.measured(clocks)} clocks of sequence {what}; {about}"
    rows[each.row], remark = _row(each.row, value, source)
    remarks += remark


def _decided(judgements: Iterable[Judgement], about: str) -> tuple[dict[str, CostRow], list[str]]:
    """Return the rows of rules that all their sequences agree on, and of the others why there is none."""
    found: dict[str, dict[int, str]] = {}
    left: dict[str, str] = {}
    for judgement in judgements:
        row, candidate = judgement.question.row, judgement.decided
        if row in ("", "refill_table"):
            continue
        told = f"{judgement.question.sequence}: {judgement.clocks} clocks, {judgement.verdict}"
        if not judgement.survivors or (candidate and not candidate.in_rows):
            left[row] = told
        elif candidate and row in candidate.rows:
            found.setdefault(row, {}).setdefault(candidate.rows[row], told)
    left |= {row: ", but ".join(values.values()) for row, values in found.items() if len(values) > 1}
    rows = {
        row: CostRow(value, (value, value), f"measured: {told}; {about}")
        for row, values in found.items() if row not in left for value, told in values.items()
    }
    return rows, [f"{told}: {row} cannot say so, and keeps the base's value and range" for row, told in left.items()]


def _row(row: str, value: Fraction, source: str) -> tuple[CostRow, list[str]]:
    least = AT_LEAST.get(row, 0)
    low, high = max(math.floor(value), least), max(math.ceil(value), least)
    remarks = []
    if value < least:
        remarks.append(f"{row}: {float(value):.3f} clocks, where the model knows at least {least}")
    elif value.denominator != 1:
        remarks.append(f"{row}: {float(value):.3f} clocks, no whole number of them: its band is {low} to {high}")
    return CostRow(min(max(round(value), low), high), (low, high), source), remarks


def profile_text(
    name: str, measured: MeasuredProfile, raw: Mapping[str, Mapping[str, int]], board: Iterable[str] = ()
) -> str:
    """Return the file of a measured profile.

    Parameters
    ----------
    name
        Name of the profile.
    raw
        Clocks of each sequence, by the memory that it ran from: kept, so that they can be evaluated again later.
    board
        Lines of table ``[board]``: what it was measured on.
    """
    return "\n".join(_lines(name, measured, raw, board)) + "\n"


def _lines(
    name: str, measured: MeasuredProfile, raw: Mapping[str, Mapping[str, int]], board: Iterable[str]
) -> Iterator[str]:
    yield "# Measured by `hiltest timing measure`. What it does not give is the base's."
    yield f'name = "{name}"'
    yield f'base = "{measured.base.name}"'
    for remark in measured.remarks:
        yield f"# {remark}"
    for judgement in measured.judgements:
        yield f"# {judgement.question.sequence}: {judgement.clocks} clocks, {judgement.verdict}"
    if lines := list(board):
        yield ""
        yield from lines
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
