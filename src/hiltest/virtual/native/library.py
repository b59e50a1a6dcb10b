"""The shared library: found, checked against its source, and declared."""

from __future__ import annotations

import ctypes
from functools import cache

from hiltest.c_library import loaded
from hiltest.virtual.native.build import LIBRARY, SOURCES

PASSED = ctypes.CFUNCTYPE(None, ctypes.c_int64)
PROVE = ctypes.CFUNCTYPE(ctypes.c_int64)
PRICE = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_uint32, ctypes.c_uint32, ctypes.c_uint32)
EXECUTE = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_uint32)
ATTEND = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_uint32)
NEUTRAL_ENTRY = 0
STACK = ctypes.CFUNCTYPE(None, ctypes.c_uint32, ctypes.c_uint32)
USES_FPU, ALIGNMENT_INSIDE, CHANGES_MASKS, LOOPS_TO_ITSELF, WATCHED, MAY_WAIT, MAY_BE_PROVED, WATCHED_INSIDE = (
    1 << bit for bit in range(8)
)
LOWERS_STACK, MOVES_STACK_BY, MOVES_STACK, STACK_MOVED = (1 << bit for bit in range(8, 12))
EXECUTING = 1 << 31  # in the entry of a block
STEADY, COUNTED, COUNTS = 1, 2, 4  # of a byte of registers
CALLS, RETURNS, LEAVES_NOTHING = 1, 2, 4  # of the end of a block
CORE_REGISTERS = 15
NO_HEAD = -1
_MOST_BLOCKS, _MOST_READS = 96, 24


class PricedBlock(ctypes.Structure):
    """``struct block`` of block_hook.c."""

    _fields_ = (
        *((name, ctypes.c_uint32) for name in (
            "address", "late", "lowers", "size", "entry", "leaves", "jumps", "count", "through", "taken", "reasons",
            "aligned", "kept", "number", "wait",
        )),
        ("next", ctypes.c_int64), ("rest", ctypes.c_uint16), ("rests", ctypes.c_uint16), ("proved", ctypes.c_uint32),
        ("executed", ctypes.c_uint32),
    )  # fmt: skip


class LoopWatch(ctypes.Structure):
    """``struct watch`` of block_hook.c."""

    _fields_ = (
        ("head", ctypes.c_int64),
        ("cycles", ctypes.c_int64),
        ("instructions", ctypes.c_int64),
        ("until", ctypes.c_int64),
        ("trigger", ctypes.c_void_p),
        ("turns", ctypes.c_uint32),
        ("blocks", ctypes.c_uint32),
        ("reads", ctypes.c_uint32),
        ("counted", ctypes.c_uint32),
        ("changes", ctypes.c_uint32),
        ("end", ctypes.c_uint32),
        ("registers", ctypes.c_uint32 * (CORE_REGISTERS + 1)),
        ("ran", ctypes.c_uint32 * _MOST_BLOCKS),
        ("read", ctypes.c_uint32 * _MOST_READS),
    )


class Counter(ctypes.Structure):
    """``struct counter`` of block_hook.c."""

    _fields_ = (
        ("cycles", ctypes.c_int64),
        ("instructions", ctypes.c_int64),
        ("deadline", ctypes.c_int64),
        ("running_number", ctypes.c_int64),
        ("before_number", ctypes.c_int64),
        ("running", ctypes.c_void_p),
        ("table", ctypes.c_void_p),
        ("runs", ctypes.c_void_p),
        ("ends", ctypes.c_void_p),
        ("places_mask", ctypes.c_uint32),
        ("state", ctypes.c_uint32),
        ("reasons", ctypes.c_uint32),
        ("known_aligned", ctypes.c_uint32),
        ("outside", ctypes.c_uint32),
        ("stopped", ctypes.c_int32),
        ("registers", ctypes.c_int32 * (CORE_REGISTERS + 1)),
        ("stacks", ctypes.c_uint32 * 4),
        ("lowered_from", ctypes.c_uint32),
        ("lowest", ctypes.c_uint32 * 2),
        ("stop", ctypes.c_void_p),
        ("read_register", ctypes.c_void_p),
        ("read_registers", ctypes.c_void_p),
        ("price", PRICE),
        ("execute", EXECUTE),
        ("attend", ATTEND),
        ("stack", STACK),
        ("passed", PASSED),
        ("prove", PROVE),
        ("watch", LoopWatch),
    )


class Window(ctypes.Structure):
    """``struct window`` of block_hook.c."""

    _fields_ = (
        ("base", ctypes.c_uint64),
        ("opened", ctypes.c_void_p),
        ("ask", ctypes.c_void_p),
        ("read_register", ctypes.c_void_p),
        ("write_register", ctypes.c_void_p),
        ("xpsr", ctypes.c_int32),
        ("steady", ctypes.c_void_p),
        ("counter", ctypes.c_void_p),
    )


@cache
def _load() -> tuple[ctypes.CDLL | None, str]:
    """Load the library, or say why it is not used."""
    # PyDLL: none of these functions takes long, and the emulator calls the hook itself, as a plain C function.
    library, reason = loaded(LIBRARY, SOURCES, ctypes.PyDLL)
    if library is None:
        return None, reason
    library.hiltest_calls_size.restype = ctypes.c_size_t
    for name, *arguments in (
        ("note", ctypes.c_uint32, ctypes.c_int32), ("reset",), ("leave",), ("resume", ctypes.c_int64),
    ):  # fmt: skip
        function = getattr(library, f"hiltest_calls_{name}")
        function.argtypes = (ctypes.c_void_p, *arguments)
        function.restype = ctypes.c_uint32 if name == "leave" else None
    library.hiltest_settle.argtypes = (ctypes.c_void_p, ctypes.c_uint32)
    library.hiltest_end_watch.argtypes = (ctypes.c_void_p,)
    library.hiltest_end_watch.restype = None
    library.hiltest_add_block.argtypes = (ctypes.c_void_p, ctypes.c_void_p)
    library.hiltest_add_block.restype = None
    library.hiltest_block_begins.argtypes = (ctypes.c_void_p, ctypes.c_uint64, ctypes.c_uint32, ctypes.c_void_p)
    library.hiltest_block_begins.restype = None
    return library, ""


def missing_because() -> str:
    """Say why there is no block hook in C; empty when there is."""
    return _load()[1]


def library() -> ctypes.CDLL:
    """Return the library.

    Raises
    ------
    RuntimeError
        When there is none that fits; ask `missing_because` first.
    """
    found, reason = _load()
    if found is None:
        raise RuntimeError(reason)
    return found
