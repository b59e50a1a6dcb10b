"""Rules of fetching and of addresses: possible behaviours of a core, and those that match a board's clocks.

A candidate is a profile with other values in some rows, including rows that profile files cannot have. A virtual board
with this profile predicts the count of the firmware: the complete sequence minus its second half.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from hiltest.virtual.board.k64f import VirtualK64F
from hiltest.virtual.model.timing import CostRow, TimingProfile, replace_values
from hiltest.virtual.program.elf import FirmwareImage

_BUFFER_BYTES = 128  # memory for the loads and stores of sequences


# Rows of other fetch rules, which profile files cannot have.
_EVERY_THIRD, _EVERY_SECOND = {"misplaced_on_end": 3}, {"misplaced_on_end": 2}
_PAST_NARROW = {"late_past_narrow": 1}


@dataclass(frozen=True, slots=True)
class Candidate:
    """One possible behaviour of a core."""

    says: str
    rows: Mapping[str, int] = field(default_factory=dict)
    """Values of rows."""
    in_rows: bool = True
    """True if a profile file can express the behaviour."""

    def apply_to(self, profile: TimingProfile) -> TimingProfile:
        """Return `profile` with this behaviour."""
        present = {name: value for name, value in self.rows.items() if name in profile.rows}
        new = {name: CostRow(value, (value, value), "") for name, value in self.rows.items() if name not in present}
        changed = replace_values(profile, present)
        return TimingProfile(profile.name, changed.rows | new, profile.memory, shipped=False)


@dataclass(frozen=True, slots=True)
class Question:
    """A sequence that decides about a row."""

    sequence: str
    about: str
    """Content of half the sequence."""
    row: str
    """Row that the sequence decides, or that a candidate contradicts."""
    candidates: tuple[Candidate, ...]
    """Possible answers; the first one is that the rule does not apply."""


def questions(value: Mapping[str, int]) -> tuple[Question, ...]:
    """Return the questions in order of their dependencies.

    Parameters
    ----------
    value
        Values of the rows that other sequences gave.
    """

    def row_is(row: str, *says: str) -> tuple[Candidate, ...]:
        """Return candidates for the values 0, 1 and so on of a row."""
        return tuple(Candidate(text, {row: number}) for number, text in enumerate(says))

    def value_question(sequence: str, about: str, row: str, *says: str) -> Question:
        """Return the question for a row's value: 0, 1 and so on."""
        return Question(sequence, about, row, row_is(row, *says))

    def fetch_waits(row: str) -> tuple[Candidate, ...]:
        """Return candidates for the waits in a long run, which a row prices."""
        return (
            Candidate("none waits", {row: 0}),
            Candidate("one in three waits", {row: 1} | _EVERY_THIRD),
            Candidate("one in two waits", {row: 1} | _EVERY_SECOND, in_rows=False),
        )

    third = row_is("fetch_late", "none waits", "one of the three waits")
    folded = (
        Candidate("IT takes the same time as elsewhere", {"it_folded": value["it"]}),
        Candidate("IT takes no time", {"it_folded": 0}),
    )
    refills = (
        Candidate("its refill is that of other branches", {"refill_table": value["refill_indirect"]}),
        *(
            Candidate(f"with its refill it takes {value['table_branch'] + refill}", {"refill_table": refill})
            for refill in (4, 5, 6)
            if refill != value["refill_indirect"]
        ),
    )
    unaligned = row_is("unaligned", "as if aligned", "one clock more for each part but the first")
    return (
        Question("load_and_three", "4 times LDR, 3 misaligned EOR.W, NOP", "fetch_late", third),
        Question(
            "integers_misplaced",
            "5 NOP around 48 misaligned EOR.W",
            "fetch_late_integer",
            fetch_waits("fetch_late_integer"),
        ),
        Question("pair_and_three", "4 times VMOV of a pair, 3 misaligned UMAAL, 5 NOP", "fetch_late", third),
        Question(
            "load_and_two",
            "4 times LDR, 2 misaligned EOR.W, 2 NOP",
            "fetch_late",
            (
                Candidate("none waits"),
                Candidate("the second waits", {"fetch_late": 1} | _EVERY_SECOND, in_rows=False),
            ),
        ),
        Question("fp_misplaced", "5 NOP around 48 misaligned VADD", "fetch_late_fp", fetch_waits("fetch_late_fp")),
        Question(
            "load_compare_and_three",
            "4 times LDR.W, CMP, 3 misaligned EOR.W, 4 NOP",
            "fetch_late",
            (
                Candidate("none waits after the CMP"),
                Candidate("one of the three waits", {"fetch_late": 1} | _PAST_NARROW, in_rows=False),
            ),
        ),
        value_question(
            "loop_misplaced",
            "MOVS, 16 turns of a misaligned SUBS.W and BNE, 2 NOP",
            "target_misplaced",
            "the branch to it does not wait",
            "the branch to it takes one clock more",
        ),
        value_question(
            "calls_misplaced",
            "5 NOP around 16 misaligned BL, to a BX LR",
            "return_misplaced",
            "the return does not wait",
            "the return takes one clock more",
        ),
        value_question(
            "computed_address",
            "8 times ADDS, LDR from the computed address",
            "address_use",
            "LDR does not wait",
            "LDR waits one clock",
        ),
        Question("compare_if_then", "8 times CMP of two bytes, IT, MOVEQ", "it_folded", folded),
        Question("if_then", "16 times IT, ADDEQ of two bytes", "it_folded", folded),
        Question("table_branch", "8 TBB to the next instruction", "refill_table", refills),
        Question("loads_one_off", "8 times LDR at +1, EOR.W", "unaligned", unaligned),
        Question("loads_two_off", "8 times LDR at +2, EOR.W", "unaligned", unaligned),
        Question("loads_three_off", "8 times LDR at +3, EOR.W", "unaligned", unaligned),
        value_question(
            "loads_of_one_base",
            "4 times LDR [r1], #4, LDR [r1], #-4",
            "load_same_base",
            "the loads overlap",
            "no load overlaps",
        ),
        value_question(
            "loads_of_two_memories",
            "4 times LDR from SRAM_U, LDR from flash",
            "load_other_block",
            "the loads overlap",
            "no load overlaps",
        ),
        value_question(
            "multiple_behind_store",
            "4 times NOP, STR, LDM of two words",
            "multiple_behind_store",
            "LDM does not wait",
            "LDM waits one clock",
        ),
        value_question(
            "fp_computed_address",
            "twice VMOV to the FPU, VMOV back, LDR from this address, NOP.W",
            "address_use_fp",
            "LDR does not wait",
            "LDR waits one clock",
        ),
        value_question(
            "loads_and_three",
            "twice 3 LDR, 3 misaligned EOR.W, NOP, 3 NOP.W",
            "fetch_late_access",
            "none waits",
            "one of the three waits",
        ),
        value_question(
            "two_loads_and_three",
            "twice NOP, misaligned LDR.W, EOR.W, LDR.W, 2 EOR.W, NOP, 2 NOP.W",
            "fetch_late_unbroken",
            "none waits",
            "the third of the five waits",
        ),
        Question(
            "loads_of_two_bases",
            "twice LDR [r1], #4, LDR [r2], #4, LDR [r1], #-4, LDR [r2], #-4",
            "load_same_base",
            (
                Candidate("the loads overlap"),
                Candidate("no load overlaps", {"load_behind_load": value["load"]}, in_rows=False),
            ),
        ),
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
        """The only matching candidate, or None."""
        return self.survivors[0] if len(self.survivors) == 1 else None

    @property
    def shows_rule(self) -> bool:
        """Return whether the core contradicts the first candidate, in which the rule does not apply."""
        return self.question.candidates[0] not in self.survivors

    @property
    def verdict(self) -> str:
        """Text of the matching candidates."""
        if not self.survivors:
            return "no candidate matches"
        if self.decided is None:
            return "undecided: " + ", or ".join(survivor.says for survivor in self.survivors)
        return self.decided.says


def predicted_clocks(image: FirmwareImage, profile: TimingProfile, sequence: str) -> int:
    """Return the clocks of the first half of a sequence on a core with a profile."""
    board = VirtualK64F(image, profile=profile)
    begin = image.symbols[f"sequence_{sequence}_sram"].address
    half_bytes = int.from_bytes(image.read(begin - 4, 4), "little")
    # The buffer's third word is the address of a word in flash, here 0. Bit 0 of a place is set, as in a function's.
    whole, second_half = (
        board.call("sequence_enter", bytearray(_BUFFER_BYTES), place | 1).cycles
        for place in (begin, begin + half_bytes)
    )
    return whole - second_half


def judge(clocks: Mapping[str, int], profile: TimingProfile, image: FirmwareImage) -> Iterator[Judgement]:
    """Compare the measured clocks with the candidates.

    Parameters
    ----------
    clocks
        Clocks of half of each sequence, run from SRAM_L with its data in SRAM_U.
    profile
        Profile with the rows of all rules, and with the rows that other sequences gave.
    image
        Firmware with the sequences.
    """
    for question in questions({name: row.value for name, row in profile.rows.items()}):
        predicted = tuple(
            predicted_clocks(image, candidate.apply_to(profile), question.sequence) for candidate in question.candidates
        )
        judgement = Judgement(question, clocks[question.sequence], predicted)
        survivor = judgement.decided
        if survivor:
            profile = survivor.apply_to(profile)
        yield judgement
