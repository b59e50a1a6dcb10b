"""Request and reply of TIME_SEQUENCE: short runs of one kind of instruction."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Annotated, ClassVar

from hiltest.link.fields import FieldReader, number
from hiltest.link.replies import RunCost, Status
from hiltest.link.request import Request

#: Names of the sequences, in the order of the protocol.
SEQUENCES = (
    "data",
    "divide",
    "load_chain",
    "loads",
    "stores",
    "stores_by_register",
    "load_behind_store",
    "store_behind_load",
    "load_store_pairs",
    "load_multiple",
    "store_multiple",
    "branch_not_taken",
    "branch_taken",
    "call_and_return",
    "table_branch",
    "if_then",
    "barrier",
    "system",
    "exclusive",
    "fp",
    "fp_chain",
    "accumulate",
    "accumulate_chain",
    "accumulate_and_multiply",
    "accumulate_over_integers",
    "fp_divide",
    "fp_divide_result",
    "square_root",
    "fp_loads",
    "fp_stores",
    "fp_pairs",
    "data_independent",
    "multiply",
    "multiply_chain",
    "multiply_long",
    "multiply_long_chain",
    "multiply_pairs",
    "multiply_pairs_chain",
    "pack_halves",
    "loads_of_halves",
    "stores_of_halves",
    "fp_multiply",
    "fp_multiply_chain",
    "fp_convert",
    "fp_moves",
    "fp_compare",
    "fp_load_multiple",
    "fp_store_multiple",
    "readings",
    "exception_entry",
    "exception_return",
    "fp_misplaced",
    "integers_misplaced",
    "load_and_three",
    "load_and_two",
    "load_compare_and_three",
    "pair_and_three",
    "calls_misplaced",
    "loop_misplaced",
    "computed_address",
    "compare_if_then",
    "wide_compare_if_then",
    "loads_one_off",
    "loads_two_off",
    "loads_three_off",
    "loads_of_one_base",
    "loads_of_two_bases",
    "loads_of_two_memories",
    "multiple_behind_store",
    "fp_computed_address",
    "loads_and_three",
    "two_loads_and_three",
)


class SequencePlace(IntEnum):
    """Memory that a sequence runs from; the values are those of the protocol."""

    SRAM = 0
    FLASH = 1
    FLASH_ALONE = 2
    """Flash, with cache, prefetch and buffers of its controller off."""
    FLASH_WITHOUT_CACHE = 3
    FLASH_WITHOUT_PREFETCH = 4


@dataclass(frozen=True)
class TimeSequence(Request[RunCost | None]):
    """Run a sequence of instructions of the firmware; the reply is None without a cycle counter.

    The cost is that of its first half. The overhead is a run of its second half, which begins and ends like the whole.
    """

    code = 0x26
    command = "TIME_SEQUENCE"
    answered_with: ClassVar[frozenset[Status]] = frozenset({Status.OK, Status.NO_CYCLE_COUNTER})

    sequence: Annotated[int, number("B", 0, len(SEQUENCES) - 1, "sequence")]
    """Index in `SEQUENCES`."""
    place: SequencePlace = SequencePlace.SRAM
    """Memory that it runs from."""

    def parse(self, fields: FieldReader) -> RunCost | None:
        """Read the cost of its first half, and of a run of the second."""
        return RunCost.read(fields)
