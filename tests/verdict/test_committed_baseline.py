"""The baseline that is committed is of the firmware and the rig that are."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import hiltest
from hiltest.measurement import identify
from hiltest.rig.rig import conditions_sha256
from hiltest.rig.rig_file import load_rig
from hiltest.verdict.baseline_file import read_baseline
from hiltest.verdict.compare import compare
from hiltest.verdict.evidence_reader import read_evidence

HIL = Path(__file__).parents[2] / "hil"
FILE = HIL / "baselines" / "virtual-k64f.json"
RENEW = "renew hil/baselines/virtual-k64f.json with `tox -e baseline`, and read its diff"


def test_it_is_of_the_shipped_firmware() -> None:
    manifest = json.loads((Path(hiltest.__file__).parent / "firmware" / "manifest.json").read_text(encoding="utf-8"))
    assert read_baseline(FILE).side.build_id == manifest["build_id"], f"the firmware has changed: {RENEW}"


def test_it_is_of_the_default_rig() -> None:
    rig = load_rig(HIL / "rigs" / "virtual-k64f.toml")
    assert read_baseline(FILE).conditions.rig_sha256 == conditions_sha256(rig), f"the rig has changed: {RENEW}"


def test_it_is_of_eight_seeds_and_the_gate_set() -> None:
    baseline = read_baseline(FILE)
    assert baseline.seeds == tuple(range(1, 9))
    assert baseline.conditions.suite == "gate"
    assert len(baseline.measurements) > 140
    assert [row.name for row in baseline.measurements if identify(row.name).kind is None] == []


def test_a_run_today_has_nothing_worse(changed: Callable[..., Path]) -> None:
    comparison = compare(read_evidence(FILE), read_evidence(changed("today")))
    assert comparison.evaluated, f"{comparison.sentence} {RENEW}"
    assert not comparison.regression, comparison.sentence


def test_all_of_it_was_within_the_limits() -> None:
    assert [row.name for row in read_baseline(FILE).measurements if row.failed] == []
