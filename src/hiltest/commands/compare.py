"""``hiltest compare``: improvements and regressions between runs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from hiltest.commands.options import json_option, print_document

if TYPE_CHECKING:
    from hiltest.verdict.detection import Detection
    from hiltest.verdict.evidence import Evidence

_EXIT_CODES = """
\b
Exit codes:
  0   may be merged: nothing got worse
  1   not to be merged: a limit or a test of NEW itself fails, or it crashes
  2   interrupted
  4   usage: BASE does not exist, or NEW cannot be read
  21  not to be merged: a measurement is worse by more than its tolerance
  22  unknown: BASE is damaged or not comparable, a measurement is missing,
      or a limit was not evaluated
"""


@click.command(epilog=_EXIT_CODES)
@json_option("hiltest.comparison/1")
@click.option(
    "--detect", metavar="SIZE", help="Compute how many runs per side detect a change of SIZE, such as 0.05deg."
)
@click.argument("base", type=click.Path(path_type=Path))
@click.argument("new", nargs=-1, type=click.Path(path_type=Path))
def compare(base: Path, new: tuple[Path, ...], as_json: bool, detect: str | None) -> int:
    """Compare runs, and list improvements and regressions.

    BASE and NEW are a run.json, the folder of a run, the folder of a campaign (hiltest run --seeds), or a baseline
    file. With --detect, NEW may be omitted.
    """
    from hiltest.report.comparison_text import Comparisons, print_comparison, say_how_to_keep
    from hiltest.run_record.exit_codes import ExitCode, comparison_code
    from hiltest.session.gate import read_gate
    from hiltest.verdict.evidence_reader import read_evidence

    if not new and detect is None:
        raise click.MissingParameter(param_hint="NEW", param_type="argument")
    gate = read_gate(base) if new else None
    evidence = [read_evidence(place) for place in new]
    planned = _plan_runs(base, evidence, detect) if detect is not None else None
    comparisons = [gate.compare(side) for side in evidence] if gate else []
    if as_json:
        print_document("hiltest.comparison/1", Comparisons(comparisons, planned))
    else:
        from hiltest.report.console import standard_output
        from hiltest.report.detection_text import print_detection

        for comparison in comparisons:
            print_comparison(standard_output(), comparison)
            say_how_to_keep(standard_output(), comparison, comparison.new.file)
        if planned is not None:
            print_detection(standard_output(), planned)
    codes = {comparison_code(comparison) for comparison in comparisons}
    # ExitCode lists the codes in order of precedence; without a comparison nothing is wrong.
    return next((code for code in ExitCode if code in codes), 0)


def _plan_runs(base: Path, evidence: list[Evidence], size: str) -> Detection:
    """Return how many runs detect a change; an unreadable base is a usage error, since there is no other answer."""
    from hiltest.verdict.detection import detection
    from hiltest.verdict.evidence_reader import read_evidence

    if len(evidence) > 1:
        raise click.BadParameter("accepts one NEW at most", param_hint="--detect")
    try:
        return detection(size, read_evidence(base), evidence[0] if evidence else None)
    except ValueError as error:
        raise click.BadParameter(str(error), param_hint="--detect") from error
