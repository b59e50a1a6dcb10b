"""Cycle counts that others published, and what the model counts of the same code.

    python -m tests.virtual.published --page docs/cycle-validation.md

writes the page's tables. The figures are in fixtures/published; the programs are in the folder that HILTEST_PROGRAMS
names. If an ELF file is missing, the command says so and stops.
"""

from __future__ import annotations

import argparse
import csv
import math
import sys
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import pytest

from hiltest.virtual.model.profile_file import load_profile
from hiltest.virtual.part.part_file import load_part
from hiltest.virtual.profiling.arguments import parse_argument
from hiltest.virtual.profiling.image import ProfiledImage

from ..foreign_elf import foreign_elf

FOLDER = Path(__file__).parents[2] / "fixtures" / "published"
FEWEST_FAMILIES = 3
"""A range is made of the errors of at least as many families."""
VERSIONS = ("cortex-m4-trm/1", "cortex-m4-trm/2", "cortex-m4-trm/3")


@dataclass(frozen=True)
class Published:
    """A function, the call that it was measured in, and its published cycles.

    Attributes
    ----------
    function : str
        Function whose cycles were published; the call leads to it.
    cycles : float
        Published cycles, of one of `repetitions`.
    reading : float
        Cycles of the published figure that reading the counter took.
    family : str
        Figures of one family share code, so that none of them says anything new about another one.
    chose_rules : bool
        True if a rule or a row of the model was chosen by it.
    unclear : str
        Reason why the figure is shown, but not evaluated.
    """

    part: str
    clock_hz: int
    elf: str
    call: tuple[str, ...]
    function: str
    cycles: float
    repetitions: int
    reading: float
    is_assembly: bool
    source: str
    family: str
    chose_rules: bool
    where: str
    unclear: str

    @property
    def net(self) -> float:
        """Published cycles without reading the counter."""
        return self.cycles - self.reading

    @property
    def name(self) -> str:
        return f"{self.elf.removesuffix('.elf')}: {self.function}{self._arguments}"

    @property
    def _arguments(self) -> str:
        return f"({' '.join(self.call[1:])})" if len(self.call) > 1 else ""

    def error(self, counted: float) -> float:
        """Return the error of a count, as a part of the published cycles."""
        return (counted - self.net) / self.cycles

    def deviation(self, counted: float) -> float:
        """Return by which part of the count the published cycles differ from it."""
        return (self.net - counted) / counted


@cache
def figures() -> tuple[Published, ...]:
    """Return all published figures."""
    with (FOLDER / "counts.csv").open(encoding="utf-8") as file:
        return tuple(
            Published(
                row["part"],
                int(row["clock_hz"]),
                row["elf"],
                tuple(row["call"].split()),
                row["function"] or row["call"].split()[0],
                float(row["published"]),
                int(row["per"]),
                float(row["reading"]),
                row["code"] == "assembly",
                row["source"],
                row["family"],
                row["chose_rules"] == "yes",
                row["where"],
                row["unclear"],
            )
            for row in csv.DictReader(file)
        )


@cache
def count(figure: Published, profile: str | None = None) -> float:
    """Count a figure by the part's model, or by another profile without its memories."""
    image = ProfiledImage(foreign_elf(figure.elf), part=figure.part, timing=profile, clock_hz=figure.clock_hz)
    name, *arguments = figure.call
    called = image.call(name, *map(parse_argument, arguments), timeout_s=100)
    cost = next(cost for cost in called.functions if cost.name.partition("@")[0] == figure.function)
    return cost.cycles / max(cost.calls, 1) / figure.repetitions


def evaluated(part: str | None = None) -> list[Published]:
    """Return the figures of hand-written assembly whose conditions are clear."""
    return [figure for figure in figures() if figure.is_assembly and not figure.unclear and part in (None, figure.part)]


def interval(deviations: Iterable[float]) -> tuple[float, float]:
    """Return the interval of deviations, widened to whole thousandths and to 0."""
    all_deviations = list(deviations)
    low, high = min(all_deviations), max(all_deviations)
    return min(0.0, math.floor(1000 * low) / 1000), max(0.0, math.ceil(1000 * high) / 1000)


def range_without_family(figure: Published, counts: dict[Published, float]) -> tuple[float, float]:
    """Return the range of a figure's count, from the errors of the other families of its part."""
    others = [other for other in evaluated(figure.part) if other.family != figure.family]
    low, high = interval(other.deviation(counts[other]) for other in others)
    return counts[figure] * (1 + low), counts[figure] * (1 + high)


def mean_and_worst(errors: Sequence[float]) -> tuple[float, float]:
    """Return the mean and the greatest error, without signs."""
    return sum(map(abs, errors)) / len(errors), max(map(abs, errors))


def lines(counts: dict[Published, float]) -> Iterator[str]:
    """Yield the lines of the page: a summary by part, and a table of all figures."""
    yield "| part | code | figures | mean error | worst | figures that chose no rule | mean error | worst | inside |"
    yield "| --- | --- | --: | --: | --: | --: | --: | --: | --: |"
    for part in dict.fromkeys(figure.part for figure in figures()):
        for is_assembly in (True, False):
            group = [
                figure
                for figure in figures()
                if figure.part == part and figure.is_assembly == is_assembly and not figure.unclear
            ]
            if group:
                yield _summary(part, "assembly" if is_assembly else "compiled", group, counts)
    for part in dict.fromkeys(figure.part for figure in figures()):
        yield f"\n### {part}\n"
        yield "| function | published | counted | error | range | | source |"
        yield "| --- | --: | --: | --: | --: | --- | --- |"
        for figure in figures():
            if figure.part == part:
                yield _row(figure, counts)


def _summary(part: str, kind: str, group: list[Published], counts: dict[Published, float]) -> str:
    held_out = [figure for figure in group if not figure.chose_rules]
    cells = []
    for chosen in (group, held_out):
        errors = [figure.error(counts[figure]) for figure in chosen]
        cells += [str(len(chosen)), *(map(_percent, mean_and_worst(errors)) if errors else ("", ""))]
    inside = sum(is_inside(figure, counts) for figure in group if has_range(figure))
    total = sum(map(has_range, group))
    return f"| {part} | {kind} | {' | '.join(cells)} | {f'{100 * inside / total:.0f} %' if total else ''} |"


def has_range(figure: Published) -> bool:
    """Return whether enough other families were measured on a figure's part."""
    families = {other.family for other in evaluated(figure.part)} - {figure.family}
    return len(families) >= FEWEST_FAMILIES and not figure.unclear


def is_inside(figure: Published, counts: dict[Published, float]) -> bool:
    """Return whether the published cycles are in the range of their count."""
    low, high = range_without_family(figure, counts)
    return low <= figure.net <= high


def _row(figure: Published, counts: dict[Published, float]) -> str:
    band, verdict = "", ""
    if figure.unclear:
        verdict = "not evaluated"
    elif has_range(figure):
        band = " to ".join(map(_number, range_without_family(figure, counts)))
        verdict = "inside" if is_inside(figure, counts) else "**outside**"
    kind = "" if figure.is_assembly else ", compiled"
    choice = "" if figure.chose_rules else ", chose no rule"
    counted = counts[figure]
    return (
        f"| {figure.name} | {_number(figure.cycles)} | {_number(counted + figure.reading)} | "
        f"{100 * figure.error(counted):+.2f} % | {band} | {verdict} | {figure.source}{kind}{choice} |"
    )


def _number(cycles: float) -> str:
    decimals = 0 if cycles >= 1000 or cycles == int(cycles) else 1
    return f"{cycles:,.{decimals}f}".replace(",", " ")


def _percent(part: float) -> str:
    return f"{100 * part:.2f} %"


def count_all(chosen: Sequence[Published] | None = None) -> dict[Published, float]:
    """Count figures on all cores."""
    chosen = figures() if chosen is None else chosen
    for figure in chosen:
        foreign_elf(figure.elf)  # skips the test here: a worker cannot
    with ProcessPoolExecutor() as workers:
        return dict(zip(chosen, workers.map(count, chosen), strict=True))


def versions() -> Iterator[str]:
    """Yield a table of the versions' errors where no memory waits: hand-written assembly with its data in SRAM1."""
    in_sram1 = ("ipa", "mms", "aes")
    chosen = [
        figure
        for figure in evaluated("stm32f407")
        if figure.family in in_sram1 and not figure.elf.startswith("ipa_dilithium5")
    ]
    yield "| version | mean error | worst |"
    yield "| --- | --: | --: |"
    for version in VERSIONS:
        errors = [figure.error(count(figure, version)) for figure in chosen]
        mean, worst = mean_and_worst(errors)
        yield f"| {load_profile(version).name} | {_percent(mean)} | {_percent(worst)} |"


def part_errors(part: str, counts: dict[Published, float]) -> tuple[int, int]:
    """Return the interval of all deviations of a part, in thousandths, as its file has it."""
    low, high = interval(figure.deviation(counts[figure]) for figure in evaluated(part))
    return round(1000 * low), round(1000 * high)


def main() -> int:
    """Print the tables, and write them into the page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--page", type=Path, help="write the tables into this page")
    arguments = parser.parse_args()
    try:
        for figure in figures():
            foreign_elf(figure.elf)
    except pytest.skip.Exception as missing:
        print(missing)
        return 1
    counts = count_all()
    tables = {"figures": "\n".join(lines(counts)), "versions": "\n".join(versions())}
    for name, table in tables.items():
        print(f"{name}\n{table}\n")
    for part in ("stm32f407", "stm32l4r5"):
        print(f"{load_part(part).name}: permille = {list(part_errors(part, counts))}")
    if arguments.page:
        text = arguments.page.read_text(encoding="utf-8")
        for name, table in tables.items():
            head, _, rest = text.partition(f"<!-- {name} -->\n")
            _, _, tail = rest.partition(f"<!-- end of {name} -->")
            text = f"{head}<!-- {name} -->\n{table}\n<!-- end of {name} -->{tail}"
        arguments.page.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
