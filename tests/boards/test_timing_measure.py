"""``hiltest timing measure`` gives back the profile that a board was made with."""

from __future__ import annotations

import os
import re
import tomllib
from collections.abc import Callable
from dataclasses import replace
from io import StringIO
from pathlib import Path

import pytest
from rich.console import Console
from tests.finished_run import run_module

from hiltest.boards import VirtualBench, open_board
from hiltest.boards.bench import default_firmware
from hiltest.boards.board import Board
from hiltest.boards.real import RealBoard, is_silicon
from hiltest.boards.virtual import VirtualBoard
from hiltest.link.sequences import SEQUENCES, SequencePlace, TimeSequence
from hiltest.procedures.sequences import measure_sequences
from hiltest.rig import Rig
from hiltest.virtual.board import cortex_m4
from hiltest.virtual.board.k64f import VirtualK64F
from hiltest.virtual.core.decoder import decode
from hiltest.virtual.core.library import lib
from hiltest.virtual.model.profile_file import DEFAULT_PROFILE, ROWS, load_profile
from hiltest.virtual.model.timing import TimingProfile
from hiltest.virtual.part.unique_id import VIRTUAL_UNIQUE_ID
from hiltest.virtual.profiling.timing_table import print_judgements, print_places
from hiltest.virtual.program.elf import load_image
from hiltest.virtual.program.instruction_text import instruction_text
from hiltest.virtual.silicon.measured_profile import CHECKS, EQUATIONS, PLAIN, WITH_RULES, MeasuredProfile, profile_text
from hiltest.virtual.silicon.measured_profile import solve as solve_with
from hiltest.virtual.silicon.rule_candidates import Candidate, questions

pytestmark = pytest.mark.slow

IMAGE = load_image(default_firmware())
POP_BYTES = 4  # of the instruction that a sequence returns with

# What no public measurement settles, each at the other end of its band, and vectors that come late, as out of a flash
# without a cache; and a core that is like no other.
OPEN = {
    "fp_accumulate": 2,
    "fp_accumulate_hidden": 1,
    "fp_store": 1,
    "store_behind_load": 1,
    "load_behind_store": 0,
    "it": 0,
    "refill_direct": 2,
    "refill_indirect": 3,
    "divide": 7,
    "system": 2,
    "exception_entry": 17,
    "exception_return": 12,
}
STRANGE = {
    "data": 2,
    "divide": 5,
    "load": 4,
    "load_behind_load": 2,
    "store": 3,
    "store_register_offset": 6,
    "store_behind_load": 2,
    "load_behind_store": 3,
    "multiple_base": 4,
    "branch": 2,
    "refill_direct": 3,
    "refill_indirect": 5,
    "table_branch": 4,
    "it": 2,
    "barrier": 9,
    "system": 3,
    "exclusive": 7,
    "fp": 2,
    "fp_use": 3,
    "fp_accumulate": 8,
    "fp_accumulate_hidden": 5,
    "fp_divide": 21,
    "fp_divide_use": 21,
    "fp_load": 3,
    "fp_store": 4,
    "fp_move_pair": 5,
    "exception_entry": 31,
    "exception_return": 6,
}


#: The same where TBB has a row of its own, and one more, for its refill.
STRANGE_BY_RULES = {**STRANGE, "refill_table": 9, "refill_indirect": 5} | {"table_branch": 2}


def solved(clocks: dict[str, int]) -> MeasuredProfile:
    return solve_with(clocks, "a test", IMAGE)


def written(folder: Path, values: dict[str, int], base: str) -> str:
    """Write a profile as a user would."""
    rows = "".join(
        f'\n[cost.{row}]\nvalue = {value}\nband = [{value}, {value}]\nsource = "a test"\n'
        for row, value in values.items()
    )
    (folder / "made.toml").write_text(f'name = "made/1"\nbase = "{base}"\n{rows}', encoding="utf-8")
    return str(folder / "made.toml")


def made_with(rig: Rig, profile: str) -> Rig:
    return replace(rig, board=replace(rig.board, timing=profile))


def values(profile: TimingProfile) -> dict[str, int]:
    return {name: row.value for name, row in profile.rows.items()}


@pytest.mark.parametrize(
    ("base", "changed"),
    [
        (PLAIN, {}),
        (PLAIN, OPEN),
        (PLAIN, STRANGE),
        (WITH_RULES, {}),
        (WITH_RULES, OPEN),
        (WITH_RULES, STRANGE_BY_RULES),
    ],
    ids=["plain", "plain, open", "plain, strange", "rules", "rules, open", "rules, strange"],
)
def test_it_gives_back_the_profile_that_the_board_was_made_with(
    tmp_path: Path, rig: Rig, base: str, changed: dict[str, int]
) -> None:
    result = written(tmp_path, changed, base)
    with open_board(made_with(rig, result)) as board:
        # This board's flash waits for nothing; one profile of each base shows it.
        clocks = clocks_from_sram(board) if changed else clocks_of_every_place(board)
    measured = solved(clocks)
    assert measured.remarks == ()
    assert measured.base.name == base
    (tmp_path / "measured.toml").write_text(profile_text("measured/1", measured, {}), encoding="utf-8")
    back = load_profile(str(tmp_path / "measured.toml"))
    assert values(back) == values(load_profile(result)) == values(load_profile(base)) | changed
    assert all(row.band == (row.value, row.value) for row in measured.rows.values())


def clocks_of_every_place(board: Board) -> dict[str, int]:
    """Return the clocks of each sequence, which are the same wherever it lies."""
    first, *others = measure_sequences(board).values()
    assert all(other == first for other in others)
    return first


def clocks_from_sram(board: Board) -> dict[str, int]:
    costs = {name: board.session.request(TimeSequence(number)) for number, name in enumerate(SEQUENCES)}
    return {name: cost.cycles for name, cost in costs.items() if cost is not None}


@pytest.fixture(scope="module")
def verdicts_by_rules(by_rules: dict[str, int]) -> dict[str, str]:
    return verdicts(solved(by_rules))


@pytest.fixture(scope="module")
def by_rules(rig: Rig) -> dict[str, int]:
    with open_board(made_with(rig, WITH_RULES)) as board:
        return clocks_from_sram(board)


def verdicts(measured: MeasuredProfile) -> dict[str, str]:
    return {judgement.question.sequence: judgement.verdict for judgement in measured.judgements}


BEHIND_CMP = "load_compare_and_three"
BOTH_BEHIND_CMP = "undecided: none waits after the CMP, or one of the three waits"
NONE_OR_ONE = "undecided: none waits, or one of the three waits"


@pytest.mark.parametrize(
    ("changed", "answer"),
    [
        (
            {"fetch_late": 0},
            dict.fromkeys(("load_and_three", "pair_and_three"), "none waits")
            | {"two_loads_and_three": "undecided: none waits, or the third of the five waits"},
        ),
        (
            {"fetch_late_integer": 1},
            {
                "integers_misplaced": "one in three waits",
                BEHIND_CMP: BOTH_BEHIND_CMP,
                "loads_and_three": NONE_OR_ONE,
                "pair_and_three": NONE_OR_ONE,
            },
        ),
        ({"fetch_late_fp": 0}, {"fp_misplaced": "none waits"}),
        ({"target_misplaced": 0}, {"loop_misplaced": "the branch to it does not wait"}),
        ({"return_misplaced": 1}, {"calls_misplaced": "the return takes one clock more"}),
        ({"address_use": 0}, {"computed_address": "LDR does not wait"}),
        ({"it_folded": 1}, dict.fromkeys(("compare_if_then", "if_then"), "IT takes the same time as elsewhere")),
        ({"refill_table": 2}, {"table_branch": "its refill is that of other branches"}),
        ({"refill_table": 5}, {"table_branch": "with its refill it takes 7"}),
        ({"refill_table": 6}, {"table_branch": "with its refill it takes 8"}),
        ({"unaligned": 0}, dict.fromkeys(("loads_one_off", "loads_two_off", "loads_three_off"), "as if aligned")),
        ({"load_same_base": 0}, {"loads_of_one_base": "the loads overlap"}),
        ({"load_other_block": 0}, {"loads_of_two_memories": "the loads overlap"}),
        ({"multiple_behind_store": 0}, {"multiple_behind_store": "LDM does not wait"}),
        ({"address_use_fp": 0}, {"fp_computed_address": "LDR does not wait"}),
        ({"fetch_late_access": 0}, {"loads_and_three": "none waits"}),
        ({"fetch_late_unbroken": 0}, {"two_loads_and_three": "none waits"}),
    ],
    ids=lambda item: "-".join(f"{row}={value}" for row, value in item.items()) if "_" in next(iter(item)) else "",
)
def test_a_board_that_behaves_by_another_candidate_is_told_and_its_row_written(
    tmp_path: Path, rig: Rig, verdicts_by_rules: dict[str, str], changed: dict[str, int], answer: dict[str, str]
) -> None:
    result = written(tmp_path, changed, WITH_RULES)
    with open_board(made_with(rig, result)) as board:
        measured = solved(clocks_from_sram(board))
    assert measured.remarks == ()
    assert verdicts(measured).items() - verdicts_by_rules.items() == answer.items()
    ((row, value),) = changed.items()
    assert measured.rows[row].band == (value, value)
    (tmp_path / "measured.toml").write_text(profile_text("measured/1", measured, {}), encoding="utf-8")
    assert values(load_profile(str(tmp_path / "measured.toml"))) == values(load_profile(result))


@pytest.mark.parametrize(
    ("changed", "answer", "remainder"),
    [
        ({}, {"load_and_two": "the second waits", "fp_misplaced": "one in two waits"}, {"fetch_late", "fetch_late_fp"}),
        (
            {"fetch_late": 0, "fetch_late_fp": 0, "fetch_late_integer": 1},
            {
                "load_and_three": "none waits",
                "pair_and_three": NONE_OR_ONE,
                "fp_misplaced": "none waits",
                "integers_misplaced": "one in two waits",
            },
            {"fetch_late_integer"},
        ),
    ],
    ids=["behind slow and floating-point", "behind integers"],
)
def test_of_a_board_that_fetches_every_second_one_late_no_row_is_written_that_says_every_third(
    tmp_path: Path,
    rig: Rig,
    monkeypatch: pytest.MonkeyPatch,
    changed: dict[str, int],
    answer: dict[str, str],
    remainder: set[str],
) -> None:
    result = written(tmp_path, {"fetch_late_integer": 0} | changed, WITH_RULES)
    every_second = Candidate("", {"misplaced_on_end": 2}).apply_to(load_profile(result))
    with monkeypatch.context() as of_board:
        of_board.setattr(cortex_m4, "load_profile", lambda _name: every_second)
        with open_board(made_with(rig, result)) as board:
            clocks = clocks_from_sram(board)
    measured = solved(clocks)
    assert answer.items() <= verdicts(measured).items()
    assert "no candidate matches" not in verdicts(measured).values()
    assert {remark.split(": ")[2].split()[2] for remark in measured.remarks} == remainder
    assert not remainder & measured.rows.keys()


def clocks_of_dearer_board(rig: Rig, clocks: Callable[[int, str], int], profile: str = WITH_RULES) -> dict[str, int]:
    """Return what sequences take a board on which an instruction at an address, of a text, costs more."""
    bench = VirtualBench(made_with(rig, profile))
    processor, more = bench.machine.processor, {}
    for name in SEQUENCES:
        symbol = bench.machine.image.symbols[f"sequence_{name}_sram"]
        begin = symbol.address & ~1
        code = next(
            segment.data[begin - segment.run_address :][: symbol.size]
            for segment in bench.machine.image.segments
            if segment.run_address <= begin < segment.run_address + segment.run_size
        )
        for address in [instruction.address for instruction in decode(begin, code)]:
            more[address] = clocks(address, instruction_text(address, code[address - begin :]))

    def wait(_reason: int) -> None:
        """Let the time pass that the next instruction takes more."""
        processor.core.cycles += more[processor.core.r[15]]
        processor.core.passes_breakpoint = True

    processor.at_stop = wait
    for address in (address for address, cost in more.items() if cost):
        assert lib.machine_set_breakpoint(processor.machine.handle, address, True)
    with VirtualBoard(bench) as board:
        return clocks_from_sram(board)


def test_a_board_whose_fetch_is_late_behind_two_bytes_too_is_told(rig: Rig, verdicts_by_rules: dict[str, str]) -> None:
    body = IMAGE.symbols[f"sequence_{BEHIND_CMP}_sram"]
    code = range(body.address & ~1, (body.address & ~1) + body.size)
    # LDR.W at a line, CMP, and of three EOR.W the last, 14 bytes behind it.
    third = [address for address in code if (address - code[0]) % 32 == 14]
    clocks = clocks_of_dearer_board(rig, lambda address, _text: int(address in third))
    measured = solved(clocks)
    messages = {BEHIND_CMP: "one of the three waits", "loads_and_three": NONE_OR_ONE}
    assert verdicts(measured).items() - verdicts_by_rules.items() == messages.items()
    (remark,) = measured.remarks
    assert remark.startswith(f"{BEHIND_CMP}: 44 clocks, one of the three waits: the row fetch_late cannot express this")
    assert "fetch_late" not in measured.rows


@pytest.mark.parametrize(("off", "name"), [(1, "one"), (2, "two"), (3, "three")])
def test_a_board_that_takes_longer_for_data_that_are_not_aligned_is_told(
    rig: Rig, verdicts_by_rules: dict[str, str], off: int, name: str
) -> None:
    text = f"ldr.w r0, [r1, #{off}]"
    measured = solved(clocks_of_dearer_board(rig, lambda _address, shown: int(shown == text)))
    messages = {f"loads_{name}_off": "no candidate matches"}
    assert verdicts(measured).items() - verdicts_by_rules.items() == messages.items()
    assert "unaligned" not in measured.rows


def test_one_rule_that_shows_is_enough_for_the_profile_that_has_them_all(tmp_path: Path, rig: Rig) -> None:
    result = written(tmp_path, {"address_use": 1}, PLAIN)
    with open_board(made_with(rig, result)) as board:
        measured = solved(clocks_from_sram(board))
    assert (measured.base.name, measured.remarks) == (WITH_RULES, ())
    rules = {name: row.value for name, row in measured.rows.items() if name not in ROWS}
    assert rules == {
        "fetch_late": 0,
        "fetch_late_integer": 0,
        "fetch_late_fp": 0,
        "target_misplaced": 0,
        "return_misplaced": 0,
        "address_use": 1,
        "it_folded": 1,
        "refill_table": 2,
        "unaligned": 0,
        "load_same_base": 0,
        "load_other_block": 0,
        "multiple_behind_store": 0,
        "address_use_fp": 0,
        "fetch_late_access": 0,
    }


def test_clocks_that_no_candidate_predicts_and_two_sequences_that_disagree_leave_the_row_to_the_base(
    by_rules: dict[str, int],
) -> None:
    measured = solved(by_rules | {"fp_misplaced": 60, "pair_and_three": 40})
    assert measured.remarks == (
        "fp_misplaced: 60 clocks, no candidate matches: the row fetch_late_fp cannot express this, so value and range "
        "are the base's",
        "two_loads_and_three: 24 clocks, no candidate matches: the row fetch_late_unbroken cannot express this, so "
        "value and range are the base's",
        "load_and_three: 28 clocks, one of the three waits, but pair_and_three: 40 clocks, none waits: the row "
        "fetch_late cannot express this, so value and range are the base's",
    )
    assert not {"fetch_late", "fetch_late_fp"} & measured.rows.keys()


def test_each_candidate_is_shown_with_its_clocks_and_which_one_survives(by_rules: dict[str, int]) -> None:
    console = Console(file=StringIO(), width=80)
    print_judgements(console, solved(by_rules | {"integers_misplaced": 60}).judgements)
    shown = console.file.getvalue()  # type: ignore[attr-defined]
    assert max(map(len, shown.splitlines())) <= 80
    # Of the 49 clocks of the run alone, 64 where one in three waits, the NOPs around it make four more.
    assert (
        "fp_misplaced: 68 clocks\n    5 NOP around 48 misaligned VADD\n"
        "      53 none waits\n  >   68 one in three waits\n      76 one in two waits\n"
    ) in shown
    assert "      77 one in two waits\n    no candidate matches\n" in shown
    assert all(f"\n{question.sequence}: " in shown for question in questions(values(load_profile(WITH_RULES))))


@pytest.fixture(scope="module")
def with_memories(rig: Rig) -> dict[SequencePlace, dict[str, int]]:
    with open_board(made_with(rig, "cortex-m4-k64f/1")) as board:
        return measure_sequences(board)


def test_memories_that_make_code_wait_are_told_from_what_instructions_cost(
    with_memories: dict[SequencePlace, dict[str, int]],
) -> None:
    measured = solved(with_memories[SequencePlace.SRAM])
    plain = load_profile(PLAIN)
    assert measured.remarks == ()
    assert {name: row.value for name, row in measured.rows.items()} == values(plain)


def test_flash_is_slower_with_its_cache_and_prefetch_off(
    with_memories: dict[SequencePlace, dict[str, int]],
) -> None:
    sram, flash, alone = (
        with_memories[place] for place in (SequencePlace.SRAM, SequencePlace.FLASH, SequencePlace.FLASH_ALONE)
    )
    # 32 instructions of four bytes are eight lines of the flash, which come slower than they are executed.
    assert (sram["fp"], flash["fp"]) == (32, 8 * 5)
    # Without buffers each is a read of its own. Its one clock misses an edge of the flash's clock, so that the read
    # begins with the next one: two flash clocks, of five each. Two instructions of two bytes come with one read.
    assert alone["fp"] == 32 * 2 * 5
    assert alone["data"] == alone["system"] == 32 // 2 * 2 * 5
    # A jump throws away what was fetched, the other branch of the word that it stands in too.
    assert alone["branch_taken"] == 16 * 2 * 5
    assert all(alone[name] > flash[name] for name in flash)


def test_flash_is_slower_with_either_of_cache_and_prefetch_off_where_that_one_counts(
    with_memories: dict[SequencePlace, dict[str, int]],
) -> None:
    flash, alone = with_memories[SequencePlace.FLASH], with_memories[SequencePlace.FLASH_ALONE]
    uncached, unread_ahead = (
        with_memories[place] for place in (SequencePlace.FLASH_WITHOUT_CACHE, SequencePlace.FLASH_WITHOUT_PREFETCH)
    )
    # Straight code never comes back. The four instructions of a line are executed within one flash clock, and with its
    # end the next line is read, which takes another.
    assert uncached["fp"] == flash["fp"]
    assert unread_ahead["fp"] == 32 // 4 * 2 * 5
    # A call of what is in another line finds it, and its own line again, in the cache alone: two reads for every call.
    assert 40 == flash["call_and_return"] < unread_ahead["call_and_return"]
    assert uncached["call_and_return"] == 8 * 2 * 2 * 5
    for name in flash:
        assert flash[name] <= uncached[name] <= alone[name]
        assert flash[name] <= unread_ahead[name] <= alone[name]


def test_the_clocks_from_flash_are_shown_and_written_with_cache_and_prefetch_on_and_off(
    with_memories: dict[SequencePlace, dict[str, int]],
) -> None:
    raw = {place.name.lower(): clocks for place, clocks in with_memories.items()}
    written = tomllib.loads(profile_text("measured/1", solved(raw["sram"]), raw))
    assert written["measured"] == raw
    console = Console(file=StringIO(), width=80)
    print_places(console, raw)
    shown = console.file.getvalue()  # type: ignore[attr-defined]
    assert re.search(r"sequence +SRAM_L +flash +cache off +prefetch off +all off", shown)
    places = ("flash", "flash_without_cache", "flash_without_prefetch", "flash_alone")
    of_fp = " +".join(str(raw[place]["fp"]) for place in places)
    assert re.search(rf"^ ?fp +32 +{of_fp} *$", shown, re.M)
    print_places(console, dict.fromkeys(raw, raw["sram"]))
    assert "takes the same clocks, with and without cache and prefetch" in console.file.getvalue()  # type: ignore[attr-defined]


def test_every_row_is_solved_for_once_and_every_sequence_used() -> None:
    rows = [equation.row for equation in EQUATIONS]
    assert sorted((*rows, "table_branch")) == sorted(ROWS)
    used = [item.sequence for item in (*EQUATIONS, *CHECKS, *questions(values(load_profile(WITH_RULES))))]
    assert sorted((*used, "readings")) == sorted(SEQUENCES)


@pytest.fixture(scope="module")
def clocks(rig: Rig) -> dict[str, int]:
    with open_board(made_with(rig, PLAIN)) as board:
        return clocks_of_every_place(board)


def with_edge(machine: VirtualK64F, clocks: int) -> None:
    """Have every run of a sequence count more before it returns, as a refill at its edges would make it."""
    core, handle = machine.processor.core, machine.processor.machine.handle

    def wait(_reason: int) -> None:
        """Let time pass; those that count themselves answer it in r0."""
        core.cycles += clocks
        core.r[0] += clocks
        core.passes_breakpoint = True

    machine.processor.at_stop = wait
    for name in SEQUENCES:
        for place in ("sram", "flash"):
            symbol = machine.image.symbols[f"sequence_{name}_{place}"]
            returns_at = (symbol.address & ~1) + symbol.size - POP_BYTES
            assert lib.machine_set_breakpoint(handle, returns_at, True)


@pytest.mark.parametrize("edge", [1, 4])
def test_what_a_run_costs_at_its_edges_is_in_no_row(rig: Rig, clocks: dict[str, int], edge: int) -> None:
    ask, rig = TimeSequence(SEQUENCES.index("fp")), made_with(rig, PLAIN)
    with open_board(rig) as board:
        without = board.session.request(ask)
    bench = VirtualBench(rig)
    with_edge(bench.machine, edge)
    with VirtualBoard(bench) as board:
        cost = board.session.request(ask)
        result = clocks_of_every_place(board)
    assert without is not None
    assert cost is not None
    assert cost.overhead_cycles == without.overhead_cycles + edge  # it is there
    assert result == clocks
    measured = solved(result)
    assert measured.remarks == ()
    plain = load_profile(PLAIN)
    assert {name: row.band for name, row in measured.rows.items()} == {
        name: (row.value, row.value) for name, row in plain.rows.items()
    }


def test_clocks_that_are_no_whole_number_an_instruction_widen_the_band(clocks: dict[str, int]) -> None:
    measured = solved(clocks | {"fp_stores": 48})
    assert measured.rows["fp_store"].band == (1, 2)
    assert measured.remarks == ("fp_store: 1.500 clocks is not a whole number: its band is 1 to 2",)


def test_a_rule_that_does_not_hold_is_told(clocks: dict[str, int]) -> None:
    (remark,) = solved(clocks | {"accumulate_chain": 128}).remarks
    assert remark.startswith("accumulate_chain: 128 clocks, but the rows give 96: a rule of the model does not apply")
    (remark,) = solved(clocks | {"load_store_pairs": 64}).remarks
    assert remark.startswith("load_store_pairs: 64 clocks, but the rows give 48")


@pytest.mark.parametrize(
    ("mnemonics", "answer"),
    [
        (("mul", "mla", "mls"), {"multiply", "multiply_chain"}),
        (("umull", "smull", "umlal", "smlal"), {"multiply_long", "multiply_long_chain"}),
        (("smlad", "smladx", "smlabb", "smlatt"), {"multiply_pairs", "multiply_pairs_chain"}),
        (("ssub16", "pkhtb", "pkhbt", "uxth"), {"pack_halves"}),
        (("ldrsh",), {"loads_of_halves"}),
        (("strh",), {"stores_of_halves"}),
        (("vmul.f32",), {"accumulate_and_multiply", "fp_multiply", "fp_multiply_chain"}),
        (("vcvt.f32.s32", "vmov.f32", "vabs.f32", "vneg.f32"), {"fp_convert"}),
        (("vcmpe.f32", "vmrs"), {"fp_compare"}),
        (("vldmia",), {"fp_load_multiple"}),
        (("vstmia",), {"fp_store_multiple"}),
    ],
    ids=lambda item: item[0].partition(".")[0] if isinstance(item, tuple) else "",
)
def test_a_class_of_the_kernels_that_costs_more_than_others_of_its_row_is_told(
    rig: Rig, mnemonics: tuple[str, ...], answer: set[str]
) -> None:
    def more(_address: int, text: str) -> int:
        return int(text.split()[0].removesuffix(".w") in mnemonics)

    clocks = clocks_of_dearer_board(rig, more, PLAIN)
    assert {remark.split(":")[0] for remark in solved(clocks).remarks} == answer


def test_a_result_that_comes_later_than_the_model_knows_is_told_and_the_profile_can_be_read(
    clocks: dict[str, int], tmp_path: Path
) -> None:
    measured = solved(clocks | {"fp_divide_result": clocks["fp_divide_result"] + 8})
    assert measured.remarks == ("fp_divide_use: 3 clocks after fp_divide, but the model allows 0 or 1",)
    (tmp_path / "measured.toml").write_text(profile_text("measured/1", measured, {}), encoding="utf-8")
    assert load_profile(str(tmp_path / "measured.toml")).rows["fp_divide_use"].value == 14


def test_over_a_port_it_is_the_same(pty_board: Callable[[Rig], object], rig: Rig, clocks: dict[str, int]) -> None:
    path = pty_board(made_with(rig, PLAIN)).path  # type: ignore[attr-defined]
    with RealBoard(str(path), rig) as board:
        assert measure_sequences(board)[SequencePlace.SRAM] == clocks


def test_only_a_chip_is_called_silicon() -> None:
    assert not is_silicon(VIRTUAL_UNIQUE_ID)
    assert not is_silicon(bytes(16))
    assert is_silicon(bytes.fromhex("0123456789abcdef" * 2))


@pytest.mark.slow
def test_the_command_writes_a_profile_named_after_the_board_and_shows_what_it_found(tmp_path: Path) -> None:
    done = run_module("hiltest", "timing", "measure", folder=tmp_path)
    assert done.returncode == 0, done.stderr
    name = f"virtual-{VIRTUAL_UNIQUE_ID.hex()}"
    rows = tomllib.loads((tmp_path / f"{name}.toml").read_text(encoding="utf-8"))["cost"]
    assert done.stdout.splitlines()[-1] == f"{name}.toml: {name}, {len(rows)} rows"
    assert {equation.row for equation in EQUATIONS} <= rows.keys()
    assert re.search(r"^ ?fp_accumulate +3 +3 +2 to 3", done.stdout, re.M)
    assert "Code in flash takes the same clocks, with and without cache and prefetch." in done.stdout
    profile = load_profile(str(tmp_path / f"{name}.toml"))
    assert re.fullmatch(rf"{name}\+[0-9a-f]{{8}}", profile.name)
    assert values(profile) == values(load_profile(DEFAULT_PROFILE))
    assert "build" in profile.rows["fp"].source


MEASURED = f"virtual-{VIRTUAL_UNIQUE_ID.hex()}"
OF_THIS_BOARD = f'name = "{MEASURED}"\nbase = "{DEFAULT_PROFILE}"\n[measured.sram]\nfp = 3\n'


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "code"),
    [
        (OF_THIS_BOARD, 0),
        (OF_THIS_BOARD.replace(MEASURED, "silicon-12"), 4),
        ("", 4),
        ("my notes", 4),
        (OF_THIS_BOARD.partition("[measured")[0], 4),
    ],
    ids=["this board's", "another's", "empty", "notes", "written by hand"],
)
def test_only_an_earlier_measurement_of_the_board_is_overwritten(tmp_path: Path, text: str, code: int) -> None:
    file = tmp_path / "x.toml"
    file.write_text(text, encoding="utf-8")
    done = run_module("hiltest", "timing", "measure", "--out", "x.toml", folder=tmp_path)
    assert done.returncode == code, done.stderr
    assert (file.read_text(encoding="utf-8") == text) is bool(code)
    refused = f"x.toml exists, is not a measured profile {MEASURED}, and is not overwritten"
    assert (refused in done.stderr) is bool(code)


@pytest.mark.parametrize(
    ("changed", "row", "remark"),
    [
        ({"accumulate": 0}, "fp_accumulate", "but the model requires at least 1"),
        ({"accumulate_over_integers": -64}, "fp_accumulate_hidden", "but the model allows at most 2"),
    ],
)
def test_what_no_profile_may_hold_is_told_and_the_profile_can_be_read(
    clocks: dict[str, int], tmp_path: Path, changed: dict[str, int], row: str, remark: str
) -> None:
    measured = solved(clocks | changed)
    assert any(item.startswith(f"{row}: ") and item.endswith(remark) for item in measured.remarks)
    (tmp_path / "measured.toml").write_text(profile_text("measured/1", measured, {}), encoding="utf-8")
    assert load_profile(str(tmp_path / "measured.toml")).rows[row] == measured.rows[row]


@pytest.mark.slow
def test_who_only_wants_to_see_the_clocks_writes_them_nowhere(tmp_path: Path) -> None:
    done = run_module("hiltest", "timing", "measure", "--out", os.devnull, folder=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "fp_accumulate" in done.stdout
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_a_file_that_cannot_be_written_is_told(tmp_path: Path) -> None:
    done = run_module("hiltest", "timing", "measure", "--out", "gone/x.toml", folder=tmp_path)
    assert done.returncode == 4
    assert "cannot write gone/x.toml: No such file or directory; name another file" in done.stderr
