"""Runner of a study, which distributes its blocks to workers and saves each finished block."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, astuple, replace
from pathlib import Path
from typing import Any

from hiltest import __version__
from hiltest.budgets import STUDY_JOURNAL
from hiltest.errors import ConfigError
from hiltest.json_files import parse_json, read_bounded
from hiltest.run_record.exit_codes import WORDS, ExitCode
from hiltest.run_record.files import write_atomically
from hiltest.run_record.journal import Journal
from hiltest.run_record.outcomes import TestOutcome
from hiltest.run_record.recorder import describe_host
from hiltest.run_record.run import Column, Findings, Run, Table, TestResult, Verdict, utc_now
from hiltest.run_record.run_json import write_run
from hiltest.studies.jobs import compute_pieces
from hiltest.studies.study import Numbers, Plan, blocks_of, measure_block, study_of
from hiltest.studies.study_page import PAGE_FILE, PRINTED_HEADER, page

BLOCKS_FILE = "blocks.jsonl"
"""Finished blocks of an unfinished study: one line of JSON each."""
_REMARK = "finished blocks are saved: repeat the command to continue"
_OTHERWISE = "remove it to start over, or name another folder with --out"

Progress = Callable[[str, int, int], None]


def run_study(
    plan: Plan, folder: Path, *, jobs: int | str, progress: Progress, asked_to_end: Callable[[], bool] = lambda: False
) -> Run:
    """Measure all unfinished blocks, and write ``run.json`` and the page.

    Parameters
    ----------
    folder
        Existing folder, which may have finished blocks of an interrupted run of the same plan.
    jobs
        Number of processes, or the address of a dask scheduler.
    progress
        Called with the unit of progress, the finished number and the total.
    asked_to_end
        Returns True to end after the current blocks.

    Raises
    ------
    ConfigError
        If the folder is in use, or has blocks of another plan.
    KeyboardInterrupt
        If an end was requested; without a message.
    HiltestError
        If the remaining blocks cannot be measured, see `compute_pieces`.
    """
    journal = Journal(folder, BLOCKS_FILE)
    try:
        done = _saved_blocks(plan, journal.path)
        began_s, began_utc = time.monotonic(), utc_now()
        journal.announce(
            {
                "schema": "hiltest.study-blocks/1",
                "hiltest": __version__,
                "plan": _as_json(plan),
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
    text = read_bounded(journal, STUDY_JOURNAL, otherwise=_OTHERWISE)
    blocks = len(blocks_of(plan))
    numbers_by_block: dict[int, Numbers] = {}
    for line_number, line in enumerate(text.splitlines(), 1):
        try:
            entry: Any = parse_json(line, STUDY_JOURNAL)
            if entry["kind"] == "start":
                if (entry["hiltest"], entry["plan"]) != (__version__, _as_json(plan)):
                    raise ConfigError(
                        f"{journal}: it contains blocks of another study: {_describe_start(entry)}; {_OTHERWISE}"
                    )
                continue
            number, numbers = entry["number"], entry["numbers"]
            if type(number) is not int or not 0 <= number < blocks or not all(map(_is_number, numbers)):
                raise ValueError("not a block of this study")
        except (ValueError, LookupError, TypeError, AttributeError) as error:
            raise ConfigError(f"{journal}: line {line_number} is damaged: {error}; {_OTHERWISE}") from error
        numbers_by_block[number] = tuple(numbers)
    return numbers_by_block


def _as_json(plan: Plan) -> dict[str, Any]:
    numbers = asdict(replace(plan, files=())) | {"methods": list(plan.methods)}
    return {name: value for name, value in numbers.items() if name != "files"}


def _describe_start(start: Mapping[str, Any]) -> str:
    plan = dict(start["plan"])
    conditions = plan.pop("conditions", None) or {}
    settings = (f"{key} {value}" for key, value in (plan | conditions).items() if value not in (None, []))
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
    for number, numbers in compute_pieces(
        measure_block, plan, remaining, jobs, remark=_REMARK, asked_to_end=asked_to_end
    ):
        yield number, numbers
        so_far += blocks[number].count
        progress(label, so_far, instances)


def _record(plan: Plan, done: Mapping[int, Numbers], began_utc: str, took_s: float) -> Run:
    study = study_of(plan.study)
    by_condition: list[list[Numbers]] = [[] for _ in range(study.conditions)]
    for number, block in enumerate(blocks_of(plan)):  # in order of number, regardless of the order of execution
        by_condition[block.condition].append(done[number])
    conclusion = study.conclude(plan, by_condition)
    findings = Findings(describe_host(), "full", "", began_utc, seed=plan.seed)
    findings.tests.append(TestResult(f"study {study.name}", TestOutcome.PASSED, took_s))
    for measurement in conclusion.measurements:
        findings.take(measurement)
    printed = Table(
        f"study.{study.name}.printed",
        tuple(map(Column, PRINTED_HEADER)),
        tuple(map(astuple, conclusion.printed)),
    )
    findings.tables = {table.name: table for table in (conclusion.table, printed)}
    return findings.finish(Verdict(WORDS[ExitCode.OK], ExitCode.OK, conclusion.sentence, complete=True), utc_now())
