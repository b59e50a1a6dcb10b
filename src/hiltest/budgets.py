"""Budgets of all inputs: the most bytes, items and nesting that a reader accepts, and the most that reading may cost.

A reader checks bytes, items and nesting before it does work that grows with them, and a refusal names the budget.
These three bound processor time and memory, which the fuzzers measure: an input over its budget fails them.
"""

from __future__ import annotations

from dataclasses import dataclass

_KI, _MI = 1 << 10, 1 << 20


class BudgetError(ValueError):
    """Error for an input beyond a budget; the text has the budget and its owner."""


@dataclass(frozen=True, slots=True)
class Budget:
    """The most that one input of a kind may have and cost."""

    name: str
    """Kind of input, with its article, for messages."""
    bytes: int
    """Size, after decompression."""
    items: int
    counted: str
    """Items, and their name in messages."""
    nesting: int
    """Levels of anything within anything."""
    time_s: float
    """Processor time of reading the largest accepted input, or of refusing one, on one core of 2 GHz."""
    memory_bytes: int
    """Memory that reading adds at its peak."""

    def check(self, *, size: int = 0, items: int = 0, nesting: int = 0) -> None:
        """Refuse an input beyond the budget.

        Raises
        ------
        BudgetError
            If it is.
        """
        if size > self.bytes:
            raise BudgetError(f"larger than {self.bytes} bytes, the budget of {self.name}")
        if items > self.items:
            raise BudgetError(f"more than {self.items} {self.counted}, the budget of {self.name}")
        if nesting > self.nesting:
            raise BudgetError(f"nested more than {self.nesting} levels deep, the budget of {self.name}")

    def time_for_s(self, size: int) -> float:
        """Return the budget of processor time for an input of `size` bytes: a share, and 0.1 s to begin with."""
        return 0.1 + self.time_s * min(1.0, size / self.bytes)


def count_separators(text: bytes) -> int:
    """Return the number of characters that begin or separate values of JSON or TOML: at least that of the values."""
    return sum(map(text.count, (b",", b":", b"=", b"[", b"{", b"\n")))


# JSON and TOML: items are separators, each of which may cost a hundred bytes as an object of Python.
RECORD = Budget("a record", 32 * _MI, 2_000_000, "values", 32, 10.0, 512 * _MI)
"""`run.json`, journals and baselines; the record of the full set has a hundredth of it."""
STUDY_JOURNAL = Budget("a study's journal", 256 * _MI, 16_000_000, "values", 32, 60.0, 2048 * _MI)
CALIBRATION = Budget("a calibration file", 1_000_000, 500_000, "values", 32, 2.0, 128 * _MI)
INTERVALS = Budget("a list of intervals", 1_000_000, 500_000, "values", 32, 2.0, 128 * _MI)
WORST_INPUT = Budget("a saved input", 4_000_000, 500_000, "values", 32, 2.0, 128 * _MI)
RIG = Budget("a rig", _MI, 200_000, "values", 16, 5.0, 256 * _MI)
"""A hundred times the largest rig that ships; TOML is parsed in Python."""
PART = Budget("a part file", 64 * _KI, 10_000, "values", 16, 1.0, 64 * _MI)
MACHINE = Budget("a machine file", 64 * _KI, 10_000, "values", 16, 1.0, 64 * _MI)
PROFILE = Budget("a timing profile", 64 * _KI, 10_000, "values", 16, 1.0, 64 * _MI)
SIGNATURE = Budget("a table of signatures", 64 * _KI, 10_000, "values", 16, 1.0, 64 * _MI)

# Recordings and logs.
RECORDING = Budget("a recording", 256 * _MI, 6_000_000, "values", 32, 20.0, 1024 * _MI)
"""A run with its bench: three hours of a line at 115 200 baud without a pause; an entry has six values."""
LINE = Budget("a line of a recording", 4 * _MI, 200_000, "values", 32, 1.0, 64 * _MI)
PACKETS = Budget("a recording of packets", 256 * _MI, 16_000_000, "packets", 1, 60.0, 2048 * _MI)
TABLE = Budget("a table of readings", 512 * _MI, 5_000_000, "lines", 32, 480.0, 2048 * _MI)
"""An hour at 1 kHz, hours of most sensors; a line of JSON takes 65 us. A document of JSON is a `TABLE_DOCUMENT`."""
TABLE_DOCUMENT = Budget("a table as one document of JSON", 64 * _MI, 4_000_000, "values", 32, 20.0, 1024 * _MI)
BINARY_LOG = Budget("a binary log", 512 * _MI, 2_000_000, "messages of sensors", 1, 120.0, 4096 * _MI)
MOTION = Budget("a motion recording", 512 * _MI, 3_600_000, "rows", 1, 20.0, 2048 * _MI)
"""An hour at 1 kHz."""

# Firmware.
ELF = Budget("an ELF", 256 * _MI, 500_000, "symbols", 64, 60.0, 1536 * _MI)
"""A chip has a few MiB of flash; debug information of large C++ firmware is a hundred times that."""
DEBUG = Budget("debug information", 64 * _MI, 4_000_000, "rows of lines or members", 64, 240.0, 4096 * _MI)
"""The decompressed size counts. Beyond its budget it is ignored, as if it were damaged; Python parses it."""
SEGMENTS = Budget("a program to load", 64 * _MI, 4096, "separate pieces", 1, 10.0, 256 * _MI)
HEX = Budget("Intel HEX", 8 * _MI, 4096, "separate pieces", 1, 20.0, 768 * _MI)
"""Text of 2.8 MiB of data; each byte is an entry of a dict while it is read."""
ARGUMENT = Budget("an argument's file", 8 * _MI, 262_144, "numbers", 32, 5.0, 128 * _MI)
"""The RAM of the board, with 32 characters a number."""
SOURCE = Budget("a calibrator's file", 64 * _MI, 500_000, "symbols", 64, 30.0, 1024 * _MI)

# Lines and packets of a running device.
STREAM = Budget("a port's input", _MI, 1_000_000, "frames", 1, 45.0, 64 * _MI)
"""Half of the time in which 115 200 baud bring it, for all forms of text that are tried together."""
PATTERN = Budget("a pattern", 4096, 10_000, "characters with its repetitions written out", 32, 0.5, 32 * _MI)
PATTERNS = Budget("a rig's patterns", 64 * _KI, 64, "patterns", 1, 5.0, 256 * _MI)
GDB = Budget("GDB", 16 * _KI, 8, "repeated answers", 1, 0.5, 4 * _MI)
"""One packet; items are answers that are sent again without a packet between them."""

# Calls of `hiltest mcp`; values are those of a command line.
TOOL_CALL = Budget("a tool's arguments", 64 * _KI, 1000, "values", 2, 0.1, _MI)
