"""Rules of fetching and of addresses: possible behaviours of a core, and those that a board's clocks support.

A candidate is a profile: rows with other values, some of which no profile file can have. A virtual board with that
profile predicts its count, as the firmware counts: the whole sequence minus its second half.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from hiltest.virtual.board.k64f import VirtualK64F
from hiltest.virtual.model.timing import CostRow, TimingProfile, replace_values
from hiltest.virtual.program.elf import FirmwareImage

_BUFFER_BYTES = 128  # memory that sequences load from and store to


# Rows of other fetch rules, which a profile file cannot name.
_EVERY_THIRD, _EVERY_SECOND = {"misplaced_on_end": 3}, {"misplaced_on_end": 2}
_PAST_NARROW = {"late_past_narrow": 1}


@dataclass(frozen=True, slots=True)
class Candidate:
    """One possible behaviour of a core."""

    says: str
    rows: Mapping[str, int] = field(default_factory=dict)
    """Values of rows."""
    in_rows: bool = True
    """True if a profile file can express it."""

    def apply_to(self, profile: TimingProfile) -> TimingProfile:
        """Return a profile with this behaviour, and otherwise the values of `profile`."""
        present = {name: value for name, value in self.rows.items() if name in profile.rows}
        new = {name: CostRow(value, (value, value), "") for name, value in self.rows.items() if name not in present}
        changed = replace_values(profile, present)
        return TimingProfile(profile.name, changed.rows | new, profile.memory, shipped=False)


@dataclass(frozen=True, slots=True)
class Question:
    """A sequence that decides about a row, or about a behaviour without a row."""

    sequence: str
    about: str
    """Content of half the sequence."""
    row: str
    """Row that it decides, or that one of its candidates contradicts; empty without one."""
    candidates: tuple[Candidate, ...]
    """Possible answers; the first one is that the rule does not hold."""


def questions(value: Mapping[str, int]) -> tuple[Question, ...]:
    """Return the questions, in an order in which none depends on a later one.

    Parameters
    ----------
    value
        Values of the rows that other sequences have given.
    """

    def row_is(row: str, *says: str) -> tuple[Candidate, ...]:
        """Return candidates that the row is 0, 1 and so on."""
        return tuple(Candidate(text, {row: number}) for number, text in enumerate(says))

    def fetch_waits(row: str) -> tuple[Candidate, ...]:
        """Return candidates for the waits in a long run, by a row."""
        return (
            Candidate("none waits", {row: 0}),
            Candidate("one in three waits", {row: 1} | _EVERY_THIRD),
            Candidate("one in two waits", {row: 1} | _EVERY_SECOND, in_rows=False),
        )

    third = row_is("fetch_late", "none waits", "one of the three waits")
    folded = (
        Candidate("IT takes what it takes elsewhere", {"it_folded": value["it"]}),
        Candidate("IT takes no time", {"it_folded": 0}),
    )
    refills = (
        Candidate("it refills as other branches do", {"refill_table": value["refill_indirect"]}),
        *(
            Candidate(f"with its refill it takes {value['table_branch'] + refill}", {"refill_table": refill})
            for refill in (4, 5, 6)
            if refill != value["refill_indirect"]
        ),
    )
    unaligned = tuple(
        Candidate(says, {"load": value["load"] + more})
        for more, says in enumerate(("as at a word", "a clock more a load", "two clocks more a load"))
    )
    return (
        Question("load_and_three", "4 times LDR, 3 EOR.W at half a word, NOP", "fetch_late", third),
        Question("pair_and_three", "4 times VMOV of a pair, 3 UMAAL at half a word, 5 NOP", "fetch_late", third),
        Question(
            "load_and_two",
            "4 times LDR, 2 EOR.W at half a word, 2 NOP",
            "fetch_late",
            (
                Candidate("none waits"),
                Candidate("the second waits", {"fetch_late": 1} | _EVERY_SECOND, in_rows=False),
            ),
        ),
        Question(
            "integers_misplaced",
            "5 NOP around 48 EOR.W at half a word",
            "fetch_late_integer",
            fetch_waits("fetch_late_integer"),
        ),
        Question("fp_misplaced", "5 NOP around 48 VADD at half a word", "fetch_late_fp", fetch_waits("fetch_late_fp")),
        Question(
            "load_compare_and_three",
            "4 times LDR.W, CMP, 3 EOR.W at half a word, 4 NOP",
            "fetch_late",
            (
                Candidate("none waits behind the CMP"),
                Candidate("one of the three waits", {"fetch_late": 1} | _PAST_NARROW, in_rows=False),
            ),
        ),
        Question(
            "loop_misplaced",
            "MOVS, 16 turns of SUBS.W at half a word and BNE, 2 NOP",
            "target_misplaced",
            row_is("target_misplaced", "the branch to it waits for nothing", "the branch to it takes one more"),
        ),
        Question(
            "calls_misplaced",
            "5 NOP around 16 BL at half a word, to a BX LR",
            "return_misplaced",
            row_is("return_misplaced", "the return waits for nothing", "the return takes one more"),
        ),
        Question(
            "computed_address",
            "8 times ADDS, LDR from the address that it made",
            "address_use",
            row_is("address_use", "LDR waits for nothing", "LDR waits a clock"),
        ),
        Question("compare_if_then", "8 times CMP of two bytes, IT, MOVEQ", "it_folded", folded),
        Question("if_then", "16 times IT, ADDEQ of two bytes", "it_folded", folded),
        Question("table_branch", "8 TBB to the next instruction", "refill_table", refills),
        Question("loads_one_off", "8 times LDR at +1, EOR.W; the default model prices none", "", unaligned),
        Question("loads_two_off", "8 times LDR at +2, EOR.W; the default model prices none", "", unaligned),
        Question("loads_three_off", "8 times LDR at +3, EOR.W; the default model prices none", "", unaligned),
    )


@dataclass(frozen=True, slots=True)
class Judgement:
    """Measured clocks of a sequence, and the prediction of each candidate [clocks of its first half]."""

    question: Question
    clocks: int
    predicted: tuple[int, ...]

    @property
    def survivors(self) -> tuple[Candidate, ...]:
        """Candidates that predict the measured clocks."""
        both = zip(self.question.candidates, self.predicted, strict=True)
        return tuple(candidate for candidate, clocks in both if clocks == self.clocks)

    @property
    def decided(self) -> Candidate | None:
        """The only surviving candidate, or None."""
        return self.survivors[0] if len(self.survivors) == 1 else None

    @property
    def shows_rule(self) -> bool:
        """Return whether the core contradicts the candidate without the rule."""
        return self.question.candidates[0] not in self.survivors

    @property
    def verdict(self) -> str:
        """Text of the surviving candidates."""
        if not self.survivors:
            return "none of the candidates predicts it"
        if self.decided is None:
            return "it cannot be told: " + ", or ".join(survivor.says for survivor in self.survivors)
        return self.decided.says


def predicted_clocks(image: FirmwareImage, profile: TimingProfile, sequence: str) -> int:
    """Return the clocks of the first half of a sequence on a core with a profile."""
    board = VirtualK64F(image, profile=profile)
    whole, second_half = (
        board.call(f"sequence_{sequence}_sram", bytearray(_BUFFER_BYTES), from_middle).cycles for from_middle in (0, 1)
    )
    return whole - second_half


def judge(clocks: Mapping[str, int], profile: TimingProfile, image: FirmwareImage) -> Iterator[Judgement]:
    """Compare the measured clocks with the candidates.

    Parameters
    ----------
    clocks
        Clocks of half of each sequence, run from SRAM_L with its data in SRAM_U.
    profile
        Profile with the rows of all rules, and with the rows that other sequences have given.
    image
        Firmware with the sequences.
    """
    for question in questions({name: row.value for name, row in profile.rows.items()}):
        predicted = tuple(
            predicted_clocks(image, candidate.apply_to(profile), question.sequence) for candidate in question.candidates
        )
        judgement = Judgement(question, clocks[question.sequence], predicted)
        survivor = judgement.decided
        if survivor and question.row:
            profile = survivor.apply_to(profile)
        yield judgement
