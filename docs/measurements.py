"""Write docs/measurements.md anew from the catalogue and the default rig: ``python docs/measurements.py``."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import groupby
from pathlib import Path

from hiltest.measurement import KINDS, NEXT_STEP, Allowance, Better, Kind, Limit, Section, identify
from hiltest.measurement.deviations import DEVIATIONS
from hiltest.rig.bench_files import shipped
from hiltest.rig.rig_file import load_rig
from hiltest.text import format_number

PAGE = Path(__file__).with_suffix(".md")

HEAD = """\
# Measurements

This page lists every kind of measurement of hiltest. The subject of a measurement is in braces:
`heading.{calibrator}.max` is `heading.direct.max` for the calibrator `direct`. `python docs/measurements.py` writes the
page from [the catalogue](../src/hiltest/measurement/measurements.toml), the only source of these facts, and
from the limits of [the default rig](../hil/rigs/virtual-k64f.toml).

- **Better** is the direction of an improvement: lower, higher, or nearer zero. If it is empty, no direction is better.
- **Limit** is that of the default rig. Your own rig states limits for these names and for any other measurement of your
  tests: [rigs.md](rigs.md).
- **Tolerance** is the largest change of a measurement that counts as unchanged in a comparison; if there are two, the
  larger one counts. *Exact* means that any change counts.
- **Deviation** is the standard deviation of a measurement over seeds of the default rig, for each subject, which is the
  effect of noise. On a real board, whose runs have different noise, it replaces the tolerance, unless the deviation of
  the bench itself is known: [compare.md](compare.md#on-a-real-board).
- The text above each table is the **next step** for a measurement outside its limit, if the run shows no cause. A known
  cause has its own next step: [gate.md](gate.md#the-likely-cause).
"""

_BETTER = {Better.LOWER: "lower", Better.HIGHER: "higher", Better.NEARER_ZERO: "nearer zero", Better.NEITHER: ""}


def page() -> str:
    """Return the text of the page."""
    limits = load_rig(shipped() / "rigs" / "virtual-k64f.toml").limits
    order = list(Section)
    kinds = sorted(KINDS.values(), key=lambda kind: order.index(kind.section))
    return (
        "\n".join(
            [
                HEAD,
                *(
                    line
                    for section, members in groupby(kinds, key=lambda kind: kind.section)
                    for line in _section(section, list(members), limits)
                ),
            ]
        )
        + "\n"
    )


def _section(section: Section, kinds: list[Kind], limits: dict[str, Limit]) -> Iterator[str]:
    yield from (f"## {section}", "", f"Next step for a measurement outside its limit: {NEXT_STEP[section]}", "")
    others = groupby(sorted((kind for kind in kinds if kind.next_step), key=lambda kind: kind.next_step), _step)
    for step, members in others:
        yield f"- {', '.join(f'`{member.name}`' for member in members)}: {step}"
    yield from [""] * any(kind.next_step for kind in kinds)
    yield "| measurement | unit | better | meaning | limit | tolerance | reason | deviation |"
    yield "| --- | --- | --- | --- | --- | --- | --- | --- |"
    for kind in kinds:
        cells = [
            f"`{kind.name}`",
            kind.unit or "",
            _BETTER[kind.better],
            kind.meaning,
            _limits(kind, limits),
            _tolerances(kind),
            kind.allowance.reason,
            _deviations(kind),
        ]
        yield f"| {' | '.join(cells)} |"
    yield ""


def _step(kind: Kind) -> str:
    return kind.next_step


def _limits(kind: Kind, limits: dict[str, Limit]) -> str:
    """Return the rig's limits, by subject where there is one."""
    found = [(identify(name).subject, limit) for name, limit in limits.items() if identify(name).kind is kind]
    return "; ".join(f"{subject}: {limit}" if subject else str(limit) for subject, limit in found)


def _deviations(kind: Kind) -> str:
    """Return what noise moves, by subject where there is one."""
    named = {name: identify(name) for name, deviation in DEVIATIONS.items() if deviation.value}
    found = [(each.subject, DEVIATIONS[name].value) for name, each in named.items() if each.kind is kind]
    return "; ".join(
        f"{subject}: {format_number(value, 3)}" if subject else format_number(value, 3) for subject, value in found
    )


def _tolerances(kind: Kind) -> str:
    others = [f"{subject}: {_tolerance(each, kind)}" for subject, each in kind.subjects.items()]
    return "; ".join([_tolerance(kind.allowance, kind), *others]) if kind.compared else "not compared"


def _tolerance(allowance: Allowance, kind: Kind) -> str:
    absolute, relative = allowance.tolerance.absolute, allowance.tolerance.relative
    size = f"{format_number(absolute)} {kind.unit or ''}".rstrip() if absolute else ""
    share = f"{100 * relative:g} %" if relative else ""
    return " and ".join(filter(None, (size, share))) or "exact"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
