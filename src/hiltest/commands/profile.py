"""``hiltest profile``: show the cycles of one function by place."""

from __future__ import annotations

from copy import deepcopy
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hiltest.commands.options import json_option
from hiltest.errors import ConfigError

if TYPE_CHECKING:
    from hiltest.virtual.profiling.image import ProfiledImage

SHIPPED = "shipped"

_EPILOG = """
\b
Arguments of the function:
  42  -7  0x2a        an integer
  2.5  1e-3           a float
  int16:1,-2,3        numbers by address (int8 to uint64, float32, float64)
  float32:@data.csv   the numbers in a text file, row by row
  zeros:64            64 zero bytes that the function fills
  zeros:float32:12    12 zeros of a type
  text:hello          characters, followed by a zero
  @data.bin           the bytes of a file
  A+B                 buffers A and B as the members of a C struct
  ptr:A               as such a member: the address of buffer A

\b
Exit codes:
  0   the function returned
  2   interrupted
  4   usage: an option, an argument or the ELF is wrong
  20  the function faulted or hung
"""


def refuse_option(context: click.Context, _parameter: click.Parameter, text: str) -> str:
    """Return the name of an ELF or a function; an unknown option would be taken for one."""
    if text.startswith("-"):
        raise click.NoSuchOption(text, ctx=context)
    return text


# Unknown options are allowed, since a negative number is an argument of the function.
@click.command(epilog=_EPILOG, context_settings={"ignore_unknown_options": True})
@click.option(
    "--lines",
    metavar="N",
    type=click.IntRange(min=0),
    default=12,
    show_default=True,
    help="Show this many source lines.",
)
@click.option(
    "--instructions",
    metavar="N",
    type=click.IntRange(min=0),
    default=0,
    show_default=True,
    help="Show this many instructions.",
)
@json_option("hiltest.profile/1")
@click.option(
    "--folded",
    metavar="FILE",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Write the call stacks for flame graph tools.",
)
@click.option(
    "--flame-graph", metavar="FILE", type=click.Path(path_type=Path, dir_okay=False), help="Write a flame graph (SVG)."
)
@click.option(
    "--profile",
    "timing",
    metavar="NAME|FILE",
    help="Count cycles by this timing profile, a name or a file.  [default: cortex-m4-trm/3]",
)
@click.option(
    "--memory",
    metavar="MAP",
    help="Set the memories of another part: flash=0x08000000:512K,ram=0x20000000:128K.  [default: as the ELF needs]",
)
@click.option(
    "--part",
    metavar="NAME|FILE",
    help="Use the memories and the timing of this chip or core, such as stm32f407 or generic-m3, or of a part file.",
)
@click.option(
    "--clock",
    metavar="HZ",
    help="Set the core clock, as 48MHz or 48_000_000.  [default: the highest of the part, else 120 MHz]",
)
@click.option(
    "--timeout",
    "timeout_s",
    metavar="S",
    type=click.IntRange(1, 100),
    default=1,
    show_default=True,
    help="Stop a function that runs longer than this virtual time, in seconds.",
)
@click.argument("elf", callback=refuse_option)
@click.argument("function", callback=refuse_option)
@click.argument("arguments", nargs=-1, type=click.UNPROCESSED)
def profile(
    elf: str,
    function: str,
    arguments: tuple[str, ...],
    lines: int,
    instructions: int,
    as_json: bool,
    folded: Path | None,
    flame_graph: Path | None,
    timeout_s: int,
    **counted: str | None,
) -> int:
    """Count the cycles of a function, by function and source line.

    ELF is any program for a Cortex-M4, M0 or M0+, or for the core of --part; "shipped" is the packaged firmware.
    FUNCTION may be a calibrator of hiltest's firmware, such as direct, which is called with 100 points.
    hiltest profile worst searches for the arguments that take the most cycles.
    """
    from hiltest.boards import default_firmware
    from hiltest.json_files import json_text
    from hiltest.run_record.files import write_asked_for
    from hiltest.studies.board_calibrators import BoardCalibrators
    from hiltest.virtual.profiling import document as documents
    from hiltest.virtual.profiling.arguments import parse_argument

    path = default_firmware() if elf == SHIPPED else Path(elf)
    inputs = [parse_argument(text) for text in arguments]
    values = deepcopy(inputs)
    image = _image(path, **counted)
    image.report_waits(lambda line: click.echo(line, err=True))
    has_table = "calibrators" in image.board.image.symbols and function not in image.board.image.symbols
    calibrators = BoardCalibrators(path) if has_table else None
    if calibrators and function in calibrators.names:
        if arguments or any(counted.values()):
            raise ConfigError(
                f"{function} is a calibrator, which is called with 100 points, without arguments and options for its "
                f"timing; leave them out, or name its function: {calibrators.functions[function]}"
            )
        called = calibrators.profile(function)
    elif calibrators and (near := get_close_matches(function, calibrators.names, n=1)):
        raise ConfigError(f"{path.name}: no function and no calibrator {function!r}; did you mean {near[0]!r}?")
    else:
        called = image.call(function, *values, timeout_s=timeout_s)
    document = documents.document(called, path, arguments, inputs, values, memory=image.memory, part=image.part)
    if folded is not None:
        write_asked_for(folded, documents.folded(document))
    if flame_graph is not None:
        from hiltest.virtual.profiling.flame_graph import flame_graph as draw

        write_asked_for(flame_graph, draw(document))
    if as_json:
        click.echo(json_text(documents.replace_nan(document)))
        return 0
    from hiltest.report.console import standard_output
    from hiltest.virtual.profiling.profile_tables import print_profile

    print_profile(standard_output(), document, lines=lines, instructions=instructions)
    return 0


def _image(path: Path, *, timing: str | None, memory: str | None, part: str | None, clock: str | None) -> ProfiledImage:
    from hiltest.virtual.calls.call_clock import parse_clock
    from hiltest.virtual.profiling.image import ProfiledImage

    clock_hz = None if clock is None else parse_clock(clock)
    return ProfiledImage(path, timing=timing, memory=memory, part=part, clock_hz=clock_hz)
