"""Build the firmware with each mistake, run the gate set on it beside the baseline, and say what was found.

    python -m tests.mutation [--part K/N] [--jobs J] [--out DIR] [WORD ...]

What is finished is kept in DIR, and not run again until firmware, package or suites change. Words choose mistakes whose
name or file has one of them. Ends with 1 when less than 95 % are red, or less than 90 % of those say first what was
expected.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
import tempfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from ..end_to_end.firmware_edits import FirmwareCopy
from .edits import Mutation, mutations
from .score import Found, Score, run_mutation

ROOT = Path(__file__).parents[2]
SCORED = ("src/hiltest", "hil/suites", "hil/rigs", "hil/baselines", "firmware_stub")


def digest() -> str:
    """Hash everything that decides what a run finds."""
    sha256 = hashlib.sha256()
    for folder in SCORED:
        for path in sorted((ROOT / folder).rglob("*")):
            if path.is_file() and "__pycache__" not in path.parts:
                sha256.update(path.relative_to(ROOT).as_posix().encode() + path.read_bytes())
    return sha256.hexdigest()[:16]


def chosen(part: str, words: Sequence[str]) -> list[Mutation]:
    """Return the mistakes of a part that have one of the words."""
    number, _, parts = part.partition("/")
    every = mutations()[int(number) - 1 :: int(parts)]
    return [entry for entry in every if not words or any(word in f"{entry.name} {entry.edit.file}" for word in words)]


def main() -> int:
    """Run, and print the score."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("words", nargs="*", metavar="WORD")
    parser.add_argument("--part", default="1/1", metavar="K/N")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--out", type=Path, default=ROOT / "hil-out" / "mutation")
    arguments = parser.parse_args()
    results = arguments.out / digest()
    results.mkdir(parents=True, exist_ok=True)
    todo = chosen(arguments.part, arguments.words)
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(arguments.jobs) as pool:
        shares = [todo[job :: arguments.jobs] for job in range(arguments.jobs)]
        score = Score(len(todo))
        jobs = [
            pool.submit(_run, share, Path(folder) / f"{number}", results, score)
            for number, share in enumerate(shares)
            if share
        ]
        for job in jobs:
            job.result()
    print(score.summary())
    return 0 if score.is_good else 1


def _run(share: Sequence[Mutation], folder: Path, results: Path, score: Score) -> None:
    copy = None
    for number, mutation in enumerate(share):
        stored = results / f"{hashlib.sha256(repr(mutation.edit).encode()).hexdigest()[:16]}.json"
        if stored.is_file():
            result = Found(**json.loads(stored.read_text(encoding="utf-8")))
        else:
            if copy is None:
                folder.mkdir()
                copy = FirmwareCopy(folder)
            result = run_mutation(copy, mutation, folder / f"run{number}")
            stored.write_text(json.dumps(result.as_json(), indent=1), encoding="utf-8")
        score.add(mutation, result)


if __name__ == "__main__":
    sys.exit(main())
