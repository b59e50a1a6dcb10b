"""Classes of cycles: the work of a class of instructions, or a stall.

The work of an instruction is its cost if no earlier instruction delays it; the rest of its cost is a
stall. The core finds the causes by removing the pipeline's state step by step, so that the parts always
add up to the whole.
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
    """Refill of the pipeline after a taken transfer."""
    FP_RESULT = "fp_result"
    """Use of a result of the floating-point instruction right before."""
    DIVISION = "division"
    """VDIV or VSQRT still occupies the FPU, or its result is not ready; or a multiply-accumulate, in a timing
    profile that hides some of its cycles."""
    LOAD_USE = "load_use"
    """A load whose address comes from the load right before, so that the two do not overlap."""
    STORE_BUFFER = "store_buffer"
    """A load that waits for the store right before."""
    ADDRESS = "address"
    """An address from a result of the instruction right before, in a profile with that rule."""
    FETCH = "fetch"
    """Four bytes not at a multiple of four that are not fetched yet, in a profile with that rule."""


WORK_OF_ROW = {
    "data": Work.INTEGER,
    "divide": Work.INTEGER,
    "it": Work.INTEGER,
    "it_skipped": Work.INTEGER,
    "load": Work.LOAD_STORE,
    "store": Work.LOAD_STORE,
    "store_register_offset": Work.LOAD_STORE,
    "multiple_base": Work.LOAD_STORE,
    "exclusive": Work.LOAD_STORE,
    "fp_load": Work.LOAD_STORE,
    "fp_store": Work.LOAD_STORE,
    "branch": Work.BRANCH,
    "table_branch": Work.BRANCH,
    "barrier": Work.SYSTEM,
    "system": Work.SYSTEM,
    "fp": Work.FLOATING_POINT,
    "fp_accumulate": Work.FLOATING_POINT,
    "fp_divide": Work.FLOATING_POINT,
    "fp_move_pair": Work.FLOATING_POINT,
}
"""Work of each instruction row of a timing profile."""

STALL_NUMBERS = {
    Stall.TAKEN_BRANCH: lib.STALL_TAKEN_BRANCH,
    Stall.FP_RESULT: lib.STALL_FP_RESULT,
    Stall.DIVISION: lib.STALL_DIVISION,
    Stall.LOAD_USE: lib.STALL_LOAD_USE,
    Stall.STORE_BUFFER: lib.STALL_STORE_BUFFER,
    Stall.ADDRESS: lib.STALL_ADDRESS,
    Stall.FETCH: lib.STALL_FETCH,
}
"""Number of each stall in the core's results."""
