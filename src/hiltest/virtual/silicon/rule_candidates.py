"""Rules of fetching and of addresses: how a core may behave, and which of it a board's clocks agree with.

A candidate is a profile: rows with other values, some of which no profile file can have. What it predicts is counted
on a virtual board that is made with it, as the firmware counts: a run of the whole less one of the second half.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from hiltest.virtual.board.k64f import VirtualK64F
from hiltest.virtual.model.timing import CostRow, TimingProfile, moved
from hiltest.virtual.program.elf import FirmwareImage

_BUFFER_BYTES = 128  # what sequences load from and store to


# Rows that a profile file has no names for: other rules of fetching.
_EVERY_THIRD, _EVERY_SECOND = {"misplaced_on_end": 3}, {"misplaced_on_end": 2}
_PAST_NARROW = {"late_past_narrow": 1}


@dataclass(frozen=True, slots=True)
class Candidate:
    """One way in which a core may behave."""

    says: str
    rows: Mapping[str, int] = field(default_factory=dict)
    """Values of rows."""
    in_rows: bool = True
    """Whether a profile file can say it."""

    def of(self, profile: TimingProfile) -> TimingProfile:
        """Return a profile that behaves so, and else as this one."""
        known = {name: value for name, value in self.rows.items() if name in profile.rows}
        new = {name: CostRow(value, (value, value), "") for name, value in self.rows.items() if name not in known}
        changed = moved(profile, known)
        return TimingProfile(profile.name, changed.rows | new, profile.memory, shipped=False)


@dataclass(frozen=True, slots=True)
class Question:
    """What a sequence tells of a row, or of what no row says."""

    sequence: str
    """Its name."""
    about: str
    """What stands in its half."""
    row: str
    """Row that it decides, or that one of its candidates contradicts; empty without one."""
    candidates: tuple[Candidate, ...]
    """The first one is that the rule does not hold."""


def questions(value: Mapping[str, int]) -> tuple[Question, ...]:
    """Return the questions, in an order in which each depends on none that comes later.

    Parameters
    ----------
    value
        Values of the rows that other sequences have given.
    """

    def of_row(row: str, *says: str) -> tuple[Candidate, ...]:
        """Return that a row is 0, and that it is 1."""
        return tuple(Candidate(each, {row: number}) for number, each in enumerate(says))

    def fetched(row: str) -> tuple[Candidate, ...]:
        """Return what a long run may wait by a row."""
        return (Candidate("none waits", {row: 0}), Candidate("one in three waits", {row: 1} | _EVERY_THIRD),
                Candidate("one in two waits", {row: 1} | _EVERY_SECOND, in_rows=False))  # fmt: skip

    third = of_row("fetch_late", "none waits", "one of the three waits")
    folded = (Candidate("IT takes what it takes elsewhere", {"it_folded": value["it"]}),
              Candidate("IT takes no time", {"it_folded": 0}))  # fmt: skip
    refills = (Candidate("it refills as other branches do", {"refill_table": value["refill_indirect"]}),
               *(Candidate(f"with its refill it takes {value['table_branch'] + refill}", {"refill_table": refill})
                 for refill in (4, 5, 6) if refill != value["refill_indirect"]))  # fmt: skip
    unaligned = tuple(
        Candidate(says, {"load": value["load"] + more})
        for more, says in enumerate(("as at a word", "a clock more a load", "two clocks more a load"))
    )
    return (
        Question("load_and_three", "4 times LDR, 3 EOR.W at half a word, NOP", "fetch_late", third),
        Question("pair_and_three", "4 times VMOV of a pair, 3 UMAAL at half a word, 5 NOP", "fetch_late", third),
        Question("load_and_two", "4 times LDR, 2 EOR.W at half a word, 2 NOP", "fetch_late", (
            Candidate("none waits"), Candidate("the second waits", {"fetch_late": 1} | _EVERY_SECOND, in_rows=False),
        )),
        Question("integers_misplaced", "5 NOP around 48 EOR.W at half a word", "fetch_late_integer",
                 fetched("fetch_late_integer")),
        Question("fp_misplaced", "5 NOP around 48 VADD at half a word", "fetch_late_fp",
                 fetched("fetch_late_fp")),
        Question("load_compare_and_three", "4 times LDR.W, CMP, 3 EOR.W at half a word, 4 NOP", "fetch_late", (
            Candidate("none waits behind the CMP"),
            Candidate("one of the three waits", {"fetch_late": 1} | _PAST_NARROW, in_rows=False),
        )),
        Question("loop_misplaced", "MOVS, 16 turns of SUBS.W at half a word and BNE, 2 NOP", "target_misplaced",
                 of_row("target_misplaced", "the branch to it waits for nothing", "the branch to it takes one more")),
        Question("calls_misplaced", "5 NOP around 16 BL at half a word, to a BX LR", "return_misplaced",
                 of_row("return_misplaced", "the return waits for nothing", "the return takes one more")),
        Question("computed_address", "8 times ADDS, LDR from the address that it made", "address_use",
                 of_row("address_use", "LDR waits for nothing", "LDR waits a clock")),
        Question("compare_if_then", "8 times CMP of two bytes, IT, MOVEQ", "it_folded", folded),
        Question("if_then", "16 times IT, ADDEQ of two bytes", "it_folded", folded),
        Question("table_branch", "8 TBB to the next instruction", "refill_table", refills),
        Question("loads_one_off", "8 times LDR at +1, EOR.W; the default model prices none", "", unaligned),
        Question("loads_two_off", "8 times LDR at +2, EOR.W; the default model prices none", "", unaligned),
        Question("loads_three_off", "8 times LDR at +3, EOR.W; the default model prices none", "", unaligned),
    )  # fmt: skip


@dataclass(frozen=True, slots=True)
class Judgement:
    """What was measured of a sequence, and what each candidate predicts [clocks of its first half]."""

    question: Question
    clocks: int
    predicted: tuple[int, ...]

    @property
    def survivors(self) -> tuple[Candidate, ...]:
        """Candidates that predict what was measured."""
        both = zip(self.question.candidates, self.predicted, strict=True)
        return tuple(candidate for candidate, clocks in both if clocks == self.clocks)

    @property
    def decided(self) -> Candidate | None:
        """The only one that survives."""
        return self.survivors[0] if len(self.survivors) == 1 else None

    @property
    def shows_rule(self) -> bool:
        """Whether the core does not behave as one without the rule."""
        return self.question.candidates[0] not in self.survivors

    @property
    def verdict(self) -> str:
        """Which one survives."""
        if not self.survivors:
            return "none of the candidates predicts it"
        if self.decided is None:
            return "it cannot be told: " + ", or ".join(survivor.says for survivor in self.survivors)
        return self.decided.says


def predicted_clocks(image: FirmwareImage, profile: TimingProfile, sequence: str) -> int:
    """Return what the first half of a sequence takes a core that behaves by a profile."""
    board = VirtualK64F(image, profile=profile)
    whole, second_half = (
        board.call(f"sequence_{sequence}_sram", bytearray(_BUFFER_BYTES), from_middle).cycles for from_middle in (0, 1)
    )
    return whole - second_half


def judge(clocks: Mapping[str, int], profile: TimingProfile, image: FirmwareImage) -> Iterator[Judgement]:
    """Hold what was measured against the candidates.

    Parameters
    ----------
    clocks
        Clocks of half of each sequence, run from SRAM_L with its data in SRAM_U.
    profile
        One that has the rows of all rules, and those that the other sequences have given.
    image
        Has the sequences.
    """
    for question in questions({name: row.value for name, row in profile.rows.items()}):
        predicted = tuple(
            predicted_clocks(image, candidate.of(profile), question.sequence) for candidate in question.candidates
        )
        judgement = Judgement(question, clocks[question.sequence], predicted)
        found = judgement.decided
        if found and question.row:
            profile = found.of(profile)
        yield judgement
