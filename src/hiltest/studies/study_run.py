"""Runner of a study: several workers share its blocks, each of which is saved when it is finished."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from hiltest import __version__
from hiltest.errors import ConfigError
from hiltest.json_files import parse_json, read_bounded
from hiltest.run_record.exit_codes import WORDS, ExitCode
from hiltest.run_record.files import write_atomically
from hiltest.run_record.journal import Journal
from hiltest.run_record.outcomes import TestOutcome
from hiltest.run_record.recorder import describe_host
from hiltest.run_record.run import Column, Findings, Run, Table, TestResult, Verdict, utc_now
from hiltest.run_record.run_json import write_run
from hiltest.studies.jobs import each_done
from hiltest.studies.study import Numbers, Plan, blocks_of, measure_block, study_of
from hiltest.studies.study_page import PAGE_FILE, page

BLOCKS_FILE = "blocks.jsonl"
"""Finished blocks of an unfinished study: one line of JSON each."""
_LARGEST_BYTES = 1 << 30
_KEPT = "the blocks done before are kept: the same command goes on from there"
_OTHERWISE = "remove it to begin anew, or name another folder with --out"

Progress = Callable[[str, int, int], None]


def run_study(
    plan: Plan, folder: Path, *, jobs: int | str, progress: Progress, asked_to_end: Callable[[], bool] = lambda: False
) -> Run:
    """Measure all blocks that are not finished yet, and write ``run.json`` and the page.

    Parameters
    ----------
    folder
        Existing folder, which may hold finished blocks of an interrupted run of the same plan.
    jobs
        Number of processes, or the address of a dask scheduler.
    progress
        Function that is called with the unit of progress, the number done, and the total.
    asked_to_end
        True to end after the current blocks.

    Raises
    ------
    ConfigError
        If the folder is in use, or holds blocks of another plan.
    KeyboardInterrupt
        If the end was requested; without a message.
    HiltestError
        If the remaining blocks cannot be measured: see `each_done`.
    """
    journal = Journal(folder, BLOCKS_FILE)
    try:
        done = _saved_blocks(plan, journal.path)
        began_s, began_utc = time.monotonic(), utc_now()
        journal.announce(
            {
                "schema": "hiltest.study-blocks/1",
                "hiltest": __version__,
                "plan": asdict(plan),
                "started_utc": began_utc,
                "environment": asdict(describe_host()),
            }
        )
        journal.begin()
        (folder / PAGE_FILE).unlink(missing_ok=True)
        for number, numbers in _measure_blocks(plan, done, jobs, progress, asked_to_end):
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


def _saved_blocks(plan: Plan, journal: Path) -> dict[int, Numbers]:
    """Return the blocks of a plan in a journal."""
    text = read_bounded(journal, largest_bytes=_LARGEST_BYTES, otherwise=_OTHERWISE)
    blocks = len(blocks_of(plan))
    numbers_by_block: dict[int, Numbers] = {}
    for line_number, line in enumerate(text.splitlines(), 1):
        try:
            entry: Any = parse_json(line)
            if entry["kind"] == "start":
                if (entry["hiltest"], entry["plan"]) != (__version__, asdict(plan)):
                    raise ConfigError(
                        f"{journal}: blocks of another study are kept here: {_describe_start(entry)}; {_OTHERWISE}"
                    )
                continue
            number, numbers = entry["number"], entry["numbers"]
            if type(number) is not int or not 0 <= number < blocks or not all(map(_is_number, numbers)):
                raise ValueError("no block of this study")
        except (ValueError, LookupError, TypeError, AttributeError) as error:
            raise ConfigError(f"{journal}: line {line_number} is damaged: {error}; {_OTHERWISE}") from error
        numbers_by_block[number] = tuple(numbers)
    return numbers_by_block


def _describe_start(start: Mapping[str, Any]) -> str:
    plan = dict(start["plan"])
    conditions = plan.pop("given", None) or {}
    settings = (f"{key} {value}" for key, value in (plan | conditions).items() if value is not None)
    return ", ".join([f"hiltest {start['hiltest']}", *settings])


def _is_number(value: object) -> bool:
    return type(value) in (int, float) and math.isfinite(value)  # type: ignore[arg-type]


def _measure_blocks(
    plan: Plan, done: Mapping[int, Numbers], jobs: int | str, progress: Progress, asked_to_end: Callable[[], bool]
) -> Iterator[tuple[int, Numbers]]:
    """Yield number and numbers of each unfinished block when it is finished."""
    blocks = blocks_of(plan)
    remaining = [number for number in range(len(blocks)) if number not in done]
    label, instances, so_far = f"{plan.study}: instances", sum(blocks[number].count for number in remaining), 0
    progress(label, 0, instances)
    for number, numbers in each_done(measure_block, plan, remaining, jobs, remark=_KEPT, asked_to_end=asked_to_end):
        yield number, numbers
        so_far += blocks[number].count
        progress(label, so_far, instances)


def _record(plan: Plan, done: Mapping[int, Numbers], began_utc: str, took_s: float) -> Run:
    study = study_of(plan.study)
    by_condition: list[list[Numbers]] = [[] for _ in range(study.conditions)]
    for number, block in enumerate(blocks_of(plan)):  # in order of number, whatever the order of execution
        by_condition[block.condition].append(done[number])
    conclusion = study.conclude(plan, by_condition)
    findings = Findings(describe_host(), "full", "", began_utc, seed=plan.seed)
    findings.tests.append(TestResult(f"study {study.name}", TestOutcome.PASSED, took_s))
    for measurement in conclusion.measurements:
        findings.take(measurement)
    printed = Table(
        f"study.{study.name}.printed",
        tuple(Column(name) for name in ("figure", "paper", "printed", "measured", "reproduced", "why")),
        tuple(
            (figure.figure, figure.paper, figure.printed, figure.measured, figure.reproduced, figure.why)
            for figure in conclusion.printed
        ),
    )
    findings.tables = {table.name: table for table in (conclusion.table, printed)}
    return findings.finish(Verdict(WORDS[ExitCode.OK], ExitCode.OK, conclusion.sentence, complete=True), utc_now())
