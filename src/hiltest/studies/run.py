"""Runs a study: its blocks shared by several workers, each kept as it is done, and the record of all."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from hiltest import __version__
from hiltest.errors import ConfigError
from hiltest.jobs import each_done
from hiltest.record.exit_codes import WORDS, ExitCode
from hiltest.record.files import write_atomically
from hiltest.record.journal import Journal
from hiltest.record.outcomes import TestOutcome
from hiltest.record.recorder import describe_host
from hiltest.record.run import Column, Findings, Run, Table, TestResult, Verdict, utc_now
from hiltest.record.run_json import write_run
from hiltest.strict_json import parse_json, read_bounded
from hiltest.studies.page import PAGE_FILE, page
from hiltest.studies.study import Numbers, Plan, blocks_of, measure_block, study_of

BLOCKS_FILE = "blocks.jsonl"
"""The blocks that are done of a study that is not: a line of JSON each."""
_LARGEST_BYTES = 1 << 30
_KEPT = "the blocks done before are kept: the same command goes on from there"
_OTHERWISE = "remove it to begin anew, or name another folder with --out"

Progress = Callable[[str, int, int], None]


def run_study(
    plan: Plan, folder: Path, *, jobs: int | str, progress: Progress, asked_to_end: Callable[[], bool] = lambda: False
) -> Run:
    """Do all blocks that are not done yet, and write ``run.json`` and the page.

    Parameters
    ----------
    folder
        It is there already. What an interrupted run of the same plan has done is in it.
    jobs
        Number of processes, or the address of a dask scheduler.
    progress
        Called with what is counted, how many are done, and of how many.
    asked_to_end
        Whether to end after the blocks that are being done.

    Raises
    ------
    ConfigError
        If the folder is in use, or holds blocks of another plan.
    KeyboardInterrupt
        If it was asked to end; says nothing.
    HiltestError
        If the blocks that are left cannot be done: see `each_done`.
    """
    journal = Journal(folder, BLOCKS_FILE)
    try:
        done = _kept(plan, journal.path)
        began_s, began_utc = time.monotonic(), utc_now()
        journal.announce({
            "schema": "hiltest.study-blocks/1", "hiltest": __version__, "plan": asdict(plan), "started_utc": began_utc,
            "environment": asdict(describe_host()),
        })  # fmt: skip
        journal.begin()
        (folder / PAGE_FILE).unlink(missing_ok=True)
        for number, numbers in _measured(plan, done, jobs, progress, asked_to_end):
            journal.append("block", {"number": number, "numbers": list(numbers)})
            done[number] = numbers
        if len(done) < len(blocks_of(plan)):
            raise KeyboardInterrupt
        run = _record(plan, done, began_utc, time.monotonic() - began_s)
        write_run(run, folder)
        write_atomically(folder / PAGE_FILE, page(study_of(plan.study), run))
        journal.finish()
        return run
    finally:
        journal.release()


def _kept(plan: Plan, journal: Path) -> dict[int, Numbers]:
    """Return the blocks of a plan that a journal has."""
    text = read_bounded(journal, largest_bytes=_LARGEST_BYTES, otherwise=_OTHERWISE)
    blocks = len(blocks_of(plan))
    found: dict[int, Numbers] = {}
    for line_number, line in enumerate(text.splitlines(), 1):
        try:
            entry: Any = parse_json(line)
            if entry["kind"] == "start":
                if (entry["hiltest"], entry["plan"]) != (__version__, asdict(plan)):
                    raise ConfigError(f"{journal}: blocks of another study are kept here: {_said(entry)}; {_OTHERWISE}")
                continue
            number, numbers = entry["number"], entry["numbers"]
            if type(number) is not int or not 0 <= number < blocks or not all(map(_is_number, numbers)):
                raise ValueError("no block of this study")
        except (ValueError, LookupError, TypeError, AttributeError) as error:
            raise ConfigError(f"{journal}: line {line_number} is damaged: {error}; {_OTHERWISE}") from error
        found[number] = tuple(numbers)
    return found


def _said(start: Mapping[str, Any]) -> str:
    plan = dict(start["plan"])
    given = plan.pop("given", None) or {}
    said = (f"{key} {value}" for key, value in (plan | given).items() if value is not None)
    return ", ".join([f"hiltest {start['hiltest']}", *said])


def _is_number(value: object) -> bool:
    return type(value) in (int, float) and math.isfinite(value)  # type: ignore[arg-type]


def _measured(
    plan: Plan, done: Mapping[int, Numbers], jobs: int | str, progress: Progress, asked_to_end: Callable[[], bool]
) -> Iterator[tuple[int, Numbers]]:
    """Yield number and numbers of each block that is not done, as it gets done."""
    blocks = blocks_of(plan)
    left = [number for number in range(len(blocks)) if number not in done]
    what, instances, so_far = f"{plan.study}: instances", sum(blocks[number].count for number in left), 0
    progress(what, 0, instances)
    for number, numbers in each_done(measure_block, plan, left, jobs, kept=_KEPT, asked_to_end=asked_to_end):
        yield number, numbers
        so_far += blocks[number].count
        progress(what, so_far, instances)


def _record(plan: Plan, done: Mapping[int, Numbers], began_utc: str, took_s: float) -> Run:
    study = study_of(plan.study)
    by_condition: list[list[Numbers]] = [[] for _ in range(study.conditions)]
    for number, block in enumerate(blocks_of(plan)):  # in this order, whatever the order in which they were done
        by_condition[block.condition].append(done[number])
    found = study.conclude(plan, by_condition)
    findings = Findings(describe_host(), "full", "", began_utc, seed=plan.seed)
    findings.tests.append(TestResult(f"study {study.name}", TestOutcome.PASSED, took_s))
    for measurement in found.measurements:
        findings.take(measurement)
    printed = Table(
        f"study.{study.name}.printed",
        tuple(Column(name) for name in ("figure", "paper", "printed", "measured", "reproduced", "why")),
        tuple((each.what, each.where, each.printed, each.measured, each.reproduced, each.why)
              for each in found.printed),
    )  # fmt: skip
    findings.tables = {each.name: each for each in (found.table, printed)}
    return findings.finish(Verdict(WORDS[ExitCode.OK], ExitCode.OK, found.sentence, complete=True), utc_now())
