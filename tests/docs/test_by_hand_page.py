"""The page about boards that are turned by hand: its questions, answers, rule and verdicts are the program's."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

from hiltest.measurement import Limit, check
from hiltest.orientation.angles import Pose
from hiltest.procedures.hand_poses import BEGINS_ANEW, Wish, question_of, wish_of
from hiltest.rig.bench_files import shipped
from hiltest.rig.rig_file import load_rig
from hiltest.verdict.verdict import decide

from ..written_run import board, findings

__all__ = ["board", "findings"]

PAGE = (Path(__file__).parents[2] / "docs" / "by-hand.md").read_text(encoding="utf-8")
SESSION, _, COMPASS, VERDICT = re.findall(r"^```text\n(.*?)^```", PAGE, re.M | re.S)
RIG = load_rig(shipped() / "rigs" / "frdm-k64f.toml")


def test_the_questions_are_those_that_are_asked() -> None:
    for number, heading_deg in enumerate((0.0, 90.0, 180.0)):
        assert question_of(number, Pose(heading_deg)) in SESSION
        assert question_of(number, Pose(heading_deg)) in COMPASS
    assert COMPASS.startswith(BEGINS_ANEW)


def test_every_wish_is_in_the_table_and_no_other() -> None:
    rows = re.findall(r"^\| `(\w)`, `(\w+)` \|", PAGE, re.M)
    assert [wish_of(letter) for letter, _ in rows] == [wish_of(word) for _, word in rows] == list(Wish)


def test_the_uncertainty_that_the_page_works_out_is_the_shipped_rigs() -> None:
    table = re.findall(r"^```toml\n(.*?)^```", PAGE, re.M | re.S)[-1]
    shown = tomllib.loads(table)
    assert shown["mounting"]["uncertainty_deg"] == RIG.mounting.uncertainty_deg if RIG.mounting else False
    assert shown["turntable"] == {"kind": RIG.turntable.kind, "uncertainty_deg": RIG.turntable.uncertainty_deg}
    whole, centred = (RIG.guard_band_deg(f"heading.direct.{statistic}") for statistic in ("max", "max_centred"))
    assert f"U = {whole:.2f} degrees here, and {centred:g} for a centred error" in PAGE
    affected = PAGE[PAGE.index("The uncertainty affects") : PAGE.index("A simulated table")]
    for statistic in re.findall(r"`(?:heading\.\*)?\.(\w+)`", affected):
        assert RIG.guard_band_deg(f"heading.direct.{statistic}")


def test_the_verdict_reads_as_the_page_has_it(findings) -> None:  # type: ignore[no-untyped-def]
    near = check(
        "heading.direct.max", 1.62, unit="deg", limit=Limit(max=2), uncertainty=RIG.guard_band_deg("heading.direct.max")
    )
    assert decide(findings(near, tables=False), pytest_exit=0).sentence.startswith(VERDICT.strip())


ROWS = re.findall(r"^\| [^|\n]+ \| (\d\S*) \| ([a-z ]+) \| (\S+) \| ([a-z ]+) \|$", PAGE, re.M)


@pytest.mark.parametrize("row", ROWS)
def test_the_verdicts_follow_from_the_values_beside_them(row: tuple[str, ...]) -> None:
    for value, verdict in (row[:2], row[2:]):
        result = check("heading.direct.max", float(value), unit="deg", limit=Limit(max=2), uncertainty=1.0)
        assert str(result.outcome) == verdict
