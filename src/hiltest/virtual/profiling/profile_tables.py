"""Tables of a profile, for a terminal."""

from __future__ import annotations

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from hiltest.virtual.profiling.document import ChangedBuffer, ProfileDocument

_NAMES = {
    "floating_point": "floating point",
    "load_store": "load, store",
    "branch": "branches",
    "integer": "integer",
    "system": "system",
    "taken_branch": "refill after taken branches",
    "fp_result": "floating-point results",
    "division": "division and square root",
    "load_use": "loaded addresses",
    "store_buffer": "store buffer",
    "address": "computed addresses",
    "fetch": "instruction fetches",
    "asleep": "asleep (WFI)",
    "memory": "waits for memories",
}
_VALUES_SHOWN = 16
_FUNCTIONS_SHOWN = 30


def print_profile(console: Console, profile: ProfileDocument, *, lines: int, instructions: int) -> None:
    """Print the result and cost of a call, and the distribution of its cycles.

    Parameters
    ----------
    lines, instructions
        How many of the most expensive source lines and instructions to show.
    """
    _print_head(console, profile)
    console.print(_kinds(profile))
    console.print(_functions(profile))
    if profile.loops:
        console.print(_loops(profile))
    if lines and profile.lines:
        console.print(_lines(profile, lines))
    if instructions:
        console.print(_instructions(profile, instructions))


def _print_head(console: Console, profile: ProfileDocument) -> None:
    call = f"{profile.function}({', '.join(profile.arguments)})"
    console.print(escape(f"{call}{_format_value(profile.returned)}"), soft_wrap=True)
    for buffer in profile.buffers:
        console.print(escape(_buffer(buffer)), soft_wrap=True)
    microseconds = profile.cycles / profile.core_clock_hz * 1e6
    mean_cycles = profile.cycles / profile.instructions
    stack = "" if profile.stack_bytes is None else f", {_group_digits(profile.stack_bytes)} bytes of stack"
    console.print(
        f"[bold]{_group_digits(profile.cycles)} cycles[/bold], {_group_digits(profile.instructions)} instructions "
        f"({mean_cycles:.2f} cycles each), {microseconds:.2f} us at {profile.core_clock_hz / 1e6:g} MHz{stack}",
        soft_wrap=True,
    )
    band = f": {profile.band.explained(of=profile.cycles)}" if profile.band else ""
    console.print(escape(f"cycle model {profile.cycle_model}{band}"), soft_wrap=True)
    for note in profile.notes:
        console.print(escape(f"note: {note}"), style="yellow", soft_wrap=True)


def _format_value(value: float | int | None) -> str:
    if value is None:
        return ""
    if isinstance(value, float):
        return f" = {value:.9g}"
    mask = 0xFFFFFFFF if -(1 << 31) <= value < 1 << 32 else 0xFFFFFFFFFFFFFFFF
    return f" = {value} (0x{value & mask:x})"


def _buffer(buffer: ChangedBuffer) -> str:
    first = buffer.values[:_VALUES_SHOWN]
    shown = " ".join(f"{value:.9g}" if isinstance(value, float) else str(value) for value in first)
    more = "" if len(buffer.values) <= _VALUES_SHOWN else f" ... {len(buffer.values)} in total"
    return f"argument {buffer.argument} holds {buffer.type}: {shown}{more}"


def _kinds(profile: ProfileDocument) -> Table:
    table = _table("where the cycles go", "cycles", "share")
    for share in profile.shares:
        if share.cycles and share.kind != "stall":
            table.add_row(_NAMES[share.name], _group_digits(share.cycles), f"{share.percent:.1f} %")
    stalls = [share for share in profile.shares if share.cycles and share.kind == "stall"]
    if stalls:
        total = sum(share.cycles for share in stalls)
        table.add_row("stalls", _group_digits(total), f"{sum(share.percent for share in stalls):.1f} %")
    for share in stalls:
        table.add_row(f"  {_NAMES[share.name]}", _group_digits(share.cycles), f"{share.percent:.1f} %", style="dim")
    return table


def _functions(profile: ProfileDocument) -> Table:
    table = _table("function", "calls", "cycles", "share", "with callees", "instructions", "stalls")
    for function in profile.functions[:_FUNCTIONS_SHOWN]:
        table.add_row(
            escape(function.name),
            _group_digits(function.calls),
            _group_digits(function.self_cycles),
            _share(profile, function.self_cycles),
            _group_digits(function.cycles),
            _group_digits(function.instructions),
            _group_digits(function.stall_cycles),
        )
    _say_what_is_left_out(table, len(profile.functions), _FUNCTIONS_SHOWN)
    return table


def _loops(profile: ProfileDocument) -> Table:
    """Return a table of loops that wait for the fetch of misaligned instructions."""
    table = _table("loop with misaligned instructions", "turns", "misaligned", "cycles lost", "share")
    table.add_column("remedy", overflow="fold")
    for loop in profile.loops:
        where = f"{loop.function} {loop.address:08x} to {loop.last:08x} {loop.location}".rstrip()
        table.add_row(
            escape(where),
            _group_digits(loop.turns),
            f"{100 * loop.misplaced / loop.wide:.0f} %",
            _group_digits(loop.cycles),
            _share(profile, loop.cycles),
            escape(loop.advice),
        )
    return table


def _lines(profile: ProfileDocument, most: int) -> Table:
    table = _table("source line", "cycles", "share", "instructions", "stalls")
    for line in profile.lines[:most]:
        table.add_row(
            escape(line.location),
            _group_digits(line.cycles),
            _share(profile, line.cycles),
            _group_digits(line.instructions),
            _group_digits(line.stall_cycles),
        )
    _say_what_is_left_out(table, len(profile.lines), most)
    return table


def _instructions(profile: ProfileDocument, most: int) -> Table:
    table = _table("instruction", "times", "cycles", "share", "stalls")
    for address in profile.addresses[:most]:
        place = f"{address.address:08x} {address.function} {address.location}".rstrip()
        table.add_row(
            escape(f"{place}  {address.text}"),
            _group_digits(address.executions),
            _group_digits(address.cycles),
            _share(profile, address.cycles),
            _group_digits(address.stall_cycles),
        )
    _say_what_is_left_out(table, len(profile.addresses), most)
    return table


def _say_what_is_left_out(table: Table, present: int, shown: int) -> None:
    if present > shown:
        table.add_row(f"... {present - shown} more", style="dim")


def _table(first: str, *numbers: str) -> Table:
    table = Table(box=SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0))
    table.add_column(first, overflow="fold")
    for name in numbers:
        table.add_column(name, justify="right", no_wrap=True)
    return table


def _share(profile: ProfileDocument, cycles: int) -> str:
    return f"{100 * cycles / profile.cycles:.1f} %"


def _group_digits(count: int) -> str:
    return f"{count:,}".replace(",", " ")
