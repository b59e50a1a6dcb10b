"""``hiltest run``: run the suites on a bench, and decide a verdict."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from contextlib import redirect_stderr, redirect_stdout
from inspect import cleandoc
from pathlib import Path
from typing import Any

import click

from hiltest.commands.options import (
    EXIT_CODES,
    CapturedErrors,
    jobs_option,
    json_option,
    load_named_rig,
    parsed,
    print_error,
    pytest_options,
    seed_range,
    setting_option,
)
from hiltest.errors import ConfigError
from hiltest.rig.bench_files import REAL_RIG
from hiltest.session.settings import DEFAULT_OUT, check_environment, file_name, serial_number

_BENCH_HELP = "Ask an operator at the terminal and on a page to turn a board; the same as hiltest run --page.\n\n"


class _Run(click.Command):
    """Command whose error about an unknown option explains how to pass pytest's options."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse the command line."""
        try:
            return super().parse_args(ctx, args)
        except click.NoSuchOption as error:
            hint = f"Options of pytest follow --: {ctx.command_path} -- -k heading"
            raise click.UsageError(f"{error.format_message()} {hint}", ctx) from error

    def format_help_text(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the help, in which the command has the name that it was called by."""
        intro = _BENCH_HELP if ctx.info_name == "bench" else ""
        formatter.write_paragraph()
        with formatter.indentation():
            formatter.write_text(intro + cleandoc(self.help or "").replace("hiltest run", ctx.command_path))


@click.command(cls=_Run, epilog=EXIT_CODES)
@setting_option(
    "rig",
    "rigs",
    multiple=True,
    help="Use this rig: a file, or the name of a rig in hil/rigs. Name several rigs to run their boards at once.",
)
@setting_option("firmware")
@setting_option("base")
@setting_option("port")
@setting_option("out", default=DEFAULT_OUT)
@setting_option("seed")
@click.option("--seeds", metavar="A..B", callback=seed_range, help="Run once for each seed, and summarise the runs.")
@click.option(
    "--may-fail",
    metavar="N",
    type=click.IntRange(min=0),
    default=0,
    show_default=True,
    help="Tolerate this many of --seeds that miss a limit.",
)
@jobs_option("Run --seeds in this many processes")
@setting_option("poses")
@setting_option("suite")
@setting_option("calibration")
@setting_option("label")
@setting_option("baseline")
@click.option(
    "--against",
    metavar="ELF",
    callback=parsed(file_name),
    help="Run this older firmware first, and fail if the firmware is worse.",
)
@click.option(
    "--serial",
    metavar="S",
    callback=parsed(serial_number),
    help="Record this board of a batch in the folder S of --out, and write page and tables over all boards there.",
)
@click.option("--flash", is_flag=True, help="Flash the firmware onto the board first, as hiltest flash does.")
@click.option(
    "--page",
    is_flag=True,
    help="Show the operator's questions also on a page, with the board as it lies. hiltest bench is short for it.",
)
@click.option(
    "--host",
    metavar="ADDRESS",
    help="Serve the page on this address. Unless it is a loopback address, the printed URL contains a secret.  "
    "[default: 127.0.0.1]",
)
@setting_option("coverage")
@setting_option("record")
@setting_option("replay")
@json_option("hiltest.run/1, with --seeds hiltest.seeds/1, with several rigs hiltest.boards/1")
@click.option("-v", "--verbose", is_flag=True, help="Print every test and every measurement.")
@click.argument("pytest_args", metavar="[ELF] [PYTEST_ARGS]...", nargs=-1, type=click.UNPROCESSED)
def run(*, as_json: bool, **arguments: Any) -> int:
    """Run the suites and print a verdict.

    The suites are those in hil/suites of this folder, or the packaged ones if there are none. ELF is the same as
    --firmware ELF. Arguments after -- go to pytest: hiltest run -- -k heading
    """
    if as_json and (arguments["page"] or arguments["host"]):
        raise ConfigError("--json hides the address of the page: leave one of --json and --page out")
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
    out: Path,
    rigs: tuple[str, ...],
    seeds: range | None,
    may_fail: int,
    jobs: int | str | None,
    against: str | None,
    flash: bool,
    serial: str | None,
    page: bool,
    host: str | None,
    verbose: bool,
    pytest_args: Sequence[str],
    **arguments: Any,
) -> tuple[int, Path | None]:
    """Run the suites, and return the exit code and the file with the record; None without one."""
    from hiltest.campaigns.one_run import check_against, run_suites
    from hiltest.run_record.files import BOARDS_FILE, OLDER_FOLDER, SEEDS_FILE
    from hiltest.session.older_firmware import OlderFirmware, base_of_environment
    from hiltest.session.record_folder import sole_command

    check_environment()
    if pytest_args and _is_firmware(pytest_args[0]):
        if arguments["firmware"] is not None:
            raise ConfigError(f"two firmwares: --firmware {arguments['firmware']} and {pytest_args[0]}; leave one out")
        arguments["firmware"], *pytest_args = Path(pytest_args[0]), *pytest_args[1:]
    if pytest_args and Path(pytest_args[0]).is_file():
        _refuse_other_files(Path(pytest_args[0]))
    arguments["rig"] = rigs[0] if len(rigs) == 1 else None
    page_host = host or ("127.0.0.1" if page else None)
    if page_host and not (rigs or arguments["port"] or os.environ.get("HIL_RIG")):
        arguments["rig"] = REAL_RIG
    if serial is not None:
        arguments["label"] = arguments["label"] or serial
    own = {name: arguments.pop(name) for name in ("baseline", "coverage", "record", "replay")}
    base = own["baseline"] or base_of_environment()
    options = [*pytest_options(arguments), *_verbosity(pytest_args, verbose=verbose), *pytest_args]
    if may_fail and seeds is None:
        raise ConfigError("--may-fail needs several seeds: add --seeds A..B")
    if jobs and seeds is None:
        raise ConfigError("--jobs needs several seeds: add --seeds A..B")
    if flash and (seeds is not None or against is not None):
        raise ConfigError(
            "--flash is for a real board, and --seeds and --against are for the virtual board: leave one of them out"
        )
    if against is not None:
        check_against(base and f"the baseline {base}", arguments["port"])
    taped = next((name for name in ("record", "replay") if own[name]), None)
    if taped and (seeds is not None or against is not None):
        raise ConfigError(f"--{taped} is for a single run: leave out --seeds and --against")
    if len(rigs) > 1:
        for_one_board = {
            "seeds": seeds,
            "against": against,
            "port": arguments["port"],
            "coverage": own["coverage"],
            "calibration": arguments["calibration"],
            "page": page_host,
            "serial": serial,
            "record": own["record"],
            "replay": own["replay"],
        }
        if name := next((name for name, value in for_one_board.items() if value is not None), None):
            raise ConfigError(f"--{name} is for one board, and {len(rigs)} rigs are named: leave one of them out")
        from hiltest.campaigns.several_boards import run_boards

        options += pytest_options({"baseline": base})
        with sole_command(out):
            return run_boards(rigs, options, out, flashes=flash), out / BOARDS_FILE
    if seeds is not None:
        if arguments["seed"] is not None or arguments["port"]:
            raise ConfigError("--seeds runs many simulated worlds: leave out --seed and --port")
        if page_host or serial:
            raise ConfigError("--page and --serial are for the run of one board: leave them out")
        from hiltest.campaigns.campaign import run_seeds

        if against is not None:
            _check_firmwares(against, arguments["firmware"], arguments["rig"], arguments["base"])
        with sole_command(out):
            code = run_seeds(
                seeds,
                options,
                out,
                may_fail=may_fail,
                baseline=base,
                against=against,
                jobs=jobs,
                coverage=own["coverage"] or os.environ.get("HIL_COVERAGE"),
            )
        return code, out / SEEDS_FILE
    older = None if against is None else OlderFirmware(against, tuple(options), out / OLDER_FOLDER)
    folder = out / serial if serial else out
    ended = run_suites([*options, *pytest_options(own)], folder, older=older, flashes=flash, page_host=page_host)
    if serial and ended[1] is not None and ended[1].parent.name == serial:
        from hiltest.campaigns.several_boards import add_to_batch

        click.echo(f"Label: {add_to_batch(out, serial)}")
    return ended


def _is_firmware(argument: str) -> bool:
    """Return whether an argument is the name of a firmware file, rather than one for pytest."""
    from hiltest.virtual.program.image_formats import names_image

    return not argument.startswith("-") and names_image(argument)


def _refuse_other_files(file: Path) -> None:
    """Name the place of a file that is neither firmware nor a test."""
    places = {".toml": f"name a rig with --rig {file}", ".c": f"judge a source with hiltest judge {file}"}
    if _is_firmware(str(file)):
        raise ConfigError(f"two firmwares: {file} is the second one; compare two with --against")
    if file.suffix != ".py":
        raise ConfigError(
            f"{file} is neither firmware nor a test; {places.get(file.suffix, f'fit a log with hiltest fit {file}')}"
        )


def _verbosity(pytest_args: Sequence[str], *, verbose: bool) -> list[str]:
    """Return pytest's verbosity: a dot per test, unless an option or the ini file sets it."""
    if verbose:
        return ["-v"]
    return [] if any(re.fullmatch(r"-[vq]+|--verbose|--quiet", argument) for argument in pytest_args) else ["-q"]


def _check_firmwares(older: str, newer: Path | None, rig: str | None, base: int | None) -> None:
    """Check both firmwares before the older one runs on every seed.

    Raises
    ------
    ConfigError, BenchError, ProtocolError
        If an ELF cannot be loaded, or the newer one does not answer as it must.
    """
    from hiltest.boards import VirtualBench, open_board

    bench = load_named_rig(rig)
    VirtualBench(bench, firmware=Path(older))
    open_board(bench, firmware=newer, base=base).close()
