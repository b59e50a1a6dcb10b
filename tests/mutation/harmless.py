"""Build the firmware with each harmless change, run the full set, and list false alarms against the shipped firmware.

    python -m tests.mutation.harmless [--rig RIG] [--seed N] [WORD ...]

Words choose changes by their names. Ends with 1 if a change raises a false alarm.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterator
from pathlib import Path

from hiltest.run_record.comparison import Change
from hiltest.run_record.failures import failed_otherwise, failed_test
from hiltest.run_record.reader import read_record
from hiltest.run_record.run import Run
from hiltest.verdict.compare import compare
from hiltest.verdict.evidence import evidence_of
from hiltest.verdict.wording import entry

from ..end_to_end.firmware_edits import Edit, FirmwareCopy

FILE = Path(__file__).with_name("harmless.toml")
WALL_LIMIT_S = 600  # a run takes about 20 s


def main() -> int:
    """Run all changes and print their false alarms."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("words", nargs="*", metavar="WORD")
    parser.add_argument("--rig", default="virtual-k64f")
    parser.add_argument("--seed", default="1")
    arguments = parser.parse_args()
    bench = ("--rig", arguments.rig, "--seed", arguments.seed)
    table = tomllib.loads(FILE.read_text(encoding="utf-8"))
    rows = [row for row in table["edit"] if not arguments.words or any(word in row["name"] for word in arguments.words)]
    is_clean = True
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        firmware = FirmwareCopy(folder)
        shipped = run_full_set(folder / "shipped", *bench)
        for number, row in enumerate(rows, start=1):
            elf = firmware.build(Edit(row["file"], row["old"], row["new"]), folder / f"{number}.elf")
            run = run_full_set(folder / f"{number}", *bench, "--firmware", str(elf))
            alarms = list(false_alarms(shipped, run, table["names"][row["may_move"]]))
            is_clean = is_clean and not alarms
            size = len(run.measurements)
            print(f"[{number:2}/{len(rows)}] {row['name']}, {size}: {'; '.join(alarms) or 'no alarm'}", flush=True)
    return 0 if is_clean else 1


def run_full_set(out: Path, *options: str) -> Run:
    """Run the full set of tests, and return its record."""
    command = [sys.executable, "-m", "hiltest", "run", "--suite", "full", "--out", str(out), *options]
    subprocess.run(command, cwd=out.parent, capture_output=True, check=False, timeout=WALL_LIMIT_S)
    return read_record(out).run


def false_alarms(shipped: Run, run: Run, may_move: str) -> Iterator[str]:
    """Yield measurements that are called worse or gone without a reason, and tests that failed for another reason."""
    for difference in compare(evidence_of(shipped), evidence_of(run), together=True).differences:
        if difference.change in (Change.WORSE, Change.GONE) and not re.fullmatch(may_move, difference.name):
            yield entry(difference)
    yield from map(failed_test, failed_otherwise(run))


if __name__ == "__main__":
    sys.exit(main())
