"""Flame graph: callers below callees, with widths in proportion to cycles."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from markupsafe import Markup

from hiltest.virtual.counts.profiling import StackCost
from hiltest.virtual.profiling.document import ProfileDocument

_WIDTH, _ROW, _MARGIN = 1000.0, 20.0, 30.0
_LETTER = 6.5
_NARROWEST = 0.5  # narrower boxes are invisible
# Warm colours on which black letters are legible, one per function.
_COLOURS = ("#ffd27f", "#ffb977", "#ffe39a", "#f7a072", "#ffcf56", "#f4b183", "#ffc09f", "#f6d186")

_HEAD = """<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:g} {height:g}" role="img"
 font-family="ui-monospace, monospace" font-size="11">
<title>{title}</title>
<rect width="100%" height="100%" fill="#ffffff"/>
<text x="4" y="18">{title}</text>
"""
_BOX = """<g><title>{tip}</title><rect x="{x:.2f}" y="{y:.1f}" width="{width:.2f}" height="{height:.1f}" \
fill="{colour}" stroke="#ffffff"/><text x="{text_x:.2f}" y="{text_y:.1f}">{label}</text></g>
"""


@dataclass(frozen=True, slots=True)
class _Box:
    """One function on one path; `start` and `cycles` are its range within the cycles of the call."""

    name: str
    depth: int
    start: int
    cycles: int


def flame_graph(profile: ProfileDocument) -> str:
    """Return the profile as an SVG file, whose boxes have tooltips with their cycles."""
    boxes = list(_boxes(profile.stacks, depth=0, start=0))
    deepest = max((box.depth for box in boxes), default=0)
    height = _MARGIN + (deepest + 1) * _ROW + 4
    title = f"{profile.function}: {profile.cycles} cycles, {profile.cycle_model}"
    drawn = [Markup(_HEAD).format(width=_WIDTH, height=height, title=title)]
    colours = {name: _COLOURS[index % len(_COLOURS)] for index, name in enumerate(sorted({box.name for box in boxes}))}
    for box in boxes:
        width = box.cycles / profile.cycles * _WIDTH
        if width >= _NARROWEST:
            drawn.append(_draw(box, width, height, profile.cycles, colours[box.name]))
    return str(Markup("").join(drawn) + Markup("</svg>\n"))


def _boxes(stacks: Sequence[StackCost], *, depth: int, start: int) -> Iterator[_Box]:
    """Yield the functions at a depth, each followed by its callees."""
    callees: dict[str, list[StackCost]] = {}
    for stack in stacks:
        if len(stack.functions) > depth:
            callees.setdefault(stack.functions[depth], []).append(stack)
    for name in sorted(callees):
        cycles = sum(stack.cycles for stack in callees[name])
        yield _Box(name, depth, start, cycles)
        yield from _boxes(callees[name], depth=depth + 1, start=start)
        start += cycles


def _draw(box: _Box, width: float, height: float, whole: int, colour: str) -> Markup:
    x, y = box.start / whole * _WIDTH, height - 4 - (box.depth + 1) * _ROW
    letters = int((width - 6) / _LETTER)
    label = box.name if len(box.name) <= letters else box.name[: max(letters - 2, 0)] + ".." if letters > 3 else ""
    tip = f"{box.name}: {box.cycles} cycles, {100 * box.cycles / whole:.1f} %"
    return Markup(_BOX).format(
        tip=tip, x=x, y=y, width=width, height=_ROW - 1, colour=colour, text_x=x + 3, text_y=y + 14, label=label
    )
