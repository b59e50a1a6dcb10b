"""Classes of cycles: work, by the class of the instruction, and stalls, by their cause.

The work of an instruction is its cost if no earlier instruction delays it; the rest of its cost are stalls. The core
finds the causes by removing the state of the pipeline step by step, so that the parts always add up to the total.
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
    """Cause for which an instruction costs more than its work."""

    TAKEN_BRANCH = "taken_branch"
    """Refill of the pipeline after a taken transfer."""
    FP_RESULT = "fp_result"
    """Use of a result of the previous floating-point instruction."""
    DIVISION = "division"
    """VDIV or VSQRT occupies the FPU, or its result is not ready; with some profiles also multiply-accumulate."""
    LOAD_USE = "load_use"
    """A load whose address was loaded by the previous instruction, so that the two do not overlap."""
    STORE_BUFFER = "store_buffer"
    """A load that waits for the previous store."""
    ADDRESS = "address"
    """An address that the previous instruction has computed, in a profile with that rule."""
    FETCH = "fetch"
    """A misaligned instruction of four bytes that is not fetched yet, in a profile with that rule."""


WORK_OF_ROW = {
    "data": Work.INTEGER,
    "divide": Work.INTEGER,
    "multiply": Work.INTEGER,
    "multiply_accumulate": Work.INTEGER,
    "multiply_long": Work.INTEGER,
    "accumulate_long": Work.INTEGER,
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
