"""How often each instruction has been executed, from the blocks that ran.

A block counts for each of its instructions, whichever other blocks the same code is part of, and how often it jumped
away at its end is counted apart: no instruction need be looked at. Those of IT blocks are, each by itself.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

from hiltest.errors import ConfigError
from hiltest.virtual.cpu import Processor
from hiltest.virtual.executions import Snapshot


@dataclass(frozen=True, slots=True)
class ExecutedCode:
    """Counts by address; those of several processors may be added up.

    Attributes
    ----------
    executed : Counter of int
        How often each instruction was executed; skipped in an IT block is not executed.
    jumped : Counter of int
        How often each transfer of control at the end of a block jumped away.
    """

    executed: Counter[int] = field(default_factory=Counter)
    jumped: Counter[int] = field(default_factory=Counter)

    def add(self, snapshot: Snapshot) -> None:
        """Add what has run up to a snapshot."""
        runs = snapshot.runs
        for number, (block, _) in enumerate(snapshot.entered):
            went_on, jumped = runs[2 * number], runs[2 * number + 1]
            if not went_on and not jumped:
                continue
            for each in block.instructions:
                if not each.predicated:
                    self.executed[each.address] += went_on + jumped
                elif each.transfer:
                    self.executed[each.address] += jumped
                elif each.address in block.executed:
                    self.executed[each.address] += went_on + jumped
            if block.transfers:
                self.jumped[block.instructions[-1].address] += jumped


class ExecutionWatch:
    """Keeps what a processor executes from now on, resets and code that is written anew included.

    Parameters
    ----------
    processor : Processor
        Nothing has run on it.

    Attributes
    ----------
    image : FirmwareImage
        What runs on it.

    Raises
    ------
    ConfigError
        When it does not count by block.
    """

    def __init__(self, processor: Processor) -> None:
        self.image = processor.image
        self._accounting = accounting = processor.accounting
        if accounting.snapshot(0) is None:
            raise ConfigError(
                f"no coverage with the timing profile {processor.profile.name}, which counts by instruction: "
                "it is of the blocks that ran. Take a profile without memories"
            )
        self._earlier = ExecutedCode()
        accounting.sees_all = True
        accounting.code_forgotten = self._earlier.add
        processor.cut_short = self._cut_short

    def _cut_short(self, snapshot: Snapshot) -> None:
        """Take off what stands behind an instruction that faulted: its block is counted as a whole."""
        if snapshot.running < 0:
            return
        block = snapshot.entered[snapshot.running].block
        for each in block.instructions:
            if each.address > snapshot.pc and (not each.predicated or each.transfer or each.address in block.executed):
                self._earlier.executed[each.address] -= 1
        if block.transfers and block.instructions[-1].address > snapshot.pc:
            self._earlier.jumped[block.instructions[-1].address] -= 1

    def code(self) -> ExecutedCode:
        """Return what has been executed, while nothing is."""
        found = ExecutedCode(self._earlier.executed.copy(), self._earlier.jumped.copy())
        now = self._accounting.snapshot(0)
        assert now is not None
        found.add(now)
        return found
