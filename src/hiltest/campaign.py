"""Many seeds: one run each, side by side, and what they say together."""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path

import click
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from hiltest.measurement import Measurement, Outcome, round_significant
from hiltest.report.evidence import SEEDS_FILE
from hiltest.report.record import RUN_FILE, Run, write_atomically
from hiltest.report.schema import load_run
from hiltest.report.verdict import ExitCode
from hiltest.settings import make_folder

SEEDS_SCHEMA = "hiltest.seeds/1"

# The first of these that any seed ended with is the campaign's, as for the tests of one run.
_WORST_FIRST = (2, 3, 4, 5, ExitCode.WRONG_FIRMWARE, ExitCode.BENCH_LOST, ExitCode.NOT_JUDGED)


@dataclass(frozen=True, slots=True)
class MadeWith:
    """What the numbers of a run rest on, beside its seed."""

    firmware: str
    build_id: str
    cycle_model: str
    rig: str
    rig_sha256: str


@dataclass(frozen=True, slots=True)
class SeedResult:
    """How the run of one seed ended. `sentence` is its verdict, or what it wrote when there is none."""

    seed: int
    exit_code: int
    sentence: str
    measurements: tuple[Measurement, ...] = ()
    made_with: MadeWith | None = None


@dataclass(frozen=True, slots=True)
class Spread:
    """One measurement over all seeds."""

    name: str
    unit: str
    n: int
    min: float
    median: float
    max: float
    failed_seeds: tuple[int, ...]


def run_seeds(seeds: Sequence[int], options: Sequence[str], out: Path, *, may_fail: int) -> int:
    """Run the suites once a seed, as many at a time as there are cores; write ``seeds.json``.

    Parameters
    ----------
    seeds : sequence of int
    options : sequence of str
        For pytest, the same for every seed.
    out : Path
        Gets a folder a seed.
    may_fail : int
        How many seeds may end with exit code 1.

    Returns
    -------
    int
        Exit code of the campaign.

    Raises
    ------
    ConfigError
        If `out` cannot be written to; nothing has been run then.
    """
    make_folder(out)
    (out / SEEDS_FILE).unlink(missing_ok=True)  # it says that all seeds have run
    console = Console()
    columns = (TextColumn("seeds"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with ThreadPoolExecutor(max_workers=os.cpu_count()) as pool, Progress(*columns, console=console) as progress:
        task = progress.add_task("seeds", total=len(seeds))
        results = []
        for result in pool.map(lambda seed: _run_seed(seed, options, out), seeds):
            results.append(result)
            progress.advance(task)
            if result.exit_code:
                progress.console.print(f"seed {result.seed}: {result.sentence}", markup=False, soft_wrap=True)
    spreads = spreads_of(results)
    write_atomically(out / SEEDS_FILE, _to_json(results, spreads))
    click.echo(f"{out / SEEDS_FILE}")
    click.echo(campaign_sentence(results, spreads, may_fail=may_fail))
    return campaign_exit_code(results, may_fail=may_fail)


def campaign_exit_code(results: Sequence[SeedResult], *, may_fail: int) -> int:
    """Return the exit code: anything but 0 and 1 from any seed wins, then 1 if too many failed."""
    codes = [result.exit_code for result in results]
    for code in _WORST_FIRST:
        if code in codes:
            return int(code)
    return next((code for code in codes if code not in (0, 1)), int(codes.count(1) > may_fail))


def campaign_sentence(results: Sequence[SeedResult], spreads: Sequence[Spread], *, may_fail: int) -> str:
    """Return how many seeds passed and what the worst headings were, in one sentence."""
    passed = sum(result.exit_code == 0 for result in results)
    failed = [str(result.seed) for result in results if result.exit_code]
    which = f" (not: {', '.join(failed[:10])}{', ...' if len(failed) > 10 else ''})" if failed else ""
    allowed = f", {may_fail} may fail" if may_fail else ""
    headings = [
        f"{spread.name} median {spread.median:.2f}, worst {spread.max:.2f} {spread.unit}" for spread in spreads
        if spread.name.startswith("heading.") and spread.name.endswith(".max") and "uncalibrated" not in spread.name
    ]
    word = "PASS" if campaign_exit_code(results, may_fail=may_fail) == 0 else "FAIL"
    return "; ".join([f"{passed} of {len(results)} seeds pass{which}{allowed}", *headings]) + f": {word}."


def spreads_of(results: Sequence[SeedResult]) -> list[Spread]:
    """Return smallest, middle and largest of every measurement that has a number, by name."""
    values: dict[str, list[float]] = {}
    failed: dict[str, list[int]] = {}
    units: dict[str, str] = {}
    for result in results:
        for each in result.measurements:
            if each.volatile:
                continue
            units[each.name] = each.unit
            if each.value is not None:
                values.setdefault(each.name, []).append(float(each.value))
            if each.outcome is Outcome.FAIL:
                failed.setdefault(each.name, []).append(result.seed)
    return [
        Spread(
            name, units[name], len(found), min(found), statistics.median(found), max(found),
            tuple(failed.get(name, ())),
        )
        for name, found in sorted(values.items())
    ]


def _run_seed(seed: int, options: Sequence[str], out: Path) -> SeedResult:
    """Run one seed in a process of its own: pytest keeps state that a second run would meet."""
    folder = out / f"seed-{seed:04d}"
    (folder / RUN_FILE).unlink(missing_ok=True)  # what an earlier campaign left must not pass for this one's
    command = [sys.executable, "-m", "hiltest", "run", f"--seed={seed}", f"--out={folder}", "--", *options]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if (folder / RUN_FILE).exists():
        run = load_run(folder / RUN_FILE)
        return SeedResult(seed, done.returncode, run.verdict.sentence, run.measurements, _made_with(run))
    words = (done.stderr or done.stdout).strip().splitlines()
    return SeedResult(seed, done.returncode, words[-1] if words else "no output")


def _made_with(run: Run) -> MadeWith | None:
    if run.board is None or run.rig is None:
        return None
    firmware = f"{run.board.firmware} {run.board.version}"
    return MadeWith(firmware, run.board.build_id, run.board.cycle_model, run.rig.name, run.rig.sha256)


def _to_json(results: Sequence[SeedResult], spreads: Sequence[Spread]) -> str:
    seeds = [{"seed": each.seed, "exit_code": each.exit_code, "sentence": each.sentence} for each in results]
    made_with = dict.fromkeys(each.made_with for each in results if each.made_with)
    content = {
        "schema": SEEDS_SCHEMA,
        "made_with": [asdict(each) for each in made_with],
        "seeds": seeds,
        "measurements": [_rounded(asdict(each)) for each in spreads],
    }
    return json.dumps(content, indent=1, allow_nan=False, ensure_ascii=False) + "\n"


def _rounded(content: Mapping[str, object]) -> dict[str, object]:
    return {key: round_significant(value) if isinstance(value, float) else value for key, value in content.items()}
