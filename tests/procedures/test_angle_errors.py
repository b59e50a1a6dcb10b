"""Limits that angles set by hand leave out of reach: which ones are named before the first question."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hiltest.measurement import Limit
from hiltest.procedures.angle_errors import angle_errors_deg, limits_out_of_reach
from hiltest.procedures.heading_statistics import summarise
from hiltest.rig import Rig
from hiltest.rig.bench_files import shipped
from hiltest.rig.rig_file import load_rig

PAGE = (Path(__file__).parents[2] / "docs" / "by-hand.md").read_text(encoding="utf-8")
RIG = load_rig(shipped() / "rigs" / "frdm-k64f.toml")
POSES = RIG.procedure.known_angle_poses()
HEADINGS_DEG = [pose.heading_deg for pose in POSES]


def by_hand(uncertainty_deg: float, **limits: float) -> Rig:
    turntable = replace(RIG.turntable, uncertainty_deg=uncertainty_deg)
    own = {f"heading.direct.{statistic}": Limit(max=limit_deg) for statistic, limit_deg in limits.items()}
    return replace(RIG, turntable=turntable, limits=own or RIG.limits)


def share_that_passes(rig: Rig, statistic: str) -> float:
    """Return the share of runs in which a perfect compass meets a limit with its U, by other draws."""
    draws, name = np.random.default_rng(7), f"heading.direct.{statistic}"
    errors_deg = draws.normal(0.0, rig.turntable.uncertainty_deg / 2.0, (1000, len(POSES)))
    errors_deg += draws.normal(0.0, rig.mounting.uncertainty_deg / 2.0 if rig.mounting else 0.0, (1000, 1))
    values = [getattr(summarise(errors, HEADINGS_DEG), f"{statistic}_deg") for errors in errors_deg]
    return float(np.mean([rig.limits[name].is_met(value, rig.guard_band_deg(name) or 0.0) is True for value in values]))


def test_the_limits_of_the_shipped_rig_are_in_reach_of_its_angles_and_some_are_not_of_a_protractor() -> None:
    assert limits_out_of_reach(RIG, POSES) == ""
    named = re.findall(
        r"^heading\.direct\.(\w+)\b.* deg with U (\S+): ", limits_out_of_reach(by_hand(1.0), POSES), re.M
    )
    assert named == [("max", "1.1"), ("rms", "1.1"), ("bias", "1.1"), ("max_centred", "1")]


@pytest.mark.parametrize("statistic", ["max", "rms", "max_centred"])
def test_the_limit_and_the_uncertainty_that_are_named_are_those_that_half_of_all_runs_meet(statistic: str) -> None:
    rig = by_hand(1.0, **{statistic: 1.2})
    text = limits_out_of_reach(rig, POSES)
    limit, uncertainty = map(float, re.findall(r"raise it above (\S+), or lower U below (\S+)\.$", text, re.M)[0])
    assert share_that_passes(rig, statistic) < 0.05
    assert 0.4 < share_that_passes(by_hand(1.0, **{statistic: limit}), statistic) < 0.9  # it is rounded up to a tenth
    scale = uncertainty / (rig.guard_band_deg(f"heading.direct.{statistic}") or 0.0)
    assert rig.mounting is not None
    better = replace(
        by_hand(scale, **{statistic: 1.2}),
        mounting=replace(rig.mounting, uncertainty_deg=scale * rig.mounting.uncertainty_deg),
    )
    assert share_that_passes(better, statistic) == pytest.approx(0.5, abs=0.12)


def test_nothing_is_named_for_motors_and_for_intervals_of_fewest_poses() -> None:
    for kind in ({"kind": "grbl", "port": "socket://127.0.0.1:6465"}, {"fewest_poses": True}):
        rig = by_hand(1.0)
        assert limits_out_of_reach(replace(rig, turntable=replace(rig.turntable, **kind)), POSES) == ""


def test_the_page_has_the_values_of_a_perfect_compass() -> None:
    rows = re.findall(r"^\| `\.(\w+)` \| [^|]+ \| (\S+) \| (\S+) \| (\S+) \| (\S+) \|$", PAGE, re.M)
    assert len(rows) == 4
    for statistic, *numbers in rows:
        for table_deg, (value, least) in zip((0.5, 1.0), (numbers[:2], numbers[2:]), strict=True):
            rig = by_hand(table_deg)
            assert angle_errors_deg(rig, POSES)[statistic] == pytest.approx(float(value), abs=0.006)
            uncertainty_deg = rig.guard_band_deg(f"heading.direct.{statistic}") or 0.0
            assert float(value) + uncertainty_deg == pytest.approx(float(least), abs=0.011)
