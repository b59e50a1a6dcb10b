"""``hiltest bisect``: the commit that made the firmware worse."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from hiltest.commands.options import (
    documented,
    jobs_option,
    load_named_rig,
    parsed,
    pytest_options,
    seed_range,
    setting_option,
)
from hiltest.errors import ConfigError
from hiltest.session.settings import DEFAULT_OUT, file_name

if TYPE_CHECKING:
    from hiltest.campaigns.bisection import FirstWorse

SCHEMA = "hiltest.bisection/1"
_EXIT_CODES = """
\b
Exit codes:
  0   the first worse commit was found
  2   interrupted; repeat the command to continue
  4   usage: GOOD does not build or pass, or BAD is not worse
  22  unknown: commits before BAD could not be judged
"""


@click.command(epilog=_EXIT_CODES)
@click.option(
    "--firmware",
    metavar="PATH",
    required=True,
    callback=parsed(file_name),
    help="Test this file that BUILD writes, relative to this folder: ELF, Intel HEX or raw binary.",
)
@click.option(
    "--measure",
    "measures",
    metavar="NAME",
    multiple=True,
    help="Judge by this measurement; * matches any text. Repeat the option for several.  [default: all, as "
    "hiltest compare judges them]",
)
@setting_option("rig")
@click.option("--seeds", metavar="A..B", callback=seed_range, help="Run once for each seed.  [default: the rig's seed]")
@jobs_option("Run --seeds in this many processes")
@setting_option("poses")
@setting_option("suite")
@click.option("-k", "tests", metavar="EXPRESSION", help="Run only the tests that match, as in pytest.  [default: all]")
@click.option(
    "--out",
    metavar="DIR",
    default=f"{DEFAULT_OUT}/bisect",
    show_default=True,
    callback=parsed(file_name),
    help="Keep builds and records in this folder.",
)
@documented(SCHEMA)
@click.argument("good")
@click.argument("bad")
@click.argument("build", nargs=-1, required=True, type=click.UNPROCESSED)
def bisect(
    good: str,
    bad: str,
    build: tuple[str, ...],
    firmware: str,
    measures: tuple[str, ...],
    rig: str | None,
    seeds: range | None,
    jobs: int | str | None,
    poses: str | None,
    suite: str | None,
    tests: str | None,
    out: str,
) -> tuple[int, FirstWorse]:
    """Find the first commit that made a measurement worse.

    BAD is a commit after GOOD, and worse. The command after -- builds each tested commit in a separate working tree,
    and the rigs and suites of this folder test it: hiltest bisect v1.2 HEAD --firmware build/app.elf -- make -j4.
    Commits that do not build are skipped.
    """
    from hiltest.campaigns.bisection import first_worse

    if jobs and seeds is None:
        raise ConfigError("--jobs needs several seeds: add --seeds A..B")
    options = pytest_options({"rig": rig, "poses": poses, "suite": suite})
    runs = [] if seeds is None else [f"--seeds={seeds[0]}..{seeds[-1]}", *([f"--jobs={jobs}"] if jobs else [])]
    load_named_rig(rig)  # checked first, since no commit is to blame for its faults
    try:
        result = first_worse(
            good,
            bad,
            build,
            firmware=firmware,
            out=Path(out),
            options=[*options, *(["-k", tests] if tests else [])],
            runs=runs,
            measures=measures,
        )
    except KeyboardInterrupt:
        click.echo(f"\n{out} keeps the finished builds and runs: repeat the command to continue", err=True)
        raise
    _print(result, measures)
    return int(result.exit_code), result


def _print(result: FirstWorse, measures: tuple[str, ...]) -> None:
    """Print the first commit that is worse, its changes, and the commits that could not be judged."""
    from hiltest.campaigns.judged_commit import worse_in
    from hiltest.report.comparison_text import printable, say
    from hiltest.report.console import standard_output
    from hiltest.verdict.wording import entry

    console = standard_output()
    newest = result.candidates[0]
    if len(result.candidates) == 1:
        say(console, f"{newest.name} is the first worse commit")
        say(console, f"  by {newest.author}, {newest.author_date}")
    else:
        say(
            console,
            f"one of these {len(result.candidates)} is the first worse commit; the others could not be judged:",
        )
        for candidate in result.candidates:
            say(console, f"  {candidate.name}")
    since = {difference.name: difference for difference in result.against_before.differences}
    say(console, f"since {result.before.name}:")
    for worse in worse_in(result.against_good, measures):
        say(console, f"  {entry(since.get(worse.name, worse))}")
    if not result.against_good.evaluated or result.against_good.failed:
        say(console, f"  {newest.because}")
    if result.skipped:
        say(console, "skipped:")
        for skipped in result.skipped:
            say(console, f"  {skipped.name}: {printable(skipped.because)}")
    say(console, f"records: {result.before.record}, {newest.record}")
