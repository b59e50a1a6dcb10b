"""Classes of cycles: the work of a class of instructions, or a stall.

The work of an instruction is what it costs when nothing before it makes it wait; what is above that is a
stall. The core finds its cause by taking away, one after the other, what the pipeline remembers: the parts
therefore always add up to the whole.
"""

from __future__ import annotations

from enum import StrEnum

from hiltest.virtual.core.library import lib


class Work(StrEnum):
    """Class of an instruction."""

    FLOATING_POINT = "floating_point"
    LOAD_STORE = "load_store"
    BRANCH = "branch"
    INTEGER = "integer"
    SYSTEM = "system"


class Stall(StrEnum):
    """Reason why an instruction cost more than its work."""

    TAKEN_BRANCH = "taken_branch"
    """The pipeline refills behind a transfer that is taken."""
    FP_RESULT = "fp_result"
    """It uses what the floating-point instruction right before it computes."""
    DIVISION = "division"
    """VDIV or VSQRT still occupies the FPU, or its result is not there yet; a multiply-accumulate, in a timing
    profile that hides some of its cycles."""
    LOAD_USE = "load_use"
    """A load takes its address from the load right before it, so the two do not overlap."""
    STORE_BUFFER = "store_buffer"
    """A load right behind a store waits for it."""
    ADDRESS = "address"
    """It makes an address of what the instruction right before it computes; in a profile that knows that."""
    FETCH = "fetch"
    """Its four bytes do not begin at a multiple of four, and are not fetched yet; in a profile that knows that."""


WORK_OF_ROW = {
    "data": Work.INTEGER, "divide": Work.INTEGER, "it": Work.INTEGER, "it_skipped": Work.INTEGER,
    "load": Work.LOAD_STORE, "store": Work.LOAD_STORE, "store_register_offset": Work.LOAD_STORE,
    "multiple_base": Work.LOAD_STORE, "exclusive": Work.LOAD_STORE, "fp_load": Work.LOAD_STORE,
    "fp_store": Work.LOAD_STORE,
    "branch": Work.BRANCH, "table_branch": Work.BRANCH,
    "barrier": Work.SYSTEM, "system": Work.SYSTEM,
    "fp": Work.FLOATING_POINT, "fp_accumulate": Work.FLOATING_POINT, "fp_divide": Work.FLOATING_POINT,
    "fp_move_pair": Work.FLOATING_POINT,
}  # fmt: skip
"""Class of each row of a timing profile that prices instructions."""

STALL_NUMBERS = {
    Stall.TAKEN_BRANCH: lib.STALL_TAKEN_BRANCH, Stall.FP_RESULT: lib.STALL_FP_RESULT,
    Stall.DIVISION: lib.STALL_DIVISION, Stall.LOAD_USE: lib.STALL_LOAD_USE,
    Stall.STORE_BUFFER: lib.STALL_STORE_BUFFER, Stall.ADDRESS: lib.STALL_ADDRESS, Stall.FETCH: lib.STALL_FETCH,
}  # fmt: skip
"""Number of each cause in the core's results."""
