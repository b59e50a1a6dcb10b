"""Calibrators over recorded clouds, on the virtual board and on the host."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from scipy.ndimage import gaussian_filter1d

from hiltest.boards import Board
from hiltest.calibration import FASTER, FIRMWARE, FOR_COMPARISON, REFERENCES, FitStatus
from hiltest.calibration.acceptance import Acceptance
from hiltest.calibration.quality import sphere_directions
from hiltest.calibration.shapes import Shape
from hiltest.errors import ConfigError
from hiltest.log_fitting import FieldUnit, Samples, read_samples
from hiltest.log_fitting.fit_notes import notes
from hiltest.log_fitting.fit_result import SampleFit
from hiltest.log_fitting.sample_fit import ALL, fit_by_shape, fit_on_board, fit_on_host
from hiltest.log_fitting.sample_fit_table import print_fit
from hiltest.procedures.golden_points import golden_points

from ..calibration.hand_turned import hand_turned
from ..instances import instance
from ..interfaces.conftest import shared_data  # noqa: F401  # a fixture
from .indoor_walk import indoor_walk

_GOLDEN = sorted((Path(__file__).parents[2] / "fixtures" / "clouds").glob("*.json"))


def _cloud(points_ut: np.ndarray, unit: FieldUnit = FieldUnit.UT) -> Samples:
    return Samples(Path("cloud.csv"), np.asarray(points_ut, dtype=float), unit, "option", ("x", "y", "z"), 0)


def _drawn(seed: int, count: int, covered: float, noise_ut: float) -> Samples:
    drawn = instance(
        seed, count, noise_ut=noise_ut, stretch=0.03, largest_hard_iron_ut=100.0, covered=(covered, covered)
    )
    return _cloud(drawn.points_counts / 10.0)


def _verdicts(fit: SampleFit) -> dict[str, Acceptance]:
    """Return the verdicts of the two calibrators that firmware and host both have."""
    return {
        calibrator.name: calibrator.verdict
        for calibrator in fit.calibrators
        if calibrator.name in ("direct", "iterative")
    }


@pytest.mark.slow  # both, of 7 000 samples
@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("count", [361, 1000, 7000])
@pytest.mark.parametrize(
    ("covered", "noise_ut", "verdict"),
    [
        (1.0, 0.4, Acceptance.GOOD),
        (0.75, 0.4, Acceptance.GOOD),
        (0.55, 0.4, Acceptance.FAIR),
        (1.0, 2.0, Acceptance.POOR),
        (0.2, 0.4, Acceptance.REFUSED),
        (0.1, 0.1, Acceptance.REFUSED),
    ],
)
def test_the_board_s_verdict_is_that_of_the_whole_file_on_the_host(
    virtual_board: Board, seed: int, count: int, covered: float, noise_ut: float, verdict: Acceptance
) -> None:
    """Clouds whose figures are not at a threshold; one that is can fall on either side of it."""
    cloud = _drawn(seed, count, covered, noise_ut)
    chosen, whole = fit_on_board(virtual_board, cloud, any_shape=False), fit_on_host(cloud, any_shape=False)
    assert {calibrator.n_used for calibrator in chosen.calibrators} == {min(count, virtual_board.identity.max_points)}
    assert {calibrator.n_used for calibrator in whole.calibrators} == {count}
    assert _verdicts(chosen) == _verdicts(whole) == dict.fromkeys(["direct", "iterative"], verdict)


@pytest.mark.parametrize("path", _GOLDEN, ids=lambda path: path.stem)
def test_golden_clouds_get_the_same_verdict_and_reasons_on_both(virtual_board: Board, path: Path) -> None:
    points = np.array(json.loads(path.read_text(encoding="utf-8"))["points"], dtype=float)
    cloud = _cloud(points, FieldUnit.COUNTS)
    on_board, on_host = fit_on_board(virtual_board, cloud), fit_on_host(cloud)
    for reference in on_host.calibrators:
        (fitted,) = (calibrator for calibrator in on_board.calibrators if calibrator.name == reference.name)
        assert [reason.figure for reason in fitted.reasons] == [reason.figure for reason in reference.reasons]
        assert fitted.verdict is reference.verdict


def test_board_and_host_find_the_same_calibration(virtual_board: Board) -> None:
    cloud = _cloud(golden_points(300) / 10.0)
    on_host = {calibrator.name: calibrator for calibrator in fit_on_host(cloud).calibrators}
    for fitted in fit_on_board(virtual_board, cloud).calibrators:
        if fitted.name in on_host:
            reference = on_host[fitted.name]
            # float32 sums of 300 points: some 1e-5 of the radius; products of 16 bits, ten times that.
            rounding = 10.0 if fitted.name == "corrected" else 1.0
            np.testing.assert_allclose(fitted.hard_iron, reference.hard_iron, atol=1e-3 * rounding)
            np.testing.assert_allclose(fitted.soft_iron, reference.soft_iron, atol=2e-5 * rounding)
            assert fitted.cycles


def test_a_symmetric_distortion_is_found_in_the_unit_of_the_file() -> None:
    soft_iron = np.array([[1.05, 0.02, -0.01], [0.02, 0.97, 0.03], [-0.01, 0.03, 1.0]])
    hard_iron = np.array([0.3, -0.2, 0.45])
    readings = 0.5 * sphere_directions(200) @ soft_iron + hard_iron
    (direct,) = fit_on_host(_cloud(readings, FieldUnit.GAUSS), "direct").calibrators
    np.testing.assert_allclose(direct.hard_iron, hard_iron, atol=1e-9)
    scale = np.linalg.det(soft_iron) ** (1.0 / 3.0)
    np.testing.assert_allclose(direct.soft_iron, np.linalg.inv(soft_iron) * scale, atol=1e-9)
    assert direct.radius == pytest.approx(0.5 * scale, rel=1e-9)
    assert direct.axis_ratio == pytest.approx(np.linalg.cond(soft_iron), rel=1e-9)
    assert (direct.verdict, direct.coverage) == (Acceptance.GOOD, 1.0)


def test_a_sensor_at_rest_is_refused_whatever_the_unit() -> None:
    ball = np.random.default_rng(1).normal(size=(300, 3)) * 4.0 + (100.0, -200.0, 300.0)
    assert set(_verdicts(fit_on_host(_cloud(ball, FieldUnit.COUNTS))).values()) == {Acceptance.REFUSED}


def test_the_wrong_unit_is_refused_by_the_field_strength() -> None:
    fit = fit_on_host(_cloud(golden_points(100).astype(float), FieldUnit.UT), "direct")
    (reason,) = fit.best.reasons
    assert (reason.figure, reason.threshold, reason.verdict) == ("radius_ut", 70.0, Acceptance.REFUSED)
    assert (
        fit_on_host(_cloud(golden_points(100).astype(float), FieldUnit.COUNTS), "direct").best.verdict
        is Acceptance.GOOD
    )


@pytest.mark.parametrize(
    ("scale", "unit", "unit_from", "asked"),
    [
        (10.0, FieldUnit.UT, "header", "480 uT, and the earth's is 20 to 70 uT. Are these tenths of a microtesla"),
        (0.01, FieldUnit.UT, "option", "Are these gauss? use --unit gauss"),
        (1.0, FieldUnit.GAUSS, "header", "Are these uT?"),
        (1000.0, FieldUnit.UT, "header", "Are these nT?"),
        (1e-3, FieldUnit.UT, "header", "Are these mT?"),
        (1.0, FieldUnit.COUNTS, "assumed", "A strength of 48 would be the earth's in uT."),
        (0.01, FieldUnit.COUNTS, "assumed", "A strength of 0.48 would be the earth's in gauss."),
        (1.0, FieldUnit.UT, "header", None),
        (0.01, FieldUnit.GAUSS, "header", None),
        (1.0, FieldUnit.COUNTS, "header", None),
        (1.0, FieldUnit.COUNTS, "option", None),
        (10.0, FieldUnit.COUNTS, "assumed", "A strength of 480 would be the earth's in mG."),
        (3.0, FieldUnit.COUNTS, "assumed", None),
        (3.0, FieldUnit.UT, "header", None),
    ],
)
def test_a_strength_that_is_the_earth_s_in_another_unit_is_asked_about(
    scale: float, unit: FieldUnit, unit_from: str, asked: str | None
) -> None:
    cloud = replace(_cloud(scale * 48.0 * sphere_directions(200), unit), unit_from=unit_from)
    fit = fit_on_host(cloud, "direct")
    questions = [note for note in fit.notes if "the earth's" in note]
    assert fit.unit == unit
    assert [asked in question for question in questions] == [True] if asked else questions == []


def test_the_unit_is_not_asked_about_where_the_samples_do_not_determine_the_strength() -> None:
    directions = sphere_directions(4000)
    fit = fit_on_host(_cloud(480.0 * directions[directions[:, 2] > 0.8]), "direct")
    assert fit.condition > 300.0
    assert not any("Are these" in note for note in fit.notes)


def test_what_was_assumed_of_the_file_is_among_the_notes() -> None:
    cloud = replace(_cloud(48.0 * sphere_directions(100)), notes=("Line 1 was skipped.",))
    assert fit_on_host(cloud, "direct").notes[0] == "Line 1 was skipped."


@pytest.mark.parametrize("count", [1, 3, 8])
def test_too_few_points_are_refused_with_that_reason(virtual_board: Board, count: int) -> None:
    cloud = _cloud(golden_points(100)[:count] / 10.0)
    for fit in (fit_on_board(virtual_board, cloud), fit_on_host(cloud)):
        assert set(_verdicts(fit).values()) == {Acceptance.REFUSED}
        for calibrator in fit.calibrators:
            if calibrator.name in _verdicts(fit):
                assert (calibrator.status, calibrator.hard_iron) == ("too few points", None)


def test_the_best_has_the_best_verdict_and_then_the_smallest_direction_error() -> None:
    fit = fit_on_host(_drawn(2, 1000, 1.0, 1.0))
    assert fit.best.direction_error_deg == min(calibrator.direction_error_deg or 90.0 for calibrator in fit.calibrators)
    assert fit.best.residual_percent != min(calibrator.residual_percent or 100.0 for calibrator in fit.calibrators)


def test_all_are_those_of_the_board_and_the_references_of_the_others(virtual_board: Board) -> None:
    cloud, firmware = _drawn(1, 200, 1.0, 0.4), virtual_board.identity.calibrators
    fits = fit_on_board(virtual_board, cloud, ALL).calibrators
    assert [fit.name for fit in fits[: len(firmware)]] == list(firmware)
    assert {fit.name for fit in fits} == REFERENCES.keys() | set(firmware)
    assert [fit.cycles is None for fit in fits] == [fit.name not in firmware for fit in fits]
    assert {calibrator.name for calibrator in fit_on_host(cloud, ALL).calibrators} == REFERENCES.keys() - FASTER
    assert {calibrator.name for calibrator in fit_on_host(cloud).calibrators} == FIRMWARE - FASTER - FOR_COMPARISON


def test_many_calibrators_have_a_row_each_within_80_columns() -> None:
    console = Console(width=100, record=True, file=io.StringIO())
    fit = fit_on_host(_drawn(1, 200, 1.0, 0.4), ALL)
    print_fit(fit, console)
    # The sentences after the table are folded, so that a line may begin with a calibrator's name.
    table = console.export_text().splitlines()[: 6 + len(fit.calibrators)]
    for calibrator in fit.calibrators:
        (row,) = (line.split() for line in table if line.split()[:1] == [calibrator.name])
        assert row[1:4] == [str(calibrator.verdict), calibrator.status, f"{calibrator.radius:.4g}"]
    assert max(map(len, table[1 : 4 + len(fit.calibrators)])) <= 80


def test_an_unknown_calibrator_is_named_with_those_that_are_there(virtual_board: Board) -> None:
    cloud = _cloud(golden_points(20) / 10.0)
    with pytest.raises(ConfigError, match=r"the firmware has no calibrator 'kalman'; it has .*direct") as refusal:
        fit_on_board(virtual_board, cloud, "kalman")
    known = str(refusal.value).partition("known: ")[2].split(", ")
    assert len(set(known)) == len(known)
    with pytest.raises(ConfigError, match="calibrator 'kalman' has no float64 reference"):
        fit_on_host(cloud, "kalman")


def test_what_was_done_to_the_cloud_is_told(virtual_board: Board) -> None:
    points = np.repeat(golden_points(500)[::5] + 33_000.25, 5, axis=0)
    cloud = Samples(Path("cloud.csv"), points, FieldUnit.COUNTS, "assumed", ("1", "2", "3"), 7)
    notes = " ".join(fit_on_board(virtual_board, cloud).notes)
    assert "count as counts of unknown scale" in notes
    assert "7 rows without three finite numbers were skipped" in notes
    assert "400 of 500 readings repeat the one before and were left out" in notes
    assert "1 for 1 counts from the middle of their range; rounding moved a reading by" in notes


def test_a_board_gets_points_from_all_over_the_sphere_and_agrees_with_the_host(virtual_board: Board) -> None:
    """At a stride nine of ten points of this log would be of its rest."""
    turn = hand_turned(1, 1200)
    rest = turn[-1] + np.random.default_rng(1).normal(0.0, 0.3, (10_800, 3))
    fit = fit_on_board(virtual_board, _cloud(np.vstack([turn, rest])))
    most = virtual_board.identity.max_points
    assert {calibrator.n_used for calibrator in fit.calibrators} == {most}
    assert f"The board got {most} of {fit.n_left} points" in " ".join(fit.notes)
    results = {calibrator.name: calibrator.host_difference_deg for calibrator in fit.calibrators}
    # Noise of 0.4 deg in a reading, of 512 of them over nine unknowns; the host's own is as large.
    assert {name: value for name, value in results.items() if value is not None and value > 0.3} == {}
    assert results["direct"] is not None


def test_a_wild_row_is_left_out_and_named(virtual_board: Board) -> None:
    points = golden_points(300) / 10.0
    wild = points.copy()
    wild[[17, 203, 204]] = (900.0, -3.0, 12.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    for fit in (fit_on_board(virtual_board, _cloud(wild)), fit_on_host(_cloud(wild))):
        assert (fit.n_repeated, fit.n_dropped, fit.dropped) == (1, 2, ((18, 18), (204, 205)))
        assert "2 of the 299 readings that repeat none were left out" in " ".join(fit.notes)
        assert "lines 18, 204 to 205, with their repeats" in " ".join(fit.notes)
        assert fit.n_left == 297
        assert fit.best.verdict is Acceptance.GOOD
    assert fit_on_host(_cloud(wild), robust=False).best.verdict is Acceptance.REFUSED
    # By line of the file where it is known.
    read = replace(_cloud(wild), lines=np.arange(300) * 2 + 5)
    assert fit_on_host(read, "direct").dropped == ((39, 39), (411, 413))


def test_repeats_are_counted_completely_also_those_of_outliers(shared_data: Callable[[str], Path]) -> None:  # noqa: F811
    samples = read_samples(shared_data("xio_fusion/sensor_data.csv"))
    fit = fit_on_host(samples, "direct")
    repeats = int((np.diff(samples.points, axis=0) == 0.0).all(axis=1).sum())
    assert (fit.n_in, fit.n_repeated) == (13_514, repeats) == (13_514, 10_845)
    assert fit.n_left == fit.n_in - fit.n_repeated - fit.n_dropped == fit.calibrators[0].n_used
    assert f"{fit.n_dropped} of the 2669 readings that repeat none were left out" in " ".join(fit.notes)


def test_many_left_out_are_a_warning() -> None:
    points = golden_points(300) / 10.0
    points[:75] += np.random.default_rng(1).normal(0.0, 60.0, (75, 3))
    assert "So many may have affected the fit" in " ".join(fit_on_host(_cloud(points)).notes)


def test_a_long_ellipsoid_is_asked_about() -> None:
    points = golden_points(300) / 10.0 * (1.0, 1.0, 0.4)
    fit = fit_on_host(_cloud(points, FieldUnit.COUNTS), "direct")
    assert fit.best.verdict is Acceptance.GOOD
    assert "columns of one magnetometer" in " ".join(fit.notes)


def test_statuses_are_those_of_the_protocol(virtual_board: Board) -> None:
    fit = fit_on_board(virtual_board, _drawn(1, 100, 0.1, 0.1), "direct")
    assert fit.best.status in [status.name.lower().replace("_", " ") for status in FitStatus]
    assert fit.firmware is not None
    assert fit.firmware.cycle_model == virtual_board.cycle_model


def _turned_about_z(noise_ut: float = 0.3) -> Samples:
    angles = np.linspace(0.0, 4.0 * np.pi, 300)
    points = np.column_stack([21.0 * np.cos(angles) + 8.0, 20.0 * np.sin(angles) - 15.0, np.full(300, 44.0)])
    return _cloud(points + np.random.default_rng(1).normal(0.0, noise_ut, points.shape))


def test_a_turn_on_a_table_is_calibrated_to_the_noise(virtual_board: Board) -> None:
    for fit in (fit_on_board(virtual_board, _turned_about_z()), fit_on_host(_turned_about_z())):
        best = fit.best
        assert (best.name, best.verdict, fit.hole) == ("ellipse", Acceptance.FAIR, None)
        # .3 uT in 20.
        assert best.residual_percent == pytest.approx(1.5, rel=0.15)
        assert best.direction_error_deg is not None
        assert best.direction_error_deg < 0.2
        assert best.turn is not None
        assert (best.turn.axis, best.cycles) == ("z", None)
        assert {calibrator.verdict for calibrator in fit.calibrators if calibrator is not best} == {Acceptance.REFUSED}
        assert [reason.figure for reason in best.reasons] == ["shape"]


def test_what_every_calibrator_can_fit_is_fitted_by_no_shape() -> None:
    assert {calibrator.shape for calibrator in fit_on_host(_drawn(1, 400, 0.5, 0.4)).calibrators} == {None}


def test_a_shape_that_would_be_off_as_far_under_strong_iron_is_refused() -> None:
    fit = fit_on_host(_drawn(1, 400, 0.05, 0.4))
    assert fit.best.verdict is Acceptance.REFUSED
    assert {calibrator.shape for calibrator in fit.calibrators} == {None}
    ridge = fit_by_shape(_drawn(1, 400, 0.05, 0.4), Shape.RIDGE).best
    assert ("strong_iron_deg", Acceptance.REFUSED) in [(reason.figure, reason.verdict) for reason in ridge.reasons]


def test_a_patch_of_which_a_quarter_lies_elsewhere_is_refused() -> None:
    cap = _drawn(3, 400, 0.3, 0.4)
    assert fit_on_host(cap).best.name == "ridge"
    spoilt = cap.points.copy()
    spoilt[::4] += 20.0 * sphere_directions(100)
    (ridge,) = fit_by_shape(_cloud(spoilt), Shape.RIDGE).calibrators
    assert ("left_out_percent", Acceptance.REFUSED) in [(reason.figure, reason.verdict) for reason in ridge.reasons]
    assert fit_on_host(_cloud(spoilt)).best.verdict is Acceptance.REFUSED


def test_the_largest_hole_is_named_with_what_to_turn_to() -> None:
    directions = sphere_directions(1000)
    fit = fit_on_host(_cloud(48.0 * directions[directions[:, 0] < 0.1] + (3.0, 4.0, 5.0)))
    assert fit.best.verdict is Acceptance.FAIR
    assert fit.hole is not None
    assert fit.hole.axes == "+x"
    assert fit.hole.radius_deg == pytest.approx(np.degrees(np.arccos(0.1)), abs=4.0)  # directions lie 4 deg apart
    assert "about the sensor's +x: turn it into the direction of the field" in " ".join(fit.notes)


def test_readings_without_calibration_have_the_angle_to_the_best_calibration() -> None:
    read = fit_on_host(_cloud(48.0 * sphere_directions(400) + [4.8, 0.0, 0.0])).as_read
    assert read is not None
    # A shift of a tenth of the radius turns a direction by 0.1 sin(angle) to first order: rms 0.1 sqrt(2/3).
    assert read.direction_error_deg == pytest.approx(np.degrees(0.1 * np.sqrt(2.0 / 3.0)), rel=0.01)
    refused = fit_on_host(_drawn(1, 400, 0.1, 0.1), any_shape=False)
    assert refused.best.verdict is Acceptance.REFUSED
    assert (refused.as_read.name, refused.as_read.direction_error_deg) == ("as read", None)


def test_a_calibration_that_is_worse_than_none_is_named() -> None:
    fit = fit_on_host(_drawn(1, 400, 1.0, 0.4))
    assert fit.worse_than_none == []
    errors = {calibrator.name: calibrator.direction_error_deg or 0.0 for calibrator in fit.calibrators}
    worst = max(errors, key=lambda name: errors[name])
    worse = replace(fit, as_read=replace(fit.as_read, direction_error_deg=0.999 * errors[worst]))
    assert worst in worse.worse_than_none
    assert any(note.startswith(f"{', '.join(worse.worse_than_none)}: worse than as read") for note in notes(worse))


def _reasons(fit: SampleFit) -> dict[str, Acceptance]:
    return {reason.figure: reason.verdict for reason in fit.best.reasons}


@pytest.mark.parametrize("seed", [3, 8, 12])
def test_a_walk_through_a_house_is_refused(seed: int) -> None:
    """Predicted errors are 5 to 9 deg, of true ones of 20 to 26."""
    fit = fit_on_host(_cloud(indoor_walk(seed)))
    assert fit.best.verdict is Acceptance.REFUSED
    ridge = fit_by_shape(_cloud(indoor_walk(seed)), Shape.RIDGE)
    assert _reasons(ridge)["residual_of_spread"] is Acceptance.REFUSED


@pytest.mark.ci
def test_of_two_hundred_walks_at_most_two_give_a_calibration() -> None:
    """A sensor without iron has no error, so any calibration of a walk makes it worse."""
    verdicts = [fit_on_host(_cloud(indoor_walk(seed))).best.verdict for seed in range(200)]
    assert sum(verdict is not Acceptance.REFUSED for verdict in verdicts) <= 2


@pytest.mark.ci
@pytest.mark.parametrize(("smallest_ut", "largest_ut"), [(1.5, 6.0), (10.0, 100.0)])
def test_of_two_hundred_clouds_with_iron_none_is_refused(smallest_ut: float, largest_ut: float) -> None:
    """Also with hard iron that is hardly larger than the noise of 0.2 to 0.6 uT."""
    for seed in range(200):
        random = np.random.default_rng(seed)
        directions = gaussian_filter1d(random.normal(size=(1500, 3)), 20.0, axis=0)
        iron_ut = random.normal(size=3)
        iron_ut *= random.uniform(smallest_ut, largest_ut) / np.linalg.norm(iron_ut)
        points_ut = 48.0 * directions / np.linalg.norm(directions, axis=1, keepdims=True) + iron_ut
        points_ut += random.normal(0.0, random.uniform(0.2, 0.6), (1500, 3))
        fit = fit_on_host(_cloud(points_ut))
        assert fit.best.verdict is Acceptance.GOOD
        np.testing.assert_allclose(fit.best.hard_iron, iron_ut, atol=0.5)  # a third of the smallest


def test_a_sensor_without_iron_is_refused_and_one_with_iron_of_its_noise_is_not() -> None:
    random = np.random.default_rng(2)
    clean = 48.0 * sphere_directions(1000) + random.normal(scale=0.6, size=(1000, 3))
    fit = fit_on_host(_cloud(clean))
    assert _reasons(fit) == {"residual_of_spread": Acceptance.REFUSED}
    little = fit_on_host(_cloud(clean + np.array([0.9, 0.0, 0.0])))
    residual = (little.best.residual_percent or 0.0) / (little.as_read.residual_percent or 1.0)
    assert residual > 0.5
    assert little.best.verdict is Acceptance.GOOD


def test_halves_that_contradict_each_other_are_refused_whatever_the_shape() -> None:
    points = hand_turned(1, 1600)
    points[800:] += (6.0, 0.0, 0.0)
    fit = fit_on_host(_cloud(points))
    assert _reasons(fit)["halves_difference"] is Acceptance.REFUSED
    assert {calibrator.shape for calibrator in fit.calibrators} == {None}
    assert "halves_difference" not in _reasons(fit_on_host(_cloud(hand_turned(1, 1600))))


def test_a_known_strength_is_compared_and_needs_a_unit() -> None:
    fit = fit_on_host(_drawn(1, 400, 1.0, 0.4), field_ut=40.0)
    assert f"The radius is {fit.best.radius / 40.0:.2f} of the field" in " ".join(fit.notes)
    with pytest.raises(ConfigError, match="cannot be compared with counts"):
        fit_on_host(_cloud(golden_points(100), FieldUnit.COUNTS), field_ut=48.0)
