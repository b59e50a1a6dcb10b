"""The page of a fitted cloud: what it says, what it draws, and that nothing in it can be more than text."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from hiltest.log_fitting import FieldUnit, Samples
from hiltest.log_fitting.sample_fit import ALL, fit_on_host
from hiltest.log_fitting.sample_fit_page import fit_page
from hiltest.log_fitting.sample_fit_table import figure_tables
from hiltest.procedures.golden_points import golden_points

from ..calibration.hand_turned import TRUTH, hand_turned
from ..instances import instance
from .indoor_walk import indoor_walk


def _page(points: np.ndarray, name: str = "cloud.csv") -> str:
    cloud = Samples(Path(name), points, FieldUnit.UT, "option", ("x", "y", "z"), 0)
    return fit_page(fit_on_host(cloud), cloud)


def _titles(page: str) -> list[str]:
    # The page keeps a number and its % on one line.
    return [match.replace("\N{NO-BREAK SPACE}", " ") for match in re.findall(r"<figcaption>([^<]*)", page)]


def test_the_page_shows_verdict_figures_and_the_cloud_before_and_after() -> None:
    page = _page(golden_points(300) / 10.0)
    assert "<strong>good</strong></h1>" in page
    assert re.fullmatch("as read, with (corrected|direct|iterative)", ", ".join(_titles(page)[:2]))
    assert _titles(page)[2:] == [
        "heading error, level, at a dip of 60°",
        "length of the corrected readings",
        "coverage: 100 % of the sphere",
    ]
    # The cloud before and after, in time and on the map, a dot a point.
    assert page.count("h0") == 4 * 300


def test_half_a_cloud_shows_its_hole() -> None:
    points = golden_points(600) / 10.0
    half = points[points[:, 2] > np.median(points[:, 2])]
    page = _page(half)
    (covered,) = re.findall(r"coverage: (\d+) % of the sphere", "".join(_titles(page)))
    # 300 points inside the edge of a half: 47 % by the tests of the coverage; 5 are the fit's own error.
    assert int(covered) == pytest.approx(47, abs=5)
    assert 'class="uncovered"' in page
    assert re.search(r"largest hole about -z, radius \d\d°", "".join(_titles(page)))
    assert "<strong>fair</strong></h1>" in page


def test_left_out_readings_are_marked_and_stretch_no_drawing() -> None:
    points = golden_points(300) / 10.0
    clean = _page(points)
    points[[100, 101]] = (70.0, 1.0, 0.0), (9000.0, 0.0, 0.0)
    page = _page(points)
    assert "left out" not in clean
    # The near one before and after, both over the order of the file; and once in each drawing's key.
    assert page.count('class="mark series-3 hollow"') == 4 + 3
    assert page.count("h0") == 4 * 298


def test_a_cloud_without_a_calibration_is_still_drawn() -> None:
    page = _page(golden_points(100)[:5] / 10.0)
    assert _titles(page) == ["as read"]
    assert "<strong>refused</strong></h1>" in page


def test_many_points_are_drawn_as_fewer() -> None:
    assert len(_page(np.repeat(golden_points(500), 40, axis=0) / 10.0)) < 400_000


@pytest.mark.parametrize("points", [np.zeros((3, 3)), np.full((20, 3), 1e9), golden_points(50) / 10.0 + 1e6])
def test_clouds_of_no_size_and_far_away_are_drawn_too(points: np.ndarray) -> None:
    assert "nan" not in _page(points)


def test_names_in_the_page_are_text() -> None:
    page = _page(golden_points(50) / 10.0, "<script>alert(1)</script>.csv")
    assert page.count("<script") == 1  # its own
    assert "&lt;script&gt;" in page


def test_a_turn_in_a_plane_has_no_map_of_the_sphere() -> None:
    turn = np.linspace(0.0, 6.0, 200)
    page = _page(np.column_stack([20.0 * np.cos(turn), 20.0 * np.sin(turn), np.full(200, 40.0)]))
    assert _titles(page)[1:] == ["with circle", "length of the corrected readings"]


def test_each_block_of_the_log_has_its_mean_over_time() -> None:
    points = golden_points(400) / 10.0
    points[:50] *= 1.02  # the first of 8 blocks is 2 % longer than the others
    page = _page(points)
    levels = [float(match) for match in re.findall(r'class="end" d="M[\d.]+ ([\d.]+)L', page)]
    assert len(levels) == 8
    assert min(levels) == levels[0]
    assert levels[0] < min(levels[1:]) - 5.0


def test_each_reason_is_told_once() -> None:
    page = _page(instance(1, 400, noise_ut=2.0, stretch=0.03, covered=(1, 1)).points_counts / 10.0)
    assert page.count("a single reading") == 1


def test_the_picture_shows_the_hole_and_the_readings_after_a_change() -> None:
    points = hand_turned(3, 1200)
    points[840:] += (0.0, 0.0, 2.0)
    rows = np.flatnonzero((points - TRUTH.hard_iron)[:, 0] < 25.0)
    page = _page(points[rows])
    assert re.search(r"largest hole, \d\d° about \+x", page)
    later = sum(path.count("h0") for path in re.findall(r'class="samples[ far]* later" d="([^"]*)"', page))
    # Each is drawn twice; the step is located to two blocks of 80.
    assert later / 2 == pytest.approx((rows >= 840).sum(), abs=2 * len(rows) / 80)


def test_a_refused_calibration_has_no_heading_error() -> None:
    refused = _page(indoor_walk(1))
    assert not any("heading error" in title for title in _titles(refused))
    ball = np.random.default_rng(1).normal((20.0, 3.0, -40.0), 0.3, (300, 3))
    page = _page(ball)
    assert "cloud.csv: refused, use no calibration from this log: the sensor was at rest." in page


def test_many_calibrators_stand_in_tables_that_fit_a_page() -> None:
    cloud = Samples(Path("cloud.csv"), golden_points(100) / 10.0, FieldUnit.UT, "option", ("x", "y", "z"), 0)
    fit = fit_on_host(cloud, ALL)
    tables = figure_tables(fit)
    names = [fit.name for table in tables for fit in table.fits]
    assert names == [*(calibrator.name for calibrator in fit.calibrators), "as read"]
    assert max(len(table.fits) for table in tables) <= 5
    assert all(len(cells) == len(table.fits) for table in tables for _, cells in table.rows)
