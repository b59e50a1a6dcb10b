"""Poses tell known bugs apart by the headings that the bugs answer there."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product

import numpy as np
import pytest

from hiltest.measurement import Limit
from hiltest.orientation.angles import Pose
from hiltest.report.overview import provenance
from hiltest.run_record.run import Column, Findings, Run, Table
from hiltest.verdict.exposed_causes import LEAST_SIGMAS, cause_pairs, noise_of_limits, poses_in
from hiltest.verdict.verdict import decide

FIELD_UT = (22.8, 0.0, 42.8)
LEVEL = [Pose(heading) for heading in range(0, 360, 30)]
SINGLE = [Pose(heading, *tilt) for tilt, heading in product([(0, 0), (20, 0), (0, 20)], range(0, 360, 30))]
BOTH = [Pose(heading, *tilt) for tilt, heading in product([(0, 0), (20, 25), (-25, -15)], range(0, 360, 30))]


def test_tilts_about_both_axes_tell_all_pairs_apart() -> None:
    assert cause_pairs(poses_in(BOTH, FIELD_UT, 0.45))[0].sigmas > LEAST_SIGMAS


def test_tilts_about_single_axes_hide_the_rotation_order_and_the_arcsine() -> None:
    pairs = cause_pairs(poses_in(SINGLE, FIELD_UT, 0.45))
    hidden = {pair.other for pair in pairs if pair.one == "no bug" and pair.sigmas < LEAST_SIGMAS}
    assert {"rotation order: pitch before roll", "arcsine for roll"} <= hidden


def test_causes_with_the_same_headings_in_every_attitude_are_no_pair() -> None:
    swapped = {"swapped arguments of atan2", "headings counted the other way from east"}
    assert not [pair for pair in cause_pairs(poses_in(LEVEL, FIELD_UT, 0.45)) if {pair.one, pair.other} == swapped]


def test_distances_count_standard_deviations_of_the_noise_over_all_poses() -> None:
    def distance(attitudes: list[Pose], noise_deg: float) -> float:
        pairs = cause_pairs(poses_in(attitudes, FIELD_UT, noise_deg))
        (sigmas,) = (
            pair.sigmas for pair in pairs if (pair.one, pair.other) == ("no bug", "headings counted from east")
        )
        return sigmas

    assert distance(LEVEL, 0.5) == pytest.approx(np.sqrt(12) * 90.0 / 0.5)
    assert distance(LEVEL + SINGLE[12:], 0.25) == pytest.approx(np.sqrt(36) * 90.0 / 0.25)


def test_the_noise_follows_from_the_smallest_limit_of_a_largest_heading_error() -> None:
    limits = {
        "heading.direct.max": Limit(max=1.8),
        "heading.dpi.max": Limit(max=2.0),
        "heading.direct.rms": Limit(max=0.7),
    }
    assert noise_of_limits(limits) == pytest.approx(0.45)
    assert noise_of_limits({"heading.uncalibrated.max": Limit(min=90.0)}) == pytest.approx(0.5)


@pytest.mark.parametrize(("attitudes", "is_hidden"), [(LEVEL, True), (SINGLE, False), (BOTH, False)])
def test_a_report_names_the_bugs_that_its_poses_hide(
    attitudes: list[Pose], is_hidden: bool, findings: Callable[..., Findings]
) -> None:
    poses = poses_in(attitudes, FIELD_UT, 0.45)
    columns = tuple(
        Column(f"{vector}_{axis}", unit) for vector, unit in (("field", "uT"), ("gravity", "g")) for axis in "xyz"
    )
    collected = findings()
    collected.tables["heading.known"] = Table(
        "heading.known", columns, tuple(map(tuple, np.hstack([poses.field_ut, poses.gravity_g]).tolist()))
    )
    run: Run = collected.finish(decide(collected, pytest_exit=0), "2026-01-02T03:05:00Z")
    assert ("no tilt compensation" in dict(provenance(run)).get("bugs that these poses do not show", "")) is is_hidden
