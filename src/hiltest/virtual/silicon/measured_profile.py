"""Timing profile from measurements: the clocks of sequences of instructions give the rows.

By the rules of `hiltest.virtual.model.timing`, the first half of every sequence of the firmware costs a sum of rows,
because the costs at the edges of a run are the same in the complete sequence and in its second half. Each equation
gives one row. The rows must reproduce the clocks of the remaining sequences: a difference shows that a rule does not
apply to the core. The matching candidates (`hiltest.virtual.silicon.rule_candidates`) give the rows of the other rules.
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

#: Profiles without and with the rules of fetching and of addresses; the second one has all rows of the first one.
PLAIN, WITH_RULES = "cortex-m4-trm/1", "cortex-m4-trm/3"


@dataclass(frozen=True, slots=True)
class Equation:
    """Cost of half a sequence: `times` the `row`, `others`, constant `clocks`, and half of the sequence `less`."""

    sequence: str
    row: str
    times: int
    others: Mapping[str, int] = field(default_factory=dict)
    clocks: int = 0
    less: str = ""

    def measured(self, clocks: Mapping[str, int]) -> int:
        """Return the clocks of the sequence minus those of the other one."""
        return clocks[self.sequence] - (clocks[self.less] if self.less else 0)


#: Ordered so that each equation has only one unknown row.
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
    # Clocks between two readings of the counter; those of the same readings around a NOP are subtracted.
    Equation("exception_entry", "exception_entry", 8, less="readings"),
    Equation(
        "exception_return", "exception_return", 8, {"branch": 8, "refill_indirect": 8, "system": -8}, less="readings"
    ),
)
#: TBB has two rows but only one sequence, which gives refill_table if the rules apply, otherwise table_branch.
_REFILL_OF_TABLES = Equation("table_branch", "refill_table", 8, {"table_branch": 8})
_TABLES = Equation("table_branch", "table_branch", 8, {"refill_indirect": 8})
#: Sequences that the rows must reproduce.
CHECKS = (
    Equation("load_store_pairs", "load", 16, {"store_behind_load": 16, "load_behind_store": 16}),
    Equation("store_multiple", "multiple_base", 16, clocks=16 * 8),
    Equation("accumulate_chain", "fp_accumulate", 32),
    Equation("accumulate_and_multiply", "fp_accumulate", 16, {"fp": 16}),
    Equation("square_root", "fp_divide", 4),
    # Classes of instructions that share a row, in the combinations of the kernels.
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


#: Places of the sequences and their display names; the last three are flash with parts of its controller disabled.
PLACES = {
    "sram": "SRAM_L",
    "flash": "flash",
    "flash_without_cache": "cache off",
    "flash_without_prefetch": "prefetch off",
    "flash_alone": "all off",
}


@dataclass(frozen=True, slots=True)
class MeasuredProfile:
    rows: dict[str, CostRow]
    """Measured rows. If a solution is not an integer, the range of the row contains both adjacent integers."""
    remarks: tuple[str, ...]
    """Contradictions to the rules."""
    judgements: tuple[Judgement, ...]
    """Matching candidates of each rule of fetching and of addresses."""
    base: TimingProfile
    """Profile with the rows that no sequence gives; it has rules if any rule applies, or may apply."""


def solve(clocks: Mapping[str, int], about: str, image: FirmwareImage) -> MeasuredProfile:
    """Return the rows that give these clocks.

    Parameters
    ----------
    clocks
        Clocks of half of each sequence, run from SRAM_L with its data in SRAM_U.
    about
        Description of the measurement, which is appended to the source of each row.
    image
        Firmware with the sequences, which prices the candidates.
    """
    rows, remarks, exact = _solve_equations(clocks, about)
    base = load_profile(WITH_RULES)
    priced = TimingProfile(base.name, base.rows | rows, shipped=False)
    judgements = tuple(judge(clocks, priced, image))
    if any(judgement.shows_rule for judgement in judgements if judgement.question.row != "refill_table"):
        of_rules, more = _rule_rows(judgements, about)
        rows |= of_rules
        remarks += more
        _solve_for(_REFILL_OF_TABLES, clocks, about, exact, rows, remarks)
    else:
        base = load_profile(PLAIN)
        _solve_for(_TABLES, clocks, about, exact, rows, remarks)
    return MeasuredProfile(rows, tuple(remarks), judgements, base)


def _solve_equations(
    clocks: Mapping[str, int], about: str
) -> tuple[dict[str, CostRow], list[str], dict[str, Fraction]]:
    """Return the rows that equations give, contradictions, and the exact solutions."""
    exact = {name: Fraction(row.value) for name, row in load_profile(PLAIN).rows.items()}
    rows: dict[str, CostRow] = {}
    remarks: list[str] = []
    for equation in EQUATIONS:
        _solve_for(equation, clocks, about, exact, rows, remarks)
    for equation in CHECKS:
        expected = (
            equation.clocks
            + equation.times * exact[equation.row]
            + sum(times * exact[row] for row, times in equation.others.items())
        )
        if expected != equation.measured(clocks):
            remarks.append(
                f"{equation.sequence}: {equation.measured(clocks)} clocks, but the rows give {float(expected):g}: "
                "a rule of the model does not apply to this core"
            )
    late = rows["fp_divide_use"].value - rows["fp_divide"].value
    if not 0 <= late <= 1:
        remarks.append(f"fp_divide_use: {late} clocks after fp_divide, but the model allows 0 or 1")
        rows["fp_divide_use"] = replace(rows["fp_divide"], source=rows["fp_divide_use"].source)
    hidden, most = rows["fp_accumulate_hidden"], rows["fp_accumulate"].value - 1
    if hidden.band[1] > most:
        remarks.append(f"fp_accumulate_hidden: {hidden.value} clocks, but the model allows at most {most}")
        band = min(hidden.band[0], most), most
        rows["fp_accumulate_hidden"] = replace(hidden, value=min(hidden.value, most), band=band)
    return rows, remarks, exact


def _solve_for(
    equation: Equation,
    clocks: Mapping[str, int],
    about: str,
    exact: dict[str, Fraction],
    rows: dict[str, CostRow],
    remarks: list[str],
) -> None:
    rest = equation.clocks + sum(times * exact[row] for row, times in equation.others.items())
    value = exact[equation.row] = Fraction(equation.measured(clocks) - rest, 1) / equation.times
    origin = f"{equation.sequence} less {equation.less}" if equation.less else equation.sequence
    source = f"measured: {abs(equation.times)} in {equation.measured(clocks)} clocks of sequence {origin}; {about}"
    rows[equation.row], remark = _row(equation.row, value, source)
    remarks += remark


def _rule_rows(judgements: Iterable[Judgement], about: str) -> tuple[dict[str, CostRow], list[str]]:
    """Return the rows of rules that all their sequences agree on, and remarks on the others."""
    agreed: dict[str, dict[int, str]] = {}
    undecided: dict[str, str] = {}
    for judgement in judgements:
        row, candidate = judgement.question.row, judgement.decided
        if row == "refill_table":
            continue
        remark = f"{judgement.question.sequence}: {judgement.clocks} clocks, {judgement.verdict}"
        if not judgement.survivors or (candidate and not candidate.in_rows):
            undecided[row] = remark
        elif candidate and row in candidate.rows:
            agreed.setdefault(row, {}).setdefault(candidate.rows[row], remark)
    undecided |= {row: ", but ".join(values.values()) for row, values in agreed.items() if len(values) > 1}
    rows = {
        row: CostRow(value, (value, value), f"measured: {remark}; {about}")
        for row, values in agreed.items()
        if row not in undecided
        for value, remark in values.items()
    }
    return rows, [
        f"{remark}: the row {row} cannot express this, so value and range are the base's"
        for row, remark in undecided.items()
    ]


def _row(row: str, value: Fraction, source: str) -> tuple[CostRow, list[str]]:
    least = AT_LEAST.get(row, 0)
    low, high = max(math.floor(value), least), max(math.ceil(value), least)
    remarks = []
    if value < least:
        remarks.append(f"{row}: {float(value):.3f} clocks, but the model requires at least {least}")
    elif value.denominator != 1:
        remarks.append(f"{row}: {float(value):.3f} clocks is not a whole number: its band is {low} to {high}")
    return CostRow(min(max(round(value), low), high), (low, high), source), remarks


def profile_text(
    name: str, measured: MeasuredProfile, raw: Mapping[str, Mapping[str, int]], board: Iterable[str] = ()
) -> str:
    """Return the text of a measured profile's file.

    Parameters
    ----------
    raw
        Clocks of half of each sequence by place, which are stored so that they can be evaluated again.
    board
        Lines of table ``[board]``.
    """
    return "\n".join(_lines(name, measured, raw, board)) + "\n"


def _lines(
    name: str, measured: MeasuredProfile, raw: Mapping[str, Mapping[str, int]], board: Iterable[str]
) -> Iterator[str]:
    yield "# Measured by `hiltest timing measure`. All other rows are those of the base."
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
