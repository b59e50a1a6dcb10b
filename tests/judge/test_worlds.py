"""Worlds of `hiltest judge`: the same on every host, with a truth that has no error and a bound that is one."""

from __future__ import annotations

import hashlib
from statistics import median

import numpy as np
import pytest

from hiltest.calibration import REFERENCES
from hiltest.calibration.quality import COUNTS_PER_UT
from hiltest.judge.worlds import (
    DEFAULT_CLOUDS,
    FAMILIES,
    RESOLUTION_UT,
    WORLDS,
    Family,
    World,
    draw_world,
    draw_worlds,
)
from hiltest.rig.bench_files import shipped
from hiltest.verdict.baseline_file import read_baseline

FAMILY = pytest.mark.parametrize("family", FAMILIES, ids=lambda family: family.name)
# Digests of the samples of the last world of each family, in counts.
DIGESTS = {
    "rig": "b2423f2b15607ad3",
    "noise": "ecf3e5437c418fe3",
    "coverage": "3e8617e615006ab7",
    "soft-iron": "14cccc2cf41a64e2",
    "points": "4ecdb6a9781ee2ca",
    "half-sphere": "87128532adee20be",
}


def rms(errors: np.ndarray) -> float:
    return float(np.sqrt(np.mean(errors**2)))


def fit_errors(world: World, name: str = "geometric") -> np.ndarray:
    fit = REFERENCES[name](world.samples_ut * COUNTS_PER_UT)
    return world.poses.heading_errors_deg(fit.soft_iron, fit.hard_iron / COUNTS_PER_UT, world.clean_readings_ut)


@FAMILY
def test_a_world_is_the_same_on_every_host(family: Family) -> None:
    world = draw_world(family, WORLDS - 1)
    counts = np.rint(world.samples_ut / RESOLUTION_UT).astype("<i8")
    assert hashlib.sha256(counts.tobytes()).hexdigest()[:16] == DIGESTS[family.name]


@FAMILY
@pytest.mark.parametrize("number", [0, 57, WORLDS - 1])
def test_the_true_calibration_has_no_heading_error(family: Family, number: int) -> None:
    world = draw_world(family, number)
    truth = np.linalg.inv(world.soft_iron)
    errors = world.poses.heading_errors_deg(truth, world.hard_iron_ut, world.clean_readings_ut)
    assert np.abs(errors).max() < 1e-9  # float64
    # The scale is free.
    assert np.abs(world.poses.heading_errors_deg(3.0 * truth, world.hard_iron_ut, world.clean_readings_ut)).max() < 1e-9


def test_an_efficient_calibrator_reaches_the_bound_and_none_is_below_it() -> None:
    worlds = list(draw_worlds(FAMILIES[0]))
    errors = np.array([rms(fit_errors(world)) for world in worlds])
    ratio = rms(errors) / rms(np.array([world.bound_deg for world in worlds]))
    # The mean square of 100 worlds with nine unknowns scatters by at most sqrt(2 / 100), its root by 7 %: three of it.
    assert ratio == pytest.approx(1.0, abs=0.21)


def test_directs_worst_headings_on_the_rig_are_those_of_whole_runs() -> None:
    worlds = list(draw_worlds(FAMILIES[0]))
    worst = []
    for world in worlds:
        fit = REFERENCES["direct"](world.samples_ut * COUNTS_PER_UT)
        errors = world.poses.heading_errors_deg(fit.soft_iron, fit.hard_iron / COUNTS_PER_UT, world.readings_ut)
        worst.append(float(np.abs(errors).max()))
    baseline = read_baseline(shipped() / "baselines" / "seeds-1-100.json")
    row = next(row for row in baseline.measurements if row.name == "heading.direct.max")
    of_runs = median(float(value) for value in row.values if value is not None)
    # Medians of 100 values each with a deviation of 0.22 deg: 1.25 x 0.22 x sqrt(2 / 100) is 0.04 deg.
    assert median(worst) == pytest.approx(of_runs, abs=3 * 0.04)


def test_each_family_varies_what_its_title_says() -> None:
    noise, coverage, soft_iron, points, half = (
        [draw_world(family, number) for number in (0, WORLDS - 1)] for family in FAMILIES[1:]
    )
    assert [round(world.noise_ut, 1) for world in noise] == [0.2, 5.0]
    assert [len(world.samples_ut) for world in points] == [12, 1000]
    gaps = []
    for world in (*coverage, *half):
        directions = np.linalg.solve(world.soft_iron, (world.samples_ut - world.hard_iron_ut).T).T
        gaps.append(0.5 * (1.0 - (directions[:, 0] / np.linalg.norm(directions, axis=1)).max()))
    assert gaps[0] < 0.02  # of a hundred points
    assert gaps[1:] == pytest.approx([0.7, 0.5, 0.5], abs=0.02)
    gains = [np.linalg.eigvalsh(draw_world(FAMILIES[3], number).soft_iron) for number in range(WORLDS)]
    assert 0.8 <= np.min(gains) < 0.83
    assert 1.17 < np.max(gains) <= 1.2
    assert len(soft_iron[0].samples_ut) == 100


def test_the_second_default_cloud_ranks_fits_that_are_equal_in_the_first() -> None:
    errors = {
        (family.name, name): rms(np.array([rms(fit_errors(world, name)) for world in draw_worlds(family)]))
        for family in FAMILIES
        if family.name in DEFAULT_CLOUDS
        for name in ("direct", "corrected", "iterative")
    }
    rig, half = (
        {name: errors[cloud, name] for name in ("direct", "corrected", "iterative")} for cloud in DEFAULT_CLOUDS
    )
    assert max(rig.values()) < 1.02 * min(rig.values())
    # Each step is at least five deviations: 100 errors scatter by 7 % of their root mean square.
    assert half["corrected"] < 0.75 * half["iterative"]
    assert half["iterative"] < 0.75 * half["direct"]


@FAMILY
def test_accelerations_make_the_dip_of_the_rig_with_the_field(family: Family) -> None:
    world = draw_world(family, 40)
    directions = np.linalg.solve(world.soft_iron, (world.samples_ut - world.hard_iron_ut).T).T
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    sine = np.einsum("ij,ij->i", directions, world.accelerations_g)
    # Noise of 0.4 uT in 48.5 turns a direction by 8 mrad; the mean over the points has a tenth of that.
    assert float(np.mean(sine)) == pytest.approx(np.sin(np.radians(62.0)), abs=0.01)
