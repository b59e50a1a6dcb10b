"""One run of the gate set on an edited firmware, and the score of many."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import threading
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from hiltest.run_record.exit_codes import ExitCode
from hiltest.run_record.reader import read_record

from ..end_to_end.firmware_edits import FirmwareCopy
from .edits import Mutation

BASELINE = Path(__file__).parents[2] / "hil" / "baselines" / "virtual-k64f.json"
WALL_LIMIT_S = 300  # a run takes about ten seconds, and deadlines of what does not answer are virtual
RED_AT_LEAST = 0.95
FIRST_AT_LEAST = 0.90


@dataclass(frozen=True)
class Found:
    """What a run said of an edited firmware: its exit code, its verdict, and the first test that is not green."""

    code: int
    sentence: str
    first_test: str

    def as_json(self) -> dict[str, Any]:
        """Return it as it is kept."""
        return asdict(self)

    @property
    def first(self) -> str:
        """What stands first: the failures of the verdict with their likely cause, and the first test not green."""
        answer = re.sub(r"^(?:[^:]*: )?[A-Z ]+[.:] ", "", self.sentence)
        clauses = answer.split(". ")
        first = [clause for clause in clauses if clause is clauses[0] or clause.startswith("Likely cause")]
        return f"{answer if self.code == ExitCode.REGRESSION else '. '.join(first)} [{self.first_test}]"


def run_mutation(copy: FirmwareCopy, mutation: Mutation, folder: Path) -> Found:
    """Build the firmware with a mistake and run the gate set on it."""
    folder.mkdir(parents=True)
    try:
        elf = copy.build(mutation.edit, folder / "edited.elf")
    except subprocess.CalledProcessError:
        return Found(0, "FAIL. It does not build.", "")
    command = [sys.executable, "-m", "hiltest", "run", "--firmware", str(elf), "--baseline", str(BASELINE)]
    done = subprocess.run(
        [*command, "--out", "out"], cwd=folder, capture_output=True, text=True, check=False, timeout=WALL_LIMIT_S
    )
    run = read_record(folder / "out").run
    red = [test.id for test in run.tests if test.outcome not in ("passed", "skipped")]
    shutil.rmtree(folder)
    return Found(done.returncode, run.verdict.sentence, red[0].rpartition("/")[2] if red else "")


class Score:
    """Counts what was found, and prints each as it comes."""

    def __init__(self, total: int) -> None:
        self._total = total
        self._lock = threading.Lock()
        self._found: list[tuple[Mutation, Found]] = []

    def add(self, mutation: Mutation, found: Found) -> None:
        """Take one more."""
        with self._lock:
            self._found.append((mutation, found))
            word = "SURVIVED" if found.code == 0 else "red     " if said_first(mutation, found) else "red, but"
            print(
                f"[{len(self._found):3}/{self._total}] {word} {found.code:2}  {mutation.edit.file}: {mutation.name}: "
                f"{found.first}",
                flush=True,
            )

    @property
    def red(self) -> float:
        """Share of the mistakes that were found."""
        return sum(result.code != 0 for _, result in self._found) / max(len(self._found), 1)

    @property
    def first(self) -> float:
        """Share of the found ones of which first was said what had been expected."""
        red = [(mutation, result) for mutation, result in self._found if result.code != 0]
        return sum(said_first(mutation, result) for mutation, result in red) / max(len(red), 1)

    @property
    def is_good(self) -> bool:
        """Whether both shares are what they must be."""
        return self.red >= RED_AT_LEAST and self.first >= FIRST_AT_LEAST

    def summary(self) -> str:
        """Return the score in a sentence, and the survivors."""
        survivors = [f"{mutation.edit.file}: {mutation.name}" for mutation, result in self._found if result.code == 0]
        head = (
            f"{len(self._found)} mistakes: {self.red:.1%} found (at least {RED_AT_LEAST:.0%}), "
            f"{self.first:.1%} of those by what was expected first (at least {FIRST_AT_LEAST:.0%})"
        )
        return "\n".join([head, *(f"survived: {survivor}" for survivor in survivors)])


def said_first(mutation: Mutation, found: Found) -> bool:
    """Say whether what stands first is what was expected."""
    return re.search(mutation.first, found.first, re.IGNORECASE) is not None
