"""A comparison as text for the terminal, and as a document."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from rich.console import Console
from rich.text import Text

from hiltest.run_record.comparison import Answer, Change, Comparison, Side
from hiltest.text import format_number
from hiltest.verdict.detection import Detection
from hiltest.verdict.wording import build, counted_by, entry, how_to_keep, models_shown, revision, seen_from, shown

# Thousands are separated, as in 11 061, and must stay on one line.
_WITHIN_A_NUMBER = re.compile(r"(?<=\d) (?=\d{3}\b)")
_NO_BREAK = "\N{NO-BREAK SPACE}"
_STYLES = {Change.WORSE: "bold red", Change.GONE: "bold red", Change.BETTER: "green"}


@dataclass(frozen=True, slots=True)
class Comparisons:
    """Comparisons of runs with a base."""

    comparisons: list[Comparison]
    """Comparison for each NEW: sentence, obstacles, and the difference of each measurement."""
    detection: Detection | None
    """Numbers of runs that detect a change, with ``--detect``; null without."""


def print_comparison(console: Console, comparison: Comparison) -> None:
    """Print the sentence, the obstacles of the gate, and every measurement that changed."""
    say(console, f"{_description(comparison.base)} -> {_description(comparison.new)}")
    say(console, comparison.sentence, "" if comparison.answer is Answer.MAY else "bold red")
    print_changes(console, comparison, sentence=comparison.sentence)
    limited = [
        difference for difference in comparison.differences if difference.limit is not None and seen_from(difference)
    ]
    detectable = {difference.name: difference.seen for difference in limited if difference.seen is not None}
    print_smallest_changes(console, "smallest change that this comparison detects in 4 of 5 cases", detectable)


def print_smallest_changes(console: Console, heading: str, detectable: Mapping[str, float]) -> None:
    """Print the smallest changes in degrees that a comparison detects, for measurements with a limit, if any."""
    if detectable:
        say(console, f"{heading}, where there is a limit [deg]")
        changes = ", ".join(f"{name} {format_number(change, 2)}" for name, change in detectable.items())
        print_wrapped(console, changes, indent="  ")


def print_changes(console: Console, comparison: Comparison, *, sentence: str, at_most: int | None = None) -> None:
    """Print obstacles of the gate, unless a printed sentence has the only one, and all changes or some of each kind."""
    if comparison.remark:
        say(console, comparison.remark, "yellow")
    if not all(obstacle.rstrip(".") in sentence for obstacle in comparison.obstacles):
        count = len(comparison.obstacles)
        say(console, f"{count} reason{'s' * (count != 1)} why it is not evaluated", "bold red")
        for obstacle in comparison.obstacles:
            print_wrapped(console, obstacle, indent="  ")
    for change, differences in shown(comparison):
        say(console, f"{change} ({len(differences)})", _STYLES.get(change, "bold"))
        for difference in differences[:at_most]:
            words = ", ".join(filter(None, (entry(difference), seen_from(difference))))
            print_wrapped(console, words, indent="  ")
        if more := len(differences) - len(differences[:at_most]):
            say(console, f"  and {more} more")
    if remark := counted_by(models_shown(comparison)):
        say(console, remark)
    if not_taken := len(comparison.differences_with(Change.NOT_TAKEN)):
        say(console, f"{not_taken} measurement{'s' * (not_taken != 1)} not taken")
    if unchanged := len(comparison.differences_with(Change.UNCHANGED)):
        say(console, f"unchanged ({unchanged})")


def say_how_to_keep(console: Console, comparison: Comparison, run: str, options: str | None = None) -> None:
    """Print how to keep the improvements, if there are any and they may be kept; `options` as in `how_to_keep`."""
    if hint := how_to_keep(comparison, run, options):
        say(console, hint)


def say(console: Console, text: str, style: str = "") -> None:
    """Print a line, which the terminal may wrap; control characters are made visible."""
    console.print(Text(printable(text), style=style), soft_wrap=True)


def print_wrapped(console: Console, text: str, style: str = "", indent: str = "") -> None:
    """Print a text wrapped at the terminal's width, with unbroken numbers and names."""
    for line in textwrap.wrap(
        _WITHIN_A_NUMBER.sub(_NO_BREAK, printable(text)),
        console.width,
        initial_indent=indent,
        subsequent_indent=indent and f"{indent}  ",
        break_long_words=False,
        break_on_hyphens=False,
    ):
        console.print(Text(line.replace(_NO_BREAK, " "), style=style), soft_wrap=True)


def printable(text: str) -> str:
    """Return a text with every control character escaped; names from a file may contain some."""
    return "".join(character if character.isprintable() else ascii(character)[1:-1] for character in text)


def _description(side: Side) -> str:
    """Return a short description of a side."""
    seeds = f", seed{'s' * (len(side.seeds) != 1)} {_seed_list(side.seeds)}" if side.seeds else ""
    made_for = f", {revision(side.revision)}" if side.revision else ""
    made_with = f" ({build(side)}{made_for}{seeds})" if side.build_id else ""
    return f"{side.file or 'this run'}{made_with}"


def _seed_list(seeds: Sequence[int]) -> str:
    """Return consecutive numbers as ``1..8``, others one by one."""
    in_a_row = len(seeds) > 2 and list(seeds) == list(range(seeds[0], seeds[0] + len(seeds)))
    return f"{seeds[0]}..{seeds[-1]}" if in_a_row else ", ".join(map(str, seeds))
