"""Measure the processor time and the memory of reading one input, and make large inputs from small ones.

python -m tests.input_budgets RUN NAME FILE ...

reads files with the reader of that name of test_fuzzed_inputs.py, and fails if one is over twice its budget; RUN is a
run.json.
"""

from __future__ import annotations

import gc
import random
import re
import resource
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from hiltest.budgets import Budget

if TYPE_CHECKING:
    from tests.test_fuzzed_inputs import Reader

# An input may be over its budget by this factor: other programs share processor and caches.
FACTOR = 2.0
_PAGE_BYTES = resource.getpagesize()
_PEAK_IS_NEW_BYTES = 16 << 20
_OPEN, _CLOSE = b"[{(<", b"]})>"


class OverBudgetError(BaseException):
    """Error for an input over its budget; no reader takes it for a refusal."""


class Meter:
    """The most that inputs have cost, as shares of their budgets."""

    def __init__(self) -> None:
        self.time_share = self.memory_share = 0.0
        gc.collect()
        gc.freeze()  # objects from before do not count in a collection during a reading

    def read(self, read: Callable[[], object], budget: Budget, size: int) -> object:
        """Read an input; one over its budget is read once more, as imports and caches count at first.

        Raises
        ------
        OverBudgetError
            If reading takes more than twice the budget of time or memory both times.
        """
        try:
            return self._read_once(read, budget, size)
        except OverBudgetError:
            gc.collect()
            return self._read_once(read, budget, size)

    def _read_once(self, read: Callable[[], object], budget: Budget, size: int) -> object:
        before_bytes, began_s = _resident_bytes(), time.process_time()
        try:
            return read()
        finally:
            time_share = (time.process_time() - began_s) / budget.time_for_s(size)
            peak_bytes = 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
            memory_share = 0.0
            if peak_bytes - before_bytes > _PEAK_IS_NEW_BYTES:
                memory_share = (peak_bytes - before_bytes) / budget.memory_bytes
                _forget_peak()
            if max(time_share, memory_share) > FACTOR:
                raise OverBudgetError(
                    f"{size} bytes took {time_share:.1f} x the time and {memory_share:.1f} x the memory "
                    f"that the budget of {budget.name} allows"
                )
            self.time_share = max(self.time_share, time_share)
            self.memory_share = max(self.memory_share, memory_share)


def _resident_bytes() -> int:
    return _PAGE_BYTES * int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])


def _forget_peak() -> None:
    """Set the process's peak of memory to its present memory (proc(5), clear_refs)."""
    Path("/proc/self/clear_refs").write_text("5", encoding="ascii")


def enlarged(dice: random.Random, content: bytes, *, most_bytes: int = 1 << 20) -> bytes:
    """Return a valid input with one of its parts repeated, counted up, nested or filled, to some size."""
    size = int(4096 * (most_bytes / 4096) ** dice.random())
    begin = dice.randrange(len(content) + 1)
    end = min(len(content), begin + dice.choice((1, 2, 8, 64, 512)))
    kind = dice.randrange(7)
    if kind < 3:  # whole lines, or what stands between commas
        separator = b"\n" if kind < 2 and content.count(b"\n") > 1 else b","
        begin = content.rfind(separator, 0, begin) + 1
        end = content.find(separator, begin) + 1 or len(content)
    part = content[begin:end] or b"0"
    count = max(1, size // len(part))
    if kind in (0, 2, 3):
        large = part * count
    elif kind == 1:  # each with other names and numbers
        large = b"".join(_counted_up(part, number) for number in range(max(1, size // (len(part) + 4))))
    elif kind == 4:
        bracket = dice.randrange(len(_OPEN))
        opening, closing = _OPEN[bracket : bracket + 1], _CLOSE[bracket : bracket + 1]
        large = opening * (size // 2) + part + closing * (size // 2)
    elif kind == 5:
        large = bytes([dice.choice(b" \t\n\0-0a9\"'\\.=~}")]) * size
    else:
        large = dice.randbytes(size)
    return content[:begin] + large + content[begin if dice.random() < 0.5 else end :]


def _counted_up(part: bytes, number: int) -> bytes:
    """Return a part with a number behind its first word, and another in place of its last number."""
    named = re.sub(rb"([A-Za-z_]\w*)", rb"\g<1>%d" % number, part, count=1)
    return re.sub(rb"\d+(?=\D*$)", b"%d" % number, named, count=1)


def input_of(dice: random.Random, reader: Reader, mutated: Callable[..., bytes], share_large: float) -> bytes:
    """Return a mutated input; a share of all is large."""
    content = dice.choice(reader.corpus)
    if dice.random() < share_large:
        content = enlarged(dice, content)
        return content if dice.random() < 0.5 else mutated(dice, content, reader.corpus)
    return mutated(dice, content, reader.corpus)


def main(arguments: Sequence[str]) -> int:
    """Read files, and print those that are over their budgets."""
    from tests.test_fuzzed_inputs import every_reader

    run, name, *files = arguments
    over = 0
    with tempfile.TemporaryDirectory() as folder:
        reader, meter = every_reader(Path(folder), Path(run).read_bytes())[name], Meter()
        for file in files:
            content = Path(file).read_bytes()
            try:
                meter.read(lambda content=content: reader.take(content, Path(folder)), reader.budget, len(content))  # type: ignore[misc]
            except reader.refuses:
                continue
            except OverBudgetError as error:
                over += 1
                print(f"{name}: {file}: {error}")
    return 1 if over else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
