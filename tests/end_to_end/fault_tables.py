"""Faults of the line and of the board in short runs, beside one without; and the tables of them.

    python -m tests.end_to_end.fault_tables

writes them into docs/reliability.md.
"""

from __future__ import annotations

import re
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from tests.end_to_end.short_run import Ended, run_short, wrong_numbers
from tests.patched_firmware import HANG, OVERFLOW, UNDEFINED, patched

from hiltest.boards import default_firmware
from hiltest.rig.faults import Faults
from hiltest.rig.rig_file import load_rig

PAGE = Path(__file__).parents[2] / "docs" / "reliability.md"


@dataclass(frozen=True)
class Tried:
    """A fault, and whether the run must recover from it.

    Attributes
    ----------
    faults : str
        As the rig has it.
    instructions : sequence of int
        Or the first instructions of the command that collects points.
    noisy : bool
        Whether the magnetometer has noise: in a world without a sensor that is stuck is not seen.
    """

    what: str
    faults: str
    recovers: bool
    instructions: Sequence[int] = ()
    noisy: bool = False


OF_THE_LINE = (
    Tried("lost bytes", "lose = 5e-4", True),
    Tried("many lost bytes", "seed = 2\nlose = 0.02\nafter_s = 1.0", False),
    Tried("doubled bytes", "double = 5e-4", True),
    Tried("flipped bits", "flip = 5e-4", True),
    Tried("late bytes", "late = { probability = 5e-4, by_s = 1.5 }", True),
    Tried("split bytes", "split = 0.1", True),
    Tried("a stall", "stall = { after_s = 2.0, for_s = 3.0 }", True),
    Tried("a stall for good", "stall = { after_s = 2.0, for_s = 1e3 }", False),
    Tried("a device that disappears", "disappear = { after_s = 2.0 }", False),
    Tried("... and comes back", "disappear = { after_s = 2.0, back_after_s = 2.5 }", False),
    Tried("a baud rate 2 % off", "baud = { after_s = 2.0, to = 117_504 }", True),
    Tried("another baud rate", "baud = { after_s = 2.0, to = 57_600 }", False),
    Tried("a full output buffer", "full_output = { after_s = 2.5, for_s = 1.5 }", True),
    Tried("... that stays full", "full_output = { after_s = 2.5, for_s = 1e3 }", False),
)


def _sensor(case: str, part: str, fault: str, times: str = "", *, noisy: bool = False) -> Tried:
    key = ", ".join((f'part = "{part}"', f'fault = "{fault}"', *filter(None, [times])))
    return Tried(case, f"sensor = {{ {key} }}", False, noisy=noisy)


OF_THE_BOARD = (
    Tried("a reset in the middle", 'reset = { by = "button", after_s = 2.0 }', False),
    Tried("a brown-out", 'reset = { by = "brown-out", after_s = 2.0 }', False),
    _sensor("a sensor that is absent", "mag3110", "absent"),
    _sensor("... that goes", "mag3110", "absent", "after_s = 2.0"),
    _sensor("... for half a second", "fxos8700cq", "absent", "after_s = 2.0, for_s = 0.5"),
    _sensor("another sensor in its place", "mag3110", "other part"),
    _sensor("... in the middle", "mag3110", "other part", "after_s = 2.0"),
    _sensor("a magnetometer that is stuck", "mag3110", "frozen", "after_s = 2.0", noisy=True),
    _sensor("... after the tumble", "mag3110", "frozen", "after_s = 5.5", noisy=True),
    _sensor("an accelerometer that is stuck", "fxos8700cq", "frozen", "after_s = 2.0"),
    _sensor("a sensor at the end of its range", "mag3110", "saturated", "after_s = 2.0"),
    _sensor("... for a tenth of a second", "mag3110", "saturated", "after_s = 2.0, for_s = 0.1"),
    _sensor("... after the tumble", "fxos8700cq", "saturated", "after_s = 5.5"),
    Tried("SDA held low", 'held_line = { bus = 1, line = "sda", after_s = 2.0 }', False),
    Tried("SCL held low", 'held_line = { bus = 1, line = "scl", after_s = 2.0 }', False),
    Tried("... for 2 ms", 'held_line = { bus = 1, line = "scl", after_s = 2.0, for_s = 0.002 }', True),
    Tried("a command that hangs", "", False, HANG),
    Tried("a HardFault", "", False, UNDEFINED),
    Tried("a stack that overflows", "", False, OVERFLOW),
)
COMMAND = "command_collect"


def run(folder: Path, tried: Tried) -> Ended:
    """Make the short run with a fault."""
    firmware = patched(default_firmware(), [COMMAND], tried.instructions) if tried.instructions else None
    return run_short(folder, tried.faults, noisy=tried.noisy, firmware=firmware)


def faults_of(folder: Path) -> Faults | None:
    """Return the faults of the rig of a run."""
    return load_rig(folder / "rig.toml").faults


def begin_s(faults: Faults | None) -> float:
    """Return when a fault begins, from the opening of the port on: one of the firmware, at its first command."""
    if faults is None:
        return 0.0
    timed = (faults.stall, faults.disappear, faults.baud, faults.full_output, *faults.board_faults)
    return next((call.after_s for call in timed if call is not None), faults.after_s)


def row(tried: Tried, ended: Ended, faults: Faults | None, clean: Ended) -> str:
    """Return a row of the page's tables."""
    key = "; ".join(tried.faults.splitlines())
    text = f"`{key}`" if key else f"`{COMMAND}`: {' '.join(f'{instruction:04x}' for instruction in tried.instructions)}"
    if ended.code == 0:
        again = f"recovers: {ended.retried} request{'s' * (ended.retried != 1)} sent again"
        how = again if ended.retried else "goes on"
        reads = "the numbers of a run without faults"
    else:
        how = f"{ended.code}, connection lost after {ended.virtual_s - begin_s(faults):.1f} s"
        # The place of the firmware at that moment differs between builds.
        reads = re.sub(r": the firmware is (?!hung)[^.]*\([^)]*\)", "", ended.sentence)
        reads = re.sub(r"(in a branch to itself in \w+) \([^)]*\)", r"\1", reads)
        reads = re.sub(r"0x[0-9a-f]{8}(?: in (\w+) \([^)]*\))", r"\1", reads)
    return f"| {tried.what} | {text} | {how} | {reads} | {len(ended.numbers)} of {len(clean.numbers)} |"


def table(rows: Sequence[str], heads: str) -> str:
    """Return a table of the page."""
    return "\n".join((heads, "|---|---|---|---|---|", *rows))


TABLES = {
    f"| fault of the {where} | {result} | the run | message | numbers kept |": tried
    for where, result, tried in (
        ("line", "`[faults]`", OF_THE_LINE),
        ("board", "`[faults]`, or first instructions of", OF_THE_BOARD),
    )
}


def shown(page: str, heads: str) -> str:
    """Return the table with these heads that a page shows."""
    (match,) = re.findall(rf"^{re.escape(heads)}.*?(?=\n\n)", page, re.M | re.S)
    return str(match)


def main() -> None:
    """Try every fault, and write the tables."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        clean = {noisy: run_short(folder / f"clean {noisy}", noisy=noisy) for noisy in (False, True)}
        for heads, all_tried in TABLES.items():
            rows = []
            for number, tried in enumerate(all_tried):
                place = folder / f"{heads[2:20]} {number}"
                ended = run(place, tried)
                rows.append(row(tried, ended, faults_of(place), clean[tried.noisy]))
                print(rows[-1], wrong_numbers(ended, clean[tried.noisy]), flush=True)
            page = PAGE.read_text(encoding="utf-8")
            PAGE.write_text(page.replace(shown(page, heads), table(rows, heads)), encoding="utf-8")


if __name__ == "__main__":
    main()
