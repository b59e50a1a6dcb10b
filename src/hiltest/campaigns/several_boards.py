"""Several boards at once: one run for each rig, and the spread between the boards."""

from __future__ import annotations

import re
import statistics
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import click

from hiltest.errors import ConfigError
from hiltest.measurement import KINDS, Measurement, identify, round_significant
from hiltest.path_names import path_in
from hiltest.report.boards_page import Apart, BoardLine, boards_html, boards_markdown, boards_table, print_boards
from hiltest.report.console import standard_output
from hiltest.report.job_summary import annotation, append_to_job_summary
from hiltest.rig import Rig
from hiltest.rig.bench_files import rig_file
from hiltest.rig.rig_file import load_rig
from hiltest.run_record.exit_codes import ExitCode, outcome_of
from hiltest.run_record.files import (
    BOARDS_FILE,
    BOARDS_MARKDOWN,
    BOARDS_PAGE,
    BOARDS_TABLE,
    RUN_FILE,
    write_atomically,
    write_document,
)
from hiltest.run_record.reader import read_record
from hiltest.run_record.run import Run, Verdict
from hiltest.session.older_firmware import last_words, run_command
from hiltest.session.settings import make_folder
from hiltest.studies.jobs import compute_pieces
from hiltest.text import format_with_unit, join_words

SCHEMA = "hiltest.boards/1"

_KEPT = "the records of finished boards are kept"
_NAMED_AT_MOST = 4
_WORST = KINDS["heading.{calibrator}.max"]
_NO_FOLDER = re.compile(r"[^A-Za-z0-9._-]")


@dataclass(frozen=True, slots=True)
class Boards:
    """``boards.json``: several boards that ran at once, or one after the other with ``--serial``."""

    exit_code: int
    """Exit code that takes precedence among those of the boards."""
    sentence: str
    """Number of boards that pass, and the results of the others."""
    boards: Sequence[BoardLine]
    measurements: Sequence[Apart]
    """Measurements of each board, and how far apart they are."""


def run_boards(rigs: Sequence[str], options: Sequence[str], out: Path, *, flashes: bool = False) -> int:
    """Run the suites on several boards at once; write ``boards.json``, ``boards.html`` and ``boards.md``.

    Parameters
    ----------
    rigs
        Rig files, or names of rigs: one per board.
    options
        Options of pytest, the same for every board.
    out
        Folder that receives one folder per board, with the name of its rig.
    flashes
        True if the firmware is flashed onto each board first.

    Returns
    -------
    int
        Exit code of the board whose code takes precedence, in the order for the tests of one run.

    Raises
    ------
    ConfigError
        If two rigs share a name or a port, a name leads to another folder, an operator turns a rig, or one cannot be
        read; no run starts then.
    """
    benches = {_NO_FOLDER.sub("-", rig.name): rig for rig in (load_rig(rig_file(Path.cwd(), name)) for name in rigs)}
    if len(benches) < len(rigs):
        raise ConfigError(
            f"two of {join_words([*rigs], _NAMED_AT_MOST)} have the same name: give each board's rig its own name"
        )
    for rig in benches.values():
        path_in(out, rig.name, remedy=f"give {rig.path} another name")
    _check_apart(benches)
    files = {name: str(rig.path) for name, rig in benches.items()}
    # An earlier verdict must not pass for this one's.
    for name in (BOARDS_FILE, BOARDS_PAGE, BOARDS_MARKDOWN, BOARDS_TABLE):
        (out / name).unlink(missing_ok=True)
    make_folder(out)
    arguments = ("--flash",) if flashes else (), tuple(options), out, tuple(files.items())
    ended = {}
    click.echo(f"{len(files)} boards: {', '.join(files)}")
    for number, (code, last_line) in compute_pieces(
        _run, arguments, range(len(files)), len(files), remark=_KEPT, starts_process=True
    ):
        name = [*files][number]
        ended[name] = line, _ = _board_result(name, code, last_line, out / name)
        click.echo(f"{name}: {line.sentence}")
    verdict, apart = _write_boards({name: ended[name] for name in files}, out)
    print_boards(standard_output(), [*files], apart)
    click.echo(f"Report: {out / BOARDS_PAGE}, and a report in each board's folder")
    if remark := append_to_job_summary((out / BOARDS_MARKDOWN).read_text(encoding="utf-8"), out / BOARDS_MARKDOWN):
        click.echo(remark)
    click.echo(annotation(verdict), nl=False)
    click.echo(verdict.sentence)
    return verdict.exit_code


def add_to_batch(out: Path, serial: str) -> str:
    """Write the page and the tables over all boards of a folder; return the label of one of them.

    Parameters
    ----------
    out
        Folder with the record of each board in a folder that has the name of its serial number.
    serial
        Board whose record is there.

    Returns
    -------
    str
        One line for a label printer: serial number, verdict, date, worst heading and firmware.
    """
    folders = sorted(path.parent for path in out.glob(f"*/{RUN_FILE}"))
    runs = {folder.name: read_record(folder).run for folder in folders}
    _write_boards({name: (_line(name, name, run), run.measurements) for name, run in runs.items()}, out)
    run = runs[serial]
    errors = {
        float(measured.value): f"{measured.name} {format_with_unit(measured.value, measured.unit)}"
        for measured in run.measurements
        if measured.kind is _WORST and measured.limit and measured.value is not None
    }
    heading = errors[max(errors)] if errors else "no heading"
    return f"{serial} | {run.verdict.outcome.upper()} | {run.started_utc[:10]} | {heading} | {_firmware(run)}"


def _write_boards(
    results: Mapping[str, tuple[BoardLine, Sequence[Measurement]]], out: Path
) -> tuple[Verdict, Sequence[Apart]]:
    boards = [line for line, _ in results.values()]
    apart = apart_of({name: measurements for name, (_, measurements) in results.items()})
    verdict = verdict_of(boards)
    document = Boards(verdict.exit_code, verdict.sentence, boards, apart)
    write_document(out / BOARDS_FILE, document, SCHEMA)
    write_atomically(out / BOARDS_PAGE, boards_html(verdict, boards, apart))
    write_atomically(out / BOARDS_MARKDOWN, boards_markdown(verdict, boards, apart))
    write_atomically(out / BOARDS_TABLE, boards_table(boards, apart))
    return verdict, apart


def _check_apart(benches: Mapping[str, Rig]) -> None:
    ports: dict[str, str] = {}
    for name, rig in benches.items():
        if rig.turntable.kind == "operator":
            raise ConfigError(f"{rig.path}: an operator can turn only one board at a time: run this rig alone")
        if rig.board.kind == "real" and rig.board.port is None:
            raise ConfigError(
                f"{rig.where('board', 'kind')}: board.port: several boards need their ports: hiltest ports lists them"
            )
        for port in filter(None, (rig.board.port, rig.turntable.port)):
            if (other := ports.setdefault(port, name)) != name:
                raise ConfigError(f"{name} and {other} have the same port, {port}: correct one of the rigs")


def _run(
    arguments: tuple[tuple[str, ...], tuple[str, ...], Path, tuple[tuple[str, str], ...]], number: int
) -> tuple[int, str]:
    """Run one board in a process of its own."""
    flags, options, out, files = arguments
    name, rig = files[number]
    done = run_command(f"--rig={rig}", f"--out={out / name}", *flags, "--", *options, folder=out / name)
    return done.returncode, last_words(done.stderr or done.stdout)


def _board_result(name: str, code: int, last_line: str, folder: Path) -> tuple[BoardLine, tuple[Measurement, ...]]:
    """Return the result of a board's run, and its measurements; a board that was lost midway has some, too."""
    run: Run | None = None
    if code != ExitCode.USAGE_ERROR:  # a run with this code was refused the folder, which another run has
        with suppress(ConfigError):
            run = read_record(folder).run
    if run is None:
        code = code or ExitCode.NOT_EVALUATED  # tests were only collected, for example: nothing shows that it passed
        return BoardLine(name, folder.name, code, last_line), ()
    return replace(_line(name, folder.name, run), exit_code=code), run.measurements


def _line(name: str, folder: str, run: Run) -> BoardLine:
    return BoardLine(name, folder, run.verdict.exit_code, run.verdict.sentence, _firmware(run))


def _firmware(run: Run) -> str:
    return f"{run.board.firmware} {run.board.version} build {run.board.build_id}" if run.board else ""


def apart_of(measured: dict[str, Sequence[Measurement]]) -> list[Apart]:
    """Return each measurement with its value on every board, and the spread between them.

    Numbers of different units or cycle models are not compared.
    """
    by_name: dict[str, dict[str, Measurement]] = {}
    for board, measurements in measured.items():
        for measurement in measurements:
            if not measurement.volatile:
                by_name.setdefault(measurement.name, {})[board] = measurement
    return [_row(name, measurements) for name, measurements in by_name.items()]


def _row(name: str, by_board: dict[str, Measurement]) -> Apart:
    values = {board: measurement.value for board, measurement in by_board.items()}
    outcomes = {board: measurement.outcome for board, measurement in by_board.items()}
    numbers = [value for value in values.values() if value is not None]
    kind = identify(name).kind
    comparable = len({(measurement.unit, measurement.cycle_model) for measurement in by_board.values()}) == 1
    unit = next(iter(by_board.values())).unit
    if len(numbers) < 2 or not comparable or (kind is not None and kind.direction):
        return Apart(name, unit, values, outcomes, None)
    mean, deviation = statistics.mean(numbers), statistics.stdev(numbers)
    limits = {measurement.limit for measurement in by_board.values()}
    limit = limits.pop() if len(limits) == 1 else None
    rooms = (
        []
        if limit is None or not deviation
        else [
            *([] if limit.max is None else [limit.max - mean]),
            *([] if limit.min is None else [mean - limit.min]),
        ]
    )
    cpk = round_significant(min(rooms) / (3.0 * deviation)) if rooms else None
    spread = round_significant(max(numbers) - min(numbers))
    return Apart(name, unit, values, outcomes, spread, round_significant(mean), round_significant(deviation), cpk)


def verdict_of(boards: Sequence[BoardLine]) -> Verdict:
    """Return the verdict over all boards."""
    codes = {board.exit_code for board in boards}
    # The enumeration is in order of precedence, a pass last. Another code is a plugin's.
    ordered = (int(exit_code) for exit_code in ExitCode if exit_code in codes and exit_code)
    code = next(ordered, int(ExitCode.NOT_EVALUATED if any(codes) else ExitCode.OK))
    red = [f"{board.name}: {outcome_of(board.exit_code)}" for board in boards if board.exit_code]
    passed = f"{len(boards) - len(red)} of {len(boards)} boards pass"
    sentence = f"{passed}; {join_words(red, _NAMED_AT_MOST)}." if red else f"{passed}."
    return Verdict(outcome_of(code), code, sentence, complete=True)
