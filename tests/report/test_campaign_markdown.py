"""The page of a campaign: one for all seeds, with those that did not pass before the rest."""

from __future__ import annotations

import re

from hiltest.report.campaign_markdown import SeedLine, Spread, campaign_markdown
from hiltest.run_record.run import Verdict

from .comparisons import comparison

HOSTILE = "<script>|`"
SEEDS = [SeedLine(1, 0, "PASS."), SeedLine(2, 1, "FAIL: 2.1 deg."), SeedLine(3, 20, HOSTILE)]
SPREADS = [
    Spread("heading.direct.max", "deg", 3, 0.5, 0.9, 2.1, (2,)),
    Spread("tumble.points", "", 3, 300, 300, 300, ()),
]


def verdict(outcome: str, sentence: str) -> Verdict:
    return Verdict(outcome, 0, sentence, complete=True)


def unfolded(page: str) -> str:
    return re.sub(r"<details>.*?</details>", "", page, flags=re.S)


def test_verdict_comparison_and_what_missed_come_before_the_rest() -> None:
    page = campaign_markdown(verdict("fail", "1 of 3 seeds pass: FAIL."), SEEDS, SPREADS, comparison())
    observed = unfolded(page)
    assert observed.startswith("# FAIL\n\n1 of 3 seeds pass: FAIL.\n")
    assert "| worse | cycles.direct.total | 11 061 cycle |" in observed
    assert "| 2 | 1 | FAIL: 2.1 deg. |" in observed
    assert "| heading.direct.max | 3 | 0.5 | 0.9 | 2.1 | deg | 2 |" in observed
    assert "| 1 | 0 | PASS. |" not in observed
    assert "tumble.points" not in observed
    assert "| 1 | 0 | PASS. |" in page
    assert "| tumble.points | 3 | 300 | 300 | 300 |  |  |" in page


def test_a_green_campaign_names_no_seed() -> None:
    page = campaign_markdown(verdict("pass", "3 of 3 seeds pass: PASS."), [SeedLine(1, 0, "PASS.")], [], None)
    assert unfolded(page).split() == ["#", "PASS", "3", "of", "3", "seeds", "pass:", "PASS."]


def test_the_models_that_counted_cycles_stand_under_the_verdict() -> None:
    spreads = [Spread("cycles.direct.total", "cycle", 3, 10, 10, 11, ())]
    page = campaign_markdown(verdict("pass", "PASS."), SEEDS[:1], spreads, None, ["", "m@sram", "m@flash", "m@sram"])
    assert "\n\ncycles counted by m@flash and m@sram\n" in unfolded(page)
    assert "counted by" not in campaign_markdown(verdict("pass", "PASS."), SEEDS[:1], SPREADS, None, [""])


def test_what_a_seed_wrote_stays_text() -> None:
    page = campaign_markdown(verdict(HOSTILE, HOSTILE), SEEDS, SPREADS, None)
    assert "<script" not in page.replace("\\<script", "")
