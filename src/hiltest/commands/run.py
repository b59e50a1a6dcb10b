"""``hiltest run``: run the suites on a bench, and decide a verdict."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

import click

from hiltest.commands.options import (
    EXIT_CODES,
    CapturedErrors,
    checked,
    jobs_option,
    json_option,
    print_error,
    seed_range,
)
from hiltest.errors import ConfigError
from hiltest.session.settings import DEFAULT_OUT, address, check_environment, file_name, label, seed


class _Run(click.Command):
    """Command whose error about an unknown option explains how to pass pytest's options."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse the command line."""
        try:
            return super().parse_args(ctx, args)
        except click.NoSuchOption as error:
            hint = "pytest's own options stand behind --: hiltest run -- -k heading"
            raise click.UsageError(f"{error.format_message()} {hint}", ctx) from error


@click.command(cls=_Run, epilog=EXIT_CODES)
@click.option(
    "--rig",
    "rigs",
    metavar="R",
    multiple=True,
    callback=checked(file_name),
    help="Rig file, or name of a rig in hil/rigs; given more than once, several boards run at once.  "
    "[default: virtual-k64f]",
)
@click.option(
    "--firmware",
    metavar="FILE",
    callback=checked(file_name),
    help="Firmware for the virtual board: ELF, Intel HEX or raw binary.  [default: the packaged one]",
)
@click.option(
    "--base",
    metavar="ADDRESS",
    callback=checked(address),
    help="The firmware is a raw binary that belongs there.  [default: 0, for a .bin]",
)
@click.option(
    "--hil-port",
    metavar="URL",
    callback=checked(file_name),
    help="Serial port of a real board: a device or a pyserial URL.",
)
@click.option(
    "--out",
    metavar="DIR",
    default=DEFAULT_OUT,
    show_default=True,
    callback=checked(file_name),
    help="Folder for the record and reports.",
)
@click.option("--seed", metavar="N", callback=checked(seed), help="Seed of the simulated world.  [default: the rig's]")
@click.option("--seeds", metavar="A..B", callback=seed_range, help="Run once for each seed, and sum up.")
@click.option(
    "--may-fail",
    metavar="N",
    type=click.IntRange(min=0),
    default=0,
    show_default=True,
    help="With --seeds: how many seeds may miss a limit.",
)
@jobs_option("With --seeds: processes")
@click.option("--poses", type=click.Choice(["all", "level"]), help="Known angles to measure at.  [default: the rig's]")
@click.option(
    "--suite",
    type=click.Choice(["gate", "full"]),
    help="Set of tests: gate leaves out what takes longest.  [default: gate]",
)
@click.option(
    "--calibration",
    metavar="FILE",
    callback=checked(file_name),
    help="Calibration file of this board (hiltest calibrate), tested beside the others.",
)
@click.option(
    "--label",
    metavar="TEXT",
    callback=checked(label),
    help="Name of this run in reports and trends, such as a version or a commit.",
)
@click.option(
    "--baseline",
    metavar="FILE",
    callback=checked(file_name),
    help="Baseline, or record of a run, that this one must not be worse than.",
)
@click.option(
    "--against",
    metavar="ELF",
    callback=checked(file_name),
    help="Older firmware that this one must not be worse than; it is run first, on the same bench.",
)
@click.option("--flash", is_flag=True, help="First put the firmware onto the board: see hiltest flash.")
@click.option(
    "--coverage",
    metavar="FILE",
    type=click.Path(),
    callback=checked(file_name),
    help="Write the coverage of the firmware as the virtual board executes it, for LCOV's genhtml.",
)
@click.option(
    "--record",
    metavar="FILE",
    type=click.Path(),
    callback=checked(file_name),
    help="Record all that the run asks of its bench, with the answers; FILE.gz is compressed.",
)
@click.option(
    "--replay",
    metavar="FILE",
    type=click.Path(),
    callback=checked(file_name),
    help="Take the answers from such a recording: no board, no firmware, in a few seconds.",
)
@json_option("hiltest.run/1, with --seeds hiltest.seeds/1, of several boards hiltest.boards/1")
@click.option("-v", "--verbose", is_flag=True, help="Print every test and every measurement.")
@click.argument("pytest_args", nargs=-1, type=click.UNPROCESSED)
def run(*, as_json: bool, **arguments: Any) -> int:
    """Run the suites and end with a verdict.

    The suites are those in hil/suites of this folder, or else the ones that come with hiltest. What follows
    -- goes to pytest: hiltest run -- -k heading
    """
    if not as_json:
        return _run(**arguments)[0]
    from hiltest.run_record.exit_codes import ExitCode

    captured = CapturedErrors()
    with redirect_stdout(captured), redirect_stderr(captured):
        code, record = _run(**arguments)
    if record is not None and record.exists():
        click.echo(record.read_text(encoding="utf-8"), nl=False)
    else:
        error = "UsageError" if code == ExitCode.USAGE_ERROR else "NoRecord"
        print_error(error, captured.last_words, code)
    return code


def _run(
    *,
    out: str,
    rigs: tuple[str, ...],
    seeds: range | None,
    may_fail: int,
    jobs: int | str | None,
    against: str | None,
    flash: bool,
    verbose: bool,
    pytest_args: Sequence[str],
    **arguments: str | None,
) -> tuple[int, Path | None]:
    """Run the suites, and return the exit code and the file with the record; None without one."""
    from hiltest.campaigns.folders import sole_command
    from hiltest.campaigns.older_firmware import OlderFirmware, base_of_environment
    from hiltest.campaigns.one_run import check_against, run_suites
    from hiltest.run_record.files import BOARDS_FILE, OLDER_FOLDER, SEEDS_FILE

    check_environment()
    names = {
        "rig": "--hil-rig",
        "firmware": "--hil-firmware",
        "base": "--hil-base",
        "hil_port": "--hil-port",
        "seed": "--hil-seed",
        "poses": "--hil-poses",
        "suite": "--hil-suite",
        "calibration": "--hil-calibration",
        "label": "--hil-label",
    }
    arguments["rig"] = rigs[0] if len(rigs) == 1 else None
    of_this_run = {f"--hil-{name}": arguments.pop(name) for name in ("baseline", "coverage", "record", "replay")}
    base = of_this_run["--hil-baseline"] or base_of_environment()
    coverage = of_this_run["--hil-coverage"]
    options = [f"{names[name]}={value}" for name, value in arguments.items() if value is not None]
    options += [*_verbosity(pytest_args, verbose=verbose), *pytest_args]
    if may_fail and seeds is None:
        raise ConfigError("--may-fail says how many of several seeds may miss a limit: give --seeds A..B too")
    if jobs and seeds is None:
        raise ConfigError("--jobs says who shares the work of several seeds: give --seeds A..B too")
    if flash and (seeds is not None or against is not None):
        raise ConfigError("--flash is for a real board, --seeds and --against are for the virtual one: leave one out")
    if against is not None:
        check_against(base and f"the baseline {base}", arguments["hil_port"])
    taped = next((name for name in ("record", "replay") if of_this_run[f"--hil-{name}"]), None)
    if taped and (seeds is not None or against is not None):
        raise ConfigError(f"--{taped} is of one run: it goes neither with --seeds nor with --against")
    if len(rigs) > 1:
        of_one = {
            "--seeds": seeds is not None,
            "--against": against,
            "--hil-port": arguments["hil_port"],
            "--coverage": coverage,
            "--calibration": arguments["calibration"],
            f"--{taped}": taped,
        }
        if named := [name for name, is_given in of_one.items() if is_given]:
            raise ConfigError(f"{named[0]} is of one board, and {len(rigs)} rigs are named: leave one of them out")
        from hiltest.campaigns.several_boards import run_boards

        options += [] if base is None else [f"--hil-baseline={base}"]
        with sole_command(Path(out)):
            return run_boards(rigs, options, Path(out), flashes=flash), Path(out) / BOARDS_FILE
    if seeds is not None:
        if arguments["seed"] or arguments["hil_port"]:
            raise ConfigError("--seeds simulates many worlds: it goes neither with --seed nor with --hil-port")
        from hiltest.campaigns.campaign import run_seeds

        if against is not None:
            _check_firmwares(against, arguments["firmware"], arguments["rig"], arguments["base"])
        with sole_command(Path(out)):
            code = run_seeds(
                seeds,
                options,
                Path(out),
                may_fail=may_fail,
                baseline=base,
                against=against,
                jobs=jobs,
                coverage=coverage or os.environ.get("HIL_COVERAGE"),
            )
        return code, Path(out) / SEEDS_FILE
    older = None if against is None else OlderFirmware(against, tuple(options), Path(out) / OLDER_FOLDER)
    options += [f"{name}={value}" for name, value in of_this_run.items() if value is not None]
    return run_suites(options, Path(out), older=older, flashes=flash)


def _verbosity(pytest_args: Sequence[str], *, verbose: bool) -> list[str]:
    """Return pytest's verbosity: a dot per test, unless an option or the ini file sets it."""
    if verbose:
        return ["-v"]
    return [] if any(re.fullmatch(r"-[vq]+|--verbose|--quiet", argument) for argument in pytest_args) else ["-q"]


def _check_firmwares(older: str, newer: str | None, rig: str | None, base: str | None) -> None:
    """Check both firmwares before the older one runs on every seed.

    Raises
    ------
    ConfigError, BenchError, ProtocolError
        If an ELF cannot be loaded, or the newer one does not answer as it must.
    """
    from hiltest.boards import VirtualBench, open_board
    from hiltest.rig.bench_files import rig_file
    from hiltest.rig.rig_file import load_rig

    bench = load_rig(rig_file(Path.cwd(), rig))
    VirtualBench(bench, firmware=Path(older))
    at = None if base is None else address(base)
    open_board(bench, firmware=None if newer is None else Path(newer), base=at).close()
