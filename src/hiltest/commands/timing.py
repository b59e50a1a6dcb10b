"""``hiltest timing``: what the virtual board's clock cycles rest on."""

from __future__ import annotations

import click

_EXIT_CODES = """
\b
Exit codes:
  0   shown
  4   usage: no such profile, or the file is no timing profile
"""


@click.group()
def timing() -> None:
    """Show what a clock cycle of the virtual board rests on."""


@timing.command(epilog=_EXIT_CODES)
@click.option("--profile", "named", metavar="NAME|FILE",
              help="Timing profile, or a file of your own (.toml).  [default: cortex-m4-trm/1]")
@click.option("--json", "as_json", is_flag=True, help="Print JSON (hiltest.timing/1) and nothing else.")
def show(named: str | None, as_json: bool) -> int:
    """Print a timing profile: what each row prices, its cycles, the band of the truth, and the source."""
    from hiltest.profiling.timing_table import json_text, print_table
    from hiltest.virtual.profile_file import DEFAULT_PROFILE, load_profile, place_of

    name = named or DEFAULT_PROFILE
    profile = load_profile(name)
    if as_json:
        click.echo(json_text(profile, place_of(name)))
        return 0
    from hiltest.report.console import standard_output

    print_table(standard_output(), profile, place_of(name))
    return 0
